"""MuJoCo's C engine as pure JAX functions: `mujoco.batch.Batch` inside a `jax.pure_callback`.

The callback receives whole batches (every axis that `vmap` added, flattened), steps them on a
thread pool with the solver run to convergence, and hands back float32. It keeps no state between
calls: the same arguments give the same bits, at any number of threads.
"""

import threading
import time
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from assistax.physics.engine import OVERFLOW, UNSTABLE, Engine, Overrides, PhysicsState

_STATE = ("qpos", "qvel", "qacc_warmstart")
_NO_SENSORS = int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
_FULL = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]
_BAD = [int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{x}")) for x in ("QPOS", "QVEL", "QACC", "CTRL")]


class MujocoEngine(Engine):
    name = "mujoco"

    def __init__(self, model: mujoco.MjModel, substeps: int = 4, num_threads: int = 0):
        super().__init__(model, substeps)
        self.num_threads = num_threads
        # A callback may come from several threads; a Batch must not.
        self._lock = threading.Lock()
        self._batches: dict[tuple, Batch] = {}

    def step(self, state: PhysicsState, ctrl) -> PhysicsState:
        out = self._call(self._host_step, (*self._rows(state), ctrl), state.overrides)
        return PhysicsState(*out[:4], state.fault | out[4], state.overrides)

    def reinit(self, state: PhysicsState, mask, qpos, qvel, overrides: Overrides) -> PhysicsState:
        start = (qpos, qvel, jnp.zeros(self.model.nv))
        overrides = jax.tree.map(partial(jnp.where, mask), overrides, state.overrides)
        old = (*self._rows(state), state.sensordata, state.fault)
        out = self._call(self._host_reinit, (mask, *start, *old), overrides)
        return PhysicsState(*out, overrides)

    @staticmethod
    def _rows(state: PhysicsState):
        return tuple(getattr(state, name) for name in _STATE)

    def _call(self, host, args, overrides: Overrides):
        m = self.model
        shapes = [jax.ShapeDtypeStruct((n,), jnp.float32) for n in (m.nq, m.nv, m.nv, m.nsensordata)]
        shapes.append(jax.ShapeDtypeStruct((), jnp.int32))
        return jax.pure_callback(partial(self._timed, host), shapes, args, overrides, vmap_method="broadcast_all")

    # From here on NumPy only: a callback must not call JAX.

    def _batch(self, lead: tuple[int, ...], overrides: dict) -> Batch:
        """The Batch for this many environments, with these per-environment fields filled in."""
        n = int(np.prod(lead))
        batch = self._batches.get((n, *sorted(overrides)))
        if batch is None:
            batch = Batch(self.model, nsim=n, nthread=self.num_threads)
            # A sensor bound before the first call is refreshed by every later one.
            batch.bind("sensordata")
            self._batches[(n, *sorted(overrides))] = batch
        for name, value in overrides.items():
            rows = batch.expand(name)
            rows[:] = np.reshape(value, rows.shape)
        return batch

    def _timed(self, host, *args):
        began = time.perf_counter()
        try:
            return host(*args)
        finally:
            self.seconds += time.perf_counter() - began

    def _host_step(self, args, overrides):
        *rows, ctrl = (np.asarray(a) for a in args)
        lead = ctrl.shape[:-1]
        with self._lock:
            batch = self._batch(lead, overrides)
            for name, value in zip((*_STATE, "ctrl"), (*rows, ctrl), strict=True):
                setattr(batch, name, value.reshape(batch.nsim, -1))
            faults = self._watch(batch, lambda: self._substeps(batch))
            new = [getattr(batch, name) for name in (*_STATE, "sensordata")]
            out = [x.astype(np.float32).reshape(*lead, x.shape[-1]) for x in new]
            return *out, faults.reshape(lead)

    def _substeps(self, batch: Batch) -> None:
        """One control step. Only its last physics step computes the sensors, as nobody sees the others'."""
        flags = batch.expand("opt.disableflags")
        if self.substeps > 1:
            flags[:] = self.model.opt.disableflags | _NO_SENSORS
            batch.step(nstep=self.substeps - 1)
        flags[:] = self.model.opt.disableflags
        batch.step()

    def _host_reinit(self, args, overrides):
        mask, *rows, qpos, qvel, warmstart, sensordata, fault = (np.asarray(a) for a in args)
        lead = mask.shape
        ids = np.flatnonzero(mask)
        if not ids.size:
            return qpos, qvel, warmstart, sensordata, fault
        out = [np.array(x).reshape(mask.size, -1) for x in (qpos, qvel, warmstart, sensordata, fault)]
        with self._lock:
            batch = self._batch(lead, overrides)
            for name, value in zip(_STATE, rows, strict=True):
                getattr(batch, name)[ids] = value.reshape(mask.size, -1)[ids]
            batch.bind("ctrl")[ids] = 0.0
            faults = self._watch(batch, lambda: batch.forward(ids))
            for x, name in zip(out[:4], (*_STATE, "sensordata"), strict=True):
                x[ids] = getattr(batch, name)[ids]
            out[4][ids, 0] = faults[ids]
        return *(x.reshape(*lead, -1) for x in out[:4]), out[4].reshape(lead)

    @staticmethod
    def _watch(batch: Batch, call: Callable[[], None]) -> np.ndarray:
        """Make the call; fault bits [n] from the errors and warnings it caused."""
        before = batch.warning[..., 1].copy()
        failed = np.zeros(batch.nsim, bool)
        try:
            call()
        except SimulationError:  # out of memory for contacts; these keep the state they had
            failed = batch.status != 0
        warned = batch.warning[..., 1] > before
        unstable = warned[:, _BAD].any(1) | ~np.isfinite(batch.qpos).all(1)
        return (UNSTABLE * unstable + OVERFLOW * (failed | warned[:, _FULL].any(1))).astype(np.int32)
