"""A task's scene as it looks, posed by what is known of an episode. Needs no graphics."""

import mujoco
import numpy as np

from assistax import scenes
from assistax.tasks import task_spec

Disc = tuple[np.ndarray, np.ndarray, tuple[float, float, float, float], float]
"""Something flat on the skin: its place [3] m, what points out of the skin [3], colour, radius m."""

THICK = 0.003  # m, half of a disc


class Stage:
    """One task's scene: `model` and `data` of MuJoCo."""

    def __init__(self, task: str):
        scene = task_spec(task).scene
        self.targets = scene.targets
        self.model = scenes.build(scene).compile()
        self.data = mujoco.MjData(self.model)

    def pose(self, qpos: np.ndarray, marker: np.ndarray) -> None:
        """Put the bodies and the target there."""
        self.data.qpos[:] = qpos
        self.data.mocap_pos[0] = marker
        mujoco.mj_forward(self.model, self.data)
        self.at_mouth = bool(np.linalg.norm(marker - self.data.site("mouth").xpos) < 1e-3)
        self.model.geom("target").rgba[3] = not self.at_mouth  # it would hide the lips

    def aim(self, view: str) -> tuple[np.ndarray, np.ndarray]:
        """From where [3] m a camera of the scene looks, and the point [3] m of its axis nearest to the target."""
        camera = self.data.cam(view)
        eye, forward = camera.xpos, -camera.xmat.reshape(3, 3)[:, 2]
        return eye, eye + forward * max(float((self.data.mocap_pos[0] - eye) @ forward), 0.3)


def lying_on(normal: np.ndarray) -> np.ndarray:
    """The axes [3, 3], as columns, of a disc on the skin where this unit vector [3] points out of it."""
    x = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.7 else [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(normal, x), normal], 1)
