"""What training reports of the episodes it plays."""

import jax
import jax.numpy as jnp


def step_log(info: dict, whole: jax.Array) -> dict:
    """Of one step in all environments: `whole` [num_envs] marks whole episodes that it ended.

    First episodes that a staggered start cut short are learned from but not reported.
    """
    return {
        "episodes": whole.sum(),
        "ended": jax.tree.map(lambda x: jnp.sum(x * whole), info["metrics"]),
        "terms": jax.tree.map(jnp.mean, info["reward_terms"]),
        "fault": info["fault"].max(),
    }


def iteration_log(log: dict) -> dict:
    """Of an iteration, from the logs [num_steps, ...] of its steps."""
    episodes = log["episodes"].sum()
    return {
        "episodes": episodes,  # that ended in this iteration; the means below are over them
        "episode": jax.tree.map(lambda x: x.sum() / jnp.maximum(episodes, 1), log["ended"]),
        "reward": jax.tree.map(jnp.mean, log["terms"]),  # per step, by term
        "fault": log["fault"].max(),
    }
