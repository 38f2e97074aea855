"""What version 1 of the tasks costs: its rate open loop, and without its brakes, as shares of version 0's.

uv run python benchmarks/versions.py --out results/bench/versions/two_cores.json

The three take turns, and a share is the median over rounds of that of the round, so that whatever else the machine
does meets all of them. "env" is the whole environment, "engine" physics alone.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import assistax
from assistax.diagnostics.bench import OpenLoop
from assistax.files import write_json
from assistax.stamp import stamp
from assistax.tasks import register_task, task_spec

TASKS = ("scratch", "bed_bath", "arm_assist", "feeding", "tooth_brushing")


def versions(task: str) -> dict[str, assistax.Env]:
    """Version 0, 1, and 1 without the brakes that keep joints to their speeds."""
    newest = task_spec(f"{task}-v1")
    unbraked = replace(newest, name=f"{task}_unbraked", scene=replace(newest.scene, speed_limits=False))
    ids = {"v0": f"{task}-v0", "v1": newest.id, "unbraked": register_task(unbraked).id}
    return {name: assistax.make(id, engine="mujoco") for name, id in ids.items()}


def measure(task: str, num_envs: int, rounds: int) -> dict:
    """Of one task."""
    loops = {name: OpenLoop(env, num_envs) for name, env in versions(task).items()}
    found = [{name: loop.round() for name, loop in loops.items()} for _ in range(rounds)]

    def rates(of: str) -> dict[str, np.ndarray]:
        return {name: np.array([row[name][of] for row in found]) for name in loops}

    env, engine = rates("env"), rates("engine")
    return {
        "env_steps_per_s": {name: round(float(np.median(x))) for name, x in env.items()},
        "env_of_v0": {name: _median(x / env["v0"]) for name, x in env.items()},
        "engine_of_v0": {name: _median(x / engine["v0"]) for name, x in engine.items()},
        "env_over_engine": {name: _median(env[name] / x) for name, x in engine.items()},
    }


def _median(shares: np.ndarray) -> float:
    return round(float(np.median(shares)), 3)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=TASKS, choices=TASKS)
    parser.add_argument("--num-envs", type=int, default=1024)
    parser.add_argument("--rounds", type=int, default=11)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    found = {}
    for task in chosen.tasks:
        found[task] = measure(task, chosen.num_envs, chosen.rounds)
        print(task, found[task], flush=True)
    settings = {"num_envs": chosen.num_envs, "rounds": chosen.rounds}
    if chosen.out:
        write_json(chosen.out, {"tasks": found} | settings | stamp())


if __name__ == "__main__":
    main()
