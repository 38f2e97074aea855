"""Workers as jobs of Slurm: an array of them, which come back when they have been preempted or their time is over."""

import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from assistax.errors import UsageError, choose
from assistax.executors.local import launch

MANY = 32  # workers, where nobody says how many
GRACE = 120  # s in which a worker saves before its time is over
HOURS = 2 * GRACE / 3600, 24.0 * 365  # the least and the most that a worker may have
OURS = ("signal",)  # options of sbatch that this executor needs itself


class Worker:
    """What a job of Slurm does: a worker's process; told of the end of its time, it has it save, and queues again."""

    def __init__(self, command: Sequence[str], log: Path):
        self.command, self.log = command, log

    def __call__(self) -> int:
        # The signal is for this process alone, though Slurm sends it to all. A process that ignores it leaves that on.
        before = signal.signal(signal.SIGUSR2, signal.SIG_IGN)
        process = launch(self.command, self.log)
        self._process = process
        signal.signal(signal.SIGUSR2, before)
        return process.wait()

    def checkpoint(self) -> Any:
        from submitit.helpers import DelayedSubmission

        self._process.terminate()
        with suppress(ChildProcessError):  # not by wait(), whose lock the interrupted __call__ has
            os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOWAIT)
        return DelayedSubmission(Worker(self.command, self.log))


@dataclass
class Slurm:
    """Of each worker: partition, cores, memory, and hours until it is queued anew; `options` are others of sbatch."""

    partition: str = ""
    cores: int = 1
    memory_gb: float = 0.0  # 0: as the partition says
    hours: float = 24.0
    options: str = ""  # qos=high,account=me
    cluster: str = "slurm"  # or local: submitit's processes on this machine
    seconds = 5.0
    elsewhere = True

    def room(self, workers: int | None, jobs: int) -> int:
        try:
            from submitit import AutoExecutor
            from submitit.core.utils import FailedJobError
        except ImportError:
            raise UsageError('The executor slurm needs an extra: pip install "assistax[slurm]".') from None
        self._stopping = False
        self._submitter, self._refused = AutoExecutor, FailedJobError
        if self.cores < 1 or not HOURS[0] <= self.hours <= HOURS[1]:
            raise UsageError(f"cores must be 1 or more and hours {HOURS[0]:.2f} to {HOURS[1]:.0f}.")
        if self.memory_gb < 0:
            raise UsageError(f"memory_gb must be 0 (as the partition says) or more, not {self.memory_gb:g}.")
        if wrong := [pair for pair in self.options.split(",") if pair and not all(pair.partition("=")[::2])]:
            raise UsageError(f"options takes NAME=VALUE,NAME=VALUE, for example qos=high, not {wrong[0]!r}.")
        if taken := [name for name in self._more() if name in OURS]:
            raise UsageError(f"options cannot have {taken[0]}, which tells workers to save in time.")
        if workers is not None and workers < 1:
            raise UsageError(f"--processes must be 1 or more, not {workers}.")
        if choose("cluster", self.cluster, ("slurm", "local")) == "slurm":
            known = _ask("sinfo", "--noheader", "--format=%R %c").split("\n")
            sizes = {line.split()[0]: int(line.split()[1].rstrip("+")) for line in known if line.strip()}
            named = [choose("partition", name, sizes) for name in self.partition.split(",") if name]
            most = max((sizes[name] for name in named or sizes), default=0)
            if self.cores > most:
                raise UsageError(f"cores must be 1 to {most}, those of a node, not {self.cores}.")
            return min(jobs, workers or MANY)
        return min(jobs, workers or max(1, (os.cpu_count() or 1) // self.cores))

    def _more(self) -> dict[str, str]:
        return dict(pair.partition("=")[::2] for pair in self.options.split(",") if pair)

    def start(self, command: Sequence[str], logs: Sequence[Path]) -> list[Any]:
        submitter = self._submitter(logs[0].parent / "slurm", self.cluster, slurm_max_num_timeout=10**6)
        submitter.update_parameters(name="assistax", timeout_min=max(1, round(self.hours * 60)))
        memory = f"{max(1, round(1024 * self.memory_gb))}M" if self.memory_gb else ""
        of_slurm = {"partition": self.partition, "mem": memory}
        submitter.update_parameters(
            cpus_per_task=self.cores,
            slurm_signal_delay_s=GRACE,
            slurm_additional_parameters=self._more(),
            **{f"slurm_{name}": value for name, value in of_slurm.items() if value},
        )
        try:
            with submitter.batch():
                return [submitter.submit(Worker(list(command), log.resolve())) for log in logs]
        except self._refused as error:
            raise UsageError(f"Slurm does not take the job: {_reason(str(error))}") from None

    def running(self, workers: Sequence[Any]) -> list[Any]:
        if self.cluster == "local" or not workers:
            return [worker for worker in workers if not worker.done()]
        try:
            listed = _ask("squeue", "--me", "--array", "--noheader", "--format=%i %t")
        except UsageError:  # it may be back at the next look
            return [] if self._stopping else list(workers)
        rows = [row.split() for row in listed.splitlines()]
        # One that completes (CG) may be requeued, but not after it was stopped; Slurm then takes half a minute for it.
        queued = {name for name, state in rows if not (self._stopping and state == "CG")}
        return [worker for worker in workers if worker.job_id in queued]

    def stop(self, workers: Sequence[Any]) -> None:
        self._stopping = True
        for worker in workers:
            worker.cancel(check=False)


def _ask(*command: str) -> str:
    """What a command of Slurm prints."""
    if shutil.which(command[0]) is None:
        raise UsageError(f"Slurm is not on this machine: there is no command {command[0]}.")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise UsageError(f"Slurm cannot be reached: {_reason(done.stderr)}")
    return done.stdout


def _reason(text: str) -> str:
    lines = [line.strip() for line in text.split("\n") if "error" in line.lower()] or [text.strip().partition("\n")[0]]
    return lines[0]
