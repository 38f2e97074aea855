"""How long one waits for Assistax: importing it, its help, and a training's first update, cold and warm.

uv run python benchmarks/start_up.py --out results/bench/start_up/two_cores.json

Cold has an empty cache of compiled programs, warm what the cold start has left there. A first update has happened when
metrics.jsonl has its first row. Python's own compiled files are made before, by importing once what a training does.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from assistax.files import write_json
from assistax.stamp import stamp

COMMAND = [sys.executable, "-m", "assistax"]


def waited(command: list[str]) -> float:
    """Seconds until a command has ended."""
    began = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - began


def first_update(task: str, cache: Path) -> float:
    """Seconds until a training of the default preset has made its first update."""
    with tempfile.TemporaryDirectory() as folder:
        rows = Path(folder, "run", "metrics.jsonl")
        command = [*COMMAND, "train", task, "--steps", "1e7", "--out", str(rows.parent)]
        began = time.perf_counter()
        variables = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(cache)}
        training = subprocess.Popen(command, env=variables, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        while not (rows.exists() and rows.stat().st_size):
            if training.poll() is not None:
                sys.exit(training.communicate()[1].decode())
            time.sleep(0.05)
        seconds = time.perf_counter() - began
        training.kill()
        training.communicate()
    return seconds


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=("scratch", "feeding"))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    waited([sys.executable, "-c", "import assistax.training.loop"])
    found: dict = {
        "import": median(waited([sys.executable, "-c", "import assistax"]) for _ in range(chosen.rounds)),
        "help": median(waited([*COMMAND, "--help"]) for _ in range(chosen.rounds)),
    }
    for task in chosen.tasks:
        with tempfile.TemporaryDirectory() as cache:
            cold = first_update(task, Path(cache))
            found[task] = {"cold": cold, "warm": median(first_update(task, Path(cache)) for _ in range(chosen.rounds))}
        print(task, found[task], flush=True)
    if chosen.out:
        write_json(chosen.out, {"seconds": found, "rounds": chosen.rounds} | stamp())


if __name__ == "__main__":
    main()
