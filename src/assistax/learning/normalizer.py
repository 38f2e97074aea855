"""Running mean and variance of observations."""

import jax
import jax.numpy as jnp

from assistax.pytree import pytree

LEAST = 1e-3  # of a spread, in m, rad, N or what an observation is in, that is more than none


@pytree
class RunningStats:
    """Mean and spread of what was seen so far, by entry; see `update_stats`."""

    count: jax.Array  # float32
    mean: jax.Array  # [n]
    m2: jax.Array  # [n] sum of squared deviations from the mean


def init_stats(size: int) -> RunningStats:
    """Of nothing yet, for observations of this size."""
    return RunningStats(jnp.float32(0.0), jnp.zeros(size), jnp.zeros(size))


def update_stats(stats: RunningStats, x: jax.Array) -> RunningStats:
    """Merge a batch x [..., n] (Chan's parallel form of Welford's algorithm)."""
    x = x.reshape(-1, x.shape[-1])
    count, mean = x.shape[0], x.mean(0)
    m2 = jnp.square(x - mean).sum(0)
    total = stats.count + count
    delta = mean - stats.mean
    return RunningStats(
        total,
        stats.mean + delta * count / total,
        stats.m2 + m2 + jnp.square(delta) * stats.count * count / total,
    )


def normalize(stats: RunningStats, x: jax.Array, clip: float = 10.0) -> jax.Array:
    """x [..., n] in standard deviations from the mean, clipped; x itself before any data."""
    mean, scale = shift_and_scale(stats)
    return jnp.clip((x - mean) * scale, -clip, clip)


def shift_and_scale(stats: RunningStats) -> tuple[jax.Array, jax.Array]:
    """The mean [n] and 1 / standard deviation [n]; 0 and 1 before any data, and the scale 0 of what hardly varied.

    Nobody has learned from such an input. Divided by its spread, a stranger's preference, which was the same with all
    partners of training, or a shoulder 2 mm from where theirs were would be ten standard deviations off.
    """
    var = jnp.where(stats.count > 0, stats.m2 / jnp.maximum(stats.count, 1.0), 1.0)
    return stats.mean, jnp.where(var < LEAST**2, 0.0, jax.lax.rsqrt(jnp.maximum(var, LEAST**2)))
