"""Wash the arm from the shoulder to the wrist."""

import jax.numpy as jnp
import numpy as np

from assistax.policies.experts.controller import Expert, Goal, turn_to
from assistax.scenes import geometry
from assistax.scenes.geometry import norm
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
    """Pad flat on the skin, in strokes along both segments, each on the side where most is left to wash.

    While the person moves, it draws back and waits.
    """

    stroke_speed = 0.12
    force = 5.0
    still = 0.4  # rad/s: while a joint of the person is faster, the robot waits
    turn_speed = 3.0  # rad/s
    patience = 1.0  # s without getting further, after which another side is tried
    elevations = (-0.8, -0.3, 0.2, 0.7, 1.2)  # rad, and
    azimuths = (-0.8, 0.0, 0.8)  # rad from where the robot stands: the sides of the arm to choose from
    seen = (0.4, 0.1)  # cosine, at least, between the side of a segment and the points that a stroke washes there

    def __init__(self, env, considerate: bool = False):
        super().__init__(env, considerate)
        limbs = [geometry.capsule(env.model, f"right_{segment}") for segment in SEGMENTS]
        self._centre = jnp.array([limb.centre for limb in limbs])
        self._axis = jnp.array([limb.axis * np.sign(limb.axis @ limb.centre) for limb in limbs])  # toward the hand
        self._length, self._radius = (jnp.array([limb[i] for limb in limbs]) for i in (2, 3))
        azimuth, elevation = (x.ravel() for x in jnp.meshgrid(jnp.array(self.azimuths), jnp.array(self.elevations)))
        self._sides = azimuth, elevation

    def initial_carry(self):
        return {
            "place": jnp.float32(2.0),  # along both segments: 0 at the shoulder, 1 at the elbow, 2 at the wrist
            "way": jnp.float32(0.0),  # 1 toward the wrist, -1 back; 0: a new stroke begins
            "side": jnp.int32(0),
            "waited": jnp.float32(0.0),  # s, without getting further
            "tried": jnp.zeros(len(self.elevations) * len(self.azimuths), bool),
        }

    def _outs(self, middle, axis):
        """Unit vectors [sides, 2, 3] out of both segments, square to them, for each side to choose from."""
        azimuth, elevation = (angle[:, None] for angle in self._sides)
        toward = geometry.unit((self._base - middle.mean(0)) * LEVEL)
        level = jnp.cos(azimuth) * toward + jnp.sin(azimuth) * jnp.cross(UP, toward)
        side = jnp.cos(elevation) * level + jnp.sin(elevation) * UP
        along = jnp.einsum("ki,si->ks", side, axis)
        return geometry.unit(side[:, None] - along[..., None] * axis)

    def goal(self, carry, s, task, pos, rot, manner):
        frames = geometry.matrix(jnp.stack([s[f"{segment}_quat"] for segment in SEGMENTS]))
        origins = jnp.stack([s[f"{segment}_pos"] for segment in SEGMENTS])
        middle = origins + jnp.einsum("sij,sj->si", frames, self._centre)
        axes = jnp.einsum("sij,sj->si", frames, self._axis)
        outs = self._outs(middle, axes)
        moving = jnp.abs(s["dtheta_human"]).max() > jnp.where(carry["way"] == 0, self.still, 2.0 * self.still)
        # The side on which a stroke washes most.
        on = jnp.arange(2)[:, None] == self.env.task.segment
        facing = jnp.einsum("ksi,ni->ksn", outs, self.env.task.out_of_skin(s)) > jnp.array(self.seen)[:, None]
        left = (facing & (on & ~task.visited)).sum((1, 2))
        worth = left - 2.0 * jnp.abs(self._sides[0])
        place, way = carry["place"], carry["way"]
        stuck = carry["waited"] > self.patience
        over = (way > 0) & (place >= 2.0) | (way < 0) & (place <= 0.0) | stuck
        tried = carry["tried"] | ((jnp.arange(len(worth)) == carry["side"]) & over)
        tried &= ~moving & ~tried.all()
        begin = (way == 0) | over
        side = jnp.where(begin, jnp.where(tried, -jnp.inf, worth).argmax(), carry["side"])
        way = jnp.where(begin, jnp.where(place >= 1.0, -1.0, 1.0), way)
        place = jnp.where(over, jnp.where(place >= 1.0, 2.0, 0.0), place)
        part = jnp.where((place < 1.0) | (place == 1.0) & (way < 0), 0, 1)
        out, axis = outs[side, part], axes[part]
        spot = middle[part] + (2.0 * (place - part) - 1.0) * self._length[part] * axis + self._radius[part] * out
        off = pos - spot
        lift = off @ out
        beside = norm(off - lift * out)
        above = (beside < 0.04) & ~moving & (-rot[:, 2] @ out > 0.8)
        touching = above & (lift < 0.03)
        # Past what is clean it hurries.
        near = (norm(self.env.task.to_points(s) + pos - spot) < 0.08) & facing[side].any(0) & ~task.visited
        hurry = jnp.where(near.any(), 1.0, 3.0)
        place += jnp.where(
            above & ((lift < 0.03) | ~near.any()),
            hurry * way * manner.stroke_speed * self.env.dt / (2.0 * self._length[part]),
            0.0,
        )
        close = norm(self.env.task.to_points(s)).min() < 0.2  # m, from the arm
        away = close * (geometry.unit((self._base - pos) * LEVEL) + 0.5 * UP)
        goal = Goal(
            jnp.where(above, spot, jnp.where(moving, pos + 0.1 * away, spot + 0.06 * out)),
            turn_to(rot, -out),
            speed=jnp.where(above, jnp.clip(3.0 * jnp.abs(lift), 0.08, 0.4), 0.5),
            drift=jnp.where(touching, way * manner.stroke_speed, 0.0) * axis,
            press=jnp.where(above, -manner.force, 0.0) * out,
            free=jnp.where(above, 1.0, 0.0) * out,
        )
        further = moving | over | (jnp.abs(place - carry["place"]) > 1e-6)
        waited = jnp.where(further, 0.0, carry["waited"] + self.env.dt)
        return goal, {
            "place": jnp.clip(place, 0.0, 2.0),
            "way": jnp.where(moving, 0.0, way),
            "side": side,
            "waited": waited,
            "tried": tried,
        }
