"""Bring a level spoon to the mouth."""

import jax.numpy as jnp

from assistax.policies.experts.controller import Expert, Goal
from assistax.scenes import geometry
from assistax.scenes.geometry import norm
from assistax.tasks.rewards import LEVEL, UP, proximity


class FeedingExpert(Expert):
    """Level the spoon beside the face, bring it to the mouth, roll it toward the lips there.

    The spoon comes from where the robot stands, as far as the face can be reached from there: from straight ahead
    the hand would be out of reach.
    """

    bearing = 1.0  # rad, the most, from straight ahead
    roll = 0.7  # rad, at the mouth, with the most bearing
    force = 1.8
    share = 0.55  # of the force felt that is pressed; the rest is the hand's pull to the mouth

    def initial_carry(self):
        return {"level": jnp.bool_(False)}

    def goal(self, carry, s, task, pos, rot, manner):
        mouth, face = s["mouth_pos"], geometry.matrix(s["mouth_quat"])
        forward = geometry.unit(face[:, 0] * LEVEL)
        right = jnp.cross(forward, UP)
        robot = self._base - mouth
        bearing = jnp.clip(jnp.arctan2(robot @ right, robot @ forward), -self.bearing, self.bearing)
        tip = -jnp.cos(bearing) * forward - jnp.sin(bearing) * right
        distance = norm(mouth - pos)
        roll = self.roll * jnp.sin(bearing) / jnp.sin(self.bearing) * proximity(distance)
        side = jnp.cross(UP, tip)  # level, square to the spoon; toward the face if the spoon comes from the right
        up = jnp.cos(roll) * UP + jnp.sin(roll) * side
        turned = jnp.stack([-up, jnp.cross(tip, -up), tip], -1)
        front = mouth - 0.18 * tip + 0.02 * forward
        level = carry["level"] | ((-rot[2, 0] > 0.96) & (norm(front - pos) < 0.05))
        near = level & (distance < 0.05)
        speed = jnp.where(level, 0.21 * (1.0 - proximity(distance)) + 0.02, 0.25)
        return Goal(
            jnp.where(level, mouth + jnp.where(near, 0.0, 0.02) * forward, front),
            turned,
            speed,
            press=jnp.where(near, -self.share * manner.force, 0.0) * forward,
            free=jnp.where(near, 1.0, 0.0) * forward,
        ), {"level": level}
