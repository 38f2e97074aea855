"""Code out of the pages in docs/, as modules of somebody else's package."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import assistax

DOCS = Path(assistax.__file__).parents[2] / "docs"


def python_blocks(page: Path) -> list[str]:
    """The Python code of a page, block by block."""
    return re.findall(r"^```python\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)


def imported(path: Path, code: str) -> ModuleType:
    """The module that this code makes, in a file of its own."""
    path.write_text(code)
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec and spec.loader
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    finally:
        del sys.modules[path.stem]
    return module
