"""What a training is asked for: one configuration, its defaults from a preset, and back from a run's config.json."""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from assistax.env import Env, EnvConfig
from assistax.errors import UsageError, choose
from assistax.learning.ppo import PPO, PPOConfig
from assistax.learning.sac import SAC, SACConfig
from assistax.physics import resolve_engine
from assistax.policies import Player, Still
from assistax.settings import with_settings
from assistax.stamp import stamp
from assistax.tasks import task_class
from assistax.training.presets import ALGORITHMS, num_envs, preset

DEFAULT_STEPS = 5_000_000
# By algorithm its trainer and the group of its settings in TrainConfig.
TRAINERS = {
    "ippo": (PPO, "ppo"),
    "mappo": (PPO, "ppo"),
    "masac": (SAC, "sac"),
    "isac": (SAC, "sac"),
}


@dataclass(frozen=True)
class TrainConfig:
    task: str
    algorithm: str = "ippo"
    preset: str = "default"
    engine: str = "auto"
    steps: int = DEFAULT_STEPS  # per seed; rounded up to whole iterations
    num_envs: int = 256  # per seed
    seed: int = 0
    num_seeds: int = 1
    partners: tuple[str, ...] = ()  # "human=still": seats that do not learn, and who plays them, see partners.py
    evaluations: int = 10  # evenly over the training; the last is at its end and always made
    evaluation_episodes: int = 64
    deterministic: bool = True  # evaluate the mean action, not a sample
    env: EnvConfig = field(default_factory=EnvConfig)
    task_config: Any = None
    ppo: PPOConfig = field(default_factory=PPOConfig)  # of ippo and mappo
    sac: SACConfig = field(default_factory=SACConfig)  # of masac and isac

    @property
    def group(self) -> str:
        """The name of the settings that the algorithm has."""
        return TRAINERS[self.algorithm][1]

    @property
    def seeds(self) -> range:
        return range(self.seed, self.seed + self.num_seeds)

    @property
    def iterations(self) -> int:
        """Of each seed, together `steps` or a little more."""
        return -(-self.steps // (self.num_envs * getattr(self, self.group).num_steps))

    def trainer(self, env, partners: Mapping[str, Player]) -> Any:
        """The trainer of those agents of `env` that have no frozen partner."""
        return TRAINERS[self.algorithm][0](env, getattr(self, self.group), self.num_envs, self.iterations, partners)

    def __post_init__(self):
        choose("algorithm", self.algorithm, TRAINERS)
        for name, value in ALGORITHMS[self.algorithm].items():
            if getattr(getattr(self, self.group), name) != value:
                raise UsageError(f"{self.group}.{name} is {value} for {self.algorithm}; change --algorithm, not it.")
        for name in ("steps", "num_envs", "num_seeds", "evaluation_episodes"):
            if getattr(self, name) < 1:
                raise UsageError(f"{name} must be 1 or more, not {getattr(self, name)}.")


def configure(task: str, settings: dict[str, Any], recurrent=False, share_parameters=False, **choices) -> TrainConfig:
    """A TrainConfig from a task's preset, then `choices` (fields), then `settings` ("ppo.gamma": 0.98)."""
    cls = task_class(task)
    given = {name: value for name, value in choices.items() if value is not None}
    algorithm = choose("algorithm", given.get("algorithm", "ippo"), TRAINERS)
    _, group = TRAINERS[algorithm]
    if foreign := [name for name in settings if name.split(".")[0] in {"ppo", "sac"} - {group}]:
        raise UsageError(f"{foreign[0]} does not exist for {algorithm}; its settings are {group}.*.")
    if group == "sac" and (recurrent or share_parameters):
        raise UsageError("--recurrent and --share-parameters exist for ippo and mappo only.")
    recurrent = recurrent or settings.get("ppo.recurrent") is True
    switches = {"recurrent": recurrent, "share_parameters": share_parameters} if group == "ppo" else {}
    name = given.get("preset", "default")
    row = preset(name, algorithm, task, recurrent)
    groups = {"ppo": PPOConfig(), "sac": SACConfig()}
    fields: dict[str, Any] = {
        "num_envs": num_envs(name, algorithm),
        group: with_settings(groups[group], row | switches),
    } | given
    config = TrainConfig(task, task_config=cls.config_type(), **fields)
    resolve_engine(config.engine)
    return with_settings(config, settings)


def stored_config(stored: Mapping[str, Any]) -> TrainConfig:
    """The TrainConfig of what `to_json` made; fields that it lacks have their defaults."""
    blank = TrainConfig(stored["task"], task_config=task_class(stored["task"]).config_type())
    return with_settings(blank, {k: v for k, v in stored.items() if k not in ("task", "stamp")})


def trained_env(config: TrainConfig) -> tuple[Env, Any]:
    """The environment that something was trained in, and a trainer that knows its policies."""
    env = Env(config.task, config.engine, config.env, config.task_config)
    others = [text.split("=")[0] for text in config.partners]  # who they were makes no difference to the learners
    return env, config.trainer(env, {agent: Player(Still(env.action_sizes[agent])) for agent in others})


def to_json(config: TrainConfig) -> dict[str, Any]:
    """A configuration with the stamp of this process, without the settings that its algorithm does not have."""
    content = dataclasses.asdict(config) | {"stamp": stamp()}
    del content[{"ppo": "sac", "sac": "ppo"}[config.group]]
    return content
