"""What a task is: the page that every file in this folder fills in."""

from typing import Any, ClassVar, Protocol

import jax
import mujoco

Sensors = dict[str, jax.Array]
"""The scene's sensors by name, plus the joints' `theta_`, `dtheta_` and `torque_` by `robot` and `human`."""

TaskState = Any
"""A pytree: what the reset drew (targets) and what the episode has achieved so far."""


class Task(Protocol):
    """One assistive task: pure functions of the sensors and the task's own state."""

    title: ClassVar[str]
    config_type: ClassVar[type]
    config: Any

    def __init__(self, config: Any, model: mujoco.MjModel, dt: float):
        """`dt` is the length of a control step in s."""
        ...

    def reset(self, key: jax.Array) -> TaskState:
        """Draw a new episode: targets, and outcomes at zero."""
        ...

    def advance(self, s: Sensors, state: TaskState) -> TaskState:
        """Book what happened in this control step."""
        ...

    def observe(self, s: Sensors, state: TaskState) -> dict[str, jax.Array]:
        """The named ground-truth blocks that both agents see, in the order of the paper's table."""
        ...

    def reward_terms(self, s: Sensors, state: TaskState) -> dict[str, jax.Array]:
        """Named, scaled terms; their sum is the reward of both agents."""
        ...

    def outcomes(self, state: TaskState) -> dict[str, jax.Array]:
        """What the episode has achieved so far, in units a person understands."""
        ...

    def success(self, state: TaskState) -> jax.Array:
        """Whether the episode counts as a success by now."""
        ...

    def terminated(self, state: TaskState) -> jax.Array:
        """Whether the task itself is over (time limits are the environment's business)."""
        ...

    def markers(self, s: Sensors, state: TaskState) -> jax.Array:
        """World position [3] of the target, for the renderer."""
        ...
