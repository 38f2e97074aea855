"""Scripted people: some work with the robot, some draw back."""

import json
from pathlib import Path
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax import scenes
from assistax.scenes import geometry
from assistax.tasks.arm_assist import ArmAssist
from assistax.tasks.bed_bath import BedBath
from assistax.tasks.feeding import Feeding
from assistax.tasks.scratch import SEGMENTS, Scratch
from assistax.tasks.tooth_brushing import ToothBrushing

OFFERS = Path(__file__).with_name("offers.json")


class Reflex:
    """A person who moves the forearm (the mouth, if it drives the neck) toward the tool, or away from it."""

    privileged = True
    ways = 1
    pull = 40.0  # N, on the forearm or mouth
    damping = 0.5  # N m s/rad

    def __init__(self, env, sign: float):
        """`sign` is 1 to offer, -1 to withdraw."""
        self.sign = sign
        scene = env.spec.scene
        site = "mouth" if scene.human_driven == scenes.NECK else "wrist_target"
        self.limb = geometry.Chain(env.model, site, scene.human_driven)
        self.env, self._ids = env, scenes.qpos_ids(env.model, scene.human_driven)
        self._full = scenes.HUMAN_TORQUE * scene.human_strength

    def initial_carry(self):
        return ()

    def act(self, params, carry, state, reset, key):
        return self.moving(state, self.sign), carry

    def moving(self, state, toward):
        """The action that pulls toward the tool with `toward` times the usual force; below 0 away from it."""
        pos, _, jacobian = self.limb(state.physics.qpos)
        tool = self.env.sensors(state.physics)["tool_pos"]
        force = toward * self.pull * geometry.unit(tool - pos)
        torque = jacobian[:3].T @ force - self.damping * state.physics.qvel[self._ids]
        return jnp.clip(torque / self._full, -1.0, 1.0)


class Muscles:
    """What brings the joints that a person drives to a posture and keeps them there: springs with dampers."""

    # By joint, N m/rad and N m s/rad.
    springs: ClassVar = {"neck": (25.0, 4.0), "trunk": (60.0, 4.0), "shoulder": (60.0, 4.0), "elbow": (25.0, 1.0)}
    tense = 3.0  # times the damping while they tremble, or tool and skin lose each other

    def __init__(self, env):
        scene = env.spec.scene
        found = [next(spring for part, spring in self.springs.items() if part in name) for name in scene.human_driven]
        self._stiffness, self._damping = jnp.array(found).T
        self._ids = scenes.qpos_ids(env.model, scene.human_driven)
        self._full = scenes.HUMAN_TORQUE * scene.human_strength
        self.rest = jnp.asarray(env.model.key("start").qpos[self._ids], jnp.float32)

    def toward(self, posture, state):
        """The action toward a posture [driven] rad."""
        person = state.person.disability
        damping = self._damping * jnp.where(person.tremor > 0.0, self.tense, 1.0)
        qpos, qvel = state.physics.qpos[self._ids], state.physics.qvel[self._ids]
        torque = self._stiffness * (posture - qpos) - damping * qvel
        return jnp.clip(torque / (self._full * person.strength), -1.0, 1.0)


class Offer:
    """A person who moves into a posture in which the robot can reach what it is to work on, and holds it.

    There may be several ways to do so: which is this person's is a number from 0, the usual one.
    """

    privileged = True
    ways = 1

    def __init__(self, env, speed: float = 1.5):
        """`speed` in rad/s: how fast the person moves from one posture to the next, unless the parameters say."""
        self.env, self._muscles, self._speed = env, Muscles(env), speed
        self.rest = self._muscles.rest

    def initial_carry(self) -> Any:
        return {"aim": self.rest}

    def posture(self, carry, state, way) -> tuple[jax.Array, Any]:
        """The posture [driven] in rad that offers what is to be worked on, and the carry."""
        raise NotImplementedError

    def act(self, params, carry, state, reset, key):
        carry = jax.tree.map(lambda new, old: jnp.where(reset, new, old), self.initial_carry(), carry)
        params = params or {"speed": self._speed, "way": 0}
        posture, carry = self.posture(carry, state, jnp.asarray(params["way"], jnp.int32) % self.ways)
        missing = posture - carry["aim"]
        step = params["speed"] * self.env.dt
        aim = carry["aim"] + missing * jnp.minimum(1.0, step / jnp.maximum(jnp.abs(missing).max(), 1e-6))
        resting = jnp.abs(aim - self.rest).max() < 1e-3  # on the furniture, with loose muscles
        return jnp.where(resting, 0.0, self._muscles.toward(aim, state)), carry | {"aim": aim}


class OfferItch(Offer):
    """Stays at rest if the robot can reach the itch, and else turns that side of the arm toward it.

    Which posture serves which place on the skin was found by inverse kinematics over both bodies: tools/offers.py.
    """

    def __init__(self, env, speed: float = 1.5):
        super().__init__(env, speed)
        stored = json.loads(OFFERS.read_text())["scratch"]
        self.ways, most = len(stored), max(len(way["postures"]) for way in stored)
        self._postures = jnp.array([np.resize(way["postures"], (most, len(self.rest))) for way in stored])
        self._cells = jnp.array([[[[int(i) for i in row] for row in way[part]] for part in SEGMENTS] for way in stored])

    def posture(self, carry, state, way):
        height, angle = self.env.task.place(state.task)
        rows, columns = self._cells.shape[-2:]
        row = jnp.clip((height + 1.0) / 2.0 * rows, 0, rows - 1).astype(int)
        column = jnp.clip((angle / np.pi + 1.0) / 2.0 * columns, 0, columns - 1).astype(int)
        return self._postures[way, self._cells[way, state.task.segment, row, column]], carry


class OfferSkin(Offer):
    """Stays at rest if the robot can wash what is dirty, and else turns that side of the arm toward it.

    Which posture serves which side was found by play: tools/offers.py.
    """

    def __init__(self, env, speed: float = 1.5):
        super().__init__(env, speed)
        stored = json.loads(OFFERS.read_text())["bed_bath"]
        self.ways, most = len(stored), max(len(way["postures"]) for way in stored)
        self._postures = jnp.array([np.resize(way["postures"], (most, len(self.rest))) for way in stored])
        self._sides = jnp.array([[int(i) for i in way["sides"]] for way in stored])

    def posture(self, carry, state, way):
        up, across = self.env.task.side(state.task)
        count = self._sides.shape[-1]  # the first is opposite the upper side
        side = jnp.round((jnp.arctan2(across, up) / (2.0 * np.pi) + 0.5) * count).astype(int)
        return self._postures[way, self._sides[way, side % count]], carry


class OfferFace(Offer):
    """Turns the face toward where the robot stands, and holds it level."""

    turns = (0.5, 0.0, 1.0)  # of what it would take to look at the robot: the ways

    def __init__(self, env, speed: float = 1.5):
        super().__init__(env, speed)
        face = mujoco.MjData(env.model)
        mujoco.mj_resetDataKeyframe(env.model, face, env.model.key("start").id)
        mujoco.mj_kinematics(env.model, face)
        mouth = face.site("mouth")
        ahead, robot = mouth.xmat[[0, 3]], (env.spec.scene.robot_pos - mouth.xpos)[:2]
        bearing = np.arctan2(ahead[0] * robot[1] - ahead[1] * robot[0], ahead @ robot)
        nod = np.arctan2(-mouth.xmat[6], np.linalg.norm(ahead))
        self.ways = len(self.turns)
        self._postures = self.rest + jnp.array([[turn * bearing, -nod] for turn in self.turns])

    def posture(self, carry, state, way):
        return self._postures[way], carry


class OfferTeeth(OfferFace):
    """Holds the face level, straight ahead: the brush comes from the side."""

    turns = (0.0, -0.3)


class OfferArm:
    """Helps to carry a weak arm to the waist."""

    privileged = True
    carry = 15.0  # N/m, toward the waist
    damping = 2.0  # N m s/rad

    def __init__(self, env, speed: float = 1.5):
        scene = env.spec.scene
        self.env = env
        self.limb = geometry.Chain(env.model, "wrist_target", scene.human_driven)
        self._full = scenes.HUMAN_TORQUE * scene.human_strength

    def initial_carry(self):
        return ()

    def act(self, params, carry, state, reset, key):
        s = self.env.sensors(state.physics)
        _, _, jacobian = self.limb(state.physics.qpos)
        torque = jacobian[:3].T @ (self.carry * (s["waist_target_pos"] - s["wrist_target_pos"]))
        return jnp.clip(torque / self._full, -1.0, 1.0), carry


_BY_TASK = {Scratch: OfferItch, BedBath: OfferSkin, ArmAssist: OfferArm, Feeding: OfferFace, ToothBrushing: OfferTeeth}


def offer(env, speed: float = 1.5):
    """The person who offers what the environment's task works on, moving at `speed` rad/s.

    In version 0 and in tasks of others it is who moves toward the tool.
    """
    kind = _BY_TASK.get(type(env.task)) if env.spec.scene.worked_on else None
    return kind(env, speed) if kind else Reflex(env, 1.0)
