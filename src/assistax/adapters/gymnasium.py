"""One agent in Gymnasium, beside a frozen partner.

Importing this file registers every task; Gymnasium 1.0 and later find no environments by themselves, but import what
stands before a colon: gym.make("assistax.adapters.gymnasium:assistax/scratch-v3").

    import gymnasium as gym
    import assistax.adapters.gymnasium

    env = gym.make("assistax/scratch-v3", partner="still")
    envs = gym.make_vec("assistax/scratch-v3", num_envs=256, partner="still")
"""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from assistax.adapters import missing
from assistax.adapters.farama import METADATA, Pictures, as_gymnasium, of_one, on_host
from assistax.adapters.partner import Who, beside, check_action, episode_keys
from assistax.env import Env
from assistax.errors import UsageError
from assistax.physics import check_faults
from assistax.settings import check_count
from assistax.tasks import TASKS

try:
    import gymnasium as gym
    from gymnasium.utils.seeding import np_random
    from gymnasium.vector import AutoresetMode
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise missing(error, "gymnasium") from None


def register_tasks() -> None:
    """Tell Gymnasium of all tasks, as "assistax/TASK"; call it again for those that are registered later."""
    for task in TASKS:
        if f"assistax/{task}" not in gym.registry:
            gym.register(
                f"assistax/{task}",
                entry_point=f"{__name__}:AgentEnv",
                vector_entry_point=f"{__name__}:AgentVectorEnv",
                kwargs={"task": task},
            )


class AgentEnv(gym.Env[np.ndarray, np.ndarray]):
    """One agent's observations, actions and rewards; its partner is part of the environment.

    `info` has "metrics" of the episode up to and with this step (`success`, `return`, ...), "is_success" (where
    Stable-Baselines3 looks for it), and of this step "reward_terms", "robot_force" (N) and "cost"; see `Env.step`.

    Args:
      task: its id, for example "scratch-v3", or an Env.
      agent: "robot" or "human".
      partner: who plays the other one: "still", "random", "trained", a team file, a run folder, ..., see
        `training.partners.find_partner`; or a `Population` or `Player`.
      engine: as in `assistax.make`.
      render_mode: None or "rgb_array".
      **settings: as in `assistax.make`, for example `episode_length=500`.

    Raises:
      UsageError: a task, engine, setting or partner that cannot be used.
    """

    metadata = METADATA

    def __init__(
        self,
        task: str | Env,
        *,
        agent: str = "robot",
        partner: Who = "still",
        engine: str = "auto",
        render_mode: str | None = None,
        **settings: Any,
    ):
        self._batch, self._players = beside(task, agent, partner, engine, settings)
        self.assistax, self.agent, self.render_mode = self._batch.env, agent, render_mode
        self.observation_space = as_gymnasium(self.assistax.observation_space(agent))
        self.action_space = as_gymnasium(self.assistax.action_space(agent))
        self._pictures = Pictures(self.assistax, render_mode)
        self._state: Any = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        obs, self._state = self._batch.reset(self._players, episode_keys(self.np_random, 1))
        return np.array(obs[self.agent][0]), {}

    def step(self, action: np.ndarray):
        if self._state is None:
            raise UsageError("Call reset before step.")
        action = check_action(action, self.action_space.shape or (), self.agent)
        self._state, step = self._batch.step("disabled", self._players, self._state, {self.agent: action[None]})
        check_faults(step.info["fault"], self.assistax.engine.name)
        info = of_one(step.info)
        info["is_success"] = bool(info["metrics"]["success"])
        obs = np.array(step.obs[self.agent][0])
        return obs, float(step.reward[0]), bool(step.terminated[0]), bool(step.truncated[0]), info

    def render(self):
        """Pixels [480, 640, 3] uint8."""
        if self._state is None:
            raise UsageError("Call reset before render.")
        return self._pictures.of(self._state.env, 0)

    def close(self) -> None:
        self._pictures.close()


class AgentVectorEnv(gym.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`num_envs` times an AgentEnv, stepped in one compiled call.

    Environment i of a reset with seed s begins as an AgentEnv with seed s + i.

    Args:
      num_envs: environments side by side.
      autoreset_mode: as Gymnasium defines them: "NextStep", "SameStep" or "Disabled".
      task, agent, partner, engine, render_mode, settings: see AgentEnv.
    """

    def __init__(
        self,
        task: str | Env,
        num_envs: int = 1,
        *,
        agent: str = "robot",
        partner: Who = "still",
        engine: str = "auto",
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **settings: Any,
    ):
        check_count("num_envs", num_envs)
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            known = ", ".join(mode.value for mode in AutoresetMode)
            raise UsageError(f"Unknown autoreset_mode {autoreset_mode!r}. Known: {known}.") from None
        self._batch, self._players = beside(task, agent, partner, engine, settings)
        self.assistax, self.agent, self.render_mode = self._batch.env, agent, render_mode
        self.num_envs, self.metadata = num_envs, METADATA | {"autoreset_mode": self.autoreset_mode}
        self.single_observation_space = as_gymnasium(self.assistax.observation_space(agent))
        self.single_action_space = as_gymnasium(self.assistax.action_space(agent))
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._shape = (num_envs, *self.assistax.action_space(agent).shape)
        self._pictures = Pictures(self.assistax, render_mode)
        self._state: Any = None
        self._ended = np.zeros(num_envs, bool)  # by the step before

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None):
        """Begin episodes; with options {"reset_mask": bool [num_envs]} of those environments only."""
        keys = self._keys(seed)
        mask = (options or {}).get("reset_mask")
        if mask is None:
            obs, self._state = self._batch.reset(self._players, keys)
            self._ended[:] = False
        else:
            mask = self._checked(mask)
            obs, self._state = self._batch.reset_where(self._players, mask, keys, self._state)
            self._ended &= ~mask
        return np.array(obs[self.agent]), {}

    def step(self, actions: np.ndarray):
        if self._state is None:
            raise UsageError("Call reset before step.")
        mode, began = self.autoreset_mode, self._ended
        if mode is AutoresetMode.DISABLED and began.any():
            raise UsageError(
                f'Episodes have ended: call reset(options={{"reset_mask": ...}}) for {began.nonzero()[0]}.'
            )
        actions = check_action(actions, self._shape, self.agent)
        self._state, step = self._batch.step(_NAMES[mode], self._players, self._state, {self.agent: actions})
        check_faults(step.info["fault"], self.assistax.engine.name)
        info = on_host(step.info)
        obs, terminated, truncated = (np.array(x) for x in (step.obs[self.agent], step.terminated, step.truncated))
        self._ended = ended = terminated | truncated
        if mode is AutoresetMode.SAME_STEP:
            infos = _masked(info, ~ended)
            if ended.any():
                final_obs = np.full(self.num_envs, None, object)
                last = np.asarray(step.info["final_observation"][self.agent])
                for i in ended.nonzero()[0]:
                    final_obs[i] = last[i].copy()
                infos |= {"final_obs": final_obs, "_final_obs": ended.copy()}
                infos |= {"final_info": _masked(info, ended), "_final_info": ended.copy()}
        else:
            waited = began if mode is AutoresetMode.NEXT_STEP else np.zeros_like(began)
            infos = _masked(info, ~waited)
        return obs, np.array(step.reward, np.float64), terminated, truncated, infos

    def render(self):
        """A picture of every environment, pixels [480, 640, 3] uint8."""
        if self._state is None:
            raise UsageError("Call reset before render.")
        if self.render_mode is None:
            return None
        return tuple(self._pictures.of(self._state.env, i) for i in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        self._pictures.close()

    def _keys(self, seed: int | Sequence[int | None] | None) -> jax.Array:
        """By environment, of its own seed where it has one."""
        if seed is None:
            return episode_keys(self.np_random, self.num_envs)
        if isinstance(seed, (int, np.integer)):
            self._np_random, self._np_random_seed = np_random(int(seed))
            seeds: Sequence[int | None] = range(int(seed), int(seed) + self.num_envs)
        else:
            seeds = seed
        if len(seeds) != self.num_envs:
            raise UsageError(f"{self.num_envs} environments need as many seeds, not {len(seeds)}.")
        rngs = [self.np_random if one is None else np_random(int(one))[0] for one in seeds]
        return jax.numpy.concatenate([episode_keys(rng, 1) for rng in rngs])

    def _checked(self, mask: Any) -> np.ndarray:
        mask = np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != bool:
            raise UsageError(f"reset_mask must be {self.num_envs} truth values, not {mask.dtype} {mask.shape}.")
        if self._state is None:
            raise UsageError("Reset all environments before some of them.")
        return mask


_NAMES = {
    AutoresetMode.NEXT_STEP: "next_step",
    AutoresetMode.SAME_STEP: "same_step",
    AutoresetMode.DISABLED: "disabled",
}


def _masked(info: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    """Gymnasium's form of it: beside every entry "_" and its name, which environments have it."""
    masked = {}
    for name, value in info.items():
        masked[name] = _masked(value, mask) if isinstance(value, dict) else np.array(value)
        masked[f"_{name}"] = mask.copy()
    return masked


register_tasks()
