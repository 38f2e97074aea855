"""From actions to controls: what the robot's motors and the person's muscles are told."""

import jax
import jax.numpy as jnp
import mujoco

from assistax.errors import UsageError
from assistax.human import HumanConfig, HumanProfile, disability
from assistax.human.wandering import wander
from assistax.physics import UNSTABLE
from assistax.scenes import SceneConfig

Actions = dict[str, jax.Array]
"""By agent, "robot" [7] and "human" [2 or 3]."""


class Motors:
    """Of one scene, for one kind of people.

    Args:
      torque_scale: see EnvConfig.
      tremor_weakens: see TaskSpec.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        scene: SceneConfig,
        human: HumanConfig,
        torque_scale: float,
        tremor_weakens: bool,
    ):
        self._human, self._tremor_weakens = human, tremor_weakens
        self.sizes = {"robot": len(scene.arm.joints), "human": len(scene.human_driven)}
        robot = slice(self.sizes["human"], sum(self.sizes.values()))
        limits = jnp.asarray(model.actuator_ctrlrange[robot])
        torque = scene.control == "torque"
        self._zero = limits.mean(1) if torque else jnp.asarray(scene.start)
        scale = torque_scale if torque else 1.0
        self._spans = scale * jnp.stack([self._zero - limits[:, 0], limits[:, 1] - self._zero])
        self._brakes = jnp.zeros(model.nu - robot.stop)  # they take no control

    def checked(self, actions: Actions) -> tuple[Actions, jax.Array]:
        """Actions as numbers that can be used, and the fault UNSTABLE if some of them could not, else 0.

        Raises:
          UsageError: an agent's action is missing, or not numbers of its shape.
        """
        checked, finite = {}, jnp.bool_(True)
        for agent, size in self.sizes.items():
            if agent not in actions:
                raise UsageError(
                    f"There is no action for the {agent}; step takes one of each of {', '.join(self.sizes)}."
                )
            action = jnp.asarray(actions[agent])
            if action.shape != (size,) or not (
                jnp.issubdtype(action.dtype, jnp.floating) or jnp.issubdtype(action.dtype, jnp.integer)
            ):
                raise UsageError(
                    f"The {agent}'s action must be {size} numbers, shape ({size},), not {action.dtype} of shape "
                    f"{action.shape}; for many environments at once, jax.vmap(env.step)."
                )
            good = jnp.isfinite(action)
            checked[agent], finite = jnp.where(good, action, 0.0), finite & good.all()
        return checked, jnp.where(finite, 0, UNSTABLE)

    def controls(self, actions: Actions) -> jax.Array:
        """Controls [nu] of all actuators for actions that nothing disturbs: fractions of the person's torques, then
        N m of the robot or, with position control, rad."""
        robot, human = (jnp.clip(actions[agent], -1.0, 1.0) for agent in ("robot", "human"))
        down, up = self._spans
        return jnp.concatenate([human, self._zero + jnp.where(robot < 0, down, up) * robot, self._brakes])

    def disturbed(self, actions: Actions, person: HumanProfile, phase: jax.Array, time: jax.Array) -> jax.Array:
        """`controls` with the person's random share and tremor, `time` s into the episode; phase: see EnvState."""
        return self._trembling(self.controls(self.wandering(actions, phase, time)), person, phase, time)

    def wandering(self, actions: Actions, phase: jax.Array, time: jax.Array) -> Actions:
        """Actions with the person's random share, see HumanConfig.random_share."""
        if not (share := self._human.random_share):
            return actions
        random = wander(phase, time)
        return actions | {"human": (1.0 - share) * jnp.clip(actions["human"], -1.0, 1.0) + share * random}

    def _trembling(self, ctrl: jax.Array, person: HumanProfile, phase: jax.Array, time: jax.Array) -> jax.Array:
        if not self._human.disabled:
            return ctrl
        trembling = disability.tremor(person.disability, phase, time)
        wanted = ctrl[: trembling.size] * (1.0 if self._tremor_weakens else person.disability.strength)
        return ctrl.at[: trembling.size].set(wanted + trembling)
