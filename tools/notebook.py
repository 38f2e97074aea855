"""docs/first_steps.ipynb, out of the page of the same name; tools/pages.py writes it."""

import json
import re
from pathlib import Path
from typing import Any

PAGE, NOTEBOOK = Path("docs/first_steps.md"), Path("docs/first_steps.ipynb")
INSTALL = "# Where Assistax is not installed yet:\n# %pip install assistax"


def notebook(page: str) -> str:
    """The page as a notebook without outputs: Python blocks are cells of code, all between them cells of text."""
    title, *rest = re.split(r"^```python\n(.*?)^```$", page, flags=re.DOTALL | re.MULTILINE)
    cells = [_cell("markdown", title), _cell("code", INSTALL)]
    for i, text in enumerate(rest):
        cells.append(_cell("markdown" if i % 2 else "code", text))
    for i, cell in enumerate(cells):
        cell["id"] = f"cell-{i}"
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    about = {"kernelspec": kernel, "language_info": {"name": "python"}}
    return json.dumps({"cells": cells, "metadata": about, "nbformat": 4, "nbformat_minor": 5}, indent=1) + "\n"


def _cell(kind: str, text: str) -> dict[str, Any]:
    cell = {"cell_type": kind, "metadata": {}, "source": text.strip().splitlines(keepends=True)}
    return cell | ({"execution_count": None, "outputs": []} if kind == "code" else {})
