"""How far the brakes keep joints within their speed limits when everybody acts with all they have.

"held": full action for a second from rest, in every combination of directions. "switched": full action whose directions
are drawn anew every 0.1 s, in episodes of 8 s. Shares of the limits, the largest of all physics steps by joint.

uv run python benchmarks/joint_speeds.py --out results/joint_speeds.json
"""

import argparse
from itertools import product
from pathlib import Path

import mujoco
import numpy as np

import assistax
from assistax import scenes
from assistax.files import write_json
from assistax.stamp import stamp

TASKS = ("scratch", "bed_bath", "arm_assist", "feeding", "tooth_brushing")
SECOND, SWITCH, EPISODE = 500, 50, 4000  # physics steps


class Bodies:
    """Both bodies of a task, driven by directions [n] of -1 or 1 for each joint that anybody drives."""

    def __init__(self, task: str):
        env = assistax.make(f"{task}-v1", engine="mujoco")
        driven = env.spec.scene.human_driven
        self.names = (*driven, *scenes.PANDA.joints)
        self.model, self.data = env.model, mujoco.MjData(env.model)
        limits = {**dict(zip(scenes.PANDA.joints, scenes.PANDA.speed, strict=True)), **scenes.HUMAN_SPEED}
        self._limit = np.array([limits[name] for name in self.names])
        self._full = np.array([*[1.0] * len(driven), *env.config.torque_scale * np.array(scenes.PANDA.torque)])
        self._joints = [env.model.joint(name).dofadr[0] for name in self.names]

    def fastest(self, directions: np.ndarray, steps: int) -> np.ndarray:
        """From rest, so many physics steps with each row of directions [m, n]: the largest shares [n]."""
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        most = np.zeros(len(self.names))
        for row in directions:
            self.data.ctrl[: len(row)] = self._full * row
            for _ in range(steps):
                mujoco.mj_step(self.model, self.data)
                most = np.maximum(most, np.abs(self.data.qvel[self._joints]) / self._limit)
        return most


def measure(task: str, episodes: int, seed: int) -> dict:
    """Of one task."""
    bodies, rng = Bodies(task), np.random.default_rng(seed)
    number = len(bodies.names)
    held = np.array([bodies.fastest(np.array([one]), SECOND) for one in product((-1, 1), repeat=number)])
    drawn = (rng.choice([-1, 1], (EPISODE // SWITCH, number)) for _ in range(episodes))
    switched = np.array([bodies.fastest(directions, SWITCH) for directions in drawn])
    found = {"combinations": len(held), "episodes": episodes}
    for name, shares in (("held", held), ("switched", switched)):
        found[name] = {joint: round(float(x), 3) for joint, x in zip(bodies.names, shares.max(0), strict=True)}
    ordered = np.sort(switched.max(1))[::-1]
    return found | {"worst_episodes": ordered[:5].round(3).tolist()}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=TASKS, choices=TASKS)
    parser.add_argument("--episodes", type=int, default=300)
    parser.add_argument("--seed", type=int, default=21)
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    found = {}
    for task in chosen.tasks:
        found[task] = measure(task, chosen.episodes, chosen.seed)
        print(task, {name: max(found[task][name].values()) for name in ("held", "switched")}, flush=True)
    if chosen.out:
        write_json(chosen.out, {"tasks": found, "seed": chosen.seed} | stamp())


if __name__ == "__main__":
    main()
