"""Replay: a ring of transitions on the device, drawn from uniformly, and how it packs observations."""

from typing import Any

import jax
import jax.numpy as jnp

from assistax.pytree import pytree


@pytree
class Replay:
    """The newest transitions, in a ring; each array is [capacity, ...]."""

    rows: Any  # any pytree of [capacity, ...]
    next: jax.Array  # int32, where the next chunk goes
    size: jax.Array  # int32, rows written so far, at most the capacity


def init_replay(row: Any, capacity: int, chunk: int) -> Replay:
    """An empty ring for rows like `row`, a pytree of arrays or ShapeDtypeStructs without leading axis.

    It is filled by `chunk` rows at a time; the capacity is rounded down to whole chunks, so that
    each of them is one contiguous write.
    """
    capacity -= capacity % chunk
    rows = jax.tree.map(lambda x: jnp.zeros((capacity, *x.shape), x.dtype), row)
    return Replay(rows, jnp.int32(0), jnp.int32(0))


def add(replay: Replay, chunk: Any) -> Replay:
    """Write a chunk, a pytree of [chunk, ...] of the size given to `init_replay`, over the oldest rows.

    In place where the replay is donated to the jitted caller.
    """
    count = jax.tree.leaves(chunk)[0].shape[0]
    capacity = jax.tree.leaves(replay.rows)[0].shape[0]
    rows = jax.tree.map(
        lambda ring, new: jax.lax.dynamic_update_slice_in_dim(ring, new, replay.next, 0), replay.rows, chunk
    )
    return Replay(rows, (replay.next + count) % capacity, jnp.minimum(replay.size + count, capacity))


def sample(replay: Replay, key: jax.Array, count: int) -> Any:
    """Rows [count, ...] drawn with replacement from those written."""
    ids = jax.random.randint(key, (count,), 0, replay.size)
    return jax.tree.map(lambda ring: ring[ids], replay.rows)


class Packing:
    """One row for everybody's observation, each block of it once.

    Where the environment names its blocks (`obs_layout`) an agent's observation is columns of the
    global one, and the row is the global observation: half the memory. Elsewhere it is the global
    observation and then everybody's.
    """

    def __init__(self, env):
        self._agents = () if hasattr(env, "obs_layout") else tuple(env.agents)
        if self._agents:
            end = env.global_size
            self._places = {"global": [slice(0, end)]}
            for agent in self._agents:
                self._places[agent] = [slice(end, end + env.observation_sizes[agent])]
                end += env.observation_sizes[agent]
        else:
            whole = env.obs_layout("global")
            names = {agent: env.obs_layout(agent) for agent in ("global", *env.agents)}
            self._places = {who: [whole[name] for name in names[who]] for who in names}

    def pack(self, global_obs: jax.Array, obs: dict[str, jax.Array]) -> jax.Array:
        """A row [..., width] of the global observation [..., global_size] and those of the agents."""
        return jnp.concatenate([global_obs, *(obs[agent] for agent in self._agents)], -1)

    def unpack(self, row: jax.Array) -> dict[str, jax.Array]:
        """The observation of each agent, and "global", in a row [..., width]."""
        return {who: jnp.concatenate([row[..., at] for at in places], -1) for who, places in self._places.items()}
