"""What a task is: the page that every file in this folder fills in."""

from typing import Any, ClassVar, Protocol

import jax
import mujoco

from assistax.scenes import geometry

Sensors = dict[str, jax.Array]
"""The scene's sensors by name, plus the joints' `theta_`, `dtheta_` and `torque_` by `robot` and `human`."""

TaskState = Any
"""A pytree: what the reset drew (targets) and what the episode has achieved so far."""


_AXES = {"upper_arm": "upper_arm_quat", "forearm": "forearm_quat", "head": "mouth_quat"}


def tool_velocity(s: Sensors, part: str) -> jax.Array:
    """Velocity [3] of the tool point in m/s, world axes: as the body part sees it where the scene measures that
    (from version 1 on), else as the room does (version 0)."""
    if f"tool_vel_{part}" not in s:
        return s["tool_vel"]
    return geometry.rotate(s[_AXES[part]], s[f"tool_vel_{part}"])


def tool_force(s: Sensors, part: str) -> jax.Array:
    """Force [3] of the working surface in N, world axes: on the body part where the scene measures that, else on
    the whole person."""
    return s.get(f"tool_force_{part}", s["tool_force"])


TO_DO, DONE, NOTHING_TO_DO = 0, 1, 2  # states of a spot


class Task(Protocol):
    """One assistive task: pure functions of the sensors and the task's own state.

    One that works on many spots of the skin may have two more things, for the renderer: `spots`, by body of the person
    their places [n, 3] in m in the body's frame, and `spot_states(state)`, int8 for each of them all.
    """

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

    def helping(self, s: Sensors, state: TaskState) -> jax.Array:
        """Whether the robot helps: only then do preferences pay, so that it must not last without anything done."""
        ...

    def tool_speed(self, s: Sensors, state: TaskState) -> jax.Array:
        """Speed of the tool point in m/s, as the body part that it works on sees it, or as far as it counts as work."""
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
