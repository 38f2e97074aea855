"""Wash the arm from the shoulder to the wrist."""

import jax.numpy as jnp

from assistax.policies.experts.controller import Expert, Goal, turn_to
from assistax.scenes import geometry
from assistax.tasks.rewards import UP, norm
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
