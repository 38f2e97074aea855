"""Batches of environments with tensors of PyTorch in and out, which share the memory of JAX's arrays (DLPack).

from assistax.adapters.torch import TorchEnv

env = TorchEnv("scratch-v3", num_envs=1024)
obs = env.reset(seed=0)
obs, reward, terminated, truncated, info = env.step(actions)
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from assistax.adapters import missing
from assistax.adapters.farama import INFO
from assistax.adapters.partner import BOTH, Who, beside, episode_keys
from assistax.env import Env
from assistax.errors import UsageError, choose
from assistax.physics import check_faults
from assistax.settings import check_count, check_seed

try:
    import torch
except ImportError as error:
    raise missing(error, "torch") from None

AUTORESET = ("same_step", "next_step", "disabled")


class TorchStep(NamedTuple):
    """What a step returns; with agent="both", observations are by agent."""

    obs: Any  # [num_envs, size]
    reward: torch.Tensor  # [num_envs]
    terminated: torch.Tensor  # bool [num_envs]
    truncated: torch.Tensor  # bool [num_envs]
    info: dict[str, Any]  # [num_envs] each


class TorchEnv:
    """`num_envs` environments, stepped in one compiled call; tensors lie on `device`, where JAX computes.

    What comes out is the caller's, who may change it in place. What goes in is read before the call returns.
    `info` has "metrics" of the episode up to and with this step (`success`, `return`, ...), and of this step
    "reward_terms", "robot_force" (N) and "cost", see `Env.step`; unless autoreset is "disabled" also
    "final_observation", true also where `obs` begins the next episode.

    Args:
      task: its id, for example "scratch-v3", or an Env.
      num_envs: environments side by side.
      agent: "robot", "human", or "both": observations and actions are dicts of tensors by agent then.
      partner: who plays the other one: "still", "random", "trained", a team file, a run folder, ..., see
        `training.partners.find_partner`; or a `Population` or `Player`.
      engine: as in `assistax.make`.
      autoreset: "same_step": `obs` begins the next episode where one has ended; "next_step": the next step does, whose
        action is ignored and whose reward is 0; "disabled": call `reset` with a mask.
      **settings: as in `assistax.make`, for example `episode_length=500`.

    Raises:
      UsageError: a task, engine, setting or partner that cannot be used.
    """

    def __init__(
        self,
        task: str | Env,
        num_envs: int = 1,
        *,
        agent: str = "robot",
        partner: Who = "still",
        engine: str = "auto",
        autoreset: str = "same_step",
        **settings: Any,
    ):
        check_count("num_envs", num_envs)
        self.autoreset = choose("autoreset", autoreset, AUTORESET)
        self._batch, self._players = beside(task, agent, partner, engine, settings, both=True)
        self.assistax, self.agent, self.num_envs = self._batch.env, agent, num_envs
        self.agents = self.assistax.agents if agent == BOTH else (agent,)
        try:
            self.device = torch.from_dlpack(jnp.zeros(1)).device
        except Exception as error:  # of many kinds
            what = str(error).partition("\n")[0]
            raise UsageError(
                f"This PyTorch cannot share memory with JAX on {jax.default_backend()} ({what}); install one that can, "
                "or set JAX_PLATFORMS=cpu."
            ) from None
        self._rng, self._state = np.random.default_rng(), None

    def reset(self, seed: int | None = None, mask: torch.Tensor | None = None):
        """Observations [num_envs, size] of new episodes; with a mask, bool [num_envs], only of those it names.

        The same seed gives the same episodes; without one they are the next ones drawn.
        """
        if seed is not None:
            check_seed("seed", seed)
            self._rng = np.random.default_rng(seed)
        keys = episode_keys(self._rng, self.num_envs)
        if mask is None:
            obs, self._state = self._batch.reset(self._players, keys)
        else:
            self._check_begun("Reset all environments before some of them.")
            given = self._taken(mask, (self.num_envs,), torch.bool, "mask")
            obs, self._state = self._batch.reset_where(self._players, given, keys, self._state)
        return self._seen(obs)

    def step(self, actions: Any) -> TorchStep:
        """One control step of 8 ms; actions float32 [num_envs, size], each entry clipped to [-1, 1]."""
        self._check_begun("Call reset before step.")
        by_agent = actions if self.agent == BOTH else {self.agent: actions}
        if not isinstance(by_agent, dict) or set(by_agent) != set(self.agents):
            raise UsageError(f"There must be actions by agent, a dict of {' and '.join(self.agents)}.")
        sizes = self.assistax.action_sizes
        given = {
            agent: self._taken(by_agent[agent], (self.num_envs, sizes[agent]), torch.float32, f"{agent}'s actions")
            for agent in self.agents
        }
        self._state, step = self._batch.step(self.autoreset, self._players, self._state, given)
        check_faults(step.info["fault"], self.assistax.engine.name)
        info = jax.tree.map(torch.from_dlpack, {name: step.info[name] for name in INFO})
        if self.autoreset != "disabled":
            info["final_observation"] = self._seen(step.info["final_observation"])
        ends = torch.from_dlpack(step.terminated), torch.from_dlpack(step.truncated)
        return TorchStep(self._seen(step.obs), torch.from_dlpack(step.reward), *ends, info)

    def _seen(self, obs):
        tensors = {agent: torch.from_dlpack(obs[agent]) for agent in self.agents}
        return tensors if self.agent == BOTH else tensors[self.agent]

    def _taken(self, tensor, shape: tuple[int, ...], dtype: torch.dtype, what: str) -> jax.Array:
        """The same memory, as an array of JAX."""
        kind = f"{str(dtype).removeprefix('torch.')} {shape} on {self.device}"
        if not isinstance(tensor, torch.Tensor):
            raise UsageError(f"The {what} must be a tensor, {kind}, not {type(tensor).__name__}.")
        if tensor.shape != shape or tensor.dtype != dtype or tensor.device != self.device:
            found = f"{str(tensor.dtype).removeprefix('torch.')} {tuple(tensor.shape)} on {tensor.device}"
            raise UsageError(f"The {what} must be {kind}, not {found}.")
        return jax.dlpack.from_dlpack(tensor.detach().contiguous())

    def _check_begun(self, advice: str) -> None:
        if self._state is None:
            raise UsageError(advice)
