"""The experiments behind the results: which there are, how far each is, and a bit more of the next one.

Work in progress lies in `runs/reproduce/`, with its checkpoints; what is finished goes to `results/`, whole
or not at all. So any machine at hand for some minutes is useful: `assistax reproduce --budget 9m`.
"""

import math
import os
import shutil
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Protocol

from assistax.errors import UsageError
from assistax.executors.jobs import Job, is_worker
from assistax.executors.jobs import work as carry_out
from assistax.files import write_atomically
from assistax.human import DISABILITIES
from assistax.tasks import task_spec
from assistax.training.presets import TASKS, UNTAUGHT

ALGORITHMS = ("ippo", "ippo-rnn", "mappo", "mappo-rnn", "masac")
STEPS = {"default": 10_000_000, "paper": 40_000_000}  # of PPO by preset; ours take half an hour
# ... but of the versions from 1 on, where teachers help; the second with preferences.
TAUGHT = dict.fromkeys(TASKS, 2_000_000) | {"scratch": 4_000_000, "bed_bath": 6_000_000}
VARIED = dict.fromkeys(TASKS, 4_000_000) | {"bed_bath": 6_000_000}
UNHELPED = TAUGHT | {"arm_assist": 4_000_000}  # a robot alone does not lift the arm in 2 M
NEED_TWO = ("scratch", "bed_bath")
ALONE = "-untaught"  # what are the teachers worth?
SAC_STEPS = {"default": 3_000_000, "paper": 6_000_000}
# The robot learns beside a person who does nothing, or who resists what is done: what is the person's help worth?
STILL = ("-still", "-keeps_still")
# Who the person is and how it begins to learn, by suffix of the experiment's name.
PEOPLE: dict[str, dict[str, Any]] = {
    "": {},
    **{people: {} for people in STILL},
    ALONE: UNTAUGHT,
    "-preferences": {"env.human.preference": "sweep"},
    **{f"-{name}": {"env.human.disability": name} for name in DISABILITIES},
}
_FORMER = (  # task, version, people, seeds, millions of steps
    ("scratch", 1, "", 5, 6),
    ("scratch", 1, "-still", 3, 6),
    ("scratch", 1, "-keeps_still", 1, 6),
    ("scratch", 1, "-preferences", 3, 10),
    ("scratch", 2, "", 5, 4),
    ("scratch", 2, "-preferences", 1, 8),
    ("bed_bath", 1, "", 5, 6),
    ("bed_bath", 1, "", 2, 10),
    ("bed_bath", 1, "-still", 1, 6),
    ("bed_bath", 1, "-preferences", 3, 6),
    ("bed_bath", 2, "", 5, 6),
    ("arm_assist", 1, "", 5, 2),
    ("arm_assist", 1, "-still", 1, 2),
    ("arm_assist", 1, "-preferences", 3, 4),
    ("arm_assist", 1, ALONE, 3, 4),
    ("feeding", 1, "", 5, 2),
    ("feeding", 1, "-preferences", 3, 2),
    ("feeding", 1, "-preferences", 3, 4),
    ("feeding", 1, ALONE, 3, 4),
    ("feeding", 2, "", 5, 2),
    ("tooth_brushing", 1, "", 5, 2),
    ("tooth_brushing", 1, "-preferences", 3, 2),
    ("tooth_brushing", 1, ALONE, 2, 4),
)
WORKERS = "workers"  # folder of their claims and logs, where the work is done
KEPT = ("config.json", "evaluations.jsonl", "summary.json", "learning_curve.png")  # of a finished run
PLAYABLE = (*KEPT[:3], "policies.safetensors")  # of a finished robot


@dataclass(frozen=True)
class Method:
    """How a robot learns that is to meet strangers; docs/teamwork.md names the papers."""

    beside: str = "train"  # or "train+earlier" of the split; a habit with the bodies of its people; "", such a learner
    settings: dict[str, Any] = field(default_factory=dict)
    recurrent: bool = False
    algorithm: str = "ippo"


STAYS = {"env.human.redraw_every": 3}
METHODS = {
    "best-response": Method(),
    "best-response-clock": Method(settings={"env.clock": 1.5}),  # where the task has none
    "untaught": Method(settings=UNTAUGHT),
    "asymmetric": Method(settings={"ppo.critic_knows_partner": True}),
    "fcp": Method("train+earlier"),
    "oracle": Method(settings={"env.human.visibility": "oracle"}),
    "hidden": Method(settings={"env.human.visibility": "human"}),
    "shown": Method(settings={"env.human.visibility": "shown"}),
    "gru": Method(recurrent=True),
    "gru-hidden": Method(settings={"env.human.visibility": "human"}, recurrent=True),
    "gru-stays": Method(settings=STAYS, recurrent=True),
    "gru-stays-hidden": Method(settings=STAYS | {"env.human.visibility": "human"}, recurrent=True),
    "oracle-gru": Method(settings=STAYS | {"env.human.visibility": "oracle"}, recurrent=True),
    "liam": Method(settings={"ppo.partner_code": 16}),
    "randomised": Method("offers"),
    "self-play": Method(""),
    "self-play-hidden": Method("", {"env.human.visibility": "human"}),
    "e3t": Method("", {"env.human.random_share": 0.25}),
    "sac": Method(algorithm="isac"),
}
SEVERAL = ("best-response", "untaught", "asymmetric", "fcp", "oracle", "gru", "gru-stays", "liam", "randomised")
SEVERAL += ("self-play", "e3t")
# Who is told what people like, who sees it, and who has to find out.
TASTES = ("hidden", "shown", "best-response", "self-play-hidden", "gru-hidden", "gru-stays-hidden", "oracle")
HIDDEN = ("hidden", "gru-stays-hidden", "oracle-gru")  # who must find out what a person likes, and who is told


class Experiment(Protocol):
    """What `assistax reproduce` lists and does."""

    shows: ClassVar[str]

    @property
    def name(self) -> str:
        """Its file or folder below `results/`."""
        ...

    def progress(self, work: Path) -> float:
        """The fraction, 0 to 1, of it that lies in the folder `work`."""
        ...

    def advance(self, work: Path, seconds: float) -> Path | list[Path] | None:
        """Continue in `work` for about so many seconds; when finished, the file or the files of a folder to keep."""
        ...


@dataclass(frozen=True)
class Training:
    """One seed of one algorithm on one task."""

    task: str
    algorithm: str  # of ALGORITHMS
    preset: str
    people: str  # key of PEOPLE
    seed: int
    steps: int
    version: int  # of the task
    shows: ClassVar[str] = "learning curves"

    @property
    def name(self) -> str:
        folder = f"version{self.version}/" if self.version else ""
        who = f"{self.algorithm}-{self.preset}{self.people}"
        return f"{folder}{self.task}-{who}-{self.steps // 1_000_000}M-{self.seed}"

    def progress(self, work: Path) -> float:
        return _share_of(work, self.steps)

    def advance(self, work: Path, seconds: float) -> list[Path] | None:
        from assistax.training.configuration import configure
        from assistax.training.run import Run

        if not (work / "config.json").exists():
            Run.clear(work)
            algorithm, _, memory = self.algorithm.partition("-")
            choices: dict[str, Any] = {"algorithm": algorithm, "recurrent": bool(memory), "preset": self.preset}
            choices |= {"partners": (f"human={self.people[1:]}",)} if self.people in STILL else {}
            settings = PEOPLE[self.people] | {"evaluations": min(40, max(10, self.steps // 500_000))}
            task = f"{self.task}-v{self.version}"
            Run.create(configure(task, settings, steps=self.steps, seed=self.seed, **choices), work)
        return _train(work, seconds, KEPT)


@dataclass(frozen=True)
class Robot:
    """One seed of a robot that learns beside people of a population of ours, to meet others of it."""

    population: str  # folder below `populations/`
    split: str
    method: str  # key of METHODS
    seed: int
    steps: int
    shows: ClassVar[str] = "strangers"

    @property
    def name(self) -> str:
        return f"teamwork/{self.population}/runs/{self.split}-{self.method}-{self.steps // 1_000_000}M-{self.seed}"

    def progress(self, work: Path) -> float:
        return _share_of(work, self.steps)

    def advance(self, work: Path, seconds: float) -> list[Path] | None:
        from assistax.training import splits
        from assistax.training.configuration import configure
        from assistax.training.run import Run

        if not (work / "config.json").exists():
            Run.clear(work)
            method, population = METHODS[self.method], f"populations/{self.population}:{self.split}"
            settings, partners = dict(method.settings), (f"human={population}/{method.beside}",)
            _, people = splits.named(f"{population}/train")
            if not method.beside.startswith("train"):
                settings["env.human.people"] = people.people
                partners = (f"human={method.beside}",) if method.beside else ()
            choices: dict[str, Any] = {"algorithm": method.algorithm, "recurrent": method.recurrent}
            choices |= {"partners": partners, "steps": self.steps, "seed": self.seed}
            Run.create(configure(people.task, settings, **choices), work)
        return _train(work, seconds, PLAYABLE)


@dataclass(frozen=True)
class Sweeping:
    """A small random search."""

    task: str
    algorithm: str
    configs: int = 24
    steps: int = 2_000_000
    shows: ClassVar[str] = "sweep"

    @property
    def name(self) -> str:
        return f"sweep-{self.task}-{self.algorithm}-{self.configs}x{self.steps // 1_000_000}M"

    def progress(self, work: Path) -> float:
        return len(list(work.glob("trials/*/trial.json"))) / self.configs

    def advance(self, work: Path, seconds: float) -> list[Path] | None:
        from assistax.training.configuration import configure
        from assistax.training.search import SEARCH
        from assistax.training.sweep import Sweep

        if (work / "sweep.json").exists():
            sweep = Sweep.open(work)
        else:
            config = configure(f"{self.task}-v0", {}, algorithm=self.algorithm, preset="paper", steps=self.steps)
            sweep = Sweep.create(config, work, self.configs, SEARCH[config.group])
        if sweep.run(seconds=seconds) is None:
            return None
        return [work / name for name in ("sweep.json", "ranking.json")] + sorted(work.glob("*.png"))


def _share_of(work: Path, steps: int) -> float:
    """The fraction of these steps that the newest checkpoint has."""
    saved = [int(path.stem.split("_")[1]) for path in (work / "checkpoints").glob("step_*.safetensors")]
    return min(1.0, max(saved, default=0) / steps)


def _train(work: Path, seconds: float, kept: Sequence[str]) -> list[Path] | None:
    from assistax.training.loop import train
    from assistax.training.run import Run

    if train(Run.open(work), seconds) is None:
        return None
    return [work / name for name in kept]


def _trainings(
    algorithm: str,
    preset: str,
    people: str,
    seeds: int,
    steps: int | None = None,
    version: int | None = None,
    tasks: Sequence[str] = TASKS,
) -> Iterator[Experiment]:
    """Seed after seed; with the usual number of steps and of the newest version, unless given."""

    def usual(task):
        if algorithm == "masac":
            return SAC_STEPS[preset]
        if preset == "default" and version != 0:
            return (VARIED if people == "-preferences" else UNHELPED if people in STILL else TAUGHT)[task]
        return STEPS[preset]

    for seed in range(seeds):
        for task in tasks:
            number = task_spec(task).version if version is None else version
            yield Training(task, algorithm, preset, people, seed, steps or usual(task), number)


def _robots(
    population: str, split: str, steps: int, seeds: int | None, methods: Sequence[str] = SEVERAL
) -> Iterator[Experiment]:
    """Seed after seed of all methods: three of the best response, and two of the others."""
    number = {method: seeds or (3 if method == "best-response" else 2) for method in methods}
    for seed in range(max(number.values())):
        yield from (Robot(population, split, method, seed, steps) for method in methods if seed < number[method])


def experiments(seeds: int | None = None) -> Iterator[Experiment]:
    """All of them, what matters most first; `seeds` of each training, or as many as are planned of it."""
    some = ("scratch", "arm_assist", "feeding")
    yield from _trainings("ippo", "default", "", seeds or 5)
    yield from _trainings("ippo", "default", "-preferences", seeds or 3)
    yield from _trainings("ippo", "default", "-still", seeds or 3)
    yield from _trainings("ippo", "default", "-keeps_still", seeds or 1, tasks=NEED_TWO)
    yield from _trainings("mappo", "default", "", seeds or 3)
    for name in DISABILITIES:
        yield from _trainings("ippo", "default", f"-{name}", seeds or 1, tasks=some[1:])
    easier = [task for task in TASKS if task not in NEED_TWO]
    yield from _trainings("ippo", "default", ALONE, seeds or 3, 4_000_000, tasks=easier)
    for algorithm in ("ippo-rnn", "mappo-rnn"):
        yield from _trainings(algorithm, "default", "", seeds or 2, tasks=some)
    yield from _trainings("masac", "default", "", seeds or 3, tasks=some)
    yield from _robots("scratch-v3-tastes", "interpolate", 3_000_000, seeds or 3, TASTES[:3])
    yield from _robots("scratch-v3-tastes", "interpolate", 3_000_000, seeds or 2, TASTES[3:])
    yield from _robots("scratch-v3", "taught", 4_000_000, seeds, ("best-response", "self-play"))
    yield from _of_former_versions(seeds)
    yield from _of_the_paper(seeds or 1)


def _of_former_versions(seeds: int | None) -> Iterator[Experiment]:
    """What was measured of versions from 1 on that are no longer the newest, where a seed more says more."""
    for task, version, people, number, steps in _FORMER:
        yield from _trainings("ippo", "default", people, seeds or number, steps * 1_000_000, version, (task,))
    for task in ("feeding", "tooth_brushing"):
        yield from _trainings("mappo", "default", "", 1, version=1, tasks=(task,))
    yield from _robots("scratch-v1", "taught", 8_000_000, seeds)  # at 4 M they have 60 % and are still rising
    yield from _robots("scratch-v1", "taught", 4_000_000, seeds or 3, ("best-response-clock",))
    yield from _robots("feeding-v1", "random", 2_000_000, seeds, (*SEVERAL, *HIDDEN))
    yield from _robots("feeding-v1", "extreme", 2_000_000, seeds, ("best-response", "sac"))


def _of_the_paper(seeds: int) -> Iterator[Experiment]:
    """Version 0 of the tasks, for comparison with the paper's results."""
    paper = partial(_trainings, version=0, seeds=seeds)
    for algorithm in ALGORITHMS:
        for preset in STEPS:
            yield from paper(algorithm, preset, "")
        if algorithm == "ippo":  # do the default's ten million hold?
            yield from paper(algorithm, "default", "", steps=STEPS["paper"])
    yield Sweeping("scratch", "ippo")
    for people in ("-preferences", "-tremor+weakness"):
        yield from paper("ippo", "default", people)
    for algorithm in ALGORITHMS[1:]:
        for preset in STEPS:
            yield from paper(algorithm, preset, "-preferences")


def status(chosen: list[Experiment], results: Path, work: Path) -> list[tuple[Experiment, float]]:
    """With the fraction of each that is done: 1 only of what lies in `results`."""
    return [(e, 1.0 if (results / e.name).exists() else min(0.999, e.progress(work / e.name))) for e in chosen]


def advance(chosen: list[Experiment], results: Path, work: Path, seconds: float) -> list[Experiment]:
    """Do what is missing and nobody else does, in order, until the time is spent; returns what was finished."""
    begun = [one for one in jobs(chosen, results, work, seconds) if not one.finished]
    carry_out(work / WORKERS, begun, lambda job: print(f"{job.name} ({job.done()}% done)", flush=True))
    names = {job.name for job in begun if job.finished}
    return [one for one in chosen if one.name.replace("/", "-") in names]


def jobs(chosen: list[Experiment], results: Path, work: Path, seconds: float = math.inf) -> list[Job]:
    """The experiments as jobs, which stop when the time is spent."""
    deadline = time.monotonic() + seconds

    def job(experiment: Experiment) -> Job:
        place, kept_at = work / experiment.name, results / experiment.name

        def do() -> bool:
            if (left := deadline - time.monotonic()) <= 0:
                return False
            try:
                kept = experiment.advance(place, left)
            except UsageError as error:  # of this one; the others can continue
                if is_worker():
                    raise
                print(f"{experiment.name}: {error}", file=sys.stderr)
                return True
            if kept is not None:
                publish(kept, kept_at)
            return kept is not None

        def done() -> int:
            return 100 if kept_at.exists() else min(99, int(100 * experiment.progress(place)))

        return Job(experiment.name.replace("/", "-"), 100, done, do)

    return [job(experiment) for experiment in chosen]


def publish(kept: Path | list[Path], place: Path) -> None:
    """Copy a file, or files into a folder, whole or not at all."""
    place.parent.mkdir(parents=True, exist_ok=True)
    if isinstance(kept, Path):
        write_atomically(place, kept.read_bytes())
        return
    part = place.with_name(place.name + ".part")
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir()
    for path in kept:
        shutil.copy(path, part)
    os.replace(part, place)


def choose_experiments(pattern: str | None, seeds: int | None) -> list[Experiment]:
    """Those whose name fits a pattern with * and ?; a part of a name will do."""
    every = list(experiments(seeds))
    if pattern is None:
        return every
    found = [e for e in every if fnmatch(e.name, pattern) or fnmatch(e.name, f"*{pattern}*")]
    if not found:
        raise UsageError(f"No experiment is called {pattern!r}; `assistax reproduce` lists all.")
    return found
