"""Scratch an itch on the right arm: reach it, press with about 3 N, move at about 0.1 m/s.

Paper: task "Scratch"; reward components r_t and r_s.
"""

from dataclasses import dataclass, replace
from math import pi
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax.filters import low_pass
from assistax.pytree import pytree
from assistax.scenes import RIGHT_ARM, SceneConfig, geometry, limited
from assistax.scenes.geometry import norm
from assistax.tasks.base import Sensors, tool_force, tool_velocity
from assistax.tasks.registry import TaskSpec
from assistax.tasks.rewards import boltzmann, reach

SEGMENTS = ("upper_arm", "forearm")
TOUCHING = 1e-3  # N, a contact; 0 up to rounding


@dataclass(frozen=True)
class ScratchConfig:
    """The numbers in which versions differ; the defaults are version 0's."""

    near: float = 0.1  # m, the scratch term of version 0 counts when the tool is nearer than this
    speed: float = 0.1  # m/s, v* of the scratch term
    force: float = 3.0  # N, f* of the scratch term
    scratch_scale: float = 4.0  # of the scratch term
    pay_help_only: bool = False  # whether the scratch term pays only where it helps, or wherever the tool is near
    # What counts as speed: the stick's own and over the skin, the lesser, low-pass filtered; 0: over the skin alone.
    stroke_seconds: float = 0.0  # s, of the filter of both velocities; 0: the one over the skin, unfiltered
    sided: bool = False  # whether observations tell on which side it itches, and reach leads around the limb to it
    # Where an itch can be: between these fractions of the segment's half-length, and within this
    # angle of the side that faces away from the trunk.
    height: tuple[float, float] = (-0.8, 0.8)
    angle: float = 1.0  # rad, at most, of the itch from the side that faces away from the trunk
    spared: tuple[float, float] = (0.0, 0.0)  # rad, on the forearm: where it never itches, as nobody could scratch it
    by_area: bool = False  # whether a segment itches as often as it has skin, or both alike
    # What counts as scratching, and for how long it must last to be a success.
    scratch_distance: float = 0.1  # m, from the tool point to the itch
    scratch_force: tuple[float, float] = (1.0, 6.0)  # N, on that segment, least and most, while it counts as scratching
    scratch_speed: tuple[float, float] = (0.03, 0.3)  # m/s, least and most, while it counts as scratching
    success_seconds: float = 2.0  # s, in all


@pytree
class ScratchState:
    """What an episode has come to, beside the physics."""

    segment: jax.Array  # int32: index into SEGMENTS
    itch: jax.Array  # [3] m, the itch in the segment's body frame
    scratch_seconds: jax.Array
    strokes: jax.Array  # [2, 3] m/s, of the stick over the skin and in the room, low-pass filtered


class Scratch:
    """The task itself; see `tasks.base.Task` for what each method returns."""

    title: ClassVar[str] = "Scratch an itch on the person's right arm"
    config_type = ScratchConfig

    def __init__(self, config: ScratchConfig, model: mujoco.MjModel, dt: float):
        self.config, self.dt = config, dt
        capsules = [geometry.capsule(model, f"right_{segment}") for segment in SEGMENTS]
        self._centre = jnp.array([c.centre for c in capsules])
        self._axis = jnp.array([c.axis for c in capsules])
        self._length = jnp.array([c.half_length for c in capsules])
        self._radius = jnp.array([c.radius for c in capsules])
        skin = np.array([c.radius * c.half_length for c in capsules])
        skin[1] *= 1.0 - (config.spared[1] - config.spared[0]) / (2.0 * pi)
        self._on_forearm = float(skin[1] / skin.sum()) if config.by_area else 0.5
        # Angles are measured around the axis from the side that faces away from the trunk at rest.
        outward = [
            geometry.outward(model, f"right_{segment}", c) for segment, c in zip(SEGMENTS, capsules, strict=True)
        ]
        self._outward = jnp.array(outward)
        self._side = jnp.array(np.cross([c.axis for c in capsules], outward))

    def reset(self, key) -> ScratchState:
        """An itch on the skin of either segment, uniform in height and angle."""
        c = self.config
        u = jax.random.uniform(key, (3,))
        segment = (u[0] < self._on_forearm).astype(jnp.int32)
        height = (c.height[0] + (c.height[1] - c.height[0]) * u[1]) * self._length[segment]
        angle = c.angle * (2.0 * u[2] - 1.0)
        if (spared := c.spared[1] - c.spared[0]) > 0.0:
            angle = jnp.where(segment == 1, c.spared[1] + (2.0 * pi - spared) * u[2], angle)
        normal = jnp.cos(angle) * self._outward[segment] + jnp.sin(angle) * self._side[segment]
        itch = self._centre[segment] + height * self._axis[segment] + self._radius[segment] * normal
        return ScratchState(segment, itch, jnp.float32(0.0), jnp.zeros((2, 3)))

    def _to_itch(self, s: Sensors, state: ScratchState):
        """Vector [3] from the tool to the itch, in world axes."""
        on_upper = state.segment == 0
        pos = jnp.where(on_upper, s["upper_arm_pos"], s["forearm_pos"])
        quat = jnp.where(on_upper, s["upper_arm_quat"], s["forearm_quat"])
        return pos + geometry.rotate(quat, state.itch) - s["tool_pos"]

    def skin(self, s: Sensors, state: ScratchState):
        """In world axes the itch [3], and the unit vectors [3] out of the skin there and along the segment."""
        on_upper = state.segment == 0
        quat = jnp.where(on_upper, s["upper_arm_quat"], s["forearm_quat"])
        axis, arm = self._axis[state.segment], state.itch - self._centre[state.segment]
        normal = geometry.unit(arm - axis * (axis @ arm))
        return s["tool_pos"] + self._to_itch(s, state), geometry.rotate(quat, normal), geometry.rotate(quat, axis)

    def place(self, state: ScratchState):
        """Where on its segment the itch is: height in half-lengths from the middle, and angle in rad."""
        arm = state.itch - self._centre[state.segment]
        height = arm @ self._axis[state.segment] / self._length[state.segment]
        return height, jnp.arctan2(arm @ self._side[state.segment], arm @ self._outward[state.segment])

    def observe(self, s: Sensors, state: ScratchState):
        vector = self._to_itch(s, state)
        blocks = {
            "forearm_pos": s["forearm_pos"],
            "upper_arm_pos": s["upper_arm_pos"],
            "target_vector": vector,
            "target_distance": norm(vector)[None],
        }
        if self.config.sided:
            _, normal, axis = self.skin(s, state)
            blocks |= {"target_normal": normal, "target_axis": axis}
        return blocks

    def reward_terms(self, s: Sensors, state: ScratchState):
        c = self.config
        to_itch = self._to_itch(s, state)
        distance = norm(to_itch)
        reached = reach(distance)
        if c.sided:
            around = geometry.arc(to_itch, *self.skin(s, state)[1:], self._radius[state.segment])
            reached = reach(distance + around)
        speed, force = self.tool_speed(s, state), norm(self.on_segment(s, state, tool_force))
        moving, pressing = boltzmann(speed / c.speed), boltzmann(force / c.force)
        paid = self.helping(s, state) if c.pay_help_only else distance < c.near
        return {
            "reach": reached,
            "scratch": c.scratch_scale * paid * moving * pressing,
        }

    def advance(self, s: Sensors, state: ScratchState) -> ScratchState:
        c = self.config
        if c.stroke_seconds:
            now = jnp.stack([self.tool_velocity(s, state), s["tool_vel"]])
            state = replace(state, strokes=low_pass(state.strokes, now, self.dt, c.stroke_seconds))
        speed, force = self.tool_speed(s, state), norm(self.on_segment(s, state, tool_force))
        scratching = norm(self._to_itch(s, state)) < c.scratch_distance
        scratching &= (c.scratch_force[0] <= force) & (force <= c.scratch_force[1])
        scratching &= (c.scratch_speed[0] <= speed) & (speed <= c.scratch_speed[1])
        return replace(state, scratch_seconds=state.scratch_seconds + self.dt * scratching)

    def helping(self, s: Sensors, state: ScratchState):
        """On the itch, touching the segment that it is on."""
        near = norm(self._to_itch(s, state)) < self.config.scratch_distance
        return near & (norm(self.on_segment(s, state, tool_force)) > TOUCHING)

    def tool_velocity(self, s: Sensors, state: ScratchState):
        """Seen from the segment with the itch [3], in m/s."""
        return self.on_segment(s, state, tool_velocity)

    def tool_speed(self, s: Sensors, state: ScratchState):
        """In m/s, as far as it counts: see `ScratchConfig.stroke_seconds`."""
        return norm(state.strokes).min() if self.config.stroke_seconds else norm(self.tool_velocity(s, state))

    @staticmethod
    def on_segment(s: Sensors, state: ScratchState, of):
        """`of(s, part)` for the segment that the itch is on."""
        upper, fore = (of(s, segment) for segment in SEGMENTS)
        return upper if upper is fore else jnp.where(state.segment == 0, upper, fore)

    def outcomes(self, state: ScratchState):
        return {"scratch_seconds": state.scratch_seconds}

    def success(self, state: ScratchState):
        return state.scratch_seconds >= self.config.success_seconds

    def terminated(self, state: ScratchState):
        return jnp.bool_(False)

    def markers(self, s: Sensors, state: ScratchState):
        return s["tool_pos"] + self._to_itch(s, state)


_SCENE = SceneConfig("wheelchair", "seated", "scratcher", (0.75, 0.0, 0.0), pi, RIGHT_ARM)

_PAPER = TaskSpec(
    "scratch",
    0,
    Scratch,
    _SCENE,
    expert="assistax.policies.experts.scratch:ScratchExpert",
    bound=1000,
    preference_budget=1.0,
    tremor_weakens=True,
)
_HELPING = TaskSpec(
    "scratch",
    1,
    Scratch,
    limited(_SCENE, *SEGMENTS),
    ScratchConfig(
        height=(-1.0, 1.0),
        angle=pi,
        by_area=True,
        scratch_scale=16.0,
        pay_help_only=True,
        sided=True,
        scratch_distance=0.04,
    ),
    expert="assistax.policies.experts.scratch:ScratchExpert",
    bound=3165,
    preference_budget=3.165,
    preferences_need_help=True,
)
# While the arm rests, nearly all of its skin is within 4 cm of what the stick can touch. And without a clock a robot
# that sees where the stick is, but not which way it goes, can only rest where friction holds it.
_NEARER = replace(
    _HELPING,
    version=2,
    config=replace(_HELPING.config, scratch_distance=0.02, spared=(pi / 2, 2 * pi / 3)),
    clock=1.5,
)

# A stick that trembles by less than 3 mm to either side, or rests while the arm moves, scratches nothing.
_BY_STROKES = replace(
    _NEARER,
    version=3,
    scene=replace(_NEARER.scene, throat=True),
    config=replace(_NEARER.config, stroke_seconds=0.1),
    expert="assistax.policies.experts.scratch:ScratchByStrokesExpert",
)

SPECS = (_PAPER, _HELPING, _NEARER, _BY_STROKES)
