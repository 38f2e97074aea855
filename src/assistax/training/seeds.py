"""Several trainings at once."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from assistax import programs
from assistax.policies import stack


class Lanes:
    """Runs functions written for one training for `count` of them: each is the training it would be alone.

    On a CPU they take turns in one compiled program, as batches of small networks are slower there
    than one after the other; a "state of all lanes" is then a list. An accelerator runs them side by
    side, and the state has a leading axis, as it has in every checkpoint.
    """

    def __init__(self, count: int):
        self.count = count
        self._side_by_side = count > 1 and jax.default_backend() != "cpu"

    def start(self, fn) -> Callable[..., Any]:
        """`fn(key, ...)`, which makes a state, for lists [count] of its arguments: the state of all lanes."""
        if self._side_by_side:
            batched = programs.jit(jax.vmap(fn))
            return lambda *lists: batched(*map(stack, lists))
        fn = programs.jit(fn)
        return lambda *lists: [fn(*one) for one in zip(*lists, strict=True)]

    def jit(self, fn):
        """`fn(state, ...)`, which returns two things, for all lanes; the state that it is given is used up."""
        if self._side_by_side:
            return programs.jit(jax.vmap(fn), donate=0)
        fn = programs.jit(fn, donate=0)
        return lambda *args: tuple(map(list, zip(*(fn(*one) for one in zip(*args, strict=True)), strict=True)))

    def like(self, fn, *lists) -> Any:
        """Shapes of what a checkpoint of `start(fn)(*lists)` holds: a leading axis of lanes."""
        return jax.eval_shape(jax.vmap(fn), *map(stack, lists))

    def each(self, tree) -> list:
        """By lane."""
        return _unstack(tree, self.count) if self._side_by_side else tree

    def join(self, state):
        """With a leading axis of lanes; arrays, or `Joined` ones."""
        return state if self._side_by_side else jax.tree.map(lambda *lanes: Joined(lanes), *state)

    def split(self, joined):
        """The opposite of `join`."""
        if self._side_by_side:
            return jax.tree.map(lambda x: x.whole() if isinstance(x, Joined) else x, joined)
        return _unstack(joined, self.count)


class Joined:
    """Arrays of one shape and type as one array with a leading axis, which is not made unless it is asked for."""

    def __init__(self, lanes: Sequence[jax.Array]):
        self._lanes = lanes
        self.shape, self.dtype = (len(lanes), *lanes[0].shape), lanes[0].dtype

    def __getitem__(self, lane: int) -> jax.Array:
        return self._lanes[lane]

    def whole(self) -> jax.Array:
        """[lanes, ...]."""
        return jnp.stack(self._lanes)


class Seeds(Lanes):
    """A lane for each seed: seed k of several is the run of seed k alone."""

    def __init__(self, seeds: Sequence[int]):
        super().__init__(len(seeds))
        self.seeds = seeds
        self._keys = [jax.random.key(seed) for seed in seeds]

    def init(self, fn) -> Any:
        """The state of all seeds from `fn(key)`."""
        return self.start(fn)(self._keys)

    def like(self, fn, *lists) -> Any:
        return super().like(fn, self._keys, *lists)


def _unstack(tree: Any, count: int) -> list:
    return [jax.tree.map(lambda x, i=i: x[i], tree) for i in range(count)]
