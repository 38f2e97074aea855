"""Pytrees in safetensors files: written whole or not at all, refused when they do not fit."""

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from assistax.errors import UsageError
from assistax.files import write_atomically

FORMAT = "assistax-checkpoint-1"


def save_checkpoint(path: Path, tree: Any, metadata: dict[str, Any]) -> None:
    """Save the leaves of `tree` by their names, and `metadata` (JSON) beside them."""
    arrays = {name: np.asarray(_plain(leaf), order="C") for name, leaf in _named(tree)}
    write_atomically(path, save(arrays, {"format": FORMAT, "about": json.dumps(metadata)}))


def read_metadata(path: Path) -> dict[str, Any]:
    """The metadata of a checkpoint; raises UsageError if the file is none."""
    try:
        with safe_open(path, "numpy") as file:
            header = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise UsageError(f"{path} is not a readable checkpoint ({error}).") from None
    if header.get("format") != FORMAT:
        raise UsageError(f"{path} is not an Assistax checkpoint (format {header.get('format')!r}).")
    return json.loads(header["about"])


def load_checkpoint(path: Path, like: Any, part: str = "") -> Any:
    """The pytree in a checkpoint, which must have the names and shapes of `like`.

    With `part` (".params") only what is stored under that name; `like` is then that part.
    """
    read_metadata(path)
    leaves = []
    with safe_open(path, "numpy") as file:
        stored = set(file.keys())
        wanted = _named(like)
        for name, leaf in wanted:
            name = part + name
            if name not in stored:
                raise UsageError(f"{path} does not fit this configuration: it has no {name}.")
            value, shape = file.get_tensor(name), _shape(leaf)
            if value.shape != shape:
                raise UsageError(f"{path} does not fit this configuration: {name} is {value.shape}, not {shape}.")
            leaves.append(jax.random.wrap_key_data(value) if _is_key(leaf) else jax.numpy.asarray(value, leaf.dtype))
    return jax.tree.unflatten(jax.tree.structure(like), leaves)


def _named(tree):
    return [(jax.tree_util.keystr(path), leaf) for path, leaf in jax.tree_util.tree_leaves_with_path(tree)]


def _is_key(leaf) -> bool:
    return jax.numpy.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _plain(leaf) -> np.ndarray:
    return np.asarray(jax.random.key_data(leaf) if _is_key(leaf) else leaf)


def _shape(leaf) -> tuple[int, ...]:
    return jax.eval_shape(jax.random.key_data, leaf).shape if _is_key(leaf) else leaf.shape
