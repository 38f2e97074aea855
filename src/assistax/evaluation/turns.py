"""An episode step by step: who acts how, and what is seen of it. For whole batches of episodes and for a live one."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from assistax.env import Env, EnvState, Obs
from assistax.policies import Team, check_acts


class Turn(NamedTuple):
    """Where an episode is between two steps."""

    state: EnvState
    obs: Obs
    carries: dict[str, Any]  # of the policies, by agent
    first: jax.Array  # bool, before the first step


def begin(env: Env, team: Team, key: jax.Array, person: jax.Array | None = None) -> tuple[dict[str, Any], Turn]:
    """Reset, and draw who of each player plays: (parameters by agent, the first turn).

    `person` is the row of who it is in the environment's list of people; None draws one.
    """
    obs, state = env.reset(key, person=person)
    params = {}
    for i, agent in enumerate(env.agents):
        check_acts(team[agent], agent, obs[agent], state, env.action_sizes[agent])
        drawn = team[agent].draw(jax.random.fold_in(key, i)) if team[agent].members > 1 else 0
        drawn = state.person.index if team[agent].by_person else drawn
        params[agent] = team[agent].member(drawn)
    carries = {agent: player.initial_carry() for agent, player in team.items()}
    return params, Turn(state, obs, carries, jnp.bool_(True))


def advance(env: Env, team: Team, params: dict[str, Any], turn: Turn, key: jax.Array):
    """One control step without auto-reset: (the next turn, info as of Env.step_env, whether the episode is over)."""
    actions, carries = {}, {}
    for agent, k in zip(env.agents, jax.random.split(key, env.num_agents), strict=True):
        seen = turn.carries[agent], turn.obs[agent], turn.state, turn.first, k
        actions[agent], carries[agent] = team[agent].act(params[agent], *seen)
    obs, state, _, terminated, truncated, info = env.step_env(key, turn.state, actions)
    return Turn(state, obs, carries, jnp.bool_(False)), info, terminated["__all__"] | truncated["__all__"]


def seen(env: Env, state: EnvState) -> dict[str, Any]:
    """What a Filmed keeps of every step: its arrays by name, here without the axis of steps."""
    spotted = hasattr(env.task, "spots")
    return {
        "qpos": state.physics.qpos,
        "marker": env.markers(state),
        "force": env.sensors(state.physics)["robot_force"],
        "metrics": env.metrics(state),
        "spot_states": env.task.spot_states(state.task) if spotted else jnp.zeros(0, jnp.int8),
    }


def spots(env: Env) -> dict[str, np.ndarray]:
    """Where on the person there is something to do, as a Filmed keeps it."""
    return {body: np.asarray(places) for body, places in getattr(env.task, "spots", {}).items()}
