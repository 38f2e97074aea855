"""Scripts that know the simulator's state and were written to score without helping: none of them does.

Each scores in an earlier version of its task, or it would prove nothing.
"""

from functools import partial

import jax.numpy as jnp
import mujoco
import pytest

import assistax
from assistax import scenes
from assistax.evaluation.playing import play
from assistax.policies.experts.arm_assist import ArmAssistExpert
from assistax.policies.experts.bed_bath import BathAroundExpert
from assistax.policies.experts.feeding import FeedingExpert
from assistax.policies.experts.scratch import ScratchExpert
from assistax.policies.experts.tooth_brushing import ToothBrushingExpert
from assistax.policies.people import offer
from assistax.policies.player import Player
from assistax.scenes import geometry
from assistax.scenes.geometry import norm

EPISODES, DT = 2, 0.008  # s


class RestingBrush(ToothBrushingExpert):
    """Presses the brush to where the mouth is at rest, and leaves it there."""

    stroke_speed, force = 0.0, 1.5

    def __init__(self, env):
        super().__init__(env)
        data, places = mujoco.MjData(env.model), scenes.sensor_slices(env.model)
        mujoco.mj_resetDataKeyframe(env.model, data, 0)
        mujoco.mj_forward(env.model, data)
        self.mouth = {s: jnp.asarray(data.sensordata[places[s]], jnp.float32) for s in ("mouth_pos", "mouth_quat")}

    def goal(self, carry, s, task, pos, rot, manner):
        return super().goal(carry, s | self.mouth, task, pos, rot, manner)


class Shakes:
    """Turns the head to and fro."""

    privileged = True
    angle, hertz = 0.2, 1.0  # rad to either side, so often in a second

    def __init__(self, env):
        self.ids = scenes.qpos_ids(env.model, scenes.NECK)

    def initial_carry(self):
        return ()

    def act(self, params, carry, state, reset, key):
        beat = 2.0 * jnp.pi * self.hertz
        t = state.t * DT
        q, v = state.physics.qpos[self.ids], state.physics.qvel[self.ids]
        wanted = jnp.array([self.angle * jnp.sin(beat * t), 0.2])
        speed = jnp.array([self.angle * beat * jnp.cos(beat * t), 0.0])
        return jnp.clip((60.0 * (wanted - q) + 5.0 * (speed - v)) / scenes.HUMAN_TORQUE, -1.0, 1.0), carry


class Beside(ToothBrushingExpert):
    """Brushes so many m to the left of the mouth, and so many above it."""

    def __init__(self, env, left, above):
        super().__init__(env)
        self.off = jnp.array([0.0, left, above])

    def goal(self, carry, s, task, pos, rot, manner):
        place = s["mouth_pos"] + geometry.matrix(s["mouth_quat"]) @ self.off
        return super().goal(carry, s | {"mouth_pos": place}, task, pos, rot, manner)


class Pours(FeedingExpert):
    """Tips the spoon by 75° for 1.5 s where it is 7 cm from the mouth, and then feeds it."""

    turn_speed = 1.0

    def initial_carry(self):
        return super().initial_carry() | {"waited": jnp.float32(0.0)}

    def goal(self, carry, s, task, pos, rot, manner):
        goal, after = super().goal({"level": carry["level"]}, s, task, pos, rot, manner)
        waited, tip = carry["waited"], goal.rot[:, 2]
        there = s["mouth_pos"] - 0.07 * tip
        waited += DT * (after["level"] & ((norm(there - pos) < 0.01) | (waited > 0.0)))
        up = jnp.cos(1.3) * jnp.array([0.0, 0.0, 1.0]) + jnp.sin(1.3) * jnp.cross(jnp.array([0.0, 0.0, 1.0]), tip)
        tipped = jnp.stack([-up, jnp.cross(tip, -up), tip], -1)
        pouring, before = after["level"] & (waited < 1.5), after["level"] & (waited < 2.5)
        goal = goal._replace(
            pos=jnp.where(before, there, goal.pos),
            rot=jnp.where(pouring, tipped, goal.rot),
            press=jnp.where(before, 0.0, goal.press),
            free=jnp.where(before, 0.0, goal.free),
        )
        return goal, after | {"waited": waited}


class Hovers(FeedingExpert):
    """Holds the bowl 2.5 cm before the lips."""

    def goal(self, carry, s, task, pos, rot, manner):
        goal, carry = super().goal(carry, s, task, pos, rot, manner)
        tip, ahead = goal.rot[:, 2], geometry.matrix(s["mouth_quat"])[:, 0]
        place = s["mouth_pos"] - 0.036 * tip + 0.025 * ahead
        goal = goal._replace(pos=jnp.where(carry["level"], place, goal.pos))
        return goal._replace(press=jnp.zeros(3), free=jnp.zeros(3)), carry


def trembling(goal, axis, t, hertz=15.0, amplitude=0.0013, push=18.0):
    """On the skin, along an axis: amplitude in m, push in N."""
    beat = 2.0 * jnp.pi * hertz * t
    on_skin = norm(goal.free * jnp.ones(3)) > 0.5
    drift = on_skin * 2.0 * jnp.pi * hertz * amplitude * jnp.cos(beat) * axis
    # In phase with the acceleration, which a tool of some kg needs.
    return goal._replace(drift=drift, press=goal.press - on_skin * push * jnp.sin(beat) * axis)


class Trembles(ScratchExpert):
    """Presses the stick on the itch and trembles there by 1.3 mm to either side, 15 times a second."""

    def initial_carry(self):
        return {"t": jnp.float32(0.0)}

    def goal(self, carry, s, task, pos, rot, manner):
        goal, _ = super().goal((), s | {"clock": jnp.zeros(2)}, task, pos, rot, manner)
        return trembling(goal, self.env.task.skin(s, task)[2], carry["t"]), {"t": carry["t"] + DT}


class Laid(BathAroundExpert):
    """Lays the pad on the dirt, here and there, without strokes."""

    def goal(self, carry, s, task, pos, rot, manner):
        return super().goal(carry, s | {"clock": jnp.zeros(2)}, task, pos, rot, manner)


class TremblesInBed(Laid):
    """And trembles there by 1.3 mm to either side, 15 times a second."""

    def initial_carry(self):
        return {"t": jnp.float32(0.0)}

    def goal(self, carry, s, task, pos, rot, manner):
        goal, _ = super().goal((), s, task, pos, rot, manner)
        bath = self.env.task
        axis = bath.axes(s)[jnp.asarray(bath.segment)[bath.target(s, task)]]
        return trembling(goal, axis, carry["t"]), {"t": carry["t"] + DT}


class TakesBack(ArmAssistExpert):
    """Brings the arm to the waist, and lets it go when it lay there long enough."""

    def goal(self, carry, s, task, pos, rot, manner):
        goal, carry = super().goal(carry, s, task, pos, rot, manner)
        done = task.seconds_at_waist > 0.6
        return goal._replace(pos=jnp.where(done, pos - jnp.array([0.0, 0.3, 0.2]), goal.pos)), carry


class LeavesAgain:
    """Offers the arm, and throws it out of bed when it lay at the waist for long enough."""

    privileged = True

    def __init__(self, env):
        self.offers = offer(env)

    def initial_carry(self):
        return self.offers.initial_carry()

    def act(self, params, carry, state, reset, key):
        action, carry = self.offers.act(params, carry, state, reset, key)
        away = jnp.array([1.0, -1.0, 1.0])
        return jnp.where(state.task.seconds_at_waist > 0.6, away, action), carry


class Hops(Laid):
    """Lays the pad on the dirt twice a second, from 6 cm beside it, without strokes."""

    force = 5.0

    def initial_carry(self):
        return {"t": jnp.float32(0.0)}

    def goal(self, carry, s, task, pos, rot, manner):
        goal, _ = super().goal((), s, task, pos, rot, manner)
        bath, t = self.env.task, carry["t"]
        axis = bath.axes(s)[jnp.asarray(bath.segment)[bath.target(s, task)]]
        near = norm(goal.pos - pos) < 0.15
        up = near & (t % 0.45 < 0.2)
        beside = 0.06 * jnp.where(t // 0.45 % 2 == 0, 1.0, -1.0) * axis - 0.015 * goal.rot[:, 2]
        return goal._replace(
            pos=goal.pos + up * beside,
            speed=jnp.where(near, 0.8, goal.speed),
            press=jnp.where(up, 0.0, goal.press),
            free=jnp.where(up, 0.0, goal.free),
        ), {"t": t + DT}


CHEATS = {  # by name: the task, the version in which it scores, the robot and the person
    "a head that shakes under a brush at rest": ("tooth_brushing", 1, RestingBrush, Shakes),
    "brushing a cheek": ("tooth_brushing", 1, partial(Beside, left=-0.037, above=0.0), offer),
    "brushing the nose": ("tooth_brushing", 1, partial(Beside, left=0.0, above=0.034), offer),
    "pouring out before the mouth": ("feeding", 2, Pours, offer),
    "a spoon before the lips": ("feeding", 2, Hovers, offer),
    "a stick that trembles": ("scratch", 2, Trembles, offer),
    "a pad laid here and there": ("bed_bath", 2, Laid, offer),
    "a pad that trembles": ("bed_bath", 2, TremblesInBed, offer),
    "an arm that leaves again": ("arm_assist", 1, TakesBack, LeavesAgain),
}


def scores(task, robot, person):
    """By episode, 1 where it is a success."""
    env = assistax.make(task, engine="mujoco")
    return play(env, {"robot": Player(robot(env)), "human": Player(person(env))}, EPISODES)["metrics"]["success"]


@pytest.mark.parametrize("cheat", CHEATS)
def test_a_cheat_scores_nothing(cheat):
    task, former, robot, person = CHEATS[cheat]
    assert scores(f"{task}-v{former}", robot, person).mean() >= 0.5
    assert scores(task, robot, person).sum() == 0


@pytest.mark.xfail(strict=True, reason="version 3 filters velocities while the pad is in the air, too")
def test_a_pad_that_hops_washes_nothing():
    assert scores("bed_bath", Hops, offer).sum() == 0
