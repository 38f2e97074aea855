"""Runs as data: read their folders, pool seeds into experiments.

Runs that differ in nothing but seeds are one experiment. Others are told apart by what they differ in; nothing else
is averaged. Reads what `training` writes and needs no checkpoints, so that folders of any version will do.
"""

import dataclasses
import hashlib
import json
import os
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from assistax.errors import UsageError, choose
from assistax.files import read_json, read_rows
from assistax.formats import CONFIG, ROWS, SUMMARY
from assistax.tasks import TASKS, stored_task, task_spec

# Settings that say how something was computed or measured, not what was trained.
_NOT_THE_EXPERIMENT = {"seed", "num_seeds", "engine", "evaluations"}
_NOT_THE_EXPERIMENT |= {"env.num_threads", "env.contacts_per_env", "env.constraints_per_env"}
_NAMED = {"task", "algorithm", "preset", "steps", "partners"}
_TRIED = {"trials", "ablations"}  # folders of what was tried on the way
_PERSON = {"disability": "none", "preference": "none", "people": "none", "visibility": "both"}


# -- folders -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class StoredRun:
    """A run folder, with its settings by full name ("ppo.gamma")."""

    folder: Path
    settings: dict[str, Any]
    stamp: dict[str, Any]

    @classmethod
    def read(cls, folder: Path) -> "StoredRun":
        """Raises UsageError for a configuration that is damaged or of an unknown task."""
        path = folder / "config.json"
        config = read_json(path, CONFIG)
        try:
            config["task"] = choose("task", stored_task(config["task"]), TASKS)
        except UsageError as error:
            raise UsageError(f"Cannot read {path}: {error}") from None
        stamp = config.pop("stamp", {})
        config.pop("resumed", None)
        return cls(folder, dict(flat(config)), stamp)

    @cached_property
    def seeds(self) -> list[int]:
        return [self.settings["seed"] + i for i in range(self.settings.get("num_seeds", 1))]

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Empty for an unfinished run; "evaluation" is by seed what `evaluation.summarize` returned at the end."""
        path = self.folder / "summary.json"
        summary = read_json(path, SUMMARY) if path.exists() else {}
        if summary and len(summary["evaluation"]) != len(self.seeds):
            raise UsageError(f"{path} is not of the {len(self.seeds)} seeds that config.json is of.")
        return summary

    def origin(self, *names: str) -> Any:
        """Of the stamp ("versions", "jax"): that of the beginning and, if it was another at the end, "A, then B"."""
        then, now = self.stamp, self.summary
        for name in names:
            then, now = (one.get(name) if one else None for one in (then, now))
        return then if now in (None, then) else f"{then}, then {now}"

    @property
    def identity(self) -> Any:
        """The same for copies of a finished run."""
        return json.dumps([self.settings, self.summary]) if self.summary else self.folder.resolve()

    def rows(self, name: str) -> list[dict[str, Any]]:
        """Of "metrics" or "evaluations"."""
        return read_rows(self.folder / f"{name}.jsonl", ROWS[name])


def find_runs(folders: Sequence[Path] = ()) -> list[StoredRun]:
    """The runs in these folders, each a run or a folder of finished runs; without any those of results and runs.

    Finished runs lie at any depth, but for what was tried on the way: in sub-folders called trials or ablations they
    count only if those are named. Of copies the first.
    """
    found: dict[Any, StoredRun] = {}
    for folder in folders or (Path("results"), Path("runs")):
        inside = list(_run_folders(folder))
        if folders and not inside:
            raise UsageError(f"{folder} is not a run folder and holds none: there is no config.json.")
        runs = [StoredRun.read(path) for path in inside]
        for run in runs:
            if run.folder == folder or run.summary:
                found.setdefault(run.identity, run)
    if not found:
        where = ", ".join(map(str, folders)) or "results and runs"
        raise UsageError(f"There is no finished run in {where}; train one first (assistax train) or name its folder.")
    return list(found.values())


def _run_folders(folder: Path) -> Iterator[Path]:
    """The folder, if it is a run, or those below it, without what was tried on the way."""
    for place, inside, files in os.walk(folder):
        is_run = "config.json" in (*files, *inside)
        inside[:] = [] if is_run else sorted(set(inside) - _TRIED)
        if is_run:
            yield Path(place)


def flat(settings: dict[str, Any], prefix: str = "") -> Iterable[tuple[str, Any]]:
    """Settings by full name ("ppo.gamma"), but for the stamp."""
    for name, value in settings.items():
        if isinstance(value, dict) and name != "stamp":
            yield from flat(value, f"{prefix}{name}.")
        elif name != "stamp":
            yield prefix + name, value


# -- experiments -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Method:
    """How a team was trained, on whatever task."""

    algorithm: str  # with its switches: "ippo-rnn-taught", and partners: "ippo with human=still"
    preset: str
    steps: int  # asked for, per seed
    note: str = ""  # settings that tell it from others: "ppo.gamma=0.9"


@dataclass(frozen=True)
class Experiment:
    """Runs of one method on one task with one kind of person, that differ in their seeds only."""

    task: str
    person: str  # "none", or "disability=tremor preference=sweep"
    method: Method
    runs: tuple[StoredRun, ...]

    @property
    def seeds(self) -> list[int]:
        return [seed for run in self.runs for seed in run.seeds]

    @property
    def version(self) -> int:
        """Of the task. Rewards and outcomes of versions differ, so that what is put together is of one."""
        return task_spec(self.task).version

    @property
    def preferring(self) -> bool:
        """Whether the return has a preference's part."""
        settings = self.runs[0].settings
        people = settings.get("env.human.people", "none")
        listed = [person.get("preference", "none") for person in people] if isinstance(people, list) else [people]
        return any(preference != "none" for preference in (settings.get("env.human.preference", "none"), *listed))

    def final(self, *names: str) -> np.ndarray:
        """By seed a number of the last evaluation, ("force", "mean_in_contact") for example; see `summarize`."""
        values = []
        for run in self.runs:
            if not run.summary:
                raise UsageError(f"{run.folder} is not finished: it has no summary.json.")
            for value in run.summary["evaluation"]:
                for name in names:
                    if name not in value:
                        raise UsageError(f"{run.folder}/summary.json has no {'.'.join(names)}.")
                    value = value[name]
                values.append(value)
        return np.array(values, np.float64)

    def has(self, *names: str) -> bool:
        """Whether every run's last evaluation has that, see `final`."""
        values = [value for run in self.runs for value in run.summary.get("evaluation", ())]
        for name in names:
            values = [value.get(name, {}) for value in values]
        return bool(values) and all(value != {} for value in values)

    @property
    def name(self) -> str:
        """For messages."""
        return f"{self.task} with {self.method.algorithm}, {self.method.preset} preset"


def experiments(runs: Sequence[StoredRun]) -> list[Experiment]:
    """Pool runs that differ in nothing but seeds; raises UsageError if a seed is there twice.

    Settings that one run has and another, older or newer, does not know are no difference.
    """
    alike = defaultdict(list)
    for run in runs:
        s = run.settings
        switches = "-rnn" * s.get("ppo.recurrent", False) + "-shared" * s.get("ppo.share_parameters", False)
        switches += "-taught" * bool(s.get("ppo.teachers", ()))
        partners = "".join(f" with {partner}" for partner in s.get("partners", ()))
        method = Method(s["algorithm"] + switches + partners, s["preset"], s["steps"])
        alike[s["task"], _person(s), method].append(run)
    found = []
    for (task, person, method), group in alike.items():
        varied = [name for name in sorted({n for r in group for n in r.settings}) if _differ(name, group)]
        apart = defaultdict(list)
        for run in group:
            values = [run.settings.get(name, "unknown") for name in varied]
            apart[" ".join(f"{name}={_short(v)}" for name, v in zip(varied, values, strict=True))].append(run)
        for note, pooled in apart.items():
            found.append(Experiment(task, person, dataclasses.replace(method, note=note), tuple(pooled)))
            _check_pooled(found[-1])

    def order(e: Experiment):
        return list(TASKS).index(e.task), e.person != "none", e.person, dataclasses.astuple(e.method)

    return sorted(found, key=order)


def _short(value: Any) -> str:
    """In 40 characters, different for what is different."""
    text = str(value)
    return text if len(text) <= 40 else f"{text[:31]}~{hashlib.sha256(text.encode()).hexdigest()[:8]}"


def _person(settings: dict[str, Any]) -> str:
    parts = {name: settings.get(f"env.human.{name}", usual) for name, usual in _PERSON.items()}
    words = {k: v if isinstance(v, str) else f"{len(v)} listed" for k, v in parts.items() if v != _PERSON[k]}
    return " ".join(f"{name}={value}" for name, value in words.items()) or "none"


def _differ(name: str, runs: Sequence[StoredRun]) -> bool:
    values = [run.settings[name] for run in runs if name in run.settings]
    return name not in _NOT_THE_EXPERIMENT | _NAMED and any(value != values[0] for value in values)


def _check_pooled(experiment: Experiment) -> None:
    trained = {run.summary["steps"]: run.folder for run in experiment.runs if "steps" in run.summary}
    if len(trained) > 1:  # one was prolonged
        words = " and ".join(f"{folder} was trained for {steps} steps" for steps, folder in list(trained.items())[:2])
        raise UsageError(f"{words}; leave one out.")
    where: dict[int, Path] = {}
    for run in experiment.runs:
        for seed in run.seeds:
            if seed in where:
                raise UsageError(
                    f"{where[seed]} and {run.folder} are both seed {seed} of {experiment.name}; leave one out."
                )
            where[seed] = run.folder


def by_method(found: Sequence[Experiment]) -> dict[tuple[int, str, Method], list[Experiment]]:
    """Experiments by version of the task, person and method."""
    groups = defaultdict(list)
    for experiment in found:
        groups[experiment.version, experiment.person, experiment.method].append(experiment)
    return dict(groups)


def check_comparable(found: Sequence[Experiment]) -> None:
    """Raise UsageError if returns of the same task and person are not of the same reward and length of an episode."""
    groups = defaultdict(list)
    for experiment in found:
        groups[experiment.task, experiment.person].extend(experiment.runs)
    for runs in groups.values():
        for name in sorted({n for run in runs for n in run.settings if scales_return(n)}):
            if _differ(name, runs):
                one, *others = [run for run in runs if name in run.settings]
                two = next(run for run in others if run.settings[name] != one.settings[name])
                raise UsageError(
                    f"Returns of {one.folder} and {two.folder} cannot be compared: "
                    f"{name} is {one.settings[name]} and {two.settings[name]}."
                )


def scales_return(name: str) -> bool:
    """Whether a setting changes what a return means."""
    return name.startswith("task_config.") or name in ("env.episode_length", "env.substeps")


def differences(found: Sequence[Experiment]) -> list[str]:
    """In what the runs differ that is no setting: sentences for the reader."""
    runs = [run for experiment in found for run in experiment.runs]
    origins = {what: [run.origin(what) for run in runs] for what in ("commit", "hardware")}
    origins["engine"] = [run.summary.get("engine", run.settings.get("engine")) for run in runs]
    for package in ("assistax", "mujoco", "jax"):
        origins[package] = [run.origin("versions", package) for run in runs]
    counts = {what: Counter(values) for what, values in origins.items()}
    return [
        f"The runs differ in {what}: "
        + ", ".join(f"{value} ({n} run{'s' * (n > 1)})" for value, n in count.items())
        + "."
        for what, count in counts.items()
        if len(count) > 1
    ]


# -- curves ------------------------------------------------------------------------------------

SOURCES = {"evaluation": "evaluations", "training": "metrics"}
POINTS = 100  # of a curve at most; between them training episodes are averaged


def best_source(experiment: Experiment) -> str:
    """ "evaluation" if all its runs were evaluated while they trained, else "training"."""
    return "evaluation" if all(run.rows("evaluations") for run in experiment.runs) else "training"


def curve(experiment: Experiment, metric: str, source: str) -> tuple[np.ndarray, np.ndarray]:
    """A metric of `Env.metrics`, mean over episodes, where all seeds have it.

    Args:
      source: "evaluation" (on the fixed evaluation episodes) or "training" (episodes that ended in an iteration).

    Returns:
      (environment steps [points], values [seeds, points]).
    """
    seeds: dict[int, dict[int, float]] = {seed: {} for seed in experiment.seeds}
    folders = ", ".join(str(run.folder) for run in experiment.runs)
    name = SOURCES[choose("source", source, SOURCES)]
    for run in experiment.runs:
        try:
            for row in run.rows(name):
                values = row["episodes" if source == "evaluation" else "episode"]
                if source == "evaluation" or row["episodes"]:
                    choose(f"metric of {run.folder}", metric, values)
                    seeds[row["seed"]][row["steps"]] = float(np.mean(values[metric]))
        except (KeyError, TypeError) as error:
            raise UsageError(f"{run.folder}/{name}.jsonl has a row that does not fit: {error}.") from None
    common = sorted(set.intersection(*map(set, seeds.values())))
    if not common:
        raise UsageError(f"There is nothing to plot of {folders}: no {source} that all seeds have reached.")
    steps, values = np.array(common), np.array([[mine[at] for at in common] for mine in seeds.values()])
    if source == "evaluation" or len(common) <= POINTS:
        return steps, values
    windows = np.array_split(np.arange(len(common)), POINTS)
    return np.array([steps[w].mean() for w in windows]), np.stack([values[:, w].mean(1) for w in windows], 1)
