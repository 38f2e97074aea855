"""Training a population: a plan of independent trainings, one for each person, algorithm and seed.

plan.json   what was asked for
runs/       a run folder for each training, see training/run.py
workers/    who trains what, see executors/claims.py, and what workers have printed
manifest.jsonl and weights, when all of them are finished, see training/population.py

Every training can be stopped at any moment, and processes may share a plan: each takes what nobody else has. In the end
it is the same population, whoever trained what and when.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from assistax.errors import UsageError, choose
from assistax.executors.drive import Executor, drive
from assistax.executors.here import work_here
from assistax.executors.jobs import Job, is_worker
from assistax.files import read_json, write_json
from assistax.formats import PLAN
from assistax.human import Person
from assistax.learning.algorithms import ALGORITHMS
from assistax.policies.habits import HABITS
from assistax.tasks import task_spec
from assistax.teamwork.gather import gather
from assistax.training import loop
from assistax.training.clock import progress_bar
from assistax.training.configuration import TrainConfig, configure
from assistax.training.population import MANIFEST, Population
from assistax.training.presets import UNTAUGHT
from assistax.training.run import Run

WORKERS = "workers"  # folder of their claims and logs


@dataclass(frozen=True)
class Plan:
    """What to train: everybody of `people` with each algorithm and seed."""

    task: str
    people: tuple[Person, ...]
    algorithms: tuple[str, ...] = ("ippo",)
    seeds: int = 1
    steps: int | None = None  # of each training; None: the default
    num_envs: int | None = None  # of each training; None: the default
    settings: Mapping[str, Any] = field(default_factory=dict)
    taught: tuple[str, ...] = ()  # habits that the people are taught at first, one after the other; none: no teachers

    def __post_init__(self):
        object.__setattr__(self, "task", task_spec(self.task).id)
        settings = {name: tuple(value) if isinstance(value, list) else value for name, value in self.settings.items()}
        object.__setattr__(self, "settings", settings)  # as it is when it was stored and loaded again
        if self.seeds < 1 or not self.algorithms or not self.people:
            raise UsageError("A population needs one person, algorithm and seed or more.")
        if given := [name for name in self.settings if name.startswith("env.human.") and "visibility" not in name]:
            raise UsageError(f"Who the members are says --people; leave out {given[0]}.")
        for name in self.taught:
            choose("habit", name, HABITS)
        alone = [name for name in self.algorithms if ALGORITHMS[choose("algorithm", name, ALGORITHMS)].group != "ppo"]
        if self.taught and alone:
            raise UsageError(f"Only PPO can be taught habits: leave out --taught or {', '.join(alone)}.")
        next(iter(self.jobs()))  # settings that cannot be are refused before anything is written

    def jobs(self) -> Iterator[tuple[str, TrainConfig]]:
        """Name and configuration of each training."""
        for i, person in enumerate(self.people):
            who = {f"env.human.{name}": value for name, value in asdict(person).items()}
            for algorithm in self.algorithms:
                for seed in range(self.seeds):
                    name = f"{i:04d}-{algorithm}-{seed}"
                    # People who were taught by one script would all be alike.
                    start = UNTAUGHT if ALGORITHMS[algorithm].group == "ppo" else {}
                    if self.taught:  # every person another habit with another seed, every habit as often
                        habit = self.taught[(i + seed) % len(self.taught)]
                        robot = "expert" if person.preference == "none" else "considerate"
                        start = {"ppo.teachers": (f"robot={robot}", f"human={habit}")}
                    settings = {"snapshots": True} | start | dict(self.settings) | who
                    choices = {"algorithm": algorithm, "seed": seed, "steps": self.steps, "num_envs": self.num_envs}
                    yield name, configure(self.task, settings, **choices)

    def save(self, folder: Path) -> None:
        """Begin a population in a folder, or find the same plan there."""
        if (folder / "plan.json").exists():
            if Plan.load(folder) != self:
                raise UsageError(f"{folder} is a population by another plan; name another --out, or continue that one.")
            return
        if folder.exists() and any(folder.iterdir()):
            raise UsageError(f"{folder} is not empty; a population is trained in a folder of its own.")
        (folder / "runs").mkdir(parents=True, exist_ok=True)
        write_json(folder / "plan.json", asdict(self) | {"settings": dict(self.settings)})

    @classmethod
    def load(cls, folder: Path) -> "Plan":
        """The plan of a folder; raises UsageError if it has none."""
        path = folder / "plan.json"
        if not path.exists():
            raise UsageError(f"{folder} has no plan.json; begin with `assistax population train TASK --out {folder}`.")
        stored = read_json(path, PLAN)
        people = tuple(Person(**person) for person in stored["people"])
        algorithms = tuple(stored["algorithms"])
        sizes = stored["seeds"], stored["steps"], stored["num_envs"]
        return cls(stored["task"], people, algorithms, *sizes, stored["settings"], tuple(stored.get("taught", ())))


def jobs(folder: Path, bar: Callable = progress_bar) -> list[Job]:
    """The trainings of the plan in `folder`."""
    return [training(folder / "runs" / name, config, bar) for name, config in Plan.load(folder).jobs()]


def training(place: Path, config: TrainConfig, bar: Callable = progress_bar) -> Job:
    """A training, without pictures, in a run folder of its own."""

    def do() -> bool:
        Run.clear(place)
        run = Run.open(place) if (place / "config.json").exists() else Run.create(config, place)
        return loop.train(run, bar=bar, pictures=False) is not None

    return Job(place.name, config.steps, lambda: steps_done(place, config.steps), do)


def train(folder: Path, shard: tuple[int, int] = (1, 1)) -> Population | None:
    """Train what is not yet finished, nor just being trained by others, of shard i of n (1 to n) of a plan.

    Returns the population if everybody in the plan is finished then; None if others are not, or a signal came, or if
    this is a worker of an executor, whose driver gathers the population.
    """
    through = work_here(folder / WORKERS, partial(jobs, folder), progress_bar, "member", shard)
    return finish(folder) if through and not is_worker() else None


def train_with(folder: Path, using: Executor, workers: int | None = None) -> Population | None:
    """`train` in as many processes as an executor starts."""
    command = [sys.executable, "-m", "assistax", "population", "train", "--resume", str(folder.resolve())]
    drive(folder / WORKERS, jobs(folder), using, command, workers, progress_bar)
    return finish(folder)


def finish(folder: Path) -> Population | None:
    """The population of a plan, written down if everybody in it is finished; None before."""
    places = [folder / "runs" / name for name, _ in Plan.load(folder).jobs()]
    if not all((place / "summary.json").exists() for place in places):
        return None
    if (folder / MANIFEST).exists():
        return Population.load(folder)
    population = gather(Run.open(place) for place in places)
    if not (folder / MANIFEST).exists():  # nor has another machine just written it
        population.save(folder, beside=("plan.json", "runs", "splits", WORKERS))
    return population


def steps_done(place: Path, steps: int) -> int:
    """Steps of a run that are safe; all `steps` only when it is finished."""
    if (place / "summary.json").exists():
        return steps
    saved = [int(path.stem.split("_")[1]) for path in (place / "checkpoints").glob("step_*.safetensors")]
    return min(steps - 1, max(saved, default=0))
