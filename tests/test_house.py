"""How the package is built: rooms on floors, and no import that runs up or in a circle.

Imports are read from the source, those inside functions included.
"""

import ast
from pathlib import Path

import assistax

ROOT = Path(assistax.__file__).parent
# From the ground up: a folder, or a file of the package itself. Nobody imports from further right than it stands.
FLOORS = (
    ("errors", "inference"),
    ("pytree", "filters", "programs", "devices", "files", "stamp", "registry", "settings", "spaces"),
    ("formats", "executors"),
    ("scenes",),
    ("physics",),
    ("human",),
    ("tasks",),
    ("episode", "senses", "motors"),
    ("env",),
    ("policies",),
    ("learning",),
    ("evaluation",),
    ("viewer",),
    ("results",),
    ("training",),
    ("teamwork",),
    ("adapters", "diagnostics"),
    ("experiments",),
    ("cli",),
    ("__main__",),
)


def imports() -> dict[str, set[str]]:
    """By module, dotted and without the package's name, the modules that it imports."""
    modules = {}
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT).with_suffix("").parts
        modules[".".join(part for part in parts if part != "__init__") or "assistax"] = path
    found = {}
    for name, path in modules.items():
        found[name] = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import) and name not in ("assistax", "cli"):  # the command wants its version
                assert not [one.name for one in node.names if one.name.split(".")[0] == "assistax"], name
            assert not (isinstance(node, ast.ImportFrom) and node.level), f"{name}: name the package"
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("assistax"):
                place = node.module.removeprefix("assistax").removeprefix(".")
                inside = [f"{place}.{alias.name}".removeprefix(".") for alias in node.names]
                found[name] |= {one if one in modules else place or "assistax" for one in inside}
        found[name] -= {name}
    return found


def floor(module: str) -> int:
    room = module.partition(".")[0]
    places = [i for i, rooms in enumerate(FLOORS) if room in rooms]
    assert places, f"{room} is not in the house; give it a floor."
    return places[0]


def test_nothing_imports_from_above():
    up = [
        f"{name} imports {other}"
        for name, others in imports().items()
        for other in others
        if "assistax" not in (name, other) and floor(other) > floor(name)
    ]
    assert not up, up


def test_no_import_runs_in_a_circle():
    """Between modules; a package's __init__ is what it re-exports, and its own files do not import it."""
    left = {name: others - {"assistax"} for name, others in imports().items() if name != "assistax"}
    while free := [name for name, others in left.items() if not others & set(left)]:
        for name in free:
            del left[name]
    circle = {name: others & set(left) for name, others in left.items()}
    assert not circle, circle
