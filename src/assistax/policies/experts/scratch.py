"""Scratch an itch: press the stick on it and stroke along the limb."""

import jax.numpy as jnp

from assistax.policies.experts.controller import Expert, Goal, turn_to, way_of_stroke
from assistax.scenes import geometry
from assistax.scenes.geometry import norm
from assistax.tasks.rewards import LEVEL


class ScratchExpert(Expert):
    """Stick on the skin with 3 N, strokes of 6 cm along the limb.

    It remembers nothing: where the stick is and how it moves says what comes next, so that a learner can imitate it.
    """

    round = True
    stroke = 0.03  # m, to either side of the itch
    stroke_speed = 0.06
    force = 3.0
    drag = 1.5  # N, to overcome friction; three times as much while the stick sticks
    turning = 0.02  # m/s: slower than this, a stroke goes to the middle
    away = 0.12  # m, from the skin, until the stick points the right way
    still = 0.3  # rad/s: while a joint of the person is faster, the robot waits

    def goal(self, carry, s, task, pos, rot, manner):
        t = self.env.task
        itch, normal, axis = t.skin(s, task)
        # Square to the skin the hand would often be out of reach: the stick leans toward the robot.
        stick = geometry.unit(geometry.unit((itch - self._base) * LEVEL) - normal)
        # It comes in a funnel along the stick, so that nothing brushes the arm on the way.
        height = (pos - itch) @ normal / jnp.maximum(-stick @ normal, 0.1)
        off = pos - itch + height * stick
        along = off @ axis
        beside = norm(off - along * axis)
        wide = beside + jnp.maximum(jnp.abs(along) - self.stroke, 0.0)
        askew = norm(jnp.cross(rot[:, 2], stick))
        moving = jnp.abs(s["dtheta_human"]).max() > self.still
        least = jnp.clip(3.0 * (wide - 0.02) + 0.4 * (askew - 0.3), 0.0, self.away)
        least = jnp.where(moving, jnp.clip(height, least, self.away), least)
        on_skin = (height < 0.03) & (least < 0.03)
        speed = t.tool_velocity(s, task) @ axis
        way = way_of_stroke(along, speed, self.stroke, self.turning)
        drag = self.drag * jnp.where(jnp.abs(speed) < self.turning, 3.0, 1.0)
        spot = itch + jnp.clip(along, -self.stroke, self.stroke) * axis
        return Goal(
            spot - least * stick,
            turn_to(rot, stick),
            speed=jnp.where(on_skin, 0.1, 0.3),
            drift=jnp.where(on_skin, manner.stroke_speed * way, 0.0) * axis,
            press=jnp.where(on_skin, -manner.force, 0.0) * normal + jnp.where(on_skin, drag * way, 0.0) * axis,
            free=jnp.where(on_skin, 1.0, 0.0) * normal,
        ), carry
