"""Several seeds of one training at once."""

from typing import Any

import jax
import jax.numpy as jnp


class Seeds:
    """Runs functions written for one seed for all of them: seed k of several is the run of seed k alone.

    On a CPU they take turns in one compiled program, as batches of small networks are slower there
    than one after the other; a "state of all seeds" is then a list. An accelerator runs them side by
    side, and the state has a leading axis, as it has in every checkpoint.
    """

    def __init__(self, seeds: range):
        self.seeds = seeds
        self._side_by_side = len(seeds) > 1 and jax.default_backend() != "cpu"

    def init(self, fn) -> Any:
        """The state of all seeds from `fn(key)`."""
        fn, keys = jax.jit(fn), [jax.random.key(seed) for seed in self.seeds]
        return jax.vmap(fn)(jnp.stack(keys)) if self._side_by_side else [fn(key) for key in keys]

    def jit(self, fn):
        """`fn(state, ...)`, which returns two things, for all seeds; the state that it is given is used up."""
        if self._side_by_side:
            return jax.jit(jax.vmap(fn), donate_argnums=0)
        fn = jax.jit(fn, donate_argnums=0)
        return lambda *args: tuple(map(list, zip(*(fn(*one) for one in zip(*args, strict=True)), strict=True)))

    def like(self, fn) -> Any:
        """Shapes of what a checkpoint holds: a leading axis of seeds."""
        return jax.eval_shape(jax.vmap(fn), jax.random.split(jax.random.key(0), len(self.seeds)))

    def each(self, tree) -> list:
        """By seed."""
        return [jax.tree.map(lambda x, i=i: x[i], tree) for i in range(len(self.seeds))] if self._side_by_side else tree

    def join(self, state):
        """With a leading axis of seeds."""
        return state if self._side_by_side else jax.tree.map(lambda *xs: jnp.stack(xs), *state)

    def split(self, joined):
        """The opposite of `join`."""
        if self._side_by_side:
            return joined
        return [jax.tree.map(lambda x, i=i: x[i], joined) for i in range(len(self.seeds))]
