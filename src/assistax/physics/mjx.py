"""MJX as pure JAX functions: Warp kernels (NVIDIA GPUs, CPUs) and pure JAX (TPUs)."""

import copy
import io
from contextlib import redirect_stdout
from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax.errors import UsageError
from assistax.physics.batching import whole_batch
from assistax.physics.engine import OVERFLOW, PUSH, UNSTABLE, Engine, Overrides, PhysicsState

try:
    import warp

    warp.config.log_level = warp.LOG_ERROR  # no banner, no line per kernel
except ImportError:
    warp = None

with redirect_stdout(io.StringIO()):  # without warp-lang the import prints a harmless complaint
    from mujoco import mjx
    from mujoco.mjx._src.support import contact_force_dim

_CONTACT = mujoco.mjtSensor.mjSENS_CONTACT


class _MjxBase(Engine):
    """What both implementations share: MuJoCo's state in, one control step, MuJoCo's state out."""

    name: str
    _model: mjx.Model

    def _data(self, num_envs: int) -> mjx.Data:
        """Empty MJX data with buffers for `num_envs` environments."""
        raise NotImplementedError

    def _read(self, d: mjx.Data) -> tuple[jax.Array, jax.Array]:
        """(sensordata, fault) after a step or forward."""
        raise NotImplementedError

    def _run(self, data: mjx.Data, state: PhysicsState, ctrl, substeps: int) -> PhysicsState:
        """`substeps` steps (0: only the forward pass) of one environment."""
        fields = dict(state.overrides)
        rows = {"qpos": state.qpos, "qvel": state.qvel, "qacc_warmstart": state.qacc_warmstart}
        rows |= {PUSH: fields.pop(PUSH)} if PUSH in fields else {}
        model = self._model.replace(**fields) if fields else self._model
        data = data.replace(**rows, ctrl=jnp.asarray(ctrl, jnp.float32))
        fault = state.fault
        if substeps == 0:
            data = mjx.forward(model, data)
            fault |= self._read(data)[1]

        def substep(_, carry):
            data, fault = carry
            data = mjx.step(model, data)
            return data, fault | self._read(data)[1]

        data, fault = jax.lax.fori_loop(0, substeps, substep, (data, fault))
        fault |= UNSTABLE * ~jnp.isfinite(data.qpos).all()
        return PhysicsState(data.qpos, data.qvel, data.qacc_warmstart, self._read(data)[0], fault, state.overrides)

    def _start(self, qpos, qvel, overrides: Overrides) -> PhysicsState:
        n, m = len(qpos), self.model
        zeros = [jnp.zeros((n, size)) for size in (m.nv, m.nsensordata)]
        start = PhysicsState(qpos, qvel, *zeros, jnp.zeros(n, jnp.int32), overrides)
        data = self._data(n)
        return jax.vmap(lambda s: self._run(data, s, jnp.zeros(m.nu), 0))(start)


class WarpEngine(_MjxBase):
    """MJX-Warp. Not differentiable; on a GPU not reproducible to the bit."""

    name = "warp"

    def __init__(self, model, substeps: int = 4, contacts_per_env: int = 24, constraints_per_env: int = 96):
        if warp is None:
            raise UsageError("The warp engine needs warp-lang: pip install 'assistax[warp]'.")
        super().__init__(model, substeps)
        self._contacts, self._constraints = contacts_per_env, constraints_per_env
        self._model = mjx.put_model(model, impl="warp")
        self._step = whole_batch(self._step_batch)
        self._data = cache(self._data)

    def step(self, state: PhysicsState, ctrl) -> PhysicsState:
        return self._step(state, ctrl)

    def _step_batch(self, state: PhysicsState, ctrl) -> PhysicsState:
        data = self._data(ctrl.shape[0])
        return jax.vmap(lambda s, c: self._run(data, s, c, self.substeps))(state, ctrl)

    def _data(self, num_envs: int) -> mjx.Data:
        nowhere = jax.sharding.AbstractMesh((), ())  # else it would belong to the devices that share a batch
        with jax.ensure_compile_time_eval(), jax.sharding.use_abstract_mesh(nowhere):
            return mjx.make_data(self.model, impl="warp", naconmax=num_envs * self._contacts, njmax=self._constraints)

    def _read(self, d):
        # The counters also count what found no room; the contact buffer is shared by the batch.
        wanted = jnp.maximum(jnp.max(d._impl.nacon), jnp.max(d._impl.ncollision))
        lost = (wanted > d._impl.naconmax) | (jnp.max(d._impl.nefc) > self._constraints)
        return d.sensordata, jnp.where(lost, OVERFLOW, 0).astype(jnp.int32)


class MjxEngine(_MjxBase):
    """MJX in pure JAX. Its solver loops until it has converged, so that JAX cannot differentiate it in reverse mode.

    It has no net-force contact sensors, so they are computed here from the contact list.
    """

    name = "mjx"

    def __init__(self, model: mujoco.MjModel, substeps: int = 4):
        super().__init__(model, substeps)
        contact = np.flatnonzero(model.sensor_type == _CONTACT)
        silent = copy.copy(model)  # put_model refuses types it does not know, step skips them
        silent.sensor_type[contact] = mujoco.mjtSensor.mjSENS_CLOCK
        skipped = np.where(model.sensor_type == _CONTACT, mujoco.mjtSensor.mjSENS_USER, model.sensor_type)
        self._model = mjx.put_model(silent, impl="jax").replace(sensor_type=skipped)
        self._template = mjx.make_data(silent, impl="jax")
        self._contact_sensors = [
            (int(model.sensor_adr[i]), self._geoms(i, "obj"), self._geoms(i, "ref")) for i in contact
        ]

    def step(self, state: PhysicsState, ctrl) -> PhysicsState:
        return self._run(self._template, state, ctrl, self.substeps)

    def _data(self, num_envs: int) -> mjx.Data:
        return self._template

    def _geoms(self, sensor: int, side: str) -> jax.Array:
        """Mask [ngeom] of the geoms that one side of a contact sensor matches."""
        m = self.model
        kind, root = getattr(m, f"sensor_{side}type")[sensor], getattr(m, f"sensor_{side}id")[sensor]
        if kind == mujoco.mjtObj.mjOBJ_GEOM:
            return jnp.arange(m.ngeom) == root
        if kind == mujoco.mjtObj.mjOBJ_BODY:
            return jnp.asarray(m.geom_bodyid == root)
        inside = np.zeros(m.nbody, bool)  # a subtree: mjOBJ_XBODY
        for body in range(m.nbody):
            inside[body] = body == root or (body > 0 and inside[m.body_parentid[body]])
        return jnp.asarray(inside[m.geom_bodyid])

    def _read(self, d):
        sensordata = d.sensordata
        if self._contact_sensors:
            force, ids = contact_force_dim(self._model, d, 3)
            contact = d._impl.contact
            touching = (contact.dist[ids] < contact.includemargin[ids])[:, None]
            # The contact frame's rows are its axes, so this is the force on geom 2 in world axes.
            force = jnp.einsum("ci,cij->cj", force[:, :3], contact.frame[ids]) * touching
            geom1, geom2 = contact.geom[ids].T
            for adr, first, second in self._contact_sensors:
                sign = (first[geom1] & second[geom2]) * 1.0 - (second[geom1] & first[geom2]) * 1.0
                sensordata = sensordata.at[adr : adr + 3].set(sign @ force)
        return sensordata, jnp.int32(0)
