"""Brush in small circles."""

import jax.numpy as jnp

from assistax.policies.experts.controller import Expert, Goal, circle, press_for
from assistax.scenes import geometry
from assistax.scenes.geometry import norm
from assistax.tasks.base import tool_force
from assistax.tasks.rewards import LEVEL, UP


class ToothBrushingExpert(Expert):
    """Brush level and across the mouth, bristles on it, in small circles.

    Faster circles than its own throw the brush off the teeth, so that a considerate one corrects the force it feels.
    """

    radius = 0.012  # m, of the circles
    stroke_speed = 0.045
    force = 2.1
    fastest = 0.09  # m/s: faster circles do not stay on the teeth, whatever the person prefers
    share = 0.7  # of the force felt that is pressed; the rest is the pull of the circles
    bearing = 0.15  # rad, by which the bristles look past the mouth

    def initial_carry(self):
        return {"angle": jnp.float32(0.0), "there": jnp.bool_(False)}

    def manner(self, preference):
        manner = super().manner(preference)
        return manner._replace(stroke_speed=jnp.minimum(manner.stroke_speed, self.fastest))

    def goal(self, carry, s, task, pos, rot, manner):
        mouth, face = s["mouth_pos"], geometry.matrix(s["mouth_quat"])
        ahead = geometry.unit(face[:, 0] * LEVEL)
        left = jnp.cross(UP, ahead)
        out = jnp.cos(self.bearing) * ahead + jnp.sin(self.bearing) * left  # keeps the hand off the shoulder
        along = jnp.cross(UP, out)
        turned = jnp.stack([out, jnp.cross(along, out), along], -1)
        front = mouth + 0.03 * ahead
        aligned = jnp.trace(rot.T @ turned) > 2.9
        there = carry["there"] | (aligned & (norm(front - pos) < 0.02))
        near = there & (norm(mouth - pos) < 0.04)
        angle = carry["angle"] + near * manner.stroke_speed * self.env.dt / self.radius
        force = self.share * manner.force
        if self.considerate:
            force = jnp.where(near, press_for(manner.force, tool_force(s, "head")), force)
        offset, stroke = circle(angle, self.radius, manner.stroke_speed, left, UP)
        return Goal(
            jnp.where(there, mouth + near * offset, front),
            turned,
            drift=near * stroke,
            press=jnp.where(there, -force, 0.0) * ahead,
            free=jnp.where(there, 1.0, 0.0) * ahead,
        ), {"angle": angle, "there": there}
