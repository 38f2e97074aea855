"""Settings as frozen dataclasses: change them by name, write them to JSON, read them back."""

import ast
import dataclasses
import math
import sys
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Any, TypeVar

from assistax.errors import UsageError, choose

T = TypeVar("T")


def with_settings(config: T, settings: Mapping[str, Any], also: Iterable[str] = (), prefix: str = "") -> T:
    """A copy of the dataclass `config` with fields replaced by name, values cast to their types.

    A name may reach into nested dataclasses ("ppo.learning_rate"). `also` are names that the
    caller would have accepted, listed when a name is unknown. A configuration may have an attribute `renamed`:
    fields that are set by another name.
    """
    hints = typing.get_type_hints(type(config))
    renamed = getattr(config, "renamed", {})
    fields = {renamed.get(name, name): name for name in hints}
    changes: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}
    for name, value in settings.items():
        head, _, rest = name.partition(".")
        if head not in fields and (longer := _inside(config, head, prefix)):
            raise UsageError(f"Unknown setting {prefix + head!r}. Did you mean {longer + name.removeprefix(head)!r}?")
        choose("setting", prefix + head, [prefix + n for n in (*fields, *also)])
        inner = getattr(config, fields[head])
        if dataclasses.is_dataclass(inner) and not isinstance(value, type(inner)):
            if rest:
                nested.setdefault(head, {})[rest] = value
            elif isinstance(value, Mapping):
                nested.setdefault(head, {}).update(value)
            else:
                parts = ", ".join(f"{prefix}{head}.{f.name}" for f in dataclasses.fields(inner))
                raise UsageError(f"{prefix}{head} is a group; set one of {parts}.")
        elif rest:
            raise UsageError(f"{prefix}{head} has no parts, so {prefix}{name} does not exist.")
        else:
            changes[fields[head]] = _cast(prefix + head, hints[fields[head]], value)
    for head, values in nested.items():
        changes[fields[head]] = with_settings(getattr(config, fields[head]), values, prefix=f"{prefix}{head}.")
    return dataclasses.replace(config, **changes)  # ty: ignore[invalid-argument-type]


def _inside(config: Any, name: str, prefix: str) -> str | None:
    """The full name of the setting called `name` in one of the groups of a configuration."""
    for field in dataclasses.fields(config):
        inner = getattr(config, field.name)
        if dataclasses.is_dataclass(inner):
            if any(one.name == name for one in dataclasses.fields(inner)):
                return f"{prefix}{field.name}.{name}"
            if found := _inside(inner, name, f"{prefix}{field.name}."):
                return found
    return None


def check_count(name: str, value: int) -> None:
    """Raise UsageError unless so many can be counted, from 1 on, in the 32 bits that JAX has for it."""
    if not 1 <= value < 2**31:
        raise UsageError(f"{name} must be {'1 or more' if value < 1 else 'below 2^31'}, not {value}.")


def check_measures(group: str, config: Any) -> None:
    """Raise UsageError unless numbers are finite and 0 or more, and pairs begin with the smaller.

    A field that may be negative says so: `field(default=-1.0, metadata={"signed": True})`.
    """
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), f"{group}.{field.name}"
        if isinstance(value, tuple) and len(value) == 2 and all(isinstance(x, int | float) for x in value):
            if not -math.inf < value[0] <= value[1] < math.inf:
                raise UsageError(f"{name} must be two finite numbers, the smaller first, not {value}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            low = -sys.float_info.max if field.metadata.get("signed") else 0.0
            if not low <= value < math.inf:
                what = "finite" if field.metadata.get("signed") else "0 or more"
                raise UsageError(f"{name} must be {what}, not {value}.")


def check_seed(name: str, value: int) -> None:
    """Raise UsageError unless it is a seed of its own: JAX takes 32 bits of it."""
    if not 0 <= value < 2**32:
        raise UsageError(f"{name} must be from 0 to 2^32 - 1, not {value}.")


def parse_assignments(assignments: Iterable[str], option: str = "--set") -> dict[str, Any]:
    """["a.b=1", "c=x"] to {"a.b": 1, "c": "x"}; `option` is where they come from."""
    settings = {}
    for text in assignments:
        name, equals, value = text.partition("=")
        if not equals or not name:
            example = "ppo.learning_rate=3e-4" if option == "--set" else "cores=4"
            raise UsageError(f"{option} takes NAME=VALUE, for example {example}, not {text!r}.")
        if name in settings:
            raise UsageError(f"{option} has {name} twice; leave out one.")
        try:
            settings[name] = ast.literal_eval(value)
        except (ValueError, SyntaxError):
            settings[name] = {"true": True, "false": False}.get(value.lower(), value)
    return settings


def _cast(name: str, hint: Any, value: Any) -> Any:
    kind = typing.get_origin(hint) or hint
    if kind is types.UnionType:
        return value  # several types will do; the dataclass itself says which values
    inner = typing.get_args(hint)
    if kind is tuple and isinstance(value, str) and inner[0] is str:
        value = [word for word in value.split(",") if word]  # as one writes them on a command line
    if kind is tuple and isinstance(value, (list, tuple)):
        if Ellipsis not in inner and len(inner) != len(value):
            raise UsageError(f"{name} takes {len(inner)} values, not {len(value)}.")
        return tuple(_cast(name, inner[0], v) for v in value)
    if kind is float and isinstance(value, int | float) and not isinstance(value, bool):
        if abs(value) > sys.float_info.max or not math.isfinite(value):
            raise UsageError(f"{name} must be a finite number, not {value}.")
        return float(value)
    if kind is int and isinstance(value, float) and value.is_integer():
        return int(value)
    if not isinstance(value, kind) or (kind is not bool and isinstance(value, bool)):
        expected = {int: "a whole number", float: "a number", bool: "true or false", str: "a word"}
        raise UsageError(f"{name} must be {expected.get(kind, 'a list like (1, 2)')}, not {value!r}.")
    return value
