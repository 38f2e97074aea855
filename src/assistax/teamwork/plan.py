"""Training a population: a plan of independent trainings, one for each person, algorithm and seed.

plan.json   what was asked for
runs/       a run folder for each training, see training/run.py
manifest.jsonl and weights, when all of them are finished, see training/population.py

Every training can be stopped at any moment, and processes may share a plan: each takes its shard of it. In the end it
is the same population, whoever trained what and when.
"""

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from assistax.errors import UsageError
from assistax.files import read_json, write_json
from assistax.formats import PLAN
from assistax.human import Person
from assistax.tasks import task_spec
from assistax.teamwork.gather import gather
from assistax.training import loop
from assistax.training.clock import progress_bar
from assistax.training.configuration import TrainConfig, configure
from assistax.training.population import MANIFEST, Population
from assistax.training.run import Run


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

    def __post_init__(self):
        object.__setattr__(self, "task", task_spec(self.task).id)
        if self.seeds < 1 or not self.algorithms or not self.people:
            raise UsageError("A population needs one person, algorithm and seed or more.")
        if given := [name for name in self.settings if name.startswith("env.human.") and "visibility" not in name]:
            raise UsageError(f"Who the members are says --people; leave out {given[0]}.")
        next(iter(self.jobs()))  # settings that cannot be are said before anything is written

    def jobs(self) -> Iterator[tuple[str, TrainConfig]]:
        """Name and configuration of each training."""
        for i, person in enumerate(self.people):
            who = {f"env.human.{name}": value for name, value in asdict(person).items()}
            for algorithm in self.algorithms:
                for seed in range(self.seeds):
                    name = f"{i:04d}-{algorithm}-{seed}"
                    settings = {"snapshots": True} | dict(self.settings) | who
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
        settings = {k: tuple(v) if isinstance(v, list) else v for k, v in stored["settings"].items()}
        algorithms = tuple(stored["algorithms"])
        sizes = stored["seeds"], stored["steps"], stored["num_envs"]
        return cls(stored["task"], people, algorithms, *sizes, settings)


def train(folder: Path, shard: tuple[int, int] = (1, 1)) -> Population | None:
    """Train what is not yet finished of shard i of n (1 to n) of the plan in `folder`.

    Returns the population if everybody in the plan is finished then; None if others are not, or a signal came.
    """
    plan = Plan.load(folder)
    jobs = list(plan.jobs())
    mine = jobs[shard[0] - 1 :: shard[1]]
    steps = {name: config.steps for name, config in mine}
    done = {name: _steps_done(folder / "runs" / name, config) for name, config in mine}
    with progress_bar(sum(steps.values()), sum(done.values())) as bar:
        for number, (name, config) in enumerate(mine, 1):
            place = folder / "runs" / name
            if (place / "summary.json").exists():
                continue
            bar.set_description(f"member {number} of {len(mine)}")
            run = Run.open(place) if (place / "config.json").exists() else Run.create(config, place)
            if loop.train(run, bar=lambda *_: nullcontext(bar), pictures=False) is None:
                return None
    return finish(folder)


def finish(folder: Path) -> Population | None:
    """The population of a plan, written down if everybody in it is finished; None before."""
    places = [folder / "runs" / name for name, _ in Plan.load(folder).jobs()]
    if not all((place / "summary.json").exists() for place in places):
        return None
    if (folder / MANIFEST).exists():
        return Population.load(folder)
    population = gather(Run.open(place) for place in places)
    population.save(folder, beside=("plan.json", "runs", "splits"))
    return population


def train_side_by_side(folder: Path, processes: int) -> Population | None:
    """`train` in so many processes, each on cores of its own."""
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))
    if not 1 <= processes <= len(cores):
        raise UsageError(f"--processes must be 1 to {len(cores)}, the cores of this machine, not {processes}.")
    Plan.load(folder)
    running = []
    try:
        for i in range(processes):
            command = [sys.executable, "-m", "assistax", "population", "train", "--resume", str(folder)]
            child = subprocess.Popen([*command, "--shard", f"{i + 1}/{processes}"])
            if hasattr(os, "sched_setaffinity"):
                os.sched_setaffinity(child.pid, set(cores[i::processes]))
            running.append(child)
        ended = [child.wait() for child in running]
    except KeyboardInterrupt:  # the children have been told as well, and save
        ended = [child.wait() for child in running]
    if any(code not in (0, 130) for code in ended):
        raise UsageError(f"A process of {folder} has failed; what it printed stands above. What is finished stays.")
    return finish(folder)


def _steps_done(place: Path, config: TrainConfig) -> int:
    if (place / "summary.json").exists():
        return config.steps
    saved = [int(path.stem.split("_")[1]) for path in (place / "checkpoints").glob("step_*.safetensors")]
    return min(config.steps, max(saved, default=0))
