"""Functions of one environment that know the whole batch, however many times they are vmapped."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from assistax.errors import UsageError


def whole_batch(fn: Callable) -> Callable:
    """Turn `fn`, which maps arrays with one leading axis, into a function of one environment.

    However many times the result is vmapped, `fn` is called once, with all axes flattened into one:
    it knows how many environments there are, and its control flow is that of the whole batch.
    """
    flat = jax.custom_batching.custom_vmap(fn)

    @flat.def_vmap
    def _rule(axis_size, in_batched, *args):
        if not axis_size:
            raise UsageError("There must be one environment or more, not 0.")

        def merge(x, batched):
            x = x if batched else jnp.broadcast_to(x, (axis_size, *x.shape))
            return x.reshape(-1, *x.shape[2:])

        out = flat(*jax.tree.map(merge, args, tuple(in_batched)))
        out = jax.tree.map(lambda x: x.reshape(axis_size, -1, *x.shape[1:]), out)
        return out, jax.tree.map(lambda _: True, out)

    def single(*args):
        return jax.tree.map(lambda x: x[0], flat(*jax.tree.map(lambda x: jnp.asarray(x)[None], args)))

    return single


def chunk_size(num_envs: int) -> int:
    """How many environments `map_where` computes at a time: a thirty-second of the batch."""
    return -(-num_envs // 32)


def map_where(fn: Callable, mask: jax.Array, old: Any, *args) -> Any:
    """`fn(*args)` where mask [n] is true, `old` elsewhere; what is not asked for costs nothing.

    Episodes end at different times, so few environments of a batch do at any step: `fn` maps arrays with
    leading axis `chunk_size(n)` and is called as often as it takes.
    """
    num_envs = mask.shape[0]

    def some(carry):
        todo, out = carry
        ids = jnp.nonzero(todo, size=chunk_size(num_envs), fill_value=num_envs)[0]
        new = fn(*jax.tree.map(lambda x: x.at[ids].get(mode="clip"), args))
        out = jax.tree.map(lambda x, y: x.at[ids].set(y, mode="drop"), out, new)
        return todo.at[ids].set(False, mode="drop"), out

    return jax.lax.while_loop(lambda carry: carry[0].any(), some, (mask, old))[1]
