"""The pages for those who build on the package: their code runs as it stands."""

import importlib
import re

import pytest
from pages import DOCS, imported, python_blocks

PAGES = ("your_task", "your_algorithm", "your_arm", "your_training_code", "your_method")


@pytest.mark.parametrize("page", PAGES)
def test_the_code_of_a_page_runs(page, tmp_path, registries, capsys):
    blocks = python_blocks(page)
    assert blocks
    imported(tmp_path / f"{page}.py", "\n\n".join(blocks))
    assert "nan" not in capsys.readouterr().out


def test_readme_names_the_pages():
    readme = (DOCS.parent / "README.md").read_text()
    assert not [page for page in DOCS.glob("your_*.md") if f"docs/{page.name}" not in readme]


@pytest.mark.parametrize("page", ["docs/design.md", "docs/experts.md", "README.md", "CONTRIBUTING.md"])
def test_the_files_that_a_page_names_are_there(page):
    root = DOCS.parent
    named = re.findall(r"`([\w./]+(?:\.py|/))`", (root / page).read_text())
    places = (root, root / "src/assistax")
    assert not [name for name in named if not any((place / name).exists() for place in places)]


def test_the_pages_of_the_tasks_are_what_the_tasks_say(monkeypatch):
    """Made anew by `python tools/pages.py tasks`, all but the pictures."""
    root = DOCS.parent
    monkeypatch.syspath_prepend(str(root / "tools"))
    for path, text in importlib.import_module("task_pages").pages().items():
        assert (root / path).read_text() == text, f"{path}: python tools/pages.py tasks"
        for picture in re.findall(r"!\[.*\]\((.*)\)", text):
            assert ((root / path).parent / picture).stat().st_size < 150_000
