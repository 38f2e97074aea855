"""What every physics engine promises, and the state that all of them share."""

from abc import ABC, abstractmethod

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax.errors import SimulationError
from assistax.physics.batching import map_where, whole_batch
from assistax.pytree import pytree

Overrides = dict[str, jax.Array]
"""Model fields with a value of their own in this environment, by their MuJoCo name,
for example {"jnt_range": [njnt, 2], "actuator_gainprm": [nu, 10]}; and PUSH, see there."""

PUSH = "xfrc_applied"
"""Among the overrides no field of the model but a push from outside: [nbody, 6] force in N and torque in Nm on every
body, at its centre of mass and in world axes, held until it is taken out."""

# Bits of PhysicsState.fault.
UNSTABLE, OVERFLOW = 1, 2


@pytree
class PhysicsState:
    """One simulated scene. Batch it with `jax.vmap`, nested if need be.

    The state is the same for all engines, so a run can be continued on another engine.

    `sensordata` is a snapshot of one instant: positions, velocities and contact forces belong
    together. As after MuJoCo's own `mj_step`, that instant is the start of the last physics step,
    one step (2 ms) before `qpos` and `qvel`; after `init` it is the instant of `qpos` itself.
    """

    qpos: jax.Array  # [nq] joint positions, rad
    qvel: jax.Array  # [nv] joint velocities, rad/s
    qacc_warmstart: jax.Array  # [nv] where the constraint solver starts
    sensordata: jax.Array  # [nsensordata] in the model's sensor order
    fault: jax.Array  # int32: UNSTABLE | OVERFLOW since the last (re)initialisation
    overrides: Overrides


class Engine(ABC):
    """Pure functions on a PhysicsState, written for one environment and batched by `jax.vmap`."""

    name: str
    seconds: float = 0.0  # wall time spent in it so far, where it is not part of a larger program

    def __init__(self, model: mujoco.MjModel, substeps: int):
        self.model, self.substeps = model, substeps
        self._init, self._reinit = whole_batch(self._start), whole_batch(self._restart)

    def init(self, qpos: jax.Array, qvel: jax.Array, overrides: Overrides | None = None) -> PhysicsState:
        """Start at qpos [nq], qvel [nv] with zero controls."""
        return self._init(jnp.asarray(qpos), jnp.asarray(qvel), overrides or {})

    def reinit(
        self, state: PhysicsState, mask: jax.Array, qpos: jax.Array, qvel: jax.Array, overrides: Overrides
    ) -> PhysicsState:
        """`init` where mask (bool) is true, `state` elsewhere; those elsewhere cost nothing."""
        return self._reinit(state, mask, jnp.asarray(qpos), jnp.asarray(qvel), overrides)

    @abstractmethod
    def step(self, state: PhysicsState, ctrl: jax.Array) -> PhysicsState:
        """Hold ctrl [nu] for one control step (`substeps` physics steps)."""

    @abstractmethod
    def _start(self, qpos: jax.Array, qvel: jax.Array, overrides: Overrides) -> PhysicsState:
        """`init` of a batch: qpos [n, nq], qvel [n, nv]."""

    def _restart(self, state, mask, qpos, qvel, overrides):
        return map_where(self._start, mask, state, qpos, qvel, overrides)


def check_faults(fault, engine_name: str) -> None:
    """Raise SimulationError, naming the setting to change, if any PhysicsState.fault is set."""
    fault = np.asarray(fault)
    if not fault.any():
        return
    overflow = int(((fault & OVERFLOW) != 0).sum())
    if overflow:
        setting = {
            "warp": "raise contacts_per_env or constraints_per_env (env.contacts_per_env=...)",
            "mujoco": "raise the scene's memory (MjSpec.memory)",
        }.get(engine_name, "reduce the number of geoms that can touch")
        raise SimulationError(
            f"The {engine_name} engine dropped contacts in {overflow} of {fault.size} environments: {setting}."
        )
    unstable = int(((fault & UNSTABLE) != 0).sum())
    raise SimulationError(
        f"The simulation became non-finite in {unstable} of {fault.size} environments: check the actions for "
        "NaN, or lower env.torque_scale."
    )
