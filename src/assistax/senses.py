"""What can be sensed in a scene, and who sees what of it: the paper's observation table."""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax import scenes
from assistax.human import HumanConfig, HumanProfile, disability, preference
from assistax.physics import PhysicsState
from assistax.tasks.base import Sensors

BODIES = ("theta_robot", "dtheta_robot", "tool_pos", "tool_quat", "tool_force", "theta_human", "dtheta_human")
_HIDDEN = {
    "robot": ("theta_human", "dtheta_human"),
    "human": ("theta_robot", "dtheta_robot", "clock", "body", "expression"),
    "global": (),
}

Blocks = dict[str, jax.Array]
"""Parts of an observation by name, in its order."""


class Senses:
    """Of one scene, for one kind of people.

    Args:
      robot, driven: names of the joints that the robot and the person drive.
    """

    def __init__(self, model: mujoco.MjModel, robot: tuple[str, ...], driven: tuple[str, ...], human: HumanConfig):
        self._human, self.places = human, scenes.sensor_slices(model)
        torques = {"torque_robot": robot, "torque_human": driven}
        self._columns = {
            name: np.array([self.places[f"torque_{joint}"].start for joint in joints])
            for name, joints in torques.items()
        }
        joints = {"robot": robot, "human": scenes.HUMAN_JOINTS, "driven": driven}
        self._joints = {name: scenes.qpos_ids(model, which) for name, which in joints.items()}

    def __call__(self, physics: PhysicsState) -> Sensors:
        """The named sensors of a state, all of one instant, and its joints, 2 ms later (see PhysicsState)."""
        s = {name: physics.sensordata[place] for name, place in self.places.items()}
        s |= {name: physics.sensordata[columns] for name, columns in self._columns.items()}
        s |= {f"theta_{name}": physics.qpos[ids] for name, ids in self._joints.items()}
        return s | {f"dtheta_{name}": physics.qvel[ids] for name, ids in self._joints.items()}

    def blocks(self, s: Sensors, of_task: Blocks, person: HumanProfile) -> Blocks:
        """All that anybody sees, in the order of the paper's table."""
        blocks = {name: s[name] for name in BODIES} | of_task
        if self._human.preferring and self._human.visibility != "none":
            blocks["preference"] = preference.vector(person.preference)
        if self._human.visibility == "oracle":
            blocks["body"] = disability.vector(person.disability)
        return blocks

    def seen_by(self, who: str, blocks: Blocks) -> Blocks:
        """What "robot", "human" or "global" sees of all blocks."""
        hidden = set(_HIDDEN[who])
        if who == "robot" and self._human.visibility in ("human", "shown"):
            hidden.add("preference")
        return {name: block for name, block in blocks.items() if name not in hidden}

    def layout(self, who: str, blocks: Blocks) -> dict[str, slice]:
        """Where each block lies in what "robot", "human" or "global" sees."""
        seen, end = {}, 0
        for name, block in self.seen_by(who, blocks).items():
            seen[name] = slice(end, end + block.shape[0])
            end += block.shape[0]
        return seen


def joined(blocks: Blocks) -> jax.Array:
    """One vector of all blocks, one after the other."""
    return jnp.concatenate(list(blocks.values()))
