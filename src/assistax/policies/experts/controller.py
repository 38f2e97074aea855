"""What the scripted robots share: a script says where the tool should be, a controller turns that into torques."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from assistax import scenes
from assistax.errors import UsageError
from assistax.scenes import geometry
from assistax.scenes.geometry import norm

# The controller. Tool point and tool frame are driven with limited speed, as a person would like it.
GAIN = 6.0  # 1/s, wanted speed per m of error
TURN_GAIN = 6.0  # 1/s, wanted spin per rad of error
DAMPING = 80.0  # N s/m: times GAIN a stiffness of 480 N/m
PRESS_DAMPING = 40.0  # N s/m, along the direction of pressing
TURN_DAMPING = 4.0  # N m s/rad
TURN_SPEED = 1.5  # rad/s, at most
POSTURE_STIFFNESS, POSTURE_DAMPING = 6.0, 3.0  # N m/rad, N m s/rad: toward the ready pose, in the null space


class Goal(NamedTuple):
    """What the tool should do now, in world axes."""

    pos: jax.Array  # [3] m, of the tool point
    rot: jax.Array  # [3, 3], of the tool point's frame
    speed: jax.Array | float = 0.3  # m/s, at most, on the way to pos
    drift: jax.Array | float = 0.0  # [3] m/s, added to that: strokes
    press: jax.Array | float = 0.0  # [3] N, pushed with
    free: jax.Array | float = 0.0  # [3] unit: along it force rules, not pos; 0 for none


class Manner(NamedTuple):
    """How a script plays: with strokes or circles of this speed, pressing with this force."""

    stroke_speed: jax.Array | float  # m/s
    force: jax.Array | float  # N


class Expert:
    """A robot that follows a script of goals.

    A considerate one keeps speed and force inside what the person prefers; that is all it knows of the person.
    """

    privileged = True
    stroke_speed = 0.0  # m/s
    force = 0.0  # N
    turn_speed = TURN_SPEED  # rad/s, at most
    round = False  # whether the tool may turn about its own z axis as the arm likes

    def __init__(self, env, considerate: bool = False):
        if considerate and not env.config.human.preferring:
            raise UsageError("A considerate expert needs a person with preferences: env.human.preference=default.")
        self.considerate = considerate
        if env.config.control != "torque":
            raise UsageError(f"The expert plays with env.control=torque only, not {env.config.control!r}.")
        self.env = env
        self.tool = geometry.Chain(env.model, "tool_tip", env.robot.joints)
        self._ids = scenes.qpos_ids(env.model, env.robot.joints)
        scene = env.spec.scene
        self._base, self._ready = jnp.array(scene.robot_pos), jnp.array(scene.start)
        self._full = jnp.array(env.robot.torque) * env.config.torque_scale
        # The joints' own damping, given back: where the arm is stretched it would swallow a force of 1 N.
        self._drag = 0.9 * jnp.array(env.model.dof_damping[self._ids])

    def initial_carry(self) -> Any:
        """The script's memory."""
        return ()

    def goal(self, carry, s, task, pos, rot, manner):
        """(Goal, carry) from the sensors, the task's state, the tool's pose [3], [3, 3] and the manner."""
        raise NotImplementedError

    def manner(self, preference) -> Manner:
        """The script's own, moved into the middle half of what the person prefers if considerate."""
        if not self.considerate:
            return Manner(self.stroke_speed, self.force)
        inside = (jnp.array([0.75, 0.25]) @ preference.speed, jnp.array([0.25, 0.75]) @ preference.speed)
        bearable = (jnp.array([0.75, 0.25]) @ preference.force, jnp.array([0.25, 0.75]) @ preference.force)
        return Manner(jnp.clip(self.stroke_speed, *inside), jnp.clip(self.force, *bearable))

    def act(self, params, carry, state, reset, key):
        qpos, qvel = state.physics.qpos, state.physics.qvel[self._ids]
        pos, rot, jacobian = self.tool(qpos)
        start = self.initial_carry()
        carry = jax.tree.map(lambda new, old: jnp.where(reset, new, old), start, carry)
        s = self.env.sensors(state.physics)
        if self.env.clock:
            s["clock"] = self.env.beat(state)
        goal, carry = self.goal(carry, s, state.task, pos, rot, self.manner(state.person.preference))
        velocity = jacobian @ qvel
        error = goal.pos - pos
        error -= goal.free * jnp.dot(goal.free * jnp.ones(3), error)
        wanted = at_most(GAIN * error, goal.speed) + goal.drift
        force = DAMPING * (wanted - velocity[:3]) + goal.press
        force += (DAMPING - PRESS_DAMPING) * goal.free * jnp.dot(goal.free * jnp.ones(3), velocity[:3])
        turn = 0.5 * jnp.cross(rot.T, goal.rot.T).sum(0)  # sin(angle) times the axis of the missing turn
        torque = TURN_DAMPING * (at_most(TURN_GAIN * turn, self.turn_speed) - velocity[3:])
        posture = POSTURE_STIFFNESS * (self._ready - qpos[self._ids]) - POSTURE_DAMPING * qvel
        turns = rot.T[:2] if self.round else jnp.eye(3)  # about what the script wants to turn
        jacobian = jnp.concatenate([jacobian[:3], turns @ jacobian[3:]])
        square = jacobian @ jacobian.T + 1e-5 * jnp.eye(len(jacobian))
        posture -= jacobian.T @ jnp.linalg.solve(square, jacobian @ posture)
        joint_torque = jacobian.T @ jnp.concatenate([force, turns @ torque]) + posture + self._drag * qvel
        return jnp.clip(joint_torque / self._full, -1.0, 1.0), carry


def at_most(vector: jax.Array, length) -> jax.Array:
    """vector [3], shortened to `length` if it is longer."""
    return vector * jnp.minimum(1.0, length / jnp.maximum(norm(vector), 1e-9))


def press_for(force, felt):
    """N to press with where `felt` [3] N is felt instead of `force` N: as much more as is missing, or less."""
    return force + (force - norm(felt))


def circle(angle, radius, stroke_speed, right, up):
    """(offset [3] in m, velocity [3] in m/s) on a circle between two unit vectors; none at speed 0."""
    offset = radius * (stroke_speed > 0) * (jnp.cos(angle) * right + jnp.sin(angle) * up)
    return offset, stroke_speed * (jnp.cos(angle) * up - jnp.sin(angle) * right)


def to_and_fro(beat, mean_speed, frequency):
    """(place in m, velocity in m/s) along a line of a swing to a clock of `frequency` Hz with the sine and cosine [2]
    `beat`, that is as fast as `mean_speed` m/s on average."""
    sine, cosine = beat
    return mean_speed / (4.0 * frequency) * sine, 0.5 * jnp.pi * mean_speed * cosine


def way_of_stroke(along, speed, half, turning) -> jax.Array:
    """1 or -1: which way along a line to stroke to and fro, without a memory.

    The tool is `along` m past the middle and moves on with `speed` m/s. It goes on as it moves, as far as `half` m to
    either side, and from there, or where it is slower than `turning` m/s, to the middle.
    """
    back = (jnp.abs(along) > half) | (jnp.abs(speed) < turning)
    return jnp.where(back, -jnp.sign(along), jnp.sign(speed))


def turn_to(rot: jax.Array, direction: jax.Array) -> jax.Array:
    """The rotation [3, 3] nearest to rot whose z axis is the unit vector `direction`."""
    x = rot[:, 0] - direction * (rot[:, 0] @ direction)
    x = geometry.unit(x)
    return jnp.stack([x, jnp.cross(direction, x), direction], -1)
