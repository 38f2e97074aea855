"""A reflex by which people show how they like to be touched: away from what presses too hard, toward what is too soft.

Who works with a person is seldom told what they like, and can see whether they draw back.
"""

import jax
import jax.numpy as jnp
import mujoco

from assistax import scenes
from assistax.human.preference import TOUCH, Preference
from assistax.scenes import SceneConfig, geometry

FEELING = 0.1  # s, over which a force is felt
DAMPING = 0.5  # N m s/rad, of a limb that is pulled


def feel(felt: jax.Array, force: jax.Array, dt: float) -> jax.Array:
    """The felt force in N, `dt` s after it was `felt`, while the tool presses with `force`."""
    return felt + dt / FEELING * (force - felt)


def wish(felt: jax.Array, person: Preference) -> jax.Array:
    """-1 away from a tool that presses harder than the person likes, 1 toward one that touches too softly, else 0."""
    least, most = person.force
    return jnp.where(felt > most, -1.0, jnp.where((felt > TOUCH) & (felt < least), 1.0, 0.0))


class Limb:
    """What a person moves toward the tool or away from it: the forearm or, if it drives the neck, the mouth."""

    def __init__(self, model: mujoco.MjModel, scene: SceneConfig):
        site = "mouth" if scene.human_driven == scenes.NECK else "wrist_target"
        self.chain = geometry.Chain(model, site, scene.human_driven)
        self._ids = scenes.qpos_ids(model, scene.human_driven)
        self._full = scenes.HUMAN_TORQUE * scene.human_strength

    def pulled(self, qpos: jax.Array, qvel: jax.Array, tool: jax.Array, force: jax.Array) -> jax.Array:
        """The action [driven] that pulls with `force` N toward the tool, at [3] m; below 0 away from it."""
        pos, _, jacobian = self.chain(qpos)
        torque = jacobian[:3].T @ (force * geometry.unit(tool - pos)) - DAMPING * qvel[self._ids]
        return jnp.clip(torque / self._full, -1.0, 1.0)
