"""A task of BenchMARL, whose algorithms then train robot and human.

from benchmarl.algorithms import MappoConfig
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from assistax.adapters.benchmarl import AssistaxTask

Experiment(
    AssistaxTask("scratch-v3"),
    MappoConfig.get_from_yaml(),
    MlpConfig.get_from_yaml(),
    seed=0,
    config=ExperimentConfig.get_from_yaml(),
).run()
"""

from collections.abc import Callable
from typing import Any

from assistax.adapters import missing

try:
    from benchmarl.environments.common import TaskClass
    from tensordict import TensorDictBase
    from torchrl.data import Composite
    from torchrl.envs import EnvBase
except ImportError as error:
    raise missing(error, "benchmarl") from None

from assistax.adapters.torchrl import TorchRLEnv
from assistax.env import make


class AssistaxTask(TaskClass):
    """Both agents, each a group of its own; as many environments as BenchMARL asks for, stepped in one compiled call.

    Args:
      task: its id, for example "scratch-v3".
      engine: as in `assistax.make`.
      **settings: as in `assistax.make`, for example `episode_length=500`.

    Raises:
      UsageError: a task, engine or setting that cannot be used.
    """

    def __init__(self, task: str, engine: str = "auto", **settings: Any):
        make(task, engine, **settings)
        super().__init__(task, {"engine": engine} | settings)

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        def env() -> EnvBase:
            many = TorchRLEnv(self.name, num_envs, agent="both", **self.config)
            many.set_seed(seed)
            return many

        return env

    def supports_continuous_actions(self) -> bool:
        return True

    def supports_discrete_actions(self) -> bool:
        return False

    def max_steps(self, env: EnvBase) -> int:
        return env.assistax.episode_length

    def has_render(self, env: EnvBase) -> bool:
        return False

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        return env.group_map

    def observation_spec(self, env: EnvBase) -> Composite:
        spec = env.full_observation_spec_unbatched.clone()
        for name in set(spec.keys()) - set(env.group_map):
            del spec[name]
        return spec

    def action_spec(self, env: EnvBase) -> Composite:
        return env.full_action_spec_unbatched

    def info_spec(self, env: EnvBase) -> None:
        return None

    def state_spec(self, env: EnvBase) -> None:
        return None

    def action_mask_spec(self, env: EnvBase) -> None:
        return None

    @staticmethod
    def env_name() -> str:
        return "assistax"

    @staticmethod
    def log_info(batch: TensorDictBase) -> dict[str, float]:
        """The share of the episodes that ended in this batch which were a success, and the mean cost of a step."""
        ended, cost = batch["next", "done"], float(batch["next", "cost"].mean())
        told = {"collection/info/cost": cost}
        if ended.any():
            told["collection/info/success"] = float(batch["next", "success"][ended].float().mean())
        return told
