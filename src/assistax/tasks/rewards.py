"""The components that the paper's rewards are made of (its Table "Reward component overview")."""

import jax
import jax.numpy as jnp

SIGMA = 0.1  # σ of the reach terms


def boltzmann(x: jax.Array) -> jax.Array:
    """B(x) = x·exp(−x), largest (1/e) at x = 1: the shape of r_s, r_f and r_b."""
    return x * jnp.exp(-x)


def reach(distance: jax.Array) -> jax.Array:
    """r_t = exp(−d²/σ), distance d in m."""
    return jnp.exp(-jnp.square(distance) / SIGMA)


def norm(x: jax.Array) -> jax.Array:
    """Euclidean norm of the last axis, with a gradient of zero (not NaN) at zero."""
    square = jnp.sum(jnp.square(x), -1)
    safe = jnp.where(square > 0, square, 1.0)
    return jnp.where(square > 0, jnp.sqrt(safe), 0.0)
