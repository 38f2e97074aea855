"""`assistax settings`."""

import ast
import dataclasses
import inspect
import re
import shutil
import textwrap
from collections.abc import Iterator
from typing import Annotated, Any

import tyro

from assistax.cli.common import Json, Name, print_json

Rows = dict[str, tuple[Any, str]]
"""By full name ("ppo.gamma") the default and the meaning."""


def settings(
    task: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="TASK", help_behavior_hint="")] = None,
    *,
    algorithm: Name = None,
    preset: Name = None,
    json: Json = False,
) -> None:
    """List every setting that --set can change: name, default, meaning.

    For example:
      assistax settings
      assistax settings feeding --algorithm masac

    Args:
      task: with its own settings (task_config.*) and the presets for it; `assistax tasks` lists them.
      algorithm: of this algorithm only.
      preset: whose values are shown: default, or paper for the paper's table.
      json: print JSON.
    """
    rows = listing(task, algorithm, preset)
    if json:
        print_json({name: {"default": default, "meaning": meaning} for name, (default, meaning) in rows.items()})
    else:
        print(as_text(rows))


def listing(task: str | None = None, algorithm: str | None = None, preset: str | None = None) -> Rows:
    """The settings of a task and an algorithm; without them, of what all tasks share, and of every group."""
    from assistax.learning.algorithms import ALGORITHMS
    from assistax.tasks import TASKS
    from assistax.training.configuration import FLAGS, configure

    first_of: dict[str, str] = {}
    for name, kind in ALGORITHMS.items():
        first_of.setdefault(kind.group, name)
    rows: Rows = {}
    for name in [algorithm] if algorithm else first_of.values():
        config = configure(task or next(iter(TASKS)), {}, algorithm=name, preset=preset)
        left_out = {*FLAGS, "partner_copies"} | (set() if task else {"task_config"})
        rows |= {name: row for name, row in _rows(config) if name.partition(".")[0] not in left_out}
    return rows


def as_text(rows: Rows) -> str:
    """A line or more for each setting."""
    width = max(60, min(120, shutil.get_terminal_size().columns))
    lines = []
    for name, (default, meaning) in rows.items():
        shown = default if isinstance(default, str) else str(default)
        lines += textwrap.wrap(f"{name}={shown}  {meaning}", width, subsequent_indent=" " * 6, break_on_hyphens=False)
    return "\n".join(lines)


def meanings(config_type: type) -> dict[str, str]:
    """By field of a dataclass the comments above and behind it in the source; "" where there is none."""
    found = dict.fromkeys((field.name for field in dataclasses.fields(config_type)), "")  # ty: ignore[invalid-argument-type]
    try:
        source = textwrap.dedent(inspect.getsource(config_type))
    except (OSError, TypeError):  # typed into an interpreter
        return found
    lines = source.splitlines()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.end_lineno:
            behind = lines[node.end_lineno - 1].encode()[node.end_col_offset :].decode().strip()
            above, at = [], node.lineno - 2
            while lines[at].strip().startswith("#"):
                above.insert(0, lines[at].strip())
                at -= 1
            parts = [" ".join(re.sub(r"^#\s*", "", line) for line in part) for part in (above, [behind])]
            found[node.target.id] = "; ".join(part.rstrip(".") for part in parts if part)
    return found


def _rows(config: Any, prefix: str = "") -> Iterator[tuple[str, tuple[Any, str]]]:
    known, renamed = meanings(type(config)), getattr(config, "renamed", {})
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), prefix + renamed.get(field.name, field.name)
        if dataclasses.is_dataclass(value):
            yield from _rows(value, f"{name}.")
        else:
            yield name, (value, known[field.name])
