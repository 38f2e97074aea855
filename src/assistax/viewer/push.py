"""A hand that holds a body at a point and pulls it, as with a spring."""

from dataclasses import dataclass

import mujoco
import numpy as np

STIFFNESS = 200.0  # N/m
STRONGEST = 60.0  # N


@dataclass
class Hand:
    """Holds one body.

    Args:
      model: of the physics; what it sees of a body is where qpos puts it.
      body: its id there.
      qpos: [nq] when it takes hold.
      point: [3] m in the room, where.
    """

    model: mujoco.MjModel
    body: int
    qpos: np.ndarray
    point: np.ndarray

    def __post_init__(self):
        self._data = mujoco.MjData(self.model)
        self._pose(self.qpos)
        frame = self._data.xmat[self.body].reshape(3, 3)
        self._local = frame.T @ (self.point - self._data.xpos[self.body])
        self.target = self.point

    def pull(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(where [3] m it holds the body now, the force [3] in N towards `target`)."""
        self._pose(qpos)
        at = self._data.xpos[self.body] + self._data.xmat[self.body].reshape(3, 3) @ self._local
        force = STIFFNESS * (self.target - at)
        return at, force * min(1.0, STRONGEST / max(float(np.linalg.norm(force)), 1e-9))

    def push(self, qpos: np.ndarray) -> np.ndarray:
        """As physics.PUSH says, [nbody, 6]."""
        at, force = self.pull(qpos)
        push = np.zeros((self.model.nbody, 6), np.float32)
        push[self.body] = *force, *np.cross(at - self._data.xipos[self.body], force)
        return push

    def _pose(self, qpos):
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self._data)
        mujoco.mj_comPos(self.model, self._data)


def held_by(seen: mujoco.MjModel, body: int, model: mujoco.MjModel) -> int | None:
    """The body of the physics' model that carries one of what is seen; None for what cannot move.

    What is seen has more bodies: those fixed to another one are one with it in the physics.
    """
    names = {model.body(i).name: i for i in range(model.nbody)}
    while body and seen.body(body).name not in names:
        body = int(seen.body_parentid[body])
    found = names[seen.body(body).name]
    return found if model.body_weldid[found] and model.body_mocapid[found] < 0 else None
