"""Assistax: a robot arm and a person, both with policies of their own, and tasks to do together.

import assistax
env = assistax.make("scratch")
"""

import ctypes
import os
import sys
from typing import TYPE_CHECKING

from assistax.errors import AssistaxError, SimulationError, UsageError

if TYPE_CHECKING:
    from assistax.env import Env, EnvConfig, EnvState, make
    from assistax.learning.algorithms import register_algorithm
    from assistax.tasks import TASKS, register_task
    from assistax.training.numpy_team import load_team

    __version__: str

if sys.platform == "linux" and not os.environ.get("DISPLAY") and "MUJOCO_GL" not in os.environ:
    # Headless rendering. MuJoCo reads this when first imported, and fails then if the library is missing.
    try:
        ctypes.CDLL("libEGL.so.1")
        os.environ["MUJOCO_GL"] = "egl"
    except OSError:
        pass  # everything but rendering works, which says what to install

__all__ = [
    "TASKS",
    "AssistaxError",
    "Env",
    "EnvConfig",
    "EnvState",
    "SimulationError",
    "UsageError",
    "__version__",
    "load_team",
    "make",
    "register_algorithm",
    "register_task",
]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str):
    # JAX and MuJoCo take seconds to import; `assistax --help` should not.
    if name in ("TASKS", "register_task"):
        from assistax import tasks

        return getattr(tasks, name)
    if name == "register_algorithm":
        from assistax.learning.algorithms import register_algorithm

        return register_algorithm
    if name == "load_team":
        from assistax.training.numpy_team import load_team

        return load_team
    if name == "__version__":
        from importlib.metadata import version

        return version("assistax")
    if name in __all__:
        from assistax import env

        return getattr(env, name)
    raise AttributeError(f"module 'assistax' has no attribute {name!r}")
