"""Speeds of several tasks and sizes, in order of worth, within a budget, into one file that later calls continue."""

import dataclasses
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax

from assistax.diagnostics.bench import bench, bench_training
from assistax.env import make
from assistax.errors import UsageError, choose
from assistax.files import check_folder, read_json, write_json
from assistax.formats import COUNT
from assistax.physics import resolve_engine
from assistax.settings import check_count
from assistax.stamp import stamp
from assistax.tasks import TASKS, task_spec
from assistax.training.presets import PRESETS

_RATE = range(2**53)
FORMAT = {  # what a file of measurements holds beside its versions
    "rows": [
        {
            "of": {"preset": (str, None), "num_seeds": (int, None)},
            "task": str,
            "engine": str,
            "num_envs": COUNT,
            "env_steps_per_s?": _RATE,
            "training_steps_per_s?": _RATE,
        }
    ],
    "hardware": str,
}
CPU_SIZES = (1024, 256, 64, 16, 1)  # environments, the most telling first
ACCELERATOR_SIZES = (4096, 16384, 8192, 2048, 1024, 256, 1)
MANY_SEEDS = 16


@dataclass(frozen=True)
class Measurement:
    """Open loop, or a training, of one task at one size; what is None is not chosen."""

    task: str
    engine: str
    num_envs: int | None
    preset: str | None = None  # of the training; None: open loop
    num_seeds: int | None = None

    def measure(self, seconds: float) -> dict[str, Any]:
        """A dict ready for JSON, this measurement's own fields under "of"."""
        if self.preset is None:
            report = bench(make(self.task, self.engine), self.num_envs or CPU_SIZES[0], seconds)
        else:
            report = bench_training(self.task, self.engine, self.num_envs, seconds, self.preset, self.num_seeds or 1)
        return {"of": dataclasses.asdict(self)} | {name: x for name, x in report.items() if name not in stamp()}

    def is_of(self, row: dict[str, Any]) -> bool:
        """Whether this is what a row of a file was measured of."""
        return row["of"] == dataclasses.asdict(self)


def newest_tasks() -> list[str]:
    """Every task, in its newest version."""
    return list(dict.fromkeys(task_spec(name.partition("-v")[0]).id for name in TASKS))


def default_seconds() -> float:
    """How long to measure each: on an accelerator, where compilation takes longer than the rounds, that all may fit."""
    return 10.0 if jax.default_backend() == "cpu" else 2.0


def check_out(path: Path | None) -> None:
    """Raise UsageError unless measurements can be written there."""
    if path is not None and path.suffix != ".json":
        raise UsageError(f"--out must end in .json, not be {path.name!r}.")
    if path is not None:
        check_folder(path)


def plan(tasks: Sequence[str], engine: str, sizes: Sequence[int], train: bool, preset: str) -> list[Measurement]:
    """In order of worth: every task at the first size, open loop and in training, before all other sizes.

    Args:
      sizes: numbers of environments, 1 or more each; (): those that tell most on this machine. Trainings then have
        their preset's on a CPU, and on an accelerator one task is trained with many seeds side by side, too.

    Raises:
      UsageError: there is no such engine or preset, or a size is below 1.
    """
    engine, _ = resolve_engine(engine)
    choose("preset", preset, PRESETS)
    for size in sizes:
        check_count("num_envs", size)
    on_cpu = jax.default_backend() == "cpu"
    chosen = tuple(dict.fromkeys(sizes)) or (CPU_SIZES if on_cpu else ACCELERATOR_SIZES)
    training_sizes: tuple[int | None, ...] = (None,) if on_cpu and not sizes else chosen
    found = []
    for i, size in enumerate(chosen):
        found += [Measurement(task, engine, size) for task in tasks]
        if train and i < len(training_sizes):
            found += [Measurement(task, engine, training_sizes[i], preset, 1) for task in tasks]
        if train and i == 0 and not on_cpu and not sizes:
            found.append(Measurement(tasks[0], engine, None, preset, 1))
            found.append(Measurement(tasks[0], engine, None, preset, MANY_SEEDS))
    return found


def measure(
    wanted: Sequence[Measurement],
    path: Path | None,
    seconds: float,
    budget: float,
    say: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """What is missing in the file, one after the other; each is written down as it comes.

    Args:
      path: of the file; it may be there already, if it was measured with the same code on the same hardware.
      seconds: to measure each for, after compilation.
      budget: s; what would begin later is left for another call, but one is always made.
      say: is told of each when it is made.

    Returns:
      What the file holds: {"rows": [...], and the stamp}.

    Raises:
      UsageError: the file is of other code, versions or hardware, or is not one of measurements.
    """
    report: dict[str, Any] = {"rows": [], **json.loads(json.dumps(stamp()))}
    if path is not None and path.exists():
        before = read_json(path, FORMAT)
        if changed := [name for name in ("versions", "source", "hardware") if before.get(name) != report[name]]:
            raise UsageError(f"{path} was measured with other {' and '.join(changed)}; give another --out.")
        report = before
    missing = [one for one in wanted if not any(map(one.is_of, report["rows"]))]
    deadline = time.perf_counter() + budget
    for i, one in enumerate(missing):
        if i and time.perf_counter() > deadline:
            how = "the same command measures" if path is not None else "with --out FILE another call can measure"
            say(f"The budget is spent; {how} the {len(missing) - i} of {len(wanted)} that are left.")
            break
        row = one.measure(seconds)
        report["rows"].append(row)
        if path is not None:
            write_json(path, report)
        kind = f"training, {one.preset} preset" if one.preset else "open loop"
        rate = row["training_steps_per_s" if one.preset else "env_steps_per_s"]
        seeds = f" x {one.num_seeds} seeds" if (one.num_seeds or 1) > 1 else ""
        say(f"{row['task']}, {kind}, {row['num_envs']} environments{seeds}: {rate:,} steps/s")
    return report
