"""Wash the arm from the shoulder to the wrist."""

import jax
import jax.numpy as jnp

from assistax.policies.experts.controller import Expert, Goal, press_for, to_and_fro, turn_to, way_of_stroke
from assistax.scenes import geometry
from assistax.scenes.geometry import norm
from assistax.tasks.base import tool_force, tool_velocity
from assistax.tasks.rewards import LEVEL, UP
from assistax.tasks.scratch import SEGMENTS


class BedBathExpert(Expert):
    """Pad flat on the ridge of the arm, 5 N, from the shoulder to the wrist at an even speed."""

    stroke_speed = 0.08
    force = 5.0

    def initial_carry(self):
        return {"progress": jnp.float32(0.0)}

    def goal(self, carry, s, task, pos, rot, manner):
        progress = carry["progress"]
        points, ups = [], []
        for segment, local in zip(SEGMENTS, self.env.task.points, strict=True):
            frame, origin = geometry.matrix(s[f"{segment}_quat"]), s[f"{segment}_pos"]
            ridge = origin + local[16:8:-1] @ frame.T  # the middle row, toward the hand
            limb = geometry.unit(ridge[-1] - ridge[0])
            points.append(ridge)
            ups.append(jnp.broadcast_to(geometry.unit(jnp.asarray(UP - limb * (limb @ UP))), ridge.shape))
        points, ups = jnp.concatenate(points), jnp.concatenate(ups)
        place = progress * (len(points) - 1)
        knots = jnp.arange(len(points))
        on_skin, up = (jnp.stack([jnp.interp(place, knots, x[:, i]) for i in range(3)]) for x in (points, ups))
        up = geometry.unit(up)
        off = pos - on_skin
        above = norm(off - up * (off @ up)) < 0.03
        touching = above & (off @ up < 0.05)
        length = norm(points[1:] - points[:-1]).sum()
        progress += jnp.where(touching, manner.stroke_speed * self.env.dt / length, 0.0)
        return Goal(
            jnp.where(above, on_skin, on_skin + 0.06 * up),
            turn_to(rot, -up),
            press=jnp.where(above, -manner.force, 0.0) * up,
            free=jnp.where(above, 1.0, 0.0) * up,
        ), {"progress": jnp.minimum(progress, 1.0)}


class BathAroundExpert(Expert):
    """Pad flat on the skin, in strokes from each dirty point to the one that is best to reach from there.

    So that a learner can imitate it, it remembers nothing, goes to the point that is observed and strokes to the
    robot's clock, if it has one. While the person moves, it keeps off the skin.
    """

    round = True
    stroke = 0.03  # m, to either side of a point that is still dirty
    stroke_speed = 0.15
    force = 3.0
    drag = 2.0  # N, to overcome friction; three times as much while the pad sticks
    turning = 0.03  # m/s: slower than this, a stroke goes to the middle
    land, slide, travel = 0.12, 0.15, 0.4  # m/s, at most, onto the skin, on it and off it
    turn_speed = 3.0  # rad/s
    away = 0.1  # m, from the skin, until the pad lies right
    still = 1.5  # rad/s: while a joint of the person is faster, the robot draws back; a tremor or exploring is slower
    lean = 1.4  # how far the pad leans toward where the robot comes from

    def __init__(self, env, considerate: bool = False):
        super().__init__(env, considerate)
        limbs = [geometry.capsule(env.model, f"right_{segment}") for segment in SEGMENTS]
        self._radius = jnp.array([limb.radius for limb in limbs])

    def _about(self, way):
        """From 0 to 1, whether a way in m is more than 0, over some 5 mm: what jumps cannot be imitated."""
        return jax.nn.sigmoid(way / 0.00125)

    def goal(self, carry, s, task, pos, rot, manner):
        t = self.env.task
        vectors, normals, _ = t.places(s)
        best = t.target(s, task)
        part = jnp.asarray(t.segment)[best]
        axis, point = t.axes(s)[part], pos + vectors[best]
        # The pad washes 5 cm around its middle: it lies on the middle of what is dirty, or nearer to the robot.
        toward = geometry.unit(geometry.unit((self._base - point) * LEVEL) + UP)
        out = geometry.unit(((t.segment == part) & ~task.visited) @ normals) + self.lean * toward
        out = geometry.unit(out - axis * (out @ axis))
        spot = point + self._radius[part] * (out - normals[best])
        off = pos - spot
        height, along = off @ out, off @ axis
        beside = norm(off - height * out - along * axis)
        wide = beside + jnp.maximum(jnp.abs(along) - 2.0 * self.stroke, 0.0)
        askew = 1.0 + rot[:, 2] @ out
        least = jnp.clip(2.0 * (wide - 0.04) + 0.3 * (askew - 0.2), 0.0, self.away)
        moving = jnp.abs(s["dtheta_human"]).max() > self.still
        on_skin = self._about(0.03 - height) * self._about(0.02 - least) * ~moving
        back = (norm(vectors).min() < 0.35) * (geometry.unit((self._base - pos) * LEVEL) + 0.5 * UP)
        if "clock" in s:
            swing, drift = to_and_fro(s["clock"], manner.stroke_speed, self.env.clock)
            drag = 2.0 * self.drag * s["clock"][1]
            force = press_for(manner.force, jnp.stack([tool_force(s, segment) for segment in SEGMENTS])[part])
        else:
            speed = jnp.stack([tool_velocity(s, segment) for segment in SEGMENTS])[part] @ axis
            way = way_of_stroke(along, speed, self.stroke, self.turning)
            swing = jnp.clip(along, -self.stroke, self.stroke)
            drift = self._about(self.stroke - jnp.abs(along)) * manner.stroke_speed * way
            drag = self.drag * way * jnp.where(jnp.abs(speed) < self.turning, 3.0, 1.0)
            force = manner.force
        place = spot + swing * axis + least * out
        coming = jnp.clip(3.0 * norm(off), self.land, self.travel)
        return Goal(
            jnp.where(moving, pos + 0.15 * back, place),
            turn_to(rot, -out),
            speed=jnp.where(moving, 0.8, coming + on_skin * (self.slide - coming)),
            drift=on_skin * drift * axis,
            press=on_skin * (drag * axis - force * out),
            free=on_skin * out,
        ), carry


class BathByStrokesExpert(BathAroundExpert):
    """The same, firmer and sooner from place to place: each wants strokes of its own."""

    stroke_speed = 0.12
    force = 5.0
    land, slide, travel = 0.2, 0.25, 0.6
