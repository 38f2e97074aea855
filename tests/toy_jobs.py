"""Jobs of ten steps of some milliseconds, with a checkpoint after each; as a script, a worker of them.

`toy_jobs.py FOLDER COUNT [local|slurm]`: with an executor the driver of two such workers.
"""

import os
import signal
import sys
import time
from pathlib import Path

from assistax.errors import UsageError
from assistax.executors.drive import drive, executor
from assistax.executors.jobs import Job, work
from assistax.files import write_atomically
from assistax.training.clock import progress_bar

LENGTH, SECONDS = 10, float(os.environ.get("TOY_SECONDS", 0.03))


def steps_of(folder, name):
    """[(step, process that made it)] of a job's checkpoint."""
    path = folder / f"{name}.steps"
    lines = path.read_text().split("\n") if path.exists() else []
    return [(int(step), owner) for step, owner in (line.split() for line in lines if line)]


def jobs_of(folder, count):
    stopped = []

    def job(name):
        def do():
            if (folder / f"{name}.bad").exists():
                raise UsageError("A toy that cannot be.")
            signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
            for step in range(len(steps_of(folder, name)), LENGTH):
                if stopped:
                    return False
                time.sleep(SECONDS)
                lines = [f"{step} {owner}" for step, owner in [*steps_of(folder, name), (step, os.getpid())]]
                write_atomically(folder / f"{name}.steps", "\n".join(lines).encode())
            with open(folder / "finished", "a") as file:
                file.write(f"{name}\n")
            return True

        return Job(name, LENGTH, lambda: len(steps_of(folder, name)), do)

    return [job(f"{i:02d}") for i in range(count)]


if __name__ == "__main__":
    folder, count = Path(sys.argv[1]), int(sys.argv[2])
    jobs = jobs_of(folder, count)
    if sys.argv[3:]:
        using = executor(sys.argv[3], {})
        type(using).seconds = 0.1
        drive(folder / "workers", jobs, using, [sys.executable, *sys.argv[:3]], 2, progress_bar)
    else:
        sys.exit(0 if work(folder / "workers", jobs) else 130)
