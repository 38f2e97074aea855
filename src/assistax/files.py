"""Files that the program takes in and writes; whatever is wrong with one is a UsageError of one line that names it.

A schema says what JSON must be: a type (str, bool, int, float for any finite number, object for anything), None, a
range (a whole number in it), a tuple (one of several schemas), [schema] (a list) or {"name": schema} (an object). In
an object "name?" may be absent, and `str` stands for all other names, which are otherwise ignored.
"""

import json
import math
import os
import reprlib
import uuid
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from assistax.errors import UsageError

Schema = Any
_LEAVES = {str: "text", bool: "true or false", int: "a whole number", float: "a finite number", None: "null"}


# -- reading -----------------------------------------------------------------------------------


def read_json(path: Path, schema: Schema) -> Any:
    """The content of a JSON file that fits `schema`."""
    return parse_json(_read_bytes(path), schema, str(path))


def read_rows(path: Path, schema: Schema) -> list[dict[str, Any]]:
    """The rows of a JSON-lines file, which fit `schema`; none if there is no file.

    A last line that is not JSON was cut short by a crash, and is left out.
    """
    if not path.exists():
        return []
    lines, rows = _read_bytes(path).splitlines(), []
    for number, line in enumerate(lines, 1):
        try:
            rows.append(_loads(line))
        except ValueError as error:
            if number < len(lines):
                raise UsageError(f"Cannot read line {number} of {len(lines)} in {path}: {error}.") from None
            break
        if wrong := mismatch(rows[-1], schema):
            raise UsageError(f"Cannot read line {number} of {len(lines)} in {path}: {wrong}.")
    return rows


def parse_json(content: bytes | str, schema: Schema, source: str) -> Any:
    """JSON that fits `schema`; `source` is what an error calls it."""
    try:
        value = _loads(content)
    except ValueError as error:
        raise UsageError(f"Cannot read {source}: {error}.") from None
    if wrong := mismatch(value, schema):
        raise UsageError(f"Cannot read {source}: {wrong}.")
    return value


def mismatch(value: Any, schema: Schema, name: str = "") -> str | None:
    """What of a JSON value does not fit a schema, in words; None if all fits."""
    if schema is object:
        return None
    if isinstance(schema, dict):
        return _mismatch_in_object(value, schema, name)
    if isinstance(schema, list):
        if not isinstance(value, list):
            return f"{_called(name)} must be a list, not {reprlib.repr(value)}"
        each = (mismatch(one, schema[0], f"{name}[{i}]") for i, one in enumerate(value))
        return next(filter(None, each), None)
    schemas = schema if isinstance(schema, tuple) else (schema,)
    for one in schemas:
        if isinstance(one, (dict, list)):
            if isinstance(value, type(one)):
                return mismatch(value, one, name)
        elif _is_leaf(value, one):
            return None
    words = [_words(one) for one in schemas]
    return f"{_called(name)} must be {' or '.join(words)}, not {reprlib.repr(value)}"


def _mismatch_in_object(value: Any, schema: dict, name: str) -> str | None:
    if not isinstance(value, dict):
        return f"{_called(name)} must be an object, not {reprlib.repr(value)}"
    inner = {key.removesuffix("?"): one for key, one in schema.items() if key is not str}
    if missing := [key for key in inner if key not in value and key in schema]:
        return f"{_called(name)} has no {missing[0]}"
    if str in schema:
        inner = dict.fromkeys(value, schema[str]) | inner
    each = (mismatch(value[key], one, f"{name}.{key}".lstrip(".")) for key, one in inner.items() if key in value)
    return next(filter(None, each), None)


def _is_leaf(value: Any, schema: Schema) -> bool:
    if isinstance(schema, range):
        return type(value) is int and value in schema
    if schema is float:
        return type(value) in (int, float) and math.isfinite(value)
    return value is None if schema is None else type(value) is schema


def _words(schema: Schema) -> str:
    if isinstance(schema, range):
        return f"a whole number from {schema[0]} to {schema[-1]}"
    return "an object" if isinstance(schema, dict) else "a list" if isinstance(schema, list) else _LEAVES[schema]


def _called(name: str) -> str:
    return name or "it"


def _loads(content: bytes | str) -> Any:
    """JSON; every reason why it is none is a ValueError of one line."""
    try:
        return json.loads(content.decode() if isinstance(content, bytes) else content, parse_int=_int)
    except UnicodeDecodeError:
        raise ValueError("it is not UTF-8 text") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"it is not JSON ({error})") from None
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _int(digits: str) -> int:
    if len(digits) > 18:  # all that fits is one in 64 bits
        raise ValueError(f"the number {digits[:18]}... is too long")
    return int(digits)


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise UsageError(f"Cannot read {path}: {error.strerror}.") from None


# -- writing -----------------------------------------------------------------------------------


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that a reader, another writer or a crash sees the old content or the new, never a part."""
    part = path.with_name(f"{path.name}.{uuid.uuid4().hex[:8]}.part")
    try:
        with writing(path):
            with open(part, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, path)
    except UsageError:
        with suppress(OSError):
            part.unlink()
        raise


def write_json(path: Path, content: Any) -> None:
    """Write an indented JSON file, atomically."""
    write_atomically(path, json.dumps(content, indent=2).encode())


def check_folder(path: Path) -> None:
    """Raise UsageError unless the folder that a file of --out is to be in exists."""
    if not path.parent.is_dir():
        raise UsageError(f"The folder {path.parent} of --out does not exist.")


@contextmanager
def writing(path: Path) -> Generator[None]:
    """What cannot be written inside is a UsageError that names `path`: a full disk, a folder without the right to."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error).strip().partition("\n")[0]
        raise UsageError(f"Cannot write {path}: {reason}.") from None
