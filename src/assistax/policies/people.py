"""Scripted people."""

import jax.numpy as jnp

from assistax import scenes
from assistax.scenes import geometry
from assistax.tasks.arm_assist import ArmAssist
from assistax.tasks.rewards import UP
from assistax.tasks.scratch import Scratch


class Reflex:
    """A person who moves the forearm (the mouth, if it drives the neck) toward the tool, or away from it."""

    privileged = True
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
        pos, _, jacobian = self.limb(state.physics.qpos)
        tool = self.env.sensors(state.physics)["tool_pos"]
        force = self.sign * self.pull * geometry.unit(tool - pos)
        torque = jacobian[:3].T @ force - self.damping * state.physics.qvel[self._ids]
        return jnp.clip(torque / self._full, -1.0, 1.0), carry


class Offer:
    """A person who offers what the robot is to work on, and else keeps still.

    With an itch they turn its side of the arm toward the robot and up, unless it faces there already; with a weak
    arm they help to carry it to the waist. Wherever the target is within reach of a person at rest, rest is best.
    """

    privileged = True
    turn = 25.0  # N m, toward the robot
    enough = 0.5  # cosine of the angle to which the itch's side is turned
    carry = 15.0  # N/m, toward the waist
    damping = 2.0  # N m s/rad

    def __init__(self, env):
        scene = env.spec.scene
        self.env, self._ids = env, scenes.qpos_ids(env.model, scene.human_driven)
        self.limb = geometry.Chain(env.model, "wrist_target", scene.human_driven)
        self._base = jnp.array(scene.robot_pos) * jnp.array([1.0, 1.0, 0.0])
        self._full = scenes.HUMAN_TORQUE * scene.human_strength

    def initial_carry(self):
        return ()

    def act(self, params, carry, state, reset, key):
        task, s = self.env.task, self.env.sensors(state.physics)
        torque = jnp.zeros(len(self._ids))
        if isinstance(task, Scratch):
            torque = self._turned(task, s, state)
        elif isinstance(task, ArmAssist):
            _, _, jacobian = self.limb(state.physics.qpos)
            torque = jacobian[:3].T @ (self.carry * (s["waist_target_pos"] - s["wrist_target_pos"]))
        return jnp.clip(torque / self._full, -1.0, 1.0), carry

    def _turned(self, task, s, state):
        itch, normal = task.skin(s, state.task)
        toward = self._base - itch
        want = geometry.unit(geometry.unit(toward * jnp.array([1.0, 1.0, 0.0])) + UP)
        missing = jnp.maximum(self.enough - normal @ want, 0.0)
        _, _, jacobian = self.limb(state.physics.qpos)
        spin = jacobian[3:].T * jnp.where(state.task.segment == 0, jnp.array([1.0, 1.0, 0.0]), 1.0)[:, None]
        torque = spin @ (self.turn * missing * geometry.unit(jnp.cross(normal, want)))
        return torque - (missing > 0) * self.damping * state.physics.qvel[self._ids]
