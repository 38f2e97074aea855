"""Constrained learning: the most reward at a cost per episode of at most a limit, by a Lagrange multiplier.

The cost is `info["cost"]`, a number >= 0 per step that the team shares; what is limited is the mean of its
undiscounted sum over an episode, estimated in each iteration from the whole episodes that ended in it. The
multiplier, one for the team, follows it like a PID controller (Stooke et al., 2020).
"""

from dataclasses import replace

import jax
import jax.numpy as jnp

from assistax.env import Env
from assistax.errors import UsageError
from assistax.pytree import pytree


@pytree
class Constraint:
    """What a constrained training carries from one iteration to the next."""

    so_far: jax.Array  # [num_envs] cost of the episode that is under way
    per_step: jax.Array  # mean cost of all steps so far
    cost: jax.Array  # per episode, of the last iteration in which any ended
    excess: jax.Array  # of that cost over the limit, see `excess`
    integral: jax.Array  # of the excess, times its gain; >= 0
    multiplier: jax.Array  # >= 0


def init_constraint(num_envs: int) -> Constraint:
    """At the start: nothing has cost anything, the multiplier is 0."""
    zero = jnp.zeros(())
    return Constraint(jnp.zeros(num_envs), zero, zero, zero, zero, zero)


def check_cost(env) -> None:
    """Raises UsageError unless the steps of `env` have a cost."""
    if isinstance(env, Env):  # all of ours have, and tracing a step takes half a second
        return

    def info(key):
        _, state = env.reset(key)
        return env.step(key, state, {agent: jnp.zeros(size) for agent, size in env.action_sizes.items()})[-1]

    if "cost" not in jax.eval_shape(info, jax.random.key(0)):
        name = getattr(env, "name", type(env).__name__)
        raise UsageError(f'ppo.cost_limit needs a cost, and {name} has no "cost" in the info of its steps.')


def excess(cost: jax.Array, limit: float) -> jax.Array:
    """By which share of the larger of both the cost is above the limit: in [-1, 1], whatever a cost's unit."""
    return (cost - limit) / jnp.maximum(jnp.maximum(cost, limit), 1e-8)


def updated(now: Constraint, cost: jax.Array, limit: float, gains: tuple[float, ...]) -> Constraint:
    """After an iteration whose episodes cost `cost` on average; NaN, if none ended, changes nothing.

    Gains are of the excess, of its sum over the iterations and of its rise from one to the next. A sum that has
    fallen to zero stays there while the limit is kept.
    """
    proportional, integral, derivative = gains
    over = excess(cost, limit)
    total = jnp.maximum(now.integral + integral * over, 0.0)
    rise = jnp.maximum(over - now.excess, 0.0)
    multiplier = jnp.maximum(proportional * over + total + derivative * rise, 0.0)
    after = replace(now, cost=cost, excess=over, integral=total, multiplier=multiplier)
    return jax.tree.map(lambda new, old: jnp.where(jnp.isnan(cost), old, new), after, now)


def in_means(cost: jax.Array, now: Constraint) -> jax.Array:
    """Costs of steps as the cost critic learns them: where the mean is hundreds, it would take it a million steps."""
    return cost / jnp.where(now.per_step > 0.0, now.per_step, 1.0)


def combined(
    advantages: dict[str, jax.Array], cost_advantages: dict[str, jax.Array], multiplier: jax.Array
) -> dict[str, jax.Array]:
    """By learner what its policy learns from, [...]: reward's advantage less λ times that of cost, over 1 + λ.

    Those of cost are scaled to the spread of reward's, the same for all of the team, so that a multiplier needs no
    unit: at 1 both count alike.
    """

    def spread(by_agent):
        return sum(x.std() for x in by_agent.values())

    rate = multiplier * spread(advantages) / (spread(cost_advantages) + 1e-8)
    return {agent: (x - rate * cost_advantages[agent]) / (1.0 + multiplier) for agent, x in advantages.items()}
