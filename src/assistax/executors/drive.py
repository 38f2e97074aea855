"""Having a list of jobs done by an executor, and seeing how far it is.

What is done, by whom, and what failed is read from the folder of the jobs alone. So the driver can be killed and
started again, beside workers of an earlier one, too, and shows the same whatever the executor.
"""

import importlib
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

from tqdm import tqdm

from assistax.errors import UsageError, choose
from assistax.executors.claims import claims
from assistax.executors.jobs import Job, failure, status
from assistax.files import writing
from assistax.settings import with_settings

EXECUTORS = {"local": "Local", "slurm": "Slurm", "ray": "Ray"}  # a file each


class Executor(Protocol):
    """Starts worker processes somewhere; its settings are the fields of a dataclass."""

    seconds: float  # between two looks at the workers
    elsewhere: bool  # whether these are on other machines, too

    def room(self, workers: int | None, jobs: int) -> int:
        """How many workers there will be, if so many (None: as many as make sense) are asked for so many jobs.

        Raises UsageError if the executor is not there, or if it, or `workers`, asks for what does not exist.
        """
        ...

    def start(self, command: Sequence[str], logs: Sequence[Path]) -> list[Any]:
        """A worker for each log, which takes what the process prints."""
        ...

    def running(self, workers: Sequence[Any]) -> list[Any]:
        """Those that wait or run."""
        ...

    def stop(self, workers: Sequence[Any]) -> None:
        """Have them save and end."""
        ...


def executor(name: str, settings: dict[str, Any]) -> Executor:
    """An executor by name, with its settings."""
    module = importlib.import_module(f"assistax.executors.{choose('executor', name, EXECUTORS)}")
    return with_settings(getattr(module, EXECUTORS[name])(), settings)


def drive(
    folder: Path,
    jobs: Sequence[Job],
    using: Executor,
    command: Sequence[str],
    workers: int | None,
    bar: Callable[[int, int], tqdm],
) -> bool:
    """Have the jobs done whose claims and logs lie in `folder`, by processes of `command`, which calls `jobs.work`.

    Args:
      workers: at the same time; None: as many as fit.
      bar: makes the progress bar, of the total and what is done.

    Returns:
      Whether all are finished; False after Ctrl-C, when the workers have saved.

    Raises:
      UsageError: see `Executor.room`; or jobs failed, which is reported when all others are finished.
    """
    known: set[str] = set()
    before = {name: len(paths) for name, paths in claims(folder).items()}
    total = sum(job.size for job in jobs)
    now = status(folder, jobs, known)
    workers = using.room(workers, max(1, len(now.open)))
    crew: list[Any] = []
    found: dict[str, list[Path]] = {}
    fruitless, started, begun = 0, 0, 0
    with bar(total, now.done) as shown:
        try:
            while now.finished < len(jobs):
                failed = {job.name: why for job in now.open if (why := failure(found.get(job.name, ()), job.done))}
                free = len(now.open) - len(failed)
                begun_before, begun = begun, sum(map(len, found.values()))
                ended = len(crew) - len(crew := using.running(crew))
                fruitless = fruitless + ended if free and begun == begun_before else 0
                if fruitless >= 3:
                    raise UsageError(f"Workers end before they begin a job: {_last_line(folder / 'logs')}")
                # Workers of an earlier driver may be at work, too; what other machines do is no worker of this one.
                held = now.held if using.elsewhere else now.here
                busy = max(len(crew), held)
                if (more := min(workers - busy, free - max(0, len(crew) - held), len(jobs))) > 0:
                    crew += using.start(command, _logs(folder / "logs", started, more))
                    started += more
                elif failed and not free and not now.held:
                    name, why = min(failed.items())
                    raise UsageError(
                        f"{len(failed)} of {len(jobs)} jobs failed, {name} for one: {why.rstrip('.')}. What is "
                        f"finished stays; see {folder / 'logs'}."
                    )
                shown.set_description(f"{now.finished} of {len(jobs)} finished, {now.held} at work", refresh=False)
                time.sleep(max(using.seconds, len(jobs) / 500))
                found = {name: paths[before.get(name, 0) :] for name, paths in claims(folder).items()}
                now = status(folder, jobs, known)  # after the claims: whose newest is not free here is open no more
                shown.update(now.done - shown.n)
        except KeyboardInterrupt:
            pass
        finally:
            using.stop(crew)
            while crew := using.running(crew):
                time.sleep(min(1.0, using.seconds))
    return status(folder, jobs, known).finished == len(jobs)


def _logs(folder: Path, first: int, count: int) -> list[Path]:
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    now = time.strftime("%Y%m%d-%H%M%S")
    return [folder / f"{now}-{i}.log" for i in range(first, first + count)]


def _last_line(logs: Path) -> str:
    """Of the newest log that says anything."""
    for path in sorted(logs.glob("*.log"), reverse=True):
        if text := path.read_text(errors="replace").strip():
            return text.rpartition("\n")[2]
    return f"see {logs}"
