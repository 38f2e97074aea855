"""The tanh-squashed diagonal Gaussian that SAC's policies draw from (Haarnoja et al., 2018, appendix C)."""

import jax
import jax.numpy as jnp

from assistax.learning.networks import gaussian_log_prob

LOG_STD = (-5.0, 2.0)  # bounds of the log standard deviation, before squashing


def split_head(out: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Mean and log standard deviation [..., n] from an actor's last layer [..., 2n].

    The log standard deviation moves smoothly between its bounds, so that its gradient never vanishes for good.
    """
    mean, free = jnp.split(out, 2, axis=-1)
    low, high = LOG_STD
    return mean, low + 0.5 * (high - low) * (1.0 + jnp.tanh(free))


def sample_squashed(mean: jax.Array, log_std: jax.Array, noise: jax.Array) -> tuple[jax.Array, jax.Array]:
    """An action [..., n] in [-1, 1] by standard normal noise, differentiable in mean and log_std; its log-density."""
    u = mean + jnp.exp(log_std) * noise
    return jnp.tanh(u), squashed_log_prob(u, mean, log_std)


def squashed_log_prob(u: jax.Array, mean: jax.Array, log_std: jax.Array) -> jax.Array:
    """Log-density [...] of the action tanh(u) for u [..., n], from u as tanh cannot be undone near 1."""
    return gaussian_log_prob(u, mean, log_std) - log_tanh_slope(u).sum(-1)


def log_tanh_slope(u: jax.Array) -> jax.Array:
    """log(1 - tanh(u)²), exact where the square has rounded to one."""
    return 2.0 * (jnp.log(2.0) - u - jax.nn.softplus(-2.0 * u))
