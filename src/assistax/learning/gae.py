"""What steps are worth: the horizon of a value, and generalised advantages that tell ends from time limits.

Generalised advantage estimation is by Schulman et al. (2016).
"""

import jax
import jax.numpy as jnp


def horizon(gamma, episode_length: int):
    """How many steps a value looks ahead; at most an episode.

    A network learns a value divided by it, a mean of the rewards to come, at once. The sum over a long horizon is
    hundreds, and takes a network that starts at zero a million steps.
    """
    return 1.0 / jnp.maximum(1.0 - gamma, 1.0 / episode_length)


def gae(
    rewards: jax.Array,
    values: jax.Array,
    next_values: jax.Array,
    terminated: jax.Array,
    done: jax.Array,
    gamma: float,
    lam: float,
) -> jax.Array:
    """Advantages [T, ...].

    Args:
      rewards: [T, ...] r_t.
      values: [T, ...] V(s_t).
      next_values: [T, ...] V of the state that action t led to, before any reset: at a time limit
        the true final state, not the first of the next episode.
      terminated: [T, ...] whether that state ends the task (its value is then zero).
      done: [T, ...] terminated or truncated: nothing flows back from the step after.
    """
    deltas = rewards + gamma * next_values * (1.0 - terminated) - values

    def back(advantage, step):
        delta, done = step
        advantage = delta + gamma * lam * (1.0 - done) * advantage
        return advantage, advantage

    return jax.lax.scan(back, jnp.zeros_like(deltas[0]), (deltas, 1.0 * done), reverse=True)[1]
