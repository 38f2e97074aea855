"""Pytrees in safetensors files: written whole or not at all, refused when damaged or when they do not fit.

Beside the arrays a file holds "about" (JSON) and "sha256", by name the hash of the bytes, shape and dtype of each array
and, under "", of the bytes of "about". Files of earlier versions lack it, and are read without.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from assistax.errors import UsageError
from assistax.files import Schema, parse_json, write_atomically

FORMAT = "assistax-checkpoint-1"
WEIGHTS = (".params", ".normalizer")  # of a trainer's state: where anything not finite is damage
EVERYTHING = ("",)


class Damaged(UsageError):
    """A checkpoint or team file that does not hold what was saved; `spared` tells which older ones still do."""

    def __init__(self, path: Path, what: str, spared: Callable[[Path], bool] = lambda older: True):
        older = [p for p in path.parent.glob("step_*.safetensors") if path.stem.startswith("step_") and p < path]
        older = [p for p in older if spared(p)]
        advice = f"Remove it to continue from {max(older).name}" if older else "Restore it from a copy"
        super().__init__(f"{path} is damaged: {what}. {advice}.")


def save_checkpoint(path: Path, tree: Any, metadata: dict[str, Any]) -> str:
    """Save the leaves of `tree` by their names, and `metadata` (JSON) beside them; returns `content_hash`."""
    arrays = {name: np.asarray(_plain(leaf), order="C") for name, leaf in _named(tree)}
    about = json.dumps(metadata)
    sums = {name: _sum(array) for name, array in arrays.items()} | {"": _sha256(about.encode())}
    header = {"format": FORMAT, "about": about, "sha256": json.dumps(sums)}
    write_atomically(path, save(arrays, header))
    return _content_hash(sums)


def read_metadata(path: Path, schema: Schema = object) -> dict[str, Any]:
    """The metadata of a checkpoint, which fits `schema`; raises UsageError if the file is none or damaged."""
    with _opened(path) as file:
        _checksums(path, file)
        return parse_json(file.metadata()["about"], schema, f"what {path} says of itself")


def newest_checkpoint(folder: Path) -> Path | None:
    """Of a run's folder; None if there is none."""
    return max((folder / "checkpoints").glob("step_*.safetensors"), default=None)


def content_hash(path: Path) -> str:
    """SHA-256 of all that was saved in a file, names and metadata included; of the file itself if it has no sums."""
    with _opened(path) as file:
        sums = _checksums(path, file)
        for name in sorted(file.keys()):
            _array(path, file, name, sums)
    return _content_hash(sums) if sums else _sha256(path.read_bytes())


def load_checkpoint(path: Path, like: Any, part: str = "", finite: Sequence[str] = WEIGHTS) -> Any:
    """The pytree in a checkpoint, which must have the names, shapes and dtypes of `like`, or floats of another size.

    With `part` (".params") only what is stored under that name; `like` is then that part. What is stored under
    `finite` must be.
    """
    leaves = []
    with _opened(path) as file:
        sums = _checksums(path, file)
        stored = set(file.keys())
        for name, leaf in _named(like):
            name = part + name
            if name not in stored:
                raise UsageError(f"{path} does not fit this configuration: it has no {name}.")
            value, (shape, dtype) = _array(path, file, name, sums), _stored_as(leaf)
            if value.shape != shape:
                raise UsageError(f"{path} does not fit this configuration: {name} is {value.shape}, not {shape}.")
            if value.dtype != dtype and {value.dtype.kind, dtype.kind} != {"f"}:
                raise UsageError(f"{path} does not fit this configuration: {name} is {value.dtype}, not {dtype}.")
            if name.startswith(tuple(finite)) and value.dtype.kind == "f" and not np.isfinite(value).all():
                raise Damaged(path, f"{name} has numbers that are not finite")
            array = jax.numpy.asarray(value, dtype)
            leaves.append(jax.random.wrap_key_data(array) if _is_key(leaf) else array)
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


# -- what lies in the file ---------------------------------------------------------------------


@contextmanager
def _opened(path: Path):
    try:
        file = safe_open(path, "numpy")
    except OSError as error:
        raise UsageError(f"Cannot read {path}: {error.strerror or error}.") from None
    except (SafetensorError, ValueError) as error:
        raise Damaged(path, f"it is not a safetensors file ({error})") from None
    with file:
        yield file


def _checksums(path: Path, file) -> dict[str, str]:
    """By name the hashes that the arrays must have, {} in files of earlier versions; checks names and "about" here."""
    header = file.metadata() or {}
    if header.get("format") != FORMAT:
        raise UsageError(f"{path} is not an Assistax checkpoint (format {header.get('format')!r}).")
    if header.keys() | {"sha256"} != {"format", "about", "sha256"}:
        raise Damaged(path, "its header is not that of a checkpoint")
    if "sha256" not in header:
        return {}
    sums = parse_json(header["sha256"], {str: str}, f"the checksums of {path}")
    if sums.keys() != {"", *file.keys()}:
        raise Damaged(path, "it does not hold the arrays that were saved")
    if sums[""] != _sha256(header["about"].encode()):
        raise Damaged(path, "its metadata is not what was saved")
    return sums


def _array(path: Path, file, name: str, sums: dict[str, str]) -> np.ndarray:
    try:
        value = file.get_tensor(name)
    except (SafetensorError, TypeError, ValueError, AttributeError) as error:  # a dtype that NumPy does not know
        raise Damaged(path, f"{name} cannot be read ({error})") from None
    if sums and sums[name] != _sum(value):
        raise Damaged(path, f"{name} is not what was saved")
    return value


def _sum(array: np.ndarray) -> str:
    return _sha256(f"{array.dtype} {array.shape} ".encode(), array)


def _content_hash(sums: dict[str, str]) -> str:
    return _sha256(json.dumps(sums, sort_keys=True).encode())


def _sha256(*parts) -> str:
    found = hashlib.sha256()
    for part in parts:
        found.update(part)
    return found.hexdigest()


# -- leaves ------------------------------------------------------------------------------------


def _named(tree):
    return [(jax.tree_util.keystr(path), leaf) for path, leaf in jax.tree_util.tree_leaves_with_path(tree)]


def _is_key(leaf) -> bool:
    return jax.numpy.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _plain(leaf) -> np.ndarray:
    return np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)


def _stored_as(leaf) -> tuple[tuple[int, ...], np.dtype]:
    like = jax.eval_shape(jax.random.key_data, leaf) if _is_key(leaf) else leaf
    return like.shape, np.dtype(like.dtype)
