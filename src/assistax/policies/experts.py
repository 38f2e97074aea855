"""Scripted robot experts, one per task, and scripted people.

They show that every task can be done with the robot's own torques, give learned policies something to
be measured against, and are partners for ad-hoc teamwork. They are `privileged`: instead of an
observation they are given the whole EnvState.

A robot expert says at every step where the tool point should be, how it should be turned and how hard it
should press (a `Goal`); one controller turns that into joint torques.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from assistax import scenes
from assistax.errors import UsageError
from assistax.scenes import geometry
from assistax.tasks.rewards import UP, norm, proximity
from assistax.tasks.scratch import SEGMENTS

# The controller. Tool point and tool frame are driven with limited speed, as a person would like it.
GAIN = 6.0  # 1/s, wanted speed per m of error
TURN_GAIN = 6.0  # 1/s, wanted spin per rad of error
DAMPING = 80.0  # N s/m: times GAIN a stiffness of 480 N/m
PRESS_DAMPING = 40.0  # N s/m, along the direction of pressing
TURN_DAMPING = 4.0  # N m s/rad
TURN_SPEED = 1.5  # rad/s, at most
POSTURE_STIFFNESS, POSTURE_DAMPING = 6.0, 3.0  # N m/rad, N m s/rad: toward the ready pose, in the null space


LEVEL = jnp.array([1.0, 1.0, 0.0])


class Goal(NamedTuple):
    """What the tool should do now, in world axes."""

    pos: jax.Array  # [3] m, of the tool point
    rot: jax.Array  # [3, 3], of the tool point's frame
    speed: jax.Array | float = 0.3  # m/s, at most, on the way to pos
    drift: jax.Array | float = 0.0  # [3] m/s, added to that: strokes
    press: jax.Array | float = 0.0  # [3] N, pushed with
    free: jax.Array | float = 0.0  # [3] unit: along it force rules, not pos; 0 for none


class Manner(NamedTuple):
    """How a script plays: with strokes or circles of this pace, pressing with this force."""

    pace: jax.Array | float  # m/s
    force: jax.Array | float  # N


class Expert:
    """A robot that follows a script of goals.

    A considerate one keeps pace and force inside what the person likes; that is all it knows of the person.
    """

    privileged = True
    pace = 0.0  # m/s
    force = 0.0  # N

    def __init__(self, env, considerate: bool = False):
        if considerate and not env.config.human.preferring:
            raise UsageError("A considerate expert needs a person with preferences: env.human.preference=default.")
        self.considerate = considerate
        if env.config.control != "torque":
            raise UsageError(f"The expert plays with env.control=torque only, not {env.config.control!r}.")
        self.env = env
        self.tool = geometry.Chain(env.model, "tool_tip", scenes.ROBOT_JOINTS)
        self._ids = scenes.qpos_ids(env.model, scenes.ROBOT_JOINTS)
        scene = scenes.SCENES[env.name]
        self._base, self._ready = jnp.array(scene.robot_pos), jnp.array(scene.ready)
        self._full = jnp.array(scenes.ROBOT_TORQUE) * env.config.torque_scale
        # The joints' own damping, given back: where the arm is stretched it would swallow a force of 1 N.
        self._drag = 0.9 * jnp.array(env.model.dof_damping[self._ids])

    def initial_carry(self) -> Any:
        """The script's memory."""
        return ()

    def goal(self, carry, s, task, pos, rot, manner):
        """(Goal, carry) from the sensors, the task's state, the tool's pose [3], [3, 3] and the manner."""
        raise NotImplementedError

    def manner(self, liked) -> Manner:
        """The script's own, moved into the middle half of what the person likes if considerate."""
        if not self.considerate:
            return Manner(self.pace, self.force)
        inside = (jnp.array([0.75, 0.25]) @ liked.speed, jnp.array([0.25, 0.75]) @ liked.speed)
        bearable = (jnp.array([0.75, 0.25]) @ liked.force, jnp.array([0.25, 0.75]) @ liked.force)
        return Manner(jnp.clip(self.pace, *inside), jnp.clip(self.force, *bearable))

    def act(self, params, carry, state, reset, key):
        qpos, qvel = state.physics.qpos, state.physics.qvel[self._ids]
        pos, rot, jacobian = self.tool(qpos)
        start = self.initial_carry()
        carry = jax.tree.map(lambda new, old: jnp.where(reset, new, old), start, carry)
        goal, carry = self.goal(
            carry, self.env.sensors(state.physics), state.task, pos, rot, self.manner(state.person.preference)
        )
        velocity = jacobian @ qvel
        error = goal.pos - pos
        error -= goal.free * jnp.dot(goal.free * jnp.ones(3), error)
        wanted = _at_most(GAIN * error, goal.speed) + goal.drift
        force = DAMPING * (wanted - velocity[:3]) + goal.press
        force += (DAMPING - PRESS_DAMPING) * goal.free * jnp.dot(goal.free * jnp.ones(3), velocity[:3])
        turn = 0.5 * jnp.cross(rot.T, goal.rot.T).sum(0)  # sin(angle) times the axis of the missing turn
        torque = TURN_DAMPING * (_at_most(TURN_GAIN * turn, TURN_SPEED) - velocity[3:])
        posture = POSTURE_STIFFNESS * (self._ready - qpos[self._ids]) - POSTURE_DAMPING * qvel
        square = jacobian @ jacobian.T + 1e-5 * jnp.eye(6)
        posture -= jacobian.T @ jnp.linalg.solve(square, jacobian @ posture)
        joint_torque = jacobian.T @ jnp.concatenate([force, torque]) + posture + self._drag * qvel
        return jnp.clip(joint_torque / self._full, -1.0, 1.0), carry


class ScratchExpert(Expert):
    """Stick on the skin with 3 N, strokes of 6 cm along the limb."""

    stroke = 0.03  # m, to either side of the itch
    pace = 0.06
    force = 3.0
    drag = 1.5  # N, to overcome friction

    def initial_carry(self):
        return {"way": jnp.float32(1.0), "clear": jnp.bool_(False), "down": jnp.bool_(False)}

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
        aligned = norm(jnp.cross(rot[:, 2], stick)) < 0.2
        # First to a place well away from the skin, turning, so that nothing brushes the arm on the way.
        far, hover = itch - 0.12 * stick, itch - 0.03 * stick
        clear = carry["clear"] | (aligned & (norm(pos - far) < 0.04))
        down = carry["down"] | (clear & (norm(pos - hover) < 0.015))
        on_skin = down & (norm(off) < 0.03)
        way = jnp.where(jnp.abs(along) > self.stroke, -jnp.sign(along), carry["way"])
        place = jnp.where(clear, hover, far)
        return Goal(
            jnp.where(down, itch + jnp.clip(along, -self.stroke, self.stroke) * axis, place),
            _turn_to(rot, stick),
            drift=jnp.where(on_skin, manner.pace * way, 0.0) * axis,
            press=jnp.where(down, -manner.force, 0.0) * normal + jnp.where(on_skin, self.drag * way, 0.0) * axis,
            free=jnp.where(down, 1.0, 0.0) * normal,
        ), {"way": way, "clear": clear, "down": down}


class BedBathExpert(Expert):
    """Pad flat on the ridge of the arm, 5 N, from the shoulder to the wrist at an even pace."""

    pace = 0.08
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
        progress += jnp.where(touching, manner.pace * self.env.dt / length, 0.0)
        return Goal(
            jnp.where(above, on_skin, on_skin + 0.06 * up),
            _turn_to(rot, -up),
            press=jnp.where(above, -manner.force, 0.0) * up,
            free=jnp.where(above, 1.0, 0.0) * up,
        ), {"progress": jnp.minimum(progress, 1.0)}


class ArmAssistExpert(Expert):
    """Hook under the forearm where it hangs over the edge of the bed, lift it, carry it to the waist."""

    pull = 4.0  # m of goal per m that the forearm is away from the waist
    sink = 0.055  # m, of the hook's platform below the forearm's axis while carrying
    speeds = (1.3, 1.0, 0.7, 0.7, 1.3)  # m/s, by phase
    radius = 0.03  # m, of the circles in which a considerate expert rocks the arm

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
        speed = jnp.array(self.speeds)[phase]
        rocking = (phase == 4) & (norm(to_waist * LEVEL) < 0.1)
        angle = carry["angle"] + rocking * manner.pace * self.env.dt / self.radius
        circle, stroke = _circle(angle, self.radius, manner.pace, jnp.eye(3)[0], jnp.eye(3)[1])
        goal = Goal(ways[phase] + rocking * circle, frame, speed, drift=rocking * stroke)
        return goal, {"phase": phase + arrived, "angle": angle}


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


class ToothBrushingExpert(Expert):
    """Brush level and across the mouth, bristles on it, in small circles."""

    radius = 0.016  # m, of the circles
    pace = 0.045
    force = 2.1
    share = 0.7  # of the force felt that is pressed; the rest is the pull of the circles
    bearing = 0.15  # rad, by which the bristles look past the mouth

    def initial_carry(self):
        return {"angle": jnp.float32(0.0), "there": jnp.bool_(False)}

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
        angle = carry["angle"] + near * manner.pace * self.env.dt / self.radius
        circle, stroke = _circle(angle, self.radius, manner.pace, left, UP)
        return Goal(
            jnp.where(there, mouth + near * circle, front),
            turned,
            drift=near * stroke,
            press=jnp.where(there, -self.share * manner.force, 0.0) * ahead,
            free=jnp.where(there, 1.0, 0.0) * ahead,
        ), {"angle": angle, "there": there}


EXPERTS = {
    "scratch": ScratchExpert,
    "bed_bath": BedBathExpert,
    "arm_assist": ArmAssistExpert,
    "feeding": FeedingExpert,
    "tooth_brushing": ToothBrushingExpert,
}


def expert(env, considerate: bool = False) -> Expert:
    """The robot expert of the environment's task."""
    return EXPERTS[env.name](env, considerate)


class Reflex:
    """A person who moves the forearm (the mouth, if it drives the neck) toward the tool, or away from it."""

    privileged = True
    pull = 40.0  # N, on the forearm or mouth
    damping = 0.5  # N m s/rad

    def __init__(self, env, sign: float):
        """`sign` is 1 to offer, -1 to withdraw."""
        self.sign = sign
        scene = scenes.SCENES[env.name]
        site = "mouth" if scene.human_driven == scenes.NECK else "wrist_target"
        self.limb = geometry.Chain(env.model, site, scene.human_driven)
        self.env, self._ids = env, scenes.qpos_ids(env.model, scene.human_driven)
        self._full = scenes.HUMAN_TORQUE * scene.human_strength

    def initial_carry(self):
        return ()

    def act(self, params, carry, state, reset, key):
        pos, _, jacobian = self.limb(state.physics.qpos)
        tool = self.env.sensors(state.physics)["tool_pos"]
        force = self.sign * self.pull * geometry.unit(tool - pos)
        torque = jacobian[:3].T @ force - self.damping * state.physics.qvel[self._ids]
        return jnp.clip(torque / self._full, -1.0, 1.0), carry


def _at_most(vector: jax.Array, length) -> jax.Array:
    """vector [3], shortened to `length` if it is longer."""
    return vector * jnp.minimum(1.0, length / jnp.maximum(norm(vector), 1e-9))


def _circle(angle, radius, pace, right, up):
    """(offset [3] in m, velocity [3] in m/s) on a circle between two unit vectors; none at pace 0."""
    offset = radius * (pace > 0) * (jnp.cos(angle) * right + jnp.sin(angle) * up)
    return offset, pace * (jnp.cos(angle) * up - jnp.sin(angle) * right)


def _turn_to(rot: jax.Array, direction: jax.Array) -> jax.Array:
    """The rotation [3, 3] nearest to rot whose z axis is the unit vector `direction`."""
    x = rot[:, 0] - direction * (rot[:, 0] @ direction)
    x = geometry.unit(x)
    return jnp.stack([x, jnp.cross(direction, x), direction], -1)


BOUNDS = {"scratch": 1000, "bed_bath": 1156, "arm_assist": 11280, "feeding": 4700, "tooth_brushing": 3140}
"""The paper's upper bounds of the return per episode of 1000 steps."""
