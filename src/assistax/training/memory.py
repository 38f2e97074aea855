"""Whether this machine can hold a training, or environments, at all, asked before anything is compiled or written."""

import math
from typing import Any

import jax

from assistax.env import Env
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
    largest = max(parts, key=lambda part: parts[part])
    which = f"{parts[largest]:,.0f} GB of it for {largest}, "
    _check("This training", sum(parts.values()), which, "make that smaller, or take fewer environments or seeds")


def check_environments(env: Env, num_envs: int) -> None:
    """Raise UsageError if the states of so many environments are more than the memory there is."""
    one = jax.tree.leaves(jax.eval_shape(env.reset, jax.random.key(0)))
    _check(f"{num_envs:,} environments", num_envs * sum(map(_gb, one)), "", "take fewer")


def _check(what: str, needed: float, which: str, instead: str) -> None:
    if needed > (there := memory_gb()):
        raise UsageError(
            f"{what} would take {needed:,.0f} GB of memory, {which}and there are {there:,.0f} GB; {instead}."
        )


def _gb(x: Any) -> float:
    return math.prod(x.shape) * x.dtype.itemsize / 1e9
