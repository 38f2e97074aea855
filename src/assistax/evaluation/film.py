"""Pictures and films of a scene."""

import atexit
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np

from assistax import scenes
from assistax.errors import UsageError
from assistax.files import write_atomically, writing
from assistax.tasks import task_spec

FILM_FORMATS = {".mp4": 25, ".webp": 10, ".gif": 10, ".png": 1}  # frames per second; .webp plays in web pages


class Camera:
    """Renders joint positions of one task's scene. Use as a context manager, or `close` it."""

    def __init__(self, task: str, width: int = 640, height: int = 480, view: str = "main"):
        for name, pixels in {"width": width, "height": height}.items():
            if not 16 <= pixels <= 8192:
                raise UsageError(f"The {name} of a picture must be from 16 to 8192 pixels, not {pixels}.")
        self.model = scenes.build(task_spec(task).scene).compile()
        self.model.vis.global_.offwidth, self.model.vis.global_.offheight = width, height
        self.data = mujoco.MjData(self.model)
        self.view = view
        try:
            self._renderer = mujoco.Renderer(self.model, height, width)
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
        self.data.qpos[:] = qpos
        self.data.mocap_pos[0] = marker
        mujoco.mj_forward(self.model, self.data)
        self._renderer.update_scene(self.data, camera=self.view)
        return self._renderer.render()


def check_format(path: Path) -> None:
    """Raise UsageError unless `film` can write such a file."""
    if path.suffix not in FILM_FORMATS:
        raise UsageError(f"Can write {', '.join(FILM_FORMATS)}, not {path.name!r}.")


def film(task: str, qpos: np.ndarray, markers: np.ndarray, dt: float, path: Path, **camera) -> None:
    """Film qpos [T, nq] with targets [T, 3], dt s apart, as .mp4, .webp or .gif; for .png the last moment."""
    import imageio.v3 as iio

    check_format(path)
    rate = FILM_FORMATS[path.suffix]
    with Camera(task, **camera) as cam:
        if path.suffix == ".png":
            write_atomically(path, iio.imwrite("<bytes>", cam.picture(qpos[-1], markers[-1]), extension=".png"))
            return
        # The step that is nearest to when a frame is shown: a film is as fast as what it shows.
        shown = np.arange(max(1, int(len(qpos) * dt * rate))) / (rate * dt)
        frames = [cam.picture(qpos[i], markers[i]) for i in np.minimum(np.round(shown).astype(int), len(qpos) - 1)]
    if path.suffix in (".webp", ".gif"):
        style: dict[str, Any] = {"duration": 1000 / rate, "loop": 0}
        style |= {"quality": 60, "method": 4} if path.suffix == ".webp" else {}
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
