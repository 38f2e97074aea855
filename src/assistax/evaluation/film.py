"""Pictures and films of a scene."""

import atexit
import os
import warnings
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np
from PIL import Image

from assistax.errors import UsageError
from assistax.evaluation.filmed import Filmed
from assistax.evaluation.overlay import FINER, Overlay
from assistax.evaluation.sight import Spots, viewpoint
from assistax.evaluation.stage import THICK, Disc, Stage, lying_on
from assistax.files import write_atomically, writing

FILM_FORMATS = {".mp4": 25, ".webp": 10, ".gif": 10, ".png": 1}  # frames per second; .webp plays in web pages
ELLIPSOID = mujoco.mjtGeom.mjGEOM_ELLIPSOID


class Camera(Stage):
    """Renders joint positions of one task's scene. Use as a context manager, or `close` it."""

    def __init__(self, task: str, width: int = 640, height: int = 480, view: str = "main"):
        for name, pixels in {"width": width, "height": height}.items():
            if not 16 <= pixels <= 8192:
                raise UsageError(f"The {name} of a picture must be from 16 to 8192 pixels, not {pixels}.")
        super().__init__(task)
        fine = FINER * width, FINER * height
        self.model.vis.global_.offwidth, self.model.vis.global_.offheight = fine
        self.view: str | mujoco.MjvCamera = view
        self.width, self.height = width, height
        _headless()
        try:
            self._renderer = mujoco.Renderer(self.model, fine[1], fine[0])
        except Exception as error:  # every OpenGL backend fails with an error of its own
            raise UsageError(
                f"Cannot render here ({str(error).splitlines()[0]}). Install EGL "
                "(Debian: apt-get install libegl1 libgl1-mesa-dri) or set MUJOCO_GL=osmesa."
            ) from None

        atexit.register(self._renderer.close)  # later, OpenGL is gone, and says so

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self) -> None:
        """Give the graphics memory back."""
        self._renderer.close()
        atexit.unregister(self._renderer.close)

    def picture(self, qpos: np.ndarray, marker: np.ndarray) -> np.ndarray:
        """Pixels [height, width, 3] uint8 of the scene at qpos [nq], its target at marker [3]."""
        self.pose(qpos, marker)
        return self.render()

    def render(self, discs: Iterable[Disc] = ()) -> np.ndarray:
        """The picture of what was posed last, with discs on it."""
        self._renderer.update_scene(self.data, camera=self.view)
        scene = self._renderer.scene
        for place, normal, colour, radius in discs:
            turn = lying_on(normal).ravel()
            size = np.array([radius, radius, THICK])
            mujoco.mjv_initGeom(scene.geoms[scene.ngeom], ELLIPSOID, size, place, turn, np.array(colour, np.float32))
            scene.ngeom += 1
        return np.asarray(Image.fromarray(self._renderer.render()).reduce(FINER))

    @property
    def eye(self) -> np.ndarray:
        """Where [3] the last picture was taken from, m."""
        return np.mean([camera.pos for camera in self._renderer.scene.camera], 0)

    def pixel(self, point: np.ndarray) -> np.ndarray:
        """Where [2] a point [3] of the room lies in the last picture, in pixels to the right and down."""
        one = self._renderer.scene.camera[0]
        way, right = point - self.eye, np.cross(one.forward, one.up)
        scale = self.height / 2 * one.frustum_near / one.frustum_top / (way @ one.forward)
        return np.array([self.width / 2 + scale * (way @ right), self.height / 2 - scale * (way @ one.up)])


def check_format(path: Path, width: int = 2, height: int = 2) -> None:
    """Raise UsageError unless `film` can write such a file, of so many pixels."""
    if path.suffix not in FILM_FORMATS:
        raise UsageError(f"Can write {', '.join(FILM_FORMATS)}, not {path.name!r}.")
    if path.suffix == ".mp4" and (width % 2 or height % 2):
        raise UsageError(f"Width and height of an .mp4 must be even, not {width} x {height}.")


def film(filmed: Filmed, path: Path, plain: bool = False, view: str = "auto", **camera) -> None:
    """Film an episode as .mp4, .webp or .gif; for .png its last moment.

    Args:
      plain: without caption, arrow of the force and spots on the skin; as if only bodies and target were known.
      view: main or close, or auto: from where the help is seen best.
    """
    import imageio.v3 as iio

    check_format(path, camera.get("width", 2), camera.get("height", 2))
    rate = FILM_FORMATS[path.suffix]
    with Camera(filmed.task, view="close" if view == "auto" else view, **camera) as cam:
        spots = Spots(cam, filmed)
        if view == "auto":
            cam.view = viewpoint(cam, filmed, spots)
        overlay = None if plain or not len(filmed.force) else Overlay(cam, filmed, spots)

        def picture(i):
            return overlay.picture(i) if overlay else cam.picture(filmed.qpos[i], filmed.marker[i])

        if path.suffix == ".png":
            write_atomically(path, iio.imwrite("<bytes>", picture(len(filmed.qpos) - 1), extension=".png"))
            return
        # The step that is nearest to when a frame is shown: a film is as fast as what it shows.
        steps, dt = len(filmed.qpos), filmed.dt
        shown = np.arange(max(1, int(steps * dt * rate))) / (rate * dt)
        frames = [picture(i) for i in np.minimum(np.round(shown).astype(int), steps - 1)]
    if path.suffix in (".webp", ".gif"):
        style: dict[str, Any] = {"duration": 1000 / rate, "loop": 0}
        style |= {"quality": 42, "method": 4} if path.suffix == ".webp" else {}
        write_atomically(path, iio.imwrite("<bytes>", frames, extension=path.suffix, **style))
        return
    # ffmpeg wants a file to go back and forth in, and does not always say that a disk is full.
    with writing(path), TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"os\.fork")  # ffmpeg is not Python; JAX cannot know
        file = Path(folder) / "film.mp4"
        with iio.imopen(file, "w", plugin="FFMPEG") as video:
            video.write(frames, fps=rate, macro_block_size=1)
        content = file.read_bytes()
    write_atomically(path, content)


def _headless() -> None:
    """Let MuJoCo render without a display, too, if it was imported before the package could say so."""
    if os.environ.get("MUJOCO_GL") == "egl":
        with suppress(ImportError):  # then it fails, and says what to install
            from mujoco.egl import GLContext
            from mujoco.rendering.classic import gl_context

            gl_context.GLContext = GLContext
