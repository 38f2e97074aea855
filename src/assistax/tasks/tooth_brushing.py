"""Brush the teeth: bristles on the mouth, handle level, about 1 N, about 0.1 m/s across.

Paper: task "Tooth Brushing"; reward components r_te, r_a and r_b. The bristles look along −x of the
tool frame, the handle along −z.
"""

from dataclasses import dataclass, replace
from math import pi
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco

from assistax.pytree import pytree
from assistax.scenes import MEAL_VIEW, NECK, SceneConfig, geometry, limited
from assistax.scenes.geometry import norm
from assistax.tasks.base import Sensors, tool_force, tool_velocity
from assistax.tasks.registry import TaskSpec
from assistax.tasks.rewards import alignment, boltzmann, envelope


@dataclass(frozen=True)
class ToothBrushingConfig:
    """The numbers in which versions differ; the defaults are version 0's."""

    reach_scale: float = 2.0  # of the reach term
    brush_scale: float = 1.0  # of the brush term
    align_inward: bool = False  # whether bristles are to look along the mouth's axis, or at its middle
    pay_help_only: bool = False  # whether the brush term pays only where it helps, or wherever the bristles are near
    near: float = 0.05  # m, the brush term counts when the bristles are nearer than this
    mouth_width: float = 1e3  # m, and to either side of the face no further than this
    mouth_height: float = 1e3  # m, the same up or down the face
    own_strokes: bool = False  # whether only what the brush itself moves is speed, or also what the head does
    speed: float = 0.1  # m/s, v* of the brush term
    force: float = 1.0  # N, f* of the brush term
    # What counts as brushing, and for how long in all it must last to be a success.
    brush_angle: float = pi  # rad, from the bristles to straight into the face, at most
    brush_force: tuple[float, float] = (0.3, 3.0)  # N, on the head, least and most, while it counts as brushing
    brush_speed: tuple[float, float] = (0.03, 0.3)  # m/s, across
    success_seconds: float = 2.0  # s, in all


@pytree
class ToothBrushingState:
    """What an episode has come to, beside the physics."""

    brush_seconds: jax.Array


class ToothBrushing:
    """The task itself; see `tasks.base.Task` for what each method returns."""

    title: ClassVar[str] = "Brush a person's teeth"
    config_type = ToothBrushingConfig

    def __init__(self, config: ToothBrushingConfig, model: mujoco.MjModel, dt: float):
        self.config, self.dt = config, dt

    def reset(self, key) -> ToothBrushingState:
        """Nothing is drawn: the mouth is where the head is."""
        return ToothBrushingState(jnp.float32(0.0))

    def observe(self, s: Sensors, state: ToothBrushingState):
        vector = s["mouth_pos"] - s["tool_pos"]
        rotation = geometry.matrix(s["tool_quat"]).T @ geometry.matrix(s["mouth_quat"])
        return {
            "mouth_pos": s["mouth_pos"],
            "target_vector": vector,
            "target_distance": norm(vector)[None],
            "target_rotation": rotation.ravel(),
        }

    def _stroke(self, s: Sensors):
        """(distance to the mouth in m, speed across in m/s, force in N)."""
        vector, velocity = s["mouth_pos"] - s["tool_pos"], tool_velocity(s, "head")
        if self.config.own_strokes:
            ahead = geometry.matrix(s["mouth_quat"])[:, 0]
            both = jnp.stack([velocity, s["tool_vel"]])
            speed = norm(both - (both @ ahead)[:, None] * ahead).min()
        else:
            towards = geometry.unit(vector)
            speed = norm(velocity - (velocity @ towards) * towards)
        return norm(vector), speed, norm(tool_force(s, "head"))

    def reward_terms(self, s: Sensors, state: ToothBrushingState):
        c = self.config
        distance, speed, force = self._stroke(s)
        tool = geometry.matrix(s["tool_quat"])
        inward = -geometry.matrix(s["mouth_quat"])[:, 0] if c.align_inward else None
        align = alignment(s["mouth_pos"] - s["tool_pos"], -tool[:, 0], -tool[:, 2], inward)
        paid = self.helping(s, state) if c.pay_help_only else distance < c.near
        return {
            "reach": c.reach_scale * envelope(distance),
            "align": align * envelope(distance),
            "brush": c.brush_scale * paid * boltzmann(speed / c.speed) * boltzmann(force / c.force),
        }

    def advance(self, s: Sensors, state: ToothBrushingState) -> ToothBrushingState:
        c = self.config
        _, speed, force = self._stroke(s)
        brushing = self.helping(s, state)
        brushing &= (c.brush_force[0] <= force) & (force <= c.brush_force[1])
        brushing &= (c.brush_speed[0] <= speed) & (speed <= c.brush_speed[1])
        return ToothBrushingState(state.brush_seconds + self.dt * brushing)

    def helping(self, s: Sensors, state: ToothBrushingState):
        """The bristles are at the mouth and look into the face."""
        c, face, vector = self.config, geometry.matrix(s["mouth_quat"]), s["mouth_pos"] - s["tool_pos"]
        bristle = -geometry.matrix(s["tool_quat"])[:, 0]
        facing = -bristle @ face[:, 0] >= jnp.cos(c.brush_angle) - 1e-6
        _, aside, above = jnp.abs(face.T @ vector)
        return facing & (norm(vector) < c.near) & (aside < c.mouth_width) & (above < c.mouth_height)

    def tool_speed(self, s: Sensors, state: ToothBrushingState):
        return self._stroke(s)[1] if self.config.own_strokes else norm(tool_velocity(s, "head"))

    def outcomes(self, state: ToothBrushingState):
        return {"brush_seconds": state.brush_seconds}

    def success(self, state: ToothBrushingState):
        return state.brush_seconds >= self.config.success_seconds

    def terminated(self, state: ToothBrushingState):
        return jnp.bool_(False)

    def markers(self, s: Sensors, state: ToothBrushingState):
        return s["mouth_pos"]


_SCENE = SceneConfig("wheelchair", "seated", "toothbrush", (0.65, 0.3, 0.32), pi + 0.5, NECK, **MEAL_VIEW)

_PAPER = TaskSpec(
    "tooth_brushing",
    0,
    ToothBrushing,
    _SCENE,
    expert="assistax.policies.experts.tooth_brushing:ToothBrushingExpert",
    bound=3140,
    preference_budget=1.256,
    tremor_weakens=True,
)
_HELPING = TaskSpec(
    "tooth_brushing",
    1,
    ToothBrushing,
    limited(_SCENE, "head"),
    ToothBrushingConfig(brush_scale=4.0, brush_angle=pi / 3, align_inward=True, pay_help_only=True),
    expert="assistax.policies.experts.tooth_brushing:ToothBrushingExpert",
    bound=3542,
    preference_budget=1.256,
    preferences_need_help=True,
)
# Within 5 cm of the mouth are nose and cheeks, too, and a head that shakes moves them along a brush that rests.
_AT_THE_TEETH = replace(
    _HELPING,
    version=2,
    scene=replace(_HELPING.scene, throat=True),
    config=replace(_HELPING.config, mouth_width=0.025, mouth_height=0.015, own_strokes=True, brush_scale=8.0),
    bound=4083,
)

SPECS = (_PAPER, _HELPING, _AT_THE_TEETH)
