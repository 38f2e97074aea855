"""Wipe the right arm of a person in bed: press the pad on every part of its exposed skin.

Paper: task "Bed Bath"; reward components r_t and r_w.
"""

from dataclasses import dataclass
from math import pi
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax.pytree import pytree
from assistax.scenes import BED_VIEW, RIGHT_ARM, SceneConfig, geometry, limited
from assistax.tasks.base import Sensors, tool_force, tool_velocity
from assistax.tasks.registry import TaskSpec
from assistax.tasks.rewards import norm, reach

SEGMENTS = ("upper_arm", "forearm")
ROWS = (9, 8, 9)  # points along the limb, in three rows that are half a step apart: 26 per segment


@dataclass(frozen=True)
class BedBathConfig:
    near: float = 0.05  # m, a point is being washed while the pad's centre is nearer than this ...
    touch_force: float = 1e-3  # N, ... the pad presses with more than this; 0 up to rounding
    most_force: float = 1e6  # N, ... and with no more than this,
    speed: tuple[float, float] = (0.0, 1e3)  # m/s, ... at a speed within these,
    wash_seconds: float = 0.0  # s, and is done, once for all, after so long in all; 0: at once, merely visited
    wipe_scale: float = 3.0  # per newly visited point
    # Where the points are: fractions of the segment's length from its start, and up to this angle
    # to either side of up; the rest faces the trunk or the mattress.
    height: tuple[float, float] = (0.1, 0.9)
    angle: float = 0.8  # rad
    success_fraction: float = 0.9  # of the points


@pytree
class BedBathState:
    visited: jax.Array  # [52] bool, or washed
    seconds: jax.Array  # [52] of washing
    newly: jax.Array  # int32: points first visited in this control step


class BedBath:
    title: ClassVar[str] = "Wipe the right arm of a person in bed"
    config_type = BedBathConfig

    def __init__(self, config: BedBathConfig, model: mujoco.MjModel, dt: float):
        self.config, self.dt = config, dt
        # [2, 26, 3] m, in the body frames of the segments
        self.points = jnp.array([self._on_skin(model, f"right_{segment}") for segment in SEGMENTS])

    def _on_skin(self, model, body) -> np.ndarray:
        """Points [26, 3] on the limb's skin: three rows, evenly spaced."""
        low, high = self.config.height
        limb = geometry.capsule(model, body)
        up = geometry.upward(model, body, limb)
        side = np.cross(limb.axis, up)
        points = []
        for turn, count in zip((-1.0, 0.0, 1.0), ROWS, strict=True):
            angle = turn * self.config.angle
            inset = (max(ROWS) - count) / 2  # of the rows' common step
            fractions = low + (high - low) * (inset + np.arange(count)) / (max(ROWS) - 1)
            normal = np.cos(angle) * up + np.sin(angle) * side
            along = (2.0 * fractions - 1.0) * limb.half_length
            points.append(limb.centre + along[:, None] * limb.axis + limb.radius * normal)
        return np.concatenate(points)

    def reset(self, key) -> BedBathState:
        """Nothing is drawn: the whole arm is to be wiped."""
        count = len(SEGMENTS) * sum(ROWS)
        return BedBathState(jnp.zeros(count, bool), jnp.zeros(count), jnp.int32(0))

    def to_points(self, s: Sensors) -> jax.Array:
        """Vectors [52, 3] from the tool to all points, in world axes."""
        world = [
            s[f"{segment}_pos"] + geometry.rotate(s[f"{segment}_quat"], points)
            for segment, points in zip(SEGMENTS, self.points, strict=True)
        ]
        return jnp.concatenate(world) - s["tool_pos"]

    def _to_target(self, s: Sensors, state: BedBathState):
        """Vector [3] from the tool to the nearest point not yet visited; to the nearest of all at the end."""
        vectors = self.to_points(s)
        skip = state.visited & ~state.visited.all()
        return vectors[jnp.argmin(jnp.where(skip, jnp.inf, norm(vectors)))]

    def observe(self, s: Sensors, state: BedBathState):
        vector = self._to_target(s, state)
        return {
            "forearm_pos": s["forearm_pos"],
            "upper_arm_pos": s["upper_arm_pos"],
            "target_vector": vector,
            "target_distance": norm(vector)[None],
        }

    def reward_terms(self, s: Sensors, state: BedBathState):
        return {
            "reach": reach(norm(self._to_target(s, state))),
            "wipe": self.config.wipe_scale * state.newly,
        }

    def advance(self, s: Sensors, state: BedBathState) -> BedBathState:
        c = self.config
        force, speed = (norm(jnp.stack([of(s, part) for part in SEGMENTS])) for of in (tool_force, tool_velocity))
        rubbing = (force > c.touch_force) & (force <= c.most_force) & (c.speed[0] <= speed) & (speed <= c.speed[1])
        washing = jnp.repeat(rubbing, sum(ROWS)) & (norm(self.to_points(s)) < c.near)
        seconds = state.seconds + self.dt * washing
        done = washing & (seconds > c.wash_seconds - self.dt / 2)
        return BedBathState(state.visited | done, seconds, (done & ~state.visited).sum())

    def helping(self, s: Sensors, state: BedBathState):
        """On a point not yet washed, touching the segment that it is on."""
        force = norm(jnp.stack([tool_force(s, part) for part in SEGMENTS]))
        touching = jnp.repeat(force > self.config.touch_force, sum(ROWS))
        return (touching & ~state.visited & (norm(self.to_points(s)) < self.config.near)).any()

    def tool_speed(self, s: Sensors, state: BedBathState):
        """Seen from the segment with the nearest point."""
        upper, fore = (tool_velocity(s, part) for part in SEGMENTS)
        if upper is fore:
            return norm(upper)
        return norm(jnp.where(jnp.argmin(norm(self.to_points(s))) < sum(ROWS), upper, fore))

    def outcomes(self, state: BedBathState):
        return {"fraction_visited": state.visited.mean()}

    def success(self, state: BedBathState):
        return state.visited.mean() >= self.config.success_fraction

    def terminated(self, state: BedBathState):
        return state.visited.all()

    def markers(self, s: Sensors, state: BedBathState):
        return s["tool_pos"] + self._to_target(s, state)


_SCENE = SceneConfig("bed", "lying", "wiper", (-0.25, -0.9, 0.32), pi / 2, RIGHT_ARM, **BED_VIEW)

SPECS = (
    TaskSpec(
        "bed_bath",
        0,
        BedBath,
        _SCENE,
        expert="assistax.policies.experts.bed_bath:BedBathExpert",
        bound=1156,
        preference_budget=1.156,
    ),
    TaskSpec(
        "bed_bath",
        1,
        BedBath,
        limited(_SCENE, *SEGMENTS),
        BedBathConfig(touch_force=0.5, most_force=15.0, speed=(0.02, 0.4), wash_seconds=0.08),
        expert="assistax.policies.experts.bed_bath:BedBathExpert",
        bound=1156,
        preference_budget=1.156,
        preferences_need_help=True,
        rest_pays="reach",
    ),
)
