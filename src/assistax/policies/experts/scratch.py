"""Scratch an itch: press the stick on it and stroke along the limb."""

import jax.numpy as jnp

from assistax.policies.experts.controller import Expert, Goal, turn_to
from assistax.scenes import geometry
from assistax.scenes.geometry import norm
from assistax.tasks.rewards import LEVEL


class ScratchExpert(Expert):
    """Stick on the skin with 3 N, strokes of 6 cm along the limb."""

    stroke = 0.03  # m, to either side of the itch
    stroke_speed = 0.06
    force = 3.0
    drag = 1.5  # N, to overcome friction
    patience = 0.2  # s without moving
    still = 0.3  # rad/s: while a joint of the person is faster, the robot waits

    def initial_carry(self):
        return {
            "way": jnp.float32(1.0),
            "stuck": jnp.float32(0.0),  # s
            "clear": jnp.bool_(False),
            "down": jnp.bool_(False),
        }

    def goal(self, carry, s, task, pos, rot, manner):
        t = self.env.task
        upper = task.segment == 0
        frame = geometry.matrix(jnp.where(upper, s["upper_arm_quat"], s["forearm_quat"]))
        origin = jnp.where(upper, s["upper_arm_pos"], s["forearm_pos"])
        axis = frame @ t._axis[task.segment]
        from_centre = task.itch - t._centre[task.segment]
        normal = frame @ geometry.unit(from_centre - t._axis[task.segment] * (from_centre @ t._axis[task.segment]))
        itch = origin + frame @ task.itch
        along = (pos - itch) @ axis
        off = pos - itch - along * axis
        # Square to the skin the hand would often be out of reach: the stick leans toward the robot.
        stick = geometry.unit(geometry.unit((itch - self._base) * LEVEL) - normal)
        aligned = norm(jnp.cross(rot[:, 2], stick)) < 0.3
        # First to a place well away from the skin, turning, so that nothing brushes the arm on the way.
        far, hover = itch - 0.12 * stick, itch - 0.03 * stick
        moving = jnp.abs(s["dtheta_human"]).max() > self.still
        clear = carry["clear"] | (aligned & (norm(pos - far) < 0.06) & ~moving)
        down = carry["down"] | (clear & (norm(pos - hover) < 0.015))
        on_skin = down & (norm(off) < 0.03)
        # Something else may be in the way of a stroke: then the other way.
        stuck = jnp.where(on_skin & (t.tool_speed(s, task) < 0.03), carry["stuck"] + self.env.dt, 0.0)
        way = jnp.where(stuck > self.patience, -carry["way"], carry["way"])
        way = jnp.where(jnp.abs(along) > self.stroke, -jnp.sign(along), way)
        drag = self.drag * (1.0 + 2.0 * stuck / self.patience)
        place = jnp.where(clear, hover, jnp.where(moving & (norm(pos - itch) < 0.35), pos, far))
        return Goal(
            jnp.where(down, itch + jnp.clip(along, -self.stroke, self.stroke) * axis, place),
            turn_to(rot, stick),
            drift=jnp.where(on_skin, manner.stroke_speed * way, 0.0) * axis,
            press=jnp.where(down, -manner.force, 0.0) * normal + jnp.where(on_skin, drag * way, 0.0) * axis,
            free=jnp.where(down, 1.0, 0.0) * normal,
        ), {"way": way, "stuck": jnp.where(stuck > self.patience, 0.0, stuck), "clear": clear, "down": down}
