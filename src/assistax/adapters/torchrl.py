"""Batches of environments for TorchRL, and by way of it for BenchMARL; tensors are shared, see `adapters.torch`.

from assistax.adapters.torchrl import TorchRLEnv

env = TorchRLEnv("scratch-v3", num_envs=1024)
env.rollout(100, break_when_any_done=False)
"""

from typing import Any

from assistax.adapters import missing
from assistax.adapters.partner import BOTH, Who
from assistax.env import Env

try:
    import torch
    from tensordict import TensorDict, TensorDictBase
    from torchrl.data import Bounded, Composite, Unbounded
    from torchrl.envs import EnvBase
except ImportError as error:
    raise missing(error, "torchrl") from None

from assistax.adapters.torch import TorchEnv


class TorchRLEnv(EnvBase):
    """`num_envs` environments, stepped in one compiled call.

    For one agent the keys are TorchRL's own: "observation", "action", "reward". With agent="both" those of each agent
    are in a group of its name, ("robot", "observation") [num_envs, 1, size], as `group_map` says. Beside them come
    "success", whether the episode has been one so far, and "cost" of the step, [num_envs, 1].

    An episode that has ended begins anew when it is reset, which costs nothing: the step has drawn the next one.

    Args:
      task, num_envs, agent, partner, engine, settings: see `adapters.torch.TorchEnv`.

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
        **settings: Any,
    ):
        many = TorchEnv(task, num_envs, agent=agent, partner=partner, engine=engine, autoreset="same_step", **settings)
        super().__init__(device=many.device, batch_size=[num_envs])
        self._many, self._latest, self._seed = many, None, None
        self.assistax, self.group_map = many.assistax, {one: [one] for one in many.agents}
        self._grouped = agent == BOTH
        n, env = num_envs, many.assistax
        seen, acted, paid = {}, {}, {}
        for one in many.agents:
            size = (n, 1) if self._grouped else (n,)
            seen[one] = Unbounded((*size, env.observation_sizes[one]), device=many.device)
            acted[one] = Bounded(-1.0, 1.0, (*size, env.action_sizes[one]), device=many.device)
            paid[one] = Unbounded((*size, 1), device=many.device)

        def flag():
            return Unbounded((n, 1), dtype=torch.bool, device=many.device)

        cost = Unbounded((n, 1), device=many.device)
        self.observation_spec = self._composite("observation", seen, success=flag(), cost=cost)
        self.action_spec = self._composite("action", acted)
        self.reward_spec = self._composite("reward", paid)
        self.done_spec = Composite(done=flag(), terminated=flag(), truncated=flag(), shape=(n,))

    def _composite(self, name: str, by_agent: dict[str, Any], **more: Any) -> Composite:
        shape = self.batch_size
        if self._grouped:
            return Composite(
                {one: Composite({name: x}, shape=(*shape, 1)) for one, x in by_agent.items()} | more, shape=shape
            )
        (spec,) = by_agent.values()
        return Composite({name: spec} | more, shape=shape)

    def _told(self, name: str, by_agent: Any) -> dict[str, Any]:
        """What is by agent, under TorchRL's keys."""
        if not self._grouped:
            return {name: by_agent}
        shape = (*self.batch_size, 1)
        return {one: TensorDict({name: by_agent[one].unsqueeze(1)}, shape) for one in self.group_map}

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDictBase:
        chosen = None if tensordict is None else tensordict.get("_reset", None)
        if chosen is None or self._latest is None or (chosen.all() and not self._ended.all()):
            self._latest = self._many.reset(self._seed)
            self._seed = None
        else:
            more = chosen.view(self.batch_size) & ~self._ended  # of the others the step has drawn the next episode
            if more.any():
                self._latest = self._many.reset(mask=more)
        self._ended = torch.zeros(self.batch_size, dtype=torch.bool, device=self.device)
        flags = ("success", "done", "terminated", "truncated")
        told = {name: torch.zeros(*self.batch_size, 1, dtype=torch.bool, device=self.device) for name in flags}
        told["cost"] = torch.zeros(*self.batch_size, 1, device=self.device)
        return self._dict(self._told("observation", self._latest) | told)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self._grouped:
            actions = {one: tensordict[one, "action"].squeeze(1) for one in self.group_map}
        else:
            actions = tensordict["action"]
        step = self._many.step(actions)
        self._latest, self._ended = step.obs, step.terminated | step.truncated
        told, reward = self._told("observation", step.info["final_observation"]), step.reward.unsqueeze(-1)
        for group in [told[one] for one in self.group_map] if self._grouped else [told]:
            group["reward"] = reward.unsqueeze(-1) if self._grouped else reward
        flags = {"done": self._ended, "terminated": step.terminated, "truncated": step.truncated}
        flags |= {"success": step.info["metrics"]["success"] > 0, "cost": step.info["cost"]}
        return self._dict(told | {name: flag.unsqueeze(-1) for name, flag in flags.items()})

    def _dict(self, told: dict[str, Any]) -> TensorDictBase:
        return TensorDict(told, batch_size=self.batch_size, device=self.device)

    def _set_seed(self, seed: int | None) -> None:
        self._seed = seed
