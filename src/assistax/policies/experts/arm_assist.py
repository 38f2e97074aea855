"""Lift the forearm with the hook and carry it to the waist."""

import jax.numpy as jnp

from assistax.policies.experts.controller import Expert, Goal, circle
from assistax.scenes import geometry
from assistax.scenes.geometry import norm
from assistax.tasks.rewards import LEVEL, UP

CARRYING = 0.6  # of the speed at which the forearm may be carried, if the task limits it


class ArmAssistExpert(Expert):
    """Hook under the forearm where it hangs over the edge of the bed, lift it, carry it to the waist."""

    pull = 4.0  # m of goal per m that the forearm is away from the waist
    sink = 0.055  # m, of the hook's platform below the forearm's axis while carrying
    speeds = (1.3, 1.0, 0.7, 0.7, 1.3)  # m/s, by phase
    radius = 0.03  # m, of the circles in which a considerate expert rocks an arm

    def manner(self, preference):
        """Rocking shakes an arm off the hook for moments: that is for who cares more how fast than how firm it is."""
        manner, (how_fast, how_firm, *_) = super().manner(preference), preference.weights
        return manner._replace(stroke_speed=jnp.where(how_fast > how_firm, manner.stroke_speed, 0.0))

    def initial_carry(self):
        return {"phase": jnp.int32(0), "angle": jnp.float32(0.0)}

    def goal(self, carry, s, task, pos, rot, manner):
        phase = carry["phase"]
        wrist, frame = s["wrist_target_pos"], geometry.matrix(s["wrist_target_quat"])
        outside = geometry.unit(frame[:, 0] * LEVEL)  # the side away from the trunk
        grip = wrist - 0.075 * frame[:, 2]  # between wrist target and hand, where no mattress is below
        to_waist = s["waist_target_pos"] - wrist
        lift = jnp.clip(0.5 * norm(to_waist * LEVEL), 0.0, 0.05) * UP
        ways = jnp.stack([
            grip + 0.14 * outside + 0.15 * UP,  # over the hand
            grip + 0.14 * outside - 0.035 * UP,
            grip - 0.035 * UP,
            pos + 0.05 * UP,
            grip + self.pull * to_waist * LEVEL + lift - self.sink * UP,
        ])  # fmt: skip
        arrived = norm(ways[phase] - pos) < jnp.array([0.12, 0.02, 0.02, 0.0, 0.0])[phase]
        arrived |= (phase == 3) & (to_waist[2] < -0.02)
        most = CARRYING * self.env.task.config.carrying_speed
        speed = jnp.minimum(jnp.array(self.speeds)[phase], jnp.where(phase >= 2, most, jnp.inf))
        rocking = (phase == 4) & (norm(to_waist * LEVEL) < 0.1)
        angle = carry["angle"] + rocking * manner.stroke_speed * self.env.dt / self.radius
        offset, stroke = circle(angle, self.radius, manner.stroke_speed, jnp.eye(3)[0], jnp.eye(3)[1])
        goal = Goal(ways[phase] + rocking * offset, frame, speed, drift=rocking * stroke)
        return goal, {"phase": phase + arrived, "angle": angle}
