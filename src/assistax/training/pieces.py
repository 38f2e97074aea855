"""Checkpoints whose large arrays lie in pieces beside them, each written once however many checkpoints list it.

A replay of half a gigabyte changes by a few percent from one checkpoint to the next. So what is large of a state is cut
into pieces; a piece is a file `pieces/SHA-256` beside the checkpoint, whose metadata lists under "pieces", by array and
lane, those that make it up. What is not there yet is written before the checkpoint, and what no checkpoint lists any
more is removed after it: at every moment all that a checkpoint lists is there.
"""

import hashlib
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.tree_util import keystr, tree_map_with_path

from assistax.errors import UsageError
from assistax.files import Schema, write_atomically, writing
from assistax.training.checkpoint import WEIGHTS, Damaged, load_checkpoint, read_metadata, save_checkpoint
from assistax.training.seeds import Joined

PIECE = 2**20  # bytes; an array is large if a lane has more of it
_FOLDER = "pieces"
_LISTED: Schema = {"pieces?": {str: [[str]]}}


def save(path: Path, state: Any, metadata: dict[str, Any]) -> None:
    """Save a state that `Lanes.join` has made, and metadata (JSON) beside it.

    What is played (`WEIGHTS`) is in the checkpoint itself, whatever its size.
    """
    pieces: dict[str, list[list[str]]] = {}

    def rest(where, array):
        name = keystr(where)
        if _lane_bytes(array) <= PIECE or name.startswith(WEIGHTS):
            return array.whole() if isinstance(array, Joined) else array
        pieces[name] = [_write(path.parent / _FOLDER, array[lane]) for lane in range(array.shape[0])]
        return None

    save_checkpoint(path, tree_map_with_path(rest, state), metadata | {"pieces": pieces})


def load(path: Path, like: Any, finite: Sequence[str] = WEIGHTS) -> Any:
    """The state in a checkpoint, for `Lanes.split`; written by `save` or in one file. See `load_checkpoint`."""
    pieces = read_metadata(path, _LISTED).get("pieces", {})
    rest = tree_map_with_path(lambda where, x: None if keystr(where) in pieces else x, like)

    def whole(where, array, like):
        name = keystr(where)
        return _read(path, name, pieces[name], like) if name in pieces else array

    return tree_map_with_path(whole, load_checkpoint(path, rest, finite=finite), like, is_leaf=lambda x: x is None)


def prune(folder: Path) -> None:
    """Remove what crashes have left in a folder of checkpoints, and the pieces that none of these lists.

    As long as one of them is damaged, pieces stay: it may be replaced by a copy of what it was.
    """
    for part in folder.glob("*.safetensors*.part"):
        part.unlink(missing_ok=True)
    with suppress(UsageError):
        listed = {name for path in folder.glob("*.safetensors") for name in _listed(path)}
        for file in (folder / _FOLDER).glob("*"):
            if file.name not in listed:
                file.unlink()


def _listed(path: Path) -> set[str]:
    pieces = read_metadata(path, _LISTED).get("pieces", {})
    return {name for lanes in pieces.values() for names in lanes for name in names}


def _lane_bytes(array: Any) -> int:
    """Of an array [lanes, ...]."""
    return math.prod(array.shape[1:]) * array.dtype.itemsize


def _write(folder: Path, array: Any) -> list[str]:
    """The names of an array's pieces, in order; those that are not there are written."""
    content = np.asarray(array, order="C").reshape(-1).view(np.uint8)  # on a CPU the array itself, not a copy
    pieces = [content[at : at + PIECE] for at in range(0, len(content), PIECE)]
    with ThreadPoolExecutor() as threads:
        names = list(threads.map(lambda piece: hashlib.sha256(piece).hexdigest(), pieces))
    with writing(folder):
        folder.mkdir(exist_ok=True)
        there = {file.name: file.stat().st_size for file in folder.iterdir()}
    for name, piece in dict(zip(names, pieces, strict=True)).items():
        if there.get(name) != len(piece):
            write_atomically(folder / name, piece.tobytes())
    return names


def _read(path: Path, name: str, lanes: Sequence[Sequence[str]], like: Any) -> Joined:
    """An array [lanes, ...] of a checkpoint, from its pieces."""
    arrays = []
    for names in lanes:
        content = b"".join(_piece(path, piece) for piece in names)
        if len(content) != _lane_bytes(like):
            raise UsageError(
                f"{path} does not fit this configuration: {name} has {len(content)} bytes a seed, not "
                f"{_lane_bytes(like)}."
            )
        arrays.append(jnp.array(np.frombuffer(content, like.dtype).reshape(like.shape[1:])))
    if len(arrays) != like.shape[0]:
        raise UsageError(
            f"{path} does not fit this configuration: {name} is of {len(arrays)} seeds, not {like.shape[0]}."
        )
    return Joined(arrays)


def _piece(path: Path, name: str) -> bytes:
    file = path.parent / _FOLDER / name
    try:
        content = file.read_bytes()
    except (OSError, ValueError) as error:  # ValueError: no name that a file can have
        raise _damaged(path, name, f"cannot be read ({getattr(error, 'strerror', None) or error})") from None
    if hashlib.sha256(content).hexdigest() != name:
        raise _damaged(path, name, "is not what was saved")
    return content


def _damaged(path: Path, name: str, what: str) -> Damaged:
    def spared(other: Path) -> bool:
        with suppress(UsageError):
            return name not in _listed(other)
        return False

    return Damaged(path, f"its piece {str(path.parent / _FOLDER / name)!r} {what}", spared)
