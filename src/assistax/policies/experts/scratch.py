"""Scratch an itch: press the stick on it and stroke along the limb."""

import jax.numpy as jnp

from assistax.policies.experts.controller import Expert, Goal, press_for, to_and_fro, turn_to, way_of_stroke
from assistax.scenes import geometry
from assistax.scenes.geometry import norm
from assistax.tasks.base import tool_force
from assistax.tasks.rewards import LEVEL


class ScratchExpert(Expert):
    """Stick on the skin with 3 N, strokes along the limb: to the robot's clock or, where it has none, of 6 cm.

    It remembers nothing, so that a learner can imitate it: the clock says what comes next, or where the stick is and
    how it moves.
    """

    round = True
    stroke = 0.03  # m, to either side of the itch
    stroke_speed = 0.06
    force = 3.0
    drag = 1.5  # N, to overcome friction; three times as much while the stick sticks
    turning = 0.02  # m/s: slower than this, a stroke goes to the middle
    away = 0.12  # m, from the skin, until the stick points the right way
    still = 1.0  # rad/s: while a joint of the person is faster, the robot waits, but not for a tremor

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
        if "clock" in s:
            place, drift = to_and_fro(s["clock"], manner.stroke_speed, self.env.clock)
            drag = 2.0 * self.drag * s["clock"][1]
            force = press_for(manner.force, t.on_segment(s, task, tool_force))
        else:
            speed = t.tool_velocity(s, task) @ axis
            way = way_of_stroke(along, speed, self.stroke, self.turning)
            place, drift = jnp.clip(along, -self.stroke, self.stroke), manner.stroke_speed * way
            drag = self.drag * way * jnp.where(jnp.abs(speed) < self.turning, 3.0, 1.0)
            force = manner.force
        spot = itch + place * axis
        return Goal(
            spot - least * stick,
            turn_to(rot, stick),
            speed=jnp.where(on_skin, 0.1, 0.3),
            drift=jnp.where(on_skin, drift, 0.0) * axis,
            press=jnp.where(on_skin, -force, 0.0) * normal + jnp.where(on_skin, drag, 0.0) * axis,
            free=jnp.where(on_skin, 1.0, 0.0) * normal,
        ), carry


class ScratchByStrokesExpert(ScratchExpert):
    """The same, faster: where each stroke turns, speed does not count."""

    stroke_speed = 0.09
