"""Workers as tasks of a Ray cluster: one that runs, or one on this machine that lasts as long as the driver."""

import os
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from assistax.errors import UsageError
from assistax.executors.local import launch

CARRIED = ("JAX_", "XLA_", "ASSISTAX_", "MUJOCO_")  # variables that go with a worker


@dataclass
class Ray:
    """`cores` of each worker, and the cluster's address; without one, the running cluster or else this machine."""

    address: str = ""
    cores: int = 1
    seconds = 1.0
    elsewhere = True

    def room(self, workers: int | None, jobs: int) -> int:
        try:
            import ray
        except ImportError:
            raise UsageError('The executor ray needs an extra: pip install "assistax[ray]".') from None
        self._ray = ray
        if not ray.is_initialized():
            address = self.address or os.environ.get("RAY_ADDRESS")
            about: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
            try:
                ray.init(address, **about)
            except (ConnectionError, RuntimeError, ValueError) as error:
                reason = str(error).strip().partition("\n")[0]
                raise UsageError(f"Ray cannot be reached at {address or 'this machine'}: {reason}") from None
        nodes = [int(node["Resources"].get("CPU", 0)) for node in ray.nodes() if node["Alive"]]
        if not 1 <= self.cores <= max(nodes, default=0):
            raise UsageError(f"cores must be 1 to {max(nodes, default=0)}, those of a node, not {self.cores}.")
        places = sum(node // self.cores for node in nodes)
        count = min(places, jobs) if workers is None else workers
        if not 1 <= count <= places:
            raise UsageError(f"--processes must be 1 to {places}, the cores of the cluster, not {count}.")
        return count

    def start(self, command: Sequence[str], logs: Sequence[Path]) -> list[Any]:
        variables = {name: value for name, value in os.environ.items() if name.startswith(CARRIED)}
        task = self._ray.remote(num_cpus=self.cores, max_retries=0)(_worker)
        return [task.remote(list(command), log.resolve(), Path.cwd(), variables) for log in logs]

    def running(self, workers: Sequence[Any]) -> list[Any]:
        if not workers:
            return []
        return self._ray.wait(list(workers), num_returns=len(workers), timeout=0)[1]

    def stop(self, workers: Sequence[Any]) -> None:
        for worker in workers:
            self._ray.cancel(worker)


def _worker(command: list[str], log: Path, where: Path, variables: dict[str, str]) -> int:
    os.chdir(where)
    process: subprocess.Popen = launch(command, log, variables)
    try:
        return process.wait()
    except BaseException:  # cancelled
        process.terminate()
        process.wait()
        raise
