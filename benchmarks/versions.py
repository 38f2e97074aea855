"""What version 1 of the tasks costs: its rate open loop, and without its brakes, as shares of version 0's.

taskset -c 0 uv run python benchmarks/versions.py --out results/bench/versions/one_core.json

The three take turns in short rounds. A rate is that of the fastest, as whatever else the machine does only makes it
slower.
"env" is the whole environment, "engine" physics alone.
"""

import argparse
from dataclasses import replace
from pathlib import Path

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
    loops = {name: OpenLoop(env, num_envs, steps=4) for name, env in versions(task).items()}
    found = [{name: loop.round() for name, loop in loops.items()} for _ in range(rounds)]

    env, engine = ({name: max(row[name][of] for row in found) for name in loops} for of in ("env", "engine"))
    return {
        "env_steps_per_s": {name: round(rate) for name, rate in env.items()},
        "env_of_v0": {name: round(rate / env["v0"], 3) for name, rate in env.items()},
        "engine_of_v0": {name: round(rate / engine["v0"], 3) for name, rate in engine.items()},
        "env_over_engine": {name: round(env[name] / rate, 3) for name, rate in engine.items()},
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=TASKS, choices=TASKS)
    parser.add_argument("--num-envs", type=int, default=256)
    parser.add_argument("--rounds", type=int, default=100)
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
