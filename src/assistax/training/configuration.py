"""What a training is asked for: one configuration, its defaults from a preset, and back from a run's config.json."""

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from assistax.env import Env, EnvConfig
from assistax.errors import UsageError
from assistax.files import read_json
from assistax.formats import CHECKPOINT, CONFIG
from assistax.learning.algorithms import ALGORITHMS, Algorithm
from assistax.learning.ppo.config import most_log_std
from assistax.learning.trainer import Trainer
from assistax.physics import resolve_engine
from assistax.policies import Player, Still
from assistax.settings import check_count, check_seed, with_settings
from assistax.stamp import stamp
from assistax.tasks import stored_task, task_spec
from assistax.training import splits
from assistax.training.checkpoint import newest_checkpoint, read_metadata
from assistax.training.population import Population, is_population
from assistax.training.presets import num_envs, preset

DEFAULT_STEPS = 5_000_000


@dataclass(frozen=True)
class TrainConfig:
    """One training: what learns what, where, with whom and for how long."""

    task: str
    algorithm: str = "ippo"
    preset: str = "default"
    engine: str = "auto"
    steps: int = DEFAULT_STEPS  # per seed; rounded up to whole iterations
    num_envs: int = 256  # per seed
    seed: int = 0
    num_seeds: int = 1
    devices: int = 1  # accelerators of this machine that share the environments
    start: str = ""  # a run with whose networks this one begins, see start.py
    partners: tuple[str, ...] = ()  # "human=still": frozen partners, see partners.py
    partner_copies: tuple[str, ...] = ()  # "human=SHA-256": trained partners that the run folder holds a copy of
    evaluations: int = 10  # how many, evenly over the training; there is always one at its end
    evaluation_episodes: int = 64  # of each evaluation
    deterministic: bool = True  # evaluate the mean action, not a sample
    snapshots: bool = False  # keep the policies of every evaluation, as earlier selves of partners
    env: EnvConfig = field(default_factory=EnvConfig)
    task_config: Any = None
    method: Any = None  # the algorithm's settings, in files and --set under its group's name ("ppo.gamma")

    def __post_init__(self):
        algorithm = self.kind
        if self.method is None:
            object.__setattr__(self, "method", algorithm.config_type(**algorithm.switches))
        for name, value in algorithm.switches.items():
            if getattr(self.method, name) != value:
                raise UsageError(f"{self.group}.{name} is {value} for {self.algorithm}; change --algorithm, not it.")
        if self.devices > 1 and not algorithm.shares:
            raise UsageError(f"devices = {self.devices}, and {self.algorithm} trains on one; leave it out.")
        if self.steps < 1:
            raise UsageError(f"steps must be 1 or more, not {self.steps}.")
        for name in ("num_envs", "num_seeds", "devices", "evaluations", "evaluation_episodes"):
            check_count(name, getattr(self, name))
        check_count(f"num_envs x {self.group}.num_steps", self.num_envs * self.method.num_steps)
        for seed in (self.seed, self.seeds[-1]):
            check_seed("seed", seed)

    @property
    def kind(self) -> Algorithm:
        """The algorithm's row in the registry."""
        return ALGORITHMS[self.algorithm]

    @property
    def group(self) -> str:
        """The name under which files and commands know the algorithm's settings."""
        return self.kind.group

    @property
    def renamed(self) -> dict[str, str]:
        """Fields that files and commands know by other names, see `settings.with_settings`."""
        return {"method": self.group}

    @property
    def seeds(self) -> range:
        """The first seed and those after it, one for each run."""
        return range(self.seed, self.seed + self.num_seeds)

    @property
    def iterations(self) -> int:
        """Of each seed, together `steps` or a little more."""
        return -(-self.steps // (self.num_envs * self.method.num_steps))

    def trainer(self, env, partners: Mapping[str, Player]) -> Trainer:
        """The trainer of those agents of `env` that have no frozen partner."""
        return self.kind.trainer(env, self.method, self.num_envs, self.iterations, partners)


# What is asked for with a flag of its own, and with which: a setting by that name would be a label that says nothing.
FLAGS = {"task": "the task's name in front", "partners": "--partner", "start": "--start"}
FLAGS |= {name: f"--{name.replace('_', '-')}" for name in ("algorithm", "preset", "engine", "steps", "num_envs")}
FLAGS |= {"seed": "--seed", "num_seeds": "--num-seeds (in `assistax sweep` and `population train` by --seeds)"}


def check_settings(settings: Iterable[str]) -> None:
    """Raise UsageError for settings that have a flag of their own, or that no one sets."""
    for name in settings:
        if name in FLAGS:
            raise UsageError(f"{name} is chosen by {FLAGS[name]}, not as a setting.")
        if name == "partner_copies":
            raise UsageError("partner_copies is written by the program; leave it out.")


def configure(task: str, settings: dict[str, Any], recurrent=False, share_parameters=False, **choices) -> TrainConfig:
    """A TrainConfig from a task's preset, then `choices` (fields), then `settings` ("ppo.gamma": 0.98).

    With a population as the human's partner, the people are its members unless the settings have others. Where people
    have preferences a preset's scripted robot is the considerate one. Who begins with another run's networks is not
    taught what they know, and explores as little as they did in the end.
    """
    check_settings(settings)
    settings = people_of(choices.get("partners") or ()) | settings
    spec = task_spec(task)
    given = {name: value for name, value in choices.items() if value is not None}
    algorithm = ALGORITHMS[given.get("algorithm", "ippo")]
    others = {other.group for other in ALGORITHMS.values()} - {algorithm.group}
    if foreign := [name for name in settings if name.split(".")[0] in others]:
        raise UsageError(f"{foreign[0]} does not exist for {algorithm.name}; its settings are {algorithm.group}.*.")
    known = {field.name for field in dataclasses.fields(algorithm.config_type)}
    switches = {"recurrent": recurrent, "share_parameters": share_parameters}
    if absent := [name for name, wanted in switches.items() if wanted and name not in known]:
        raise UsageError(f"--{absent[0].replace('_', '-')} does not exist for {algorithm.name}.")
    switches["recurrent"] = recurrent or settings.get(f"{algorithm.group}.recurrent") is True
    name = given.get("preset", "default")
    row = preset(name, algorithm.name, spec.id, switches["recurrent"])
    row |= {switch: value for switch, value in switches.items() if switch in known}
    if settings.get("env.control", "torque") != "torque":  # the scripted robot plays with torques
        row |= {"teachers": tuple(one for one in row["teachers"] if "robot=" not in one)} if "teachers" in row else {}
    if (start := given.get("start")) and algorithm.group == "ppo":
        row |= {"teachers": (), "initial_log_std": _log_std_after(Path(start), algorithm.name)}
    method = with_settings(algorithm.config_type(**algorithm.switches), row)
    fields: dict[str, Any] = {"num_envs": num_envs(name, algorithm.name), "method": method} | given
    config = TrainConfig(spec.id, task_config=spec.config, **fields)
    resolve_engine(config.engine)
    config = with_settings(config, settings)
    if "ppo.teachers" not in settings and config.group == "ppo" and config.env.human.preferring:
        shown = (one.replace("robot=expert", "robot=considerate") for one in config.method.teachers)
        config = with_settings(config, {"ppo.teachers": tuple(shown)})
    return config


def people_of(partners: Iterable[str | Population]) -> dict[str, Any]:
    """The settings of who the person is that these partners ("human=POP:random/train", or itself) bring along."""
    for one in partners:
        if isinstance(one, str):
            agent, _, name = one.partition("=")
            if agent != "human" or not is_population(name):
                continue
            one = splits.named(name)[1]
        words = {"env.human.disability": "none", "env.human.preference": "none"}
        return {"env.human.people": one.people, "env.human.weights": ()} | words
    return {}


def _log_std_after(start: Path, algorithm: str) -> float:
    """The most exploration that there may have been in the last iteration of a training that another begins with."""
    config = read_config(start)
    if config.algorithm != algorithm:
        raise UsageError(f"{start} is of the algorithm {config.algorithm}, not {algorithm}.")
    method, per_iteration = config.method, config.num_envs * config.method.num_steps
    if method.final_log_std is None:
        return method.initial_log_std
    path = newest_checkpoint(start)
    done = config.iterations if path is None else read_metadata(path, CHECKPOINT)["steps"] // per_iteration
    return float(most_log_std(method, done, per_iteration, config.iterations))


def stored_config(stored: Mapping[str, Any], source: str) -> TrainConfig:
    """The TrainConfig of what `to_json` made; fields that it lacks have their defaults.

    `source` is what an error calls it.
    """
    try:
        spec = task_spec(stored_task(stored["task"]))
        blank = TrainConfig(spec.id, stored.get("algorithm", "ippo"), task_config=spec.config)
        return with_settings(blank, {k: v for k, v in stored.items() if k not in ("task", "stamp", "resumed")})
    except UsageError as error:
        raise UsageError(f"Cannot read {source}: {error}") from None


def read_config(folder: Path) -> TrainConfig:
    """The configuration of a run; raises UsageError if the folder is none."""
    path = folder / "config.json"
    if not path.exists():
        raise UsageError(f"{folder} is not a run folder: it has no config.json.")
    return stored_config(read_json(path, CONFIG), str(path))


def to_play(config: TrainConfig) -> dict[str, Any]:
    """Settings of those who only play what was learned: who taught need not be able to play there."""
    return {"ppo.teachers": ()} if config.group == "ppo" else {}


def trained_env(config: TrainConfig) -> tuple[Env, Any]:
    """The environment that something was trained in, and a trainer that knows its policies and has no teachers."""
    config = with_settings(config, to_play(config))
    env = Env(config.task, config.engine, config.env, config.task_config)
    others = [text.split("=")[0] for text in config.partners]  # who they were makes no difference to the learners
    return env, config.trainer(env, {agent: Player(Still(env.action_sizes[agent])) for agent in others})


def to_json(config: TrainConfig) -> dict[str, Any]:
    """A configuration with the stamp of this process."""
    content = dataclasses.asdict(config)
    content[config.group] = content.pop("method")
    return content | {"stamp": stamp()}
