"""What PPO descends (Schulman et al., 2017), and what keeps its steps small."""

from functools import partial

import jax
import jax.numpy as jnp
import optax


def clipped_policy_loss(log_ratio: jax.Array, advantage: jax.Array, clip_eps: float) -> jax.Array:
    """PPO's surrogate, with the advantages normalised over the minibatch [...]."""
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1.0 - clip_eps, 1.0 + clip_eps)
    return -jnp.minimum(ratio * advantage, clipped * advantage).mean()


def value_loss(value: jax.Array, old: jax.Array, target: jax.Array, clip_eps: float | None) -> jax.Array:
    """Half the mean squared error of values [...]; with `clip_eps` no value gains by moving further than that from
    its `old` one, as in the implementation by Schulman et al."""
    error = jnp.square(value - target)
    if clip_eps is not None:
        near = old + jnp.clip(value - old, -clip_eps, clip_eps)
        error = jnp.maximum(error, jnp.square(near - target))
    return 0.5 * error.mean()


def adapted_rate(scale: jax.Array, kl: jax.Array, desired_kl: float | jax.Array) -> jax.Array:
    """The next `scale` of an actor's learning rate, in (0, 1], when an iteration has moved it by `kl`.

    A third slower if that is more than twice the desired, half as much again faster if less than half; so Schulman
    et al. (2017, section 4) adapt a penalty. The same rate moves a policy further as its noise shrinks.
    """
    desired = jnp.where(desired_kl > 0, desired_kl, jnp.inf)
    change = jnp.where(kl > 2.0 * desired, 1 / 1.5, jnp.where(kl < 0.5 * desired, 1.5, 1.0))
    return jnp.clip(scale * change, 1e-3, 1.0)


def clip_networks(grads: dict, max_norm: float) -> dict:
    """Scale the gradient of each network (grads[agent][network]) to at most this norm."""

    def clip(grad):
        scale = jnp.minimum(1.0, max_norm / (optax.tree.norm(grad) + 1e-8))
        return jax.tree.map(partial(jnp.multiply, scale), grad)

    return {agent: {name: clip(grad) for name, grad in nets.items()} for agent, nets in grads.items()}
