"""What an arrangement of processes and cores is worth for trainings, on a machine that does nothing else.

uv run --extra ray python benchmarks/executors.py --out results/bench/executors/two_cores.json

"cores": steps/s of IPPO without evaluations, all processes together: one process on all cores or on one of them, and
one for each core, pinned to it or not. "jobs": seconds of the whole command `assistax population train` for 16 short
trainings, in one process or by an executor, each with an empty cache of compiled programs, and how many programs it
holds afterwards.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from assistax.files import write_json
from assistax.stamp import stamp

CORES = sorted(os.sched_getaffinity(0))
WORKER = """
import json, sys
from assistax.diagnostics.bench import bench_training
print(json.dumps(bench_training(sys.argv[1], "mujoco", None, float(sys.argv[2]))))
"""
ONE = (sys.executable, "-m", "assistax", "population", "train")
EXECUTORS = {"here": ("--processes", "1"), "local": ("--executor", "local"), "ray": ("--executor", "ray")}


def together(task: str, seconds: float, groups: list[list[int]]) -> float:
    """Steps/s of a training on each group of cores, all at once."""
    command = [sys.executable, "-c", WORKER, task, str(seconds)]
    workers = []
    for group in groups:
        workers.append(subprocess.Popen(command, stdout=subprocess.PIPE))
        os.sched_setaffinity(workers[-1].pid, group)
    return sum(json.loads(worker.communicate()[0])["training_steps_per_s"] for worker in workers)


def cores(task: str, seconds: float, rounds: int) -> dict[str, list[float]]:
    """By arrangement, steps/s in every round; the arrangements take turns."""
    arrangements = {
        "one process, all cores": [CORES],
        "one process, one core": [CORES[:1]],
        "a process for each core, pinned": [[core] for core in CORES],
        "a process for each core, not pinned": [CORES for _ in CORES],
    }
    together(task, 1.0, [CORES])  # compiles
    found: dict[str, list[float]] = {name: [] for name in arrangements}
    for _ in range(rounds):
        for name, groups in arrangements.items():
            found[name].append(together(task, seconds, groups))
            print(task, name, found[name][-1], flush=True)
    return found


def jobs(task: str, steps: int) -> dict[str, dict]:
    """By executor, what 16 trainings take."""
    found = {}
    for name, options in EXECUTORS.items():
        with tempfile.TemporaryDirectory() as folder:
            cache = Path(folder) / "cache"
            what = ("--people", "8", "--seeds", "2", "--steps", str(steps), "--out", f"{folder}/population")
            few = ("--set", "evaluations=1", "evaluation_episodes=16")
            began = time.perf_counter()
            subprocess.run(
                [*ONE, task, *what, *options, *few],
                check=True,
                stdout=subprocess.DEVNULL,
                env=os.environ | {"JAX_COMPILATION_CACHE_DIR": str(cache)},
            )
            took = round(time.perf_counter() - began, 1)
            programs = sum(path.name.endswith("-cache") for path in cache.rglob("*"))
        found[name] = {"seconds": took, "programs": programs}
        print(task, name, found[name], flush=True)
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=["scratch", "feeding"])
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=200_000, help="of each of the 16 trainings, of the last task")
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    found = {"cores": {task: cores(task, chosen.seconds, chosen.rounds) for task in chosen.tasks}}
    found["jobs"] = {chosen.tasks[-1]: jobs(chosen.tasks[-1], chosen.steps)}
    if chosen.out:
        write_json(chosen.out, found | {"steps": chosen.steps, "seconds": chosen.seconds} | stamp())


if __name__ == "__main__":
    main()
