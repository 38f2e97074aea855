"""A person who does at random what a share of the action was for, as E3T trains robots with (Yan et al., 2023).

Not white noise, which averages out at 125 steps a second: slow motions, other ones in every episode.
"""

import jax
import jax.numpy as jnp

RATES = (0.2, 0.5, 1.1)  # Hz, of the sines of which a path is made; each a quarter slower to a quarter faster


def wander(phase: jax.Array, seconds: jax.Array) -> jax.Array:
    """A smooth random path [n], in [-1, 1] and zero on average.

    Args:
      phase: [n] rad in [0, 2π), drawn once per episode; all that a path depends on.
      seconds: since the beginning of the episode.
    """
    share = phase / (2.0 * jnp.pi)
    path = jnp.zeros_like(share)
    for i, rate in enumerate(RATES):
        drawn = jnp.mod(share * 97.0**i, 1.0)  # three numbers in [0, 1) of one
        path += jnp.sin(2.0 * jnp.pi * (rate * (0.75 + 0.5 * drawn) * seconds + jnp.mod(7.0 * drawn, 1.0)))
    return path / len(RATES)
