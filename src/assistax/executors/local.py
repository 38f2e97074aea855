"""Workers as processes of this machine, each on cores of its own."""

import os
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from assistax.errors import UsageError
from assistax.executors.jobs import WORKER
from assistax.stamp import memory_gb

GB_EACH = 2.0  # of memory that a worker may come to need: trainings of the default preset have 1.4 at most


def usable_cores() -> list[int]:
    """Those that this process may run on."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def launch(command: Sequence[str], log: Path, variables: dict[str, str] | None = None) -> subprocess.Popen:
    """A worker as a process of this one, out of reach of its terminal; it saves and ends when this one is gone."""
    environment = os.environ | (variables or {}) | {WORKER: str(os.getpid())}
    with open(log, "ab") as file:
        return subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=file, stderr=file, env=environment, start_new_session=True
        )


@dataclass
class Local:
    """`cores` of each worker; 0: the workers share all cores."""

    cores: int = 0
    seconds = 0.5
    elsewhere = False

    def room(self, workers: int | None, jobs: int) -> int:
        """One worker for each core, or for so many `cores`, but no more than there are jobs and memory for."""
        mine = usable_cores()
        if not 0 <= self.cores <= len(mine):
            raise UsageError(f"cores must be 1 to {len(mine)}, those of this machine, not {self.cores}.")
        places = len(mine) // max(1, self.cores)
        count = max(1, int(min(places, memory_gb() / GB_EACH, jobs))) if workers is None else workers
        if not 1 <= count <= places:
            each = f" of {self.cores} cores each" if self.cores > 1 else ""
            raise UsageError(f"--processes must be 1 to {places}{each}, the cores of this machine, not {count}.")
        if self.cores:
            self._groups = [mine[i * self.cores : (i + 1) * self.cores] for i in range(count)]
        else:
            self._groups = [mine[i::count] for i in range(count)]
        self._by_group: dict[int, subprocess.Popen] = {}
        return count

    def start(self, command: Sequence[str], logs: Sequence[Path]) -> list[subprocess.Popen]:
        taken = {i for i, worker in self._by_group.items() if worker.poll() is None}
        free = [i for i in range(len(self._groups)) if i not in taken]
        return [self._start(command, log, i) for log, i in zip(logs, free, strict=False)]

    def _start(self, command: Sequence[str], log: Path, group: int) -> subprocess.Popen:
        worker = self._by_group[group] = launch(command, log)
        if hasattr(os, "sched_setaffinity"):
            os.sched_setaffinity(worker.pid, self._groups[group])
        return worker

    def running(self, workers: Sequence[subprocess.Popen]) -> list[subprocess.Popen]:
        return [worker for worker in workers if worker.poll() is None]

    def stop(self, workers: Sequence[subprocess.Popen]) -> None:
        for worker in workers:
            worker.terminate()
