"""Wipe the right arm of a person in bed: press the pad on every part of its exposed skin.

Paper: task "Bed Bath"; reward components r_t and r_w.
"""

from dataclasses import dataclass, replace
from math import pi
from typing import ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax.errors import UsageError
from assistax.filters import low_pass
from assistax.pytree import pytree
from assistax.scenes import BED_VIEW, RIGHT_ARM, SceneConfig, geometry, limited
from assistax.scenes.geometry import norm
from assistax.tasks.base import DONE, NOTHING_TO_DO, TO_DO, Sensors, tool_force, tool_velocity
from assistax.tasks.registry import TaskSpec
from assistax.tasks.rewards import exposed, facing, reach

SEGMENTS = ("upper_arm", "forearm")
ROWS = (9, 8, 9)  # points along the limb, in three rows that are half a step apart: 26 per segment
AROUND = (29, 23)  # points all around the segments, as many as they have skin
GOLDEN = pi * (3.0 - 5.0**0.5)  # rad, from one point to the next around a limb: even at any length and girth


@dataclass(frozen=True)
class BedBathConfig:
    """The numbers in which versions differ; the defaults are version 0's."""

    near: float = 0.05  # m, a point is being washed while the pad's centre is nearer than this ...
    touch_force: float = 1e-3  # N, ... the pad presses with more than this; 0 up to rounding
    most_force: float = 1e6  # N, ... and with no more than this,
    speed: tuple[float, float] = (0.0, 1e3)  # m/s, ... at a speed within these,
    wash_seconds: float = 0.0  # s, and is done, once for all, after so long in all; 0: at once, merely visited
    # What counts as speed: the pad's own and over the skin, the lesser, low-pass filtered; 0: over the skin alone.
    stroke_seconds: float = 0.0  # s, of the filter of both velocities; 0: the one over the skin, unfiltered
    wipe_scale: float = 3.0  # per newly visited point; more if fewer than 52 are dirty, the same in all
    sided: bool = False  # whether observations tell on which side how much dirt is, and the way leads around the limb
    # Where it does, a point is as bad to wash next as one that is so much farther away if its skin looks away
    # from the robot, or if the pad has to turn over for it.
    hidden: float = 0.6  # m, by which a point counts as farther away if its skin looks away from the robot
    turned: float = 0.2  # m, by which a point counts as farther away if the pad has to turn over for it
    reach_each: bool = False  # whether every dirty point pays a share of reach, for good once it is washed
    around: bool = False  # whether points are all around the arm, or where height and angle say
    dirty: float = pi  # rad, to either side of where a reset draws: what is to be washed; the rest is clean
    height: tuple[float, float] = (0.1, 0.9)  # if not around: fractions of the segment's length, from its start
    angle: float = 0.8  # rad, if not around: to either side of up
    success_fraction: float = 0.9  # of the points


@pytree
class BedBathState:
    """What an episode has come to, beside the physics."""

    dirty: jax.Array  # [52] bool, what was to be washed at the start
    visited: jax.Array  # [52] bool, or washed, or clean from the start
    seconds: jax.Array  # [52] of washing
    newly: jax.Array  # int32: points first visited in this control step
    strokes: jax.Array  # [3, 3] m/s, of the pad over the skin of either segment and in the room, low-pass filtered


class BedBath:
    """The task itself; see `tasks.base.Task` for what each method returns."""

    title: ClassVar[str] = "Wipe the right arm of a person in bed"
    config_type = BedBathConfig

    def __init__(self, config: BedBathConfig, model: mujoco.MjModel, dt: float):
        self.config, self.dt = config, dt
        self._robot = jnp.array(model.body("robot").pos)
        bodies = [f"right_{segment}" for segment in SEGMENTS]
        limbs = [(geometry.capsule(model, body), body) for body in bodies]
        ups = [geometry.upward(model, body, limb) for limb, body in limbs]
        skins = [(limb, up, np.cross(limb.axis, up)) for (limb, _), up in zip(limbs, ups, strict=True)]
        if config.around:
            places = [self._spiral(*skin, count) for skin, count in zip(skins, AROUND, strict=True)]
        else:
            places = [self._rows(*skin) for skin in skins]
        # In the body frames of the segments: where points are [n, 3] in m, and what points out of the skin there.
        self.points, self.normals = ([jnp.array(xs) for xs in both] for both in zip(*places, strict=True))
        angles = [
            jnp.arctan2(ns @ jnp.asarray(side), ns @ jnp.asarray(up))
            for ns, (_, up, side) in zip(self.normals, skins, strict=True)
        ]
        self._angle = jnp.concatenate(angles)  # [52] rad, around the limb from its upper side
        around = np.sort(np.asarray(self._angle))
        least = float(np.diff(around, append=around[0] + 2.0 * pi).max()) / 2.0
        if config.dirty < least:
            raise UsageError(f"task_config.dirty must be {least:.3f} rad or more: some arms would have no dirt at all.")
        self._around = jnp.stack([jnp.cos(self._angle), jnp.sin(self._angle)], 1)
        self.spots = dict(zip(bodies, self.points, strict=True))
        self._axis = jnp.array([limb.axis for limb, _ in limbs])
        self._middle = jnp.array([limb.centre for limb, _ in limbs])
        self._up_side = jnp.array([(up, side) for _, up, side in skins])
        self._radius = jnp.array([limb.radius for limb, _ in limbs])
        self.segment = np.repeat(np.arange(len(SEGMENTS)), [len(xs) for xs in self.points])  # [52], of each point

    def _rows(self, limb, up, side) -> tuple[np.ndarray, np.ndarray]:
        """Points [26, 3] on the limb's upper side and their normals: three rows, evenly spaced."""
        low, high = self.config.height
        points, normals = [], []
        for turn, count in zip((-1.0, 0.0, 1.0), ROWS, strict=True):
            angle = turn * self.config.angle
            inset = (max(ROWS) - count) / 2  # of the rows' common step
            fractions = low + (high - low) * (inset + np.arange(count)) / (max(ROWS) - 1)
            normal = np.cos(angle) * up + np.sin(angle) * side
            along = (2.0 * fractions - 1.0) * limb.half_length
            points.append(limb.centre + along[:, None] * limb.axis + limb.radius * normal)
            normals.append(np.broadcast_to(normal, (count, 3)))
        return np.concatenate(points), np.concatenate(normals)

    @staticmethod
    def _spiral(limb, up, side, count) -> tuple[np.ndarray, np.ndarray]:
        """Points [count, 3] evenly over all of the limb's skin, and their normals."""
        i = np.arange(count)[:, None]
        normals = np.cos(GOLDEN * i) * up + np.sin(GOLDEN * i) * side
        along = ((2.0 * i + 1.0) / count - 1.0) * limb.half_length
        return limb.centre + along * limb.axis + limb.radius * normals, normals

    def reset(self, key) -> BedBathState:
        """The side of the arm that is dirty, uniform around it; without one, the whole arm is."""
        count = len(self.segment)
        dirty = jnp.ones(count, bool)
        if self.config.dirty < pi:
            middle = jax.random.uniform(key, (), minval=-pi, maxval=pi)
            dirty = jnp.cos(self._angle - middle) >= jnp.cos(self.config.dirty)
        return BedBathState(dirty, ~dirty, jnp.zeros(count), jnp.int32(0), jnp.zeros((3, 3)))

    def to_points(self, s: Sensors) -> jax.Array:
        """Vectors [52, 3] from the tool to all points, in world axes."""
        world = [
            s[f"{segment}_pos"] + geometry.rotate(s[f"{segment}_quat"], points)
            for segment, points in zip(SEGMENTS, self.points, strict=True)
        ]
        return jnp.concatenate(world) - s["tool_pos"]

    def out_of_skin(self, s: Sensors) -> jax.Array:
        """Unit vectors [52, 3] that point out of the skin at the points, in world axes."""
        pairs = zip(SEGMENTS, self.normals, strict=True)
        return jnp.concatenate([normals @ geometry.matrix(s[f"{segment}_quat"]).T for segment, normals in pairs])

    def places(self, s: Sensors):
        """Of all points vectors [52, 3] from the tool, unit vectors [52, 3] out of the skin, and ways [52] in m."""
        vectors, normals = self.to_points(s), self.out_of_skin(s)
        ways = norm(vectors)
        if self.config.sided:
            ways += self._arcs(s)
        return vectors, normals, ways

    def _arcs(self, s: Sensors) -> jax.Array:
        """Lengths [52] in m of the ways around the limbs, from the side that the tool is on to each point.

        As geometry.arc has them, but with one angle of the tool for each limb, not for each point: that is not free.
        """
        quats = jnp.stack([s[f"{segment}_quat"] for segment in SEGMENTS])
        places = jnp.stack([s[f"{segment}_pos"] for segment in SEGMENTS])
        off = s["tool_pos"] - places - geometry.rotate(quats, self._middle)
        up, side = (off[:, None] * geometry.rotate(quats[:, None], self._up_side)).sum(-1).T
        apart = jnp.abs(jnp.arctan2(side, up)[self.segment] - self._angle)
        return self._radius[self.segment] * jnp.minimum(apart, 2.0 * pi - apart)

    def suits(self, s: Sensors, vectors: jax.Array, normals: jax.Array):
        """From 0 to 1 how far the skin at all points faces the robot [52], and how flat the pad lies to it [52]."""
        shown = exposed(normals, s["tool_pos"] + vectors, self._robot)
        return shown, facing(-normals, geometry.matrix(s["tool_quat"])[:, 2])

    def target(self, s: Sensors, state: BedBathState) -> jax.Array:
        """The point not yet visited that is nearest, or, if skin has sides, best to reach; of all points at the end."""
        vectors, normals, ways = self.places(s)
        if self.config.sided:
            shown, flat = self.suits(s, vectors, normals)
            ways += self.config.hidden * (1.0 - shown) + self.config.turned * (1.0 - flat)
        skip = state.visited & ~state.visited.all()
        return jnp.argmin(jnp.where(skip, jnp.inf, ways))

    def axes(self, s: Sensors):
        """Unit vectors [2, 3] along the segments, in world axes."""
        return geometry.rotate(jnp.stack([s[f"{segment}_quat"] for segment in SEGMENTS]), self._axis)

    def _dirt(self, s: Sensors, state: BedBathState):
        """What is left, by segment: the mean vector [2, 3] to it from the tool, its mean outward normal [2, 3], both 0
        where nothing is, and which share [2] of all that was dirty it is."""
        left = (jnp.arange(len(SEGMENTS))[:, None] == self.segment) & ~state.visited
        count = left.sum(1)
        vectors, normals = (left @ x / jnp.maximum(count, 1)[:, None] for x in (self.to_points(s), self.out_of_skin(s)))
        return vectors, normals, count / state.dirty.sum()

    def side(self, state: BedBathState):
        """The mean of unit vectors [2] to what was dirty, around a limb from its upper side."""
        return state.dirty @ self._around / state.dirty.sum()

    def observe(self, s: Sensors, state: BedBathState):
        vectors, normals, _ = self.places(s)
        target = self.target(s, state)
        vector = vectors[target]
        blocks = {
            "forearm_pos": s["forearm_pos"],
            "upper_arm_pos": s["upper_arm_pos"],
            "target_vector": vector,
            "target_distance": norm(vector)[None],
        }
        if self.config.sided:
            to_dirt, out_of_dirt, share = self._dirt(s, state)
            blocks |= {
                "target_normal": normals[target],
                "arm_axes": self.axes(s).ravel(),
                "dirt_vectors": to_dirt.ravel(),
                "dirt_normals": out_of_dirt.ravel(),
                "dirt_left": share,
                "dirty_side": self.side(state),
            }
        return blocks

    def reward_terms(self, s: Sensors, state: BedBathState):
        reached = (
            self._reach_each(s, state) if self.config.reach_each else reach(self.places(s)[2][self.target(s, state)])
        )
        return {
            "reach": reached,
            "wipe": self.config.wipe_scale * state.newly * (len(self.segment) / state.dirty.sum()),
        }

    def _reach_each(self, s: Sensors, state: BedBathState):
        """The mean over the dirty points: 1 of those that are washed, so that washing one never costs anything later.

        Of the others as much as the pad is near and flat to the skin there, and as that skin faces the robot.
        """
        vectors, normals, ways = self.places(s)
        shown, flat = self.suits(s, vectors, normals)
        paid = jnp.where(state.visited, 1.0, reach(ways) * (1.0 + shown + flat) / 3.0)
        return paid @ state.dirty / state.dirty.sum()

    def advance(self, s: Sensors, state: BedBathState) -> BedBathState:
        c = self.config
        if c.stroke_seconds:
            now = jnp.stack([tool_velocity(s, part) for part in SEGMENTS] + [s["tool_vel"]])
            state = replace(state, strokes=low_pass(state.strokes, now, self.dt, c.stroke_seconds))
        washing = self._washing(s, state)
        seconds = state.seconds + self.dt * washing
        done = washing & (seconds > c.wash_seconds - self.dt / 2)
        return replace(state, visited=state.visited | done, seconds=seconds, newly=(done & ~state.visited).sum())

    def _washing(self, s: Sensors, state: BedBathState) -> jax.Array:
        """[52] at which points the pad presses and moves as it should."""
        c = self.config
        force = norm(jnp.stack([tool_force(s, part) for part in SEGMENTS]))
        speed = self._speeds(s, state)
        rubbing = (force > c.touch_force) & (force <= c.most_force) & (c.speed[0] <= speed) & (speed <= c.speed[1])
        return rubbing[self.segment] & (norm(self.to_points(s)) < c.near)

    def helping(self, s: Sensors, state: BedBathState):
        """Washing a point that was dirty until this step: so for wash_seconds at each, and never by staying on one."""
        unwashed = state.dirty & (state.seconds < self.config.wash_seconds + self.dt / 2)
        return (self._washing(s, state) & unwashed).any()

    def tool_speed(self, s: Sensors, state: BedBathState):
        """Seen from the segment with the nearest point."""
        upper, fore = self._speeds(s, state)
        return jnp.where(jnp.argmin(norm(self.to_points(s))) < len(self.points[0]), upper, fore)

    def _speeds(self, s: Sensors, state: BedBathState) -> jax.Array:
        """[2] in m/s by segment, as far as they count: see `BedBathConfig.stroke_seconds`."""
        if self.config.stroke_seconds:
            speeds = norm(state.strokes)
            return jnp.minimum(speeds[:2], speeds[2])
        return norm(jnp.stack([tool_velocity(s, part) for part in SEGMENTS]))

    def outcomes(self, state: BedBathState):
        return {"fraction_visited": (state.visited & state.dirty).sum() / state.dirty.sum()}

    def success(self, state: BedBathState):
        return self.outcomes(state)["fraction_visited"] >= self.config.success_fraction

    def terminated(self, state: BedBathState):
        return state.visited.all()

    def spot_states(self, state: BedBathState):
        return jnp.where(state.dirty, jnp.where(state.visited, DONE, TO_DO), NOTHING_TO_DO).astype(jnp.int8)

    def markers(self, s: Sensors, state: BedBathState):
        return s["tool_pos"] + self.to_points(s)[self.target(s, state)]


_SCENE = SceneConfig("bed", "lying", "wiper", (-0.25, -0.9, 0.32), pi / 2, RIGHT_ARM, **BED_VIEW)

_PAPER = TaskSpec(
    "bed_bath",
    0,
    BedBath,
    _SCENE,
    expert="assistax.policies.experts.bed_bath:BedBathExpert",
    bound=1156,
    preference_budget=1.156,
    tremor_weakens=True,
)
_HELPING = TaskSpec(
    "bed_bath",
    1,
    BedBath,
    limited(_SCENE, *SEGMENTS),
    BedBathConfig(
        around=True,
        sided=True,
        reach_each=True,
        dirty=pi / 3,
        touch_force=0.5,
        most_force=15.0,
        speed=(0.02, 0.4),
        wash_seconds=0.08,
        wipe_scale=12.0,
        success_fraction=0.75,
    ),
    expert="assistax.policies.experts.bed_bath:BathAroundExpert",
    bound=1624,
    preference_budget=1.624,
    preferences_need_help=True,
    rest_pays="reach",
)
_TO_A_CLOCK = replace(_HELPING, version=2, clock=1.5)
# A pad that trembles by less than 5 mm to either side, or is only laid on the skin here and there, washes nothing.
_BY_STROKES = replace(
    _TO_A_CLOCK,
    version=3,
    scene=replace(_TO_A_CLOCK.scene, throat=True),
    config=replace(_TO_A_CLOCK.config, stroke_seconds=0.1, speed=(0.05, 0.4), wash_seconds=0.2),
    expert="assistax.policies.experts.bed_bath:BathByStrokesExpert",
)

SPECS = (_PAPER, _HELPING, _TO_A_CLOCK, _BY_STROKES)
