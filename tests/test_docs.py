"""The pages for those who build on the package: their code runs as it stands."""

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
