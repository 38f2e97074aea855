"""A task's scene in the browser: bodies, target, spots of the skin, the force on the person and the viewer's pull."""

import io
from collections.abc import Generator, Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

import mujoco
import numpy as np
import trimesh
import viser
import viser.transforms
from mjviser import ViserMujocoScene

from assistax.evaluation import overlay
from assistax.evaluation.filmed import Filmed
from assistax.evaluation.sight import Spots
from assistax.evaluation.stage import THICK, Stage, lying_on

PULL = (90, 150, 255)  # colour of the arrow
THIN = {"shaft_radius": 0.006, "head_radius": 0.016, "head_length": 0.035}  # m
NOWHERE = np.zeros((1, 2, 3), np.float32)


@contextmanager
def serving(host: str, port: int) -> Generator[viser.ViserServer]:
    """A web server with an empty scene, and no words of its own on the terminal; any free port for 0."""
    with redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=host, port=port, label="Assistax", verbose=False)
    try:
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


class Scene:
    """Shows moments of one task's episodes on a server.

    Args:
      server: whose scene becomes this one.
      first: a moment of the episode, see `show`.
    """

    def __init__(self, server: viser.ViserServer, first: Filmed):
        self.server, self.stage = server, Stage(first.task)
        server.scene.reset()
        self.stage.pose(first.qpos[0], first.marker[0])  # also says whether the target is to be seen
        self.spots = Spots(self.stage, first)
        self.bodies = ViserMujocoScene(server, self.stage.model, num_envs=1)
        self.bodies.camera_tracking_enabled = False
        add = server.scene
        self._force = add.add_arrows("/force", NOWHERE, (0, 0, 0), visible=False, **THIN)
        self._pull = add.add_arrows("/pull", NOWHERE, PULL, visible=False, **THIN)
        discs = overlay.discs(self.stage, first, 0, self.spots)
        ball = trimesh.creation.icosphere(2)
        n = len(discs)
        blank: dict[str, Any] = {"batched_scales": np.ones((n, 3)), "batched_opacities": np.ones(n), "lod": "off"}
        blank |= {"batched_colors": np.zeros((n, 3), np.uint8), "cast_shadow": False}
        places = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)), np.zeros((n, 3))
        self._discs: Any = n and add.add_batched_meshes_simple("/discs", ball.vertices, ball.faces, *places, **blank)
        self.show(first, 0)

    def show(self, filmed: Filmed, i: int, pull: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        """One moment.

        Args:
          filmed, i: an episode and its control step.
          pull: where [3] m the viewer holds a body, and to where [3] m it is pulled.
        """
        stage = self.stage
        stage.pose(filmed.qpos[i], filmed.marker[i])
        with self.server.atomic():
            self.bodies.update_from_mjdata(stage.data)
            self._show_discs(overlay.discs(stage, filmed, i, self.spots))
            force = filmed.force[i]
            felt = bool(np.linalg.norm(force) > overlay.FELT)
            if felt:
                tip = stage.data.site("tool_tip").xpos
                tail, colour = overlay.arrow(force, tip)
                self._force.points, self._force.colors = np.array([[tail, tip]], np.float32), np.array(colour, np.uint8)
            self._force.visible = felt
            if pull is not None:
                self._pull.points = np.array([pull], np.float32)
            self._pull.visible = pull is not None

    def handles(self) -> Iterator[tuple[int, Any]]:
        """What is drawn of every body that moves: (its id in the model of the stage, the node of the scene)."""
        for group in self.bodies._mesh_groups:  # the library has no public way
            yield int(group.body_ids[0]), group.handle

    def look(self, camera, view: str | mujoco.MjvCamera) -> None:
        """Let a camera of viser look as one of the scene, "main" or "close", or as one of MuJoCo."""
        if isinstance(view, str):
            eye, centre = self.stage.aim(view)
        else:
            azimuth, elevation = np.radians([view.azimuth, view.elevation])
            level = np.cos(elevation)
            forward = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
            centre = view.lookat
            eye = centre - view.distance * forward
        camera.position, camera.look_at, camera.fov = eye.copy(), centre.copy(), np.radians(45.0)

    def _show_discs(self, discs) -> None:
        if not self._discs:
            return
        places, normals, colours, radii = (np.array(part) for part in zip(*discs, strict=True))
        axes = np.stack([lying_on(normal) for normal in normals])
        self._discs.batched_positions = places
        self._discs.batched_wxyzs = viser.transforms.SO3.from_matrix(axes).wxyz
        self._discs.batched_scales = np.stack([radii, radii, np.full_like(radii, THICK)], 1)
        self._discs.batched_colors = np.round(255 * colours[:, :3]).astype(np.uint8)
        self._discs.batched_opacities = colours[:, 3]
