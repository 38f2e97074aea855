"""Both agents in the interface of JaxMARL's MultiAgentEnv. JaxMARL itself is not needed for it.

import jaxmarl
from assistax.adapters.jaxmarl import MultiAgent

env = MultiAgent("scratch-v3")
jaxmarl.make = MultiAgent  # for JaxMARL's own scripts, which make their environment by name
"""

from typing import Any

import jax
import jax.numpy as jnp

from assistax.adapters.partner import batch_of
from assistax.env import Env, EnvState, Obs
from assistax.errors import choose
from assistax.spaces import Box


class MultiAgent:
    """Pure functions of one environment, to be batched by `jax.vmap`; holds no state.

    A step that ends an episode begins the next, with fresh targets; `done` does not tell the time limit from the end of
    the task, but `info["terminated"]` and `info["truncated"]` do.

    Args:
      task: its id, for example "scratch-v3", or an Env.
      engine: as in `assistax.make`.
      same_sizes: whether both agents observe and act with as many numbers, as scripts want that share one network;
        else each has its own. Observations are filled up with zeros, after which comes a one for the agent's own place
        and a zero for the other's; of actions the first numbers count.
      **settings: as in `assistax.make`, for example `episode_length=500`.

    Raises:
      UsageError: a task, engine or setting that cannot be used.
    """

    def __init__(self, task: str | Env, engine: str = "auto", same_sizes: bool = True, **settings: Any):
        env = self.assistax = batch_of(task, engine, settings).env
        self.name, self.agents, self.num_agents = env.name, list(env.agents), env.num_agents
        self.same_sizes, self.max_steps = same_sizes, env.episode_length
        self.observation_spaces = {agent: env.observation_space(agent) for agent in env.agents}
        self.action_spaces = {agent: env.action_space(agent) for agent in env.agents}
        if same_sizes:
            self._seen, acted = max(env.observation_sizes.values()), max(env.action_sizes.values())
            self.observation_spaces = dict.fromkeys(env.agents, Box((self._seen + self.num_agents,)))
            self.action_spaces = dict.fromkeys(env.agents, Box((acted,), -1.0, 1.0))

    @property
    def agent_classes(self) -> dict[str, list[str]]:
        """Both, each of its own."""
        return {agent: [agent] for agent in self.agents}

    def observation_space(self, agent: str) -> Box:
        return self.observation_spaces[choose("agent", agent, self.agents)]

    def action_space(self, agent: str) -> Box:
        return self.action_spaces[choose("agent", agent, self.agents)]

    def reset(self, key: jax.Array) -> tuple[Obs, EnvState]:
        """(observations by agent, state)."""
        obs, state = self.assistax.reset(key)
        return self._filled(obs), state

    def step(self, key: jax.Array, state: EnvState, actions: Obs, reset_state: EnvState | None = None):
        """(observations, state, rewards, done by agent and "__all__", info), with automatic resets.

        Where an episode ends, the next begins in `reset_state`, if there is one. `info` is as of `Env.step`.
        """
        if reset_state is None:
            return self._told(self.assistax.step(key, state, self._cut(actions)))
        obs, state, rewards, done, info = self.step_env(key, state, actions)
        fresh = self.get_obs(reset_state), reset_state
        obs, state = jax.tree.map(lambda new, old: jnp.where(done["__all__"], new, old), fresh, (obs, state))
        return obs, state, rewards, done, info

    def step_env(self, key: jax.Array, state: EnvState, actions: Obs):
        """`step` without automatic resets."""
        return self._told(self.assistax.step_env(key, state, self._cut(actions)))

    def get_obs(self, state: EnvState) -> Obs:
        """Observations by agent."""
        return self._filled(self.assistax._observe(state))

    def get_avail_actions(self, state: EnvState) -> Obs:
        """Ones: every action is possible at any time."""
        return {agent: jnp.ones(self.action_spaces[agent].shape, bool) for agent in self.agents}

    def _told(self, step):
        obs, state, rewards, terminated, truncated, info = step
        done = {who: terminated[who] | truncated[who] for who in terminated}
        ends = {"terminated": terminated["__all__"], "truncated": truncated["__all__"]}
        return self._filled(obs), state, rewards | {"__all__": rewards[self.agents[0]]}, done, info | ends

    def _cut(self, actions: Obs) -> Obs:
        return {agent: actions[agent][: self.assistax.action_sizes[agent]] for agent in self.agents}

    def _filled(self, obs: Obs) -> Obs:
        if not self.same_sizes:
            return obs
        places = jnp.eye(self.num_agents)
        return {
            agent: jnp.concatenate([jnp.pad(obs[agent], (0, self._seen - obs[agent].shape[0])), places[i]])
            for i, agent in enumerate(self.agents)
        }
