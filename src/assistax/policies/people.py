"""Scripted people."""

import jax.numpy as jnp

from assistax import scenes
from assistax.scenes import geometry


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
