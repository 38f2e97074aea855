"""A list of independent jobs, and what one process does of it."""

import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from assistax.errors import AssistaxError
from assistax.executors.claims import claims, is_held, machine, read, take

WORKER = "ASSISTAX_WORKER"  # in the environment of what an executor has started: the process that did so


@dataclass(frozen=True)
class Job:
    """A piece of work in a folder of its own, which continues from where it was left, whoever does it."""

    name: str
    size: int
    done: Callable[[], int]  # how much of `size`, read from its files; all of it only when nothing is left to do
    do: Callable[[], bool]  # False if it had to stop before the end

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return self.done() >= self.size


@dataclass(frozen=True)
class Status:
    """How far a list of jobs is."""

    done: int  # of the sizes of all
    finished: int
    held: int  # by somebody
    here: int  # of these, by processes of this machine
    open: tuple[Job, ...]  # nobody has them; first those that were lost or failed least often


def status(folder: Path, jobs: Sequence[Job], known: set[str] | None = None) -> Status:
    """Of jobs whose claims lie in `folder`; `known` are finished, and those found to be are added."""
    known, found = set() if known is None else known, claims(folder)
    done, held, here, free = 0, 0, 0, []
    for job in jobs:
        done_of_it = job.size if job.name in known else min(job.size, job.done())
        done += done_of_it
        if done_of_it == job.size:
            known.add(job.name)
        elif (mine := found.get(job.name, [])) and is_held(mine[-1]):
            held += 1
            here += read(mine[-1]).get("machine") == machine()
        else:
            free.append(job)
    free.sort(key=lambda job: sum(map(_is_lost, found.get(job.name, []))))
    return Status(done, sum(job.name in known for job in jobs), held, here, tuple(free))


def _is_lost(claim: Path) -> bool:
    about = read(claim)
    return "failed" in about or not about.get("released")


def failure(earlier: Sequence[Path], done: Callable[[], int], tries: int = 3) -> str | None:
    """Why a job, of which so much is `done`, is not begun once more after these claims; None if it is."""
    if not earlier:
        return None
    if failed := read(earlier[-1]).get("failed"):
        return failed
    last = [read(path) for path in earlier[-tries:]]
    if len(last) == tries and not any(one.get("released") or one.get("at") != done() for one in last):
        return f"it has ended {tries} times without getting further"
    return None


def work(folder: Path, jobs: Sequence[Job], begin: Callable[[Job], None] = lambda _: None) -> bool:
    """Do the jobs that are not finished and that nobody else does, one after the other; `begin` is told of each.

    Returns whether it went through to the end of the list, not stopped by a signal. A job that raises ends it; what it
    raised stands in its claim.

    Raises:
      KeyboardInterrupt: SIGTERM came while no job that would save was listening; nothing is claimed any more.
    """
    _end_with_parent()
    with _Sigterm() as sigterm:
        return _work(folder, jobs, begin, sigterm)


def _work(folder: Path, jobs: Sequence[Job], begin: Callable[[Job], None], sigterm: "_Sigterm") -> bool:
    left, known = list(jobs), set()
    while left:
        free = status(folder, left, known).open
        if not free:
            return True
        job = free[0]
        left.remove(job)
        mine = take(folder, job.name, claims(folder).get(job.name, []), job.done())
        failed = None
        try:
            sigterm.interrupt_from_now()
            if mine is None or job.finished:  # while it was being claimed
                continue
            begin(job)
            if not job.do():
                return False
        except AssistaxError as error:
            failed = str(error)
            raise
        except Exception as error:
            failed = f"{type(error).__name__}: {error}".partition("\n")[0]
            raise
        finally:
            sigterm.interrupts = False
            if mine is not None:
                mine.release(failed)
    return True


class _Sigterm:
    """Has SIGTERM interrupt a job that does not listen itself; while one is claimed or released, it waits."""

    interrupts, _came = False, False

    def __enter__(self):
        with suppress(ValueError):  # not the main thread: then nobody sends us signals
            self._before = signal.signal(signal.SIGTERM, self._take)
        return self

    def __exit__(self, *_):
        with suppress(AttributeError):
            signal.signal(signal.SIGTERM, self._before)

    def interrupt_from_now(self) -> None:
        self.interrupts = True
        if self._came:
            raise KeyboardInterrupt

    def _take(self, *_) -> None:
        self._came = True
        if self.interrupts:
            raise KeyboardInterrupt


def is_worker() -> bool:
    """Whether an executor has started this process."""
    return WORKER in os.environ


def _end_with_parent(every: float = 1.0) -> None:
    """Have a worker save and stop, as after a signal, when who has started it is gone: nobody would stop it later."""
    parent = int(os.environ.get(WORKER, 0))

    def watch():
        while os.getppid() == parent:
            time.sleep(every)
        os.kill(os.getpid(), signal.SIGTERM)

    if parent:
        threading.Thread(target=watch, daemon=True).start()
