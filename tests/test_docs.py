"""The pages for those who build on the package: their code runs as it stands."""

import importlib.util
import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from pages import DOCS, imported, python_blocks

WITH_CODE = [
    path for path in [DOCS.parent / "README.md", *sorted(DOCS.rglob("*.md"))] if "```python" in path.read_text()
]
SLOW = {
    "training.md",
    "adapters.md",
    "populations.md",
}  # compile more than others; tests of their own cover what they use
ELSEWHERE = ("runs/", "checkpoints/", "populations/", ".site/")  # folders that commands make
SMALLER = {"1024": "4", "range(100)": "range(2)"}  # sizes that a page names, and those of the test


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, id=page.stem, marks=[pytest.mark.slow] * (page.name in SLOW)) for page in WITH_CODE],
)
@pytest.mark.filterwarnings("ignore:.*(infinity|precision).*")  # Gymnasium's, of observations without bounds
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # other packages', of themselves
def test_the_code_of_a_page_runs(page, tmp_path, registries, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("populations").mkdir()  # pages make others beside these
    for population in (DOCS.parent / "populations").iterdir():
        Path("populations", population.name).symlink_to(population)
    code = "\n\n".join(block for block in python_blocks(page) if can_run(block))
    for size, smaller in SMALLER.items():
        code = code.replace(size, smaller)
    imported(tmp_path / f"{page.stem}.py", code)
    assert "nan" not in capsys.readouterr().out


NOT_OURS = ("torch", "torchrl", "benchmarl", "stable_baselines3")  # too large for the test set


def can_run(block):
    """Whether what it imports is installed, as far as we do not install it."""
    needed = {name for name in NOT_OURS if re.search(rf"^(from|import) .*\b{name}\b", block, re.MULTILINE)}
    return all(importlib.util.find_spec(name) for name in needed)


def test_the_site_shows_every_page():
    """tools/site.py fails for broken links, this for pages that nobody would find."""
    root = DOCS.parent
    site = tomllib.loads((root / "zensical.toml").read_text())["project"]

    def pages(nav):
        for entry in nav:
            for where in entry.values():
                yield from [where] if isinstance(where, str) else pages(where)

    shown = list(pages(site["nav"]))
    assert {str(path.relative_to(root)) for path in DOCS.rglob("*.md")} <= set(shown)
    assert all((root / page).exists() for page in shown)


def test_readme_names_the_pages():
    readme = (DOCS.parent / "README.md").read_text()
    assert not [page for page in DOCS.glob("your_*.md") if f"docs/{page.name}" not in readme]


PAGES = [
    str(path.relative_to(DOCS.parent))
    for path in (*sorted(DOCS.rglob("*.md")), *(DOCS.parent / name for name in ("README.md", "CONTRIBUTING.md")))
]


@pytest.mark.parametrize("page", PAGES)
def test_what_a_page_names_is_there(page):
    """Files of the repository, in code and as targets of links."""
    root = DOCS.parent
    text = re.sub(r"^```.*?^```$", "", (root / page).read_text(), flags=re.DOTALL | re.MULTILINE)
    places = (root, root / "src", root / "src/assistax")
    named = [name for name in re.findall(r"`([\w.]+/[\w./]*(?:\.py|/))`", text) if not name.startswith(ELSEWHERE)]
    assert not [name for name in named if not any((place / name).exists() for place in places)]
    links = [link.partition("#")[0] for link in re.findall(r"\]\(([^)\s]+)\)", text) if "://" not in link]
    assert not [link for link in links if link and not ((root / page).parent / link).exists()]


def test_the_pages_of_the_tasks_are_what_the_tasks_say(monkeypatch):
    """Made anew by `python tools/pages.py tasks`, all but the pictures."""
    root = DOCS.parent
    for path, text in tool("task_pages", monkeypatch).pages().items():
        assert (root / path).read_text() == text, f"{path}: python tools/pages.py tasks"
        for picture in re.findall(r"!\[.*\]\((.*)\)", text):
            assert ((root / path).parent / picture).stat().st_size < 150_000


def test_the_page_of_the_populations_is_what_they_are(monkeypatch, tmp_path):
    """Made anew by `python tools/pages.py populations`."""
    root = DOCS.parent
    made = tool("population_page", monkeypatch).page(root / "populations", root / "results/teamwork", tmp_path)
    assert (DOCS / "partners.md").read_text() == made, "python tools/pages.py populations"
    assert all((DOCS / "images" / picture.name).exists() for picture in tmp_path.iterdir())


def test_the_table_of_ways_leaves_out_who_learned_together(monkeypatch):
    """Two of one way and one of another, with 1 for everybody's own robot."""
    success = np.array([[1.0, 0.5, 0.25], [0.75, 1.0, 0.0], [0.0, 0.5, 1.0]])
    matrix = {"success": success, "safe_success": success}
    people = [{"disability": body, "preference": "none"} for body in "xyy"]
    rows = [{"taught": way, "person": person} for way, person in zip("aab", people, strict=True)]
    page = tool("population_page", monkeypatch)
    lines = page._by_taste(rows, matrix).splitlines()
    assert [line.split("|")[2:4] for line in lines[5:7]] == [[" 62% ", " 12% "], [" 25% ", "  "]]
    assert [line.split("|")[2:4] for line in lines[-4:]] == [
        [" 3 ", " 100% "],
        [" 2 ", " 25% "],  # one body, two ways
        [" 2 ", " 62% "],  # two bodies, one way
        [" 2 ", " 12% "],
    ]
    assert page._by_taste([row | {"taught": ""} for row in rows], matrix) == ""
    # Who likes something is told by that, whatever they were taught, and by what it pays.
    liking = [row | {"taught": "a", "person": row["person"] | {"preference": row["taught"]}} for row in rows]
    paid = page._by_taste(liking, matrix | {page.PAID: 100 * success}).splitlines()
    assert [line.split("|")[2:4] for line in paid[5:7]] == [[" 62 ", " 12 "], [" 25 ", "  "]]
    assert [line.split("|")[3:5] for line in paid[-4:]] == [
        [" 100% ", " 100 "],
        [" 25% ", " 25 "],
        [" 62% ", " 62 "],
        [" 12% ", " 12 "],
    ]


def test_the_page_of_strangers_is_what_was_measured(monkeypatch, tmp_path):
    """Made anew by `python tools/pages.py strangers`."""
    made = tool("strangers_page", monkeypatch).page(DOCS.parent / "results/teamwork", tmp_path)
    assert (DOCS / "strangers.md").read_text() == made, "python tools/pages.py strangers"
    assert all((DOCS / "images" / picture.name).exists() for picture in tmp_path.iterdir())


def test_strangers_by_kind_are_means_over_those_of_that_kind(monkeypatch):
    """Three strangers of two bodies, taught two ways; the last one's own robot is not kept."""
    people = [{"disability": body, "preference": "none", "taught": way} for body, way in zip("xxy", "aba", strict=True)]
    part = {
        "references": {"own": {"safe_success": {"by_pair": [[1.0, 0.5, None]]}}},
        "methods": {"br": {"safe_success": {"by_pair": [[0.2, 0.4, 0.8], [0.2, 0.4, 1.0]]}}},
    }
    page = tool("strangers_page", monkeypatch)
    lines = page._by_kind(people, part).splitlines()
    assert [cell.strip() for cell in lines[0].split("|")[1:-1]] == ["robot", "x", "y", "a", "b"]
    assert [cell.strip() for cell in lines[2].split("|")[1:-1]] == ["their own", "75%", "", "100%", "50%"]
    assert [cell.strip() for cell in lines[3].split("|")[1:-1]] == ["br", "30%", "90%", "55%", "40%"]
    # What preferences pay is of both parts together: here the same three people twice, paid 100 more as strangers.
    paid = [
        {group: {name: {page.PAID: {"by_pair": [[10, 20, more]]}} for name in part[group]} for group in part}
        for more in (60, 160)
    ]
    found = {"train": paid[0], "test": paid[1], "people": {"train": people, "test": people}}
    lines = page._liked(found).strip().splitlines()
    assert [cell.strip() for cell in lines[-1].split("|")[1:-1]] == ["br", "15", "110", "60", "20"]
    assert page._liked(found | {"train": part}) == ""


def test_the_notebook_is_the_page(monkeypatch):
    """Made anew by `python tools/pages.py notebook`."""
    made = tool("notebook", monkeypatch).notebook((DOCS / "first_steps.md").read_text())
    assert (DOCS / "first_steps.ipynb").read_text() == made, "python tools/pages.py notebook"


@pytest.mark.slow
def test_the_notebook_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cells = json.loads((DOCS / "first_steps.ipynb").read_text())["cells"]
    names = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert names["report"]["episodes"] == 2 and names["picture"].size == (320, 240)


def tool(name, monkeypatch):
    """A module of tools/."""
    monkeypatch.syspath_prepend(str(DOCS.parent / "tools"))
    return importlib.import_module(name)
