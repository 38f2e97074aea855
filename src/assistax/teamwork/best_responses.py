"""Best responses in bulk: for each of some partners a robot that learns with them alone, worth 1 in the score.

best_responses.json   steps and settings
partners/             each of the partners, a population of one
runs/                 a run folder for each of the robots, see training/run.py
workers/              who trains what, see executors/claims.py
"""

import shutil
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from assistax.errors import UsageError
from assistax.executors.drive import Executor, drive
from assistax.executors.here import work_here
from assistax.executors.jobs import Job
from assistax.files import read_json, write_json
from assistax.formats import BEST_RESPONSES
from assistax.teamwork.plan import WORKERS, training
from assistax.training.clock import progress_bar
from assistax.training.configuration import TrainConfig, configure
from assistax.training.population import Population, is_population

ABOUT = "best_responses.json"


def begin(folder: Path, partners: Population, steps: int | None, settings: Mapping[str, Any]) -> None:
    """Write down in an empty folder with whom robots are to learn, for so many steps (None: the default)."""
    if folder.exists() and any(folder.iterdir()):
        raise UsageError(f"{folder} is not empty; to continue what was begun there, use --resume {folder}.")
    configure(partners.task, dict(settings), steps=steps)  # settings that cannot be are refused at once
    try:
        for one in partners.ids:
            partners.select([one]).save(folder / "partners" / one[:12])
        write_json(folder / ABOUT, {"task": partners.task, "steps": steps, "settings": dict(settings)})
    except BaseException:  # Ctrl-C, too: without ABOUT nothing could continue it
        shutil.rmtree(folder / "partners", ignore_errors=True)
        raise


def jobs(folder: Path, bar: Callable = progress_bar) -> list[Job]:
    """The trainings of what `begin` has written down."""
    return [training(folder / "runs" / name, config, bar) for name, config in _configs(folder).items()]


def train(folder: Path) -> bool:
    """Train, one after the other, the robots that nobody else does; returns whether all are finished then."""
    work_here(folder / WORKERS, partial(jobs, folder), progress_bar, "robot")
    return all(job.finished for job in jobs(folder))


def train_with(folder: Path, using: Executor, workers: int | None = None) -> bool:
    """`train` in as many processes as an executor starts."""
    command = [sys.executable, "-m", "assistax", "teamwork", "best-responses", "--resume", str(folder.resolve())]
    drive(folder / WORKERS, jobs(folder), using, command, workers, progress_bar)
    return all(job.finished for job in jobs(folder))


def runs_of(folder: Path) -> list[Path]:
    """The finished robots' run folders; raises UsageError if there are none."""
    _about(folder)
    found = sorted(path.parent for path in folder.glob("runs/*/summary.json"))
    if not found:
        raise UsageError(f"No robot of {folder} is finished; `assistax teamwork best-responses --resume {folder}`.")
    return found


def _about(folder: Path) -> dict[str, Any]:
    if not (folder / ABOUT).exists():
        raise UsageError(f"{folder} has no {ABOUT}; begin with `assistax teamwork best-responses POP --out {folder}`.")
    return read_json(folder / ABOUT, BEST_RESPONSES)


def _configs(folder: Path) -> dict[str, TrainConfig]:
    """By the first letters of the partner's id, how its robot learns."""
    about = _about(folder)
    settings = {k: tuple(v) if isinstance(v, list) else v for k, v in about["settings"].items()}
    places = sorted(place for place in (folder / "partners").iterdir() if is_population(str(place)))
    return {p.name: configure(about["task"], settings, partners=(f"human={p}",), steps=about["steps"]) for p in places}
