"""Whether this machine can hold a training at all, asked before anything is compiled or written."""

import math
from typing import Any

import jax

from assistax.errors import UsageError
from assistax.learning.trainer import Trainer
from assistax.stamp import memory_gb

MANY = 1_000_000  # environment steps an iteration, whose memory is worth the half second that looking at it takes


def check_memory(trainer: Trainer, count: int = 1) -> None:
    """Raise UsageError if what `count` trainings hold between their functions is more than the memory there is."""
    state = jax.eval_shape(trainer.init, jax.random.key(0))
    parts: dict[str, float] = {}
    for path, x in jax.tree_util.tree_leaves_with_path(state):
        part = jax.tree_util.keystr(path[:1], simple=True)
        parts[part] = parts.get(part, 0.0) + count * _gb(x)
    if trainer.steps_per_iteration > MANY:
        _, batch = jax.eval_shape(trainer.collect, state)
        parts["the steps of an iteration"] = count * sum(map(_gb, jax.tree.leaves(batch)))
    needed, there, largest = sum(parts.values()), memory_gb(), max(parts, key=lambda part: parts[part])
    if needed > there:
        raise UsageError(
            f"This training would take {needed:,.0f} GB of memory, {parts[largest]:,.0f} GB of it for {largest}, and "
            f"there are {there:,.0f} GB; make that smaller, or take fewer environments or seeds."
        )


def _gb(x: Any) -> float:
    return math.prod(x.shape) * x.dtype.itemsize / 1e9
