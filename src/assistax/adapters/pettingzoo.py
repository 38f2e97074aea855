"""Both agents in PettingZoo's parallel interface.

from assistax.adapters.pettingzoo import parallel_env

env = parallel_env("scratch-v3")
"""

from typing import Any

import jax
import numpy as np

from assistax.adapters import missing
from assistax.adapters.farama import METADATA, Pictures, as_gymnasium, of_one
from assistax.adapters.partner import batch_of, check_action, episode_keys
from assistax.env import Env
from assistax.errors import UsageError, choose
from assistax.physics import check_faults
from assistax.settings import check_seed
from assistax.spaces import Box

try:
    from pettingzoo import ParallelEnv
except ImportError as error:
    raise missing(error, "pettingzoo") from None


class parallel_env(ParallelEnv):
    """The robot and the human, each with observations and actions of their own; their reward is the same.

    `infos` of both agents have the same: "metrics" of the episode so far, and of this step "reward_terms",
    "robot_force" (N) and "cost"; see `Env.step`. `state()` is what a centralised critic may see.

    Args:
      task: its id, for example "scratch-v3", or an Env.
      engine: as in `assistax.make`.
      render_mode: None or "rgb_array".
      **settings: as in `assistax.make`, for example `episode_length=500`.

    Raises:
      UsageError: a task, engine or setting that cannot be used.
    """

    def __init__(self, task: str | Env, *, engine: str = "auto", render_mode: str | None = None, **settings: Any):
        self._batch = batch_of(task, engine, settings)
        self.assistax, self.render_mode = self._batch.env, render_mode
        self.metadata = METADATA | {"name": f"assistax/{self.assistax.name}", "is_parallelizable": True}
        self.possible_agents, self.agents = list(self.assistax.agents), []
        both = self.possible_agents
        # Made once: PettingZoo seeds what it samples from.
        self.observation_spaces = {agent: as_gymnasium(self.assistax.observation_space(agent)) for agent in both}
        self.action_spaces = {agent: as_gymnasium(self.assistax.action_space(agent)) for agent in both}
        self.state_space = as_gymnasium(Box((self.assistax.global_size,)))
        self._pictures = Pictures(self.assistax, render_mode)
        self._global_obs = jax.jit(jax.vmap(self.assistax.global_obs))
        self._state: Any = None
        self._rng = np.random.default_rng()

    def observation_space(self, agent: str):
        return self.observation_spaces[choose("agent", agent, self.possible_agents)]

    def action_space(self, agent: str):
        return self.action_spaces[choose("agent", agent, self.possible_agents)]

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None):
        if seed is not None:
            check_seed("seed", seed)
            self._rng = np.random.default_rng(seed)
        obs, self._state = self._batch.reset({}, episode_keys(self._rng, 1))
        self.agents = list(self.possible_agents)
        return {agent: np.array(obs[agent][0]) for agent in self.agents}, {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, np.ndarray]):
        if not self.agents:
            raise UsageError("The episode is over, or none has begun; call reset.")
        if absent := ", ".join(agent for agent in self.agents if agent not in actions):
            raise UsageError(f"There is no action of the {absent}; both agents act in every step.")
        given = {
            agent: check_action(actions[agent], (self.assistax.action_sizes[agent],), agent)[None]
            for agent in self.agents
        }
        self._state, step = self._batch.step("disabled", {}, self._state, given)
        check_faults(step.info["fault"], self.assistax.engine.name)
        info = of_one(step.info)
        agents, reward = self.agents, float(step.reward[0])
        terminated, truncated = bool(step.terminated[0]), bool(step.truncated[0])
        if terminated or truncated:
            self.agents = []
        return (
            {agent: np.array(step.obs[agent][0]) for agent in agents},
            dict.fromkeys(agents, reward),
            dict.fromkeys(agents, terminated),
            dict.fromkeys(agents, truncated),
            {agent: dict(info) for agent in agents},
        )

    def state(self) -> np.ndarray:
        """What either agent observes, once [global_size]."""
        if self._state is None:
            raise UsageError("Call reset before state.")
        return np.array(self._global_obs(self._state.env)[0])

    def render(self) -> np.ndarray | None:
        """Pixels [480, 640, 3] uint8."""
        if self._state is None:
            raise UsageError("Call reset before render.")
        return self._pictures.of(self._state.env, 0)

    def close(self) -> None:
        self._pictures.close()
