"""What the adapters to Gymnasium and PettingZoo have in common: spaces, what is told of a step, pictures."""

from typing import Any

import jax
import numpy as np

from assistax.env import Env, EnvState
from assistax.errors import choose
from assistax.evaluation.film import Camera
from assistax.spaces import Box

INFO = ("metrics", "reward_terms", "robot_force", "cost")  # what is told of a step, see Env.step
METADATA: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 125}


def as_gymnasium(space: Box):
    """The same space, as a gymnasium.spaces.Box."""
    from gymnasium.spaces import Box as GymnasiumBox

    return GymnasiumBox(np.asarray(space.low), np.asarray(space.high), space.shape, np.float32)


def on_host(info: dict[str, Any]) -> dict[str, Any]:
    """What is told of a step, in NumPy [n]."""
    return jax.device_get({name: info[name] for name in INFO})


def of_one(info: dict[str, Any]) -> dict[str, Any]:
    """The same of the only environment of a batch, as plain numbers."""
    return jax.tree.map(lambda x: x[0].item(), on_host(info))


class Pictures:
    """The camera is made for the first picture; without a render mode there is none, and no picture."""

    def __init__(self, env: Env, render_mode: str | None):
        if render_mode is not None:
            choose("render_mode", render_mode, METADATA["render_modes"])
        self._env, self._on = env, render_mode is not None
        self._camera: Camera | None = None
        self._marker = jax.jit(env.markers)

    def of(self, state: EnvState, i: int) -> np.ndarray | None:
        """Pixels [height, width, 3] uint8 of environment i of a batch."""
        if not self._on:
            return None
        if self._camera is None:
            self._camera = Camera(self._env.name)
        one: Any = jax.tree.map(lambda x: x[i], state)
        return self._camera.picture(np.asarray(one.physics.qpos), np.asarray(self._marker(one)))

    def close(self) -> None:
        if self._camera is not None:
            self._camera.close()
            self._camera = None
