"""MuJoCo's C engine as pure JAX functions: `mujoco.batch.Batch` inside a `jax.pure_callback`.

The callback receives whole batches (every axis that `vmap` added, flattened), steps them on a
thread pool with the solver run to convergence, and hands back float32. It keeps no state between
calls: the same arguments give the same bits, at any number of threads.
"""

import ctypes
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from assistax.physics.compiled import keep_programs_that_call_back
from assistax.physics.engine import OVERFLOW, PUSH, UNSTABLE, Engine, Overrides, PhysicsState

_STATE = ("qpos", "qvel", "qacc_warmstart")
_FULL = [int(mujoco.mjtWarning.mjWARN_CONTACTFULL), int(mujoco.mjtWarning.mjWARN_CNSTRFULL)]
_BAD = [int(getattr(mujoco.mjtWarning, f"mjWARN_BAD{x}")) for x in ("QPOS", "QVEL", "QACC", "CTRL")]


def _quiet() -> None:
    """MuJoCo writes its warnings into MUJOCO_LOG.TXT in the working directory; here they are faults of a state.

    Its handler is set to a C function that does nothing: one in Python would be called from threads of the pool.
    """
    if mujoco.get_mju_user_warning() is None:
        library = ctypes.CDLL(str(next(Path(mujoco.__file__).parent.glob("*mujoco.*[sd]*"))))
        nothing = ctypes.cast(ctypes.CDLL(None).strlen, ctypes.c_void_p)
        ctypes.c_void_p.in_dll(library, "mju_user_warning").value = nothing.value


class MujocoEngine(Engine):
    """MuJoCo's C engine on the cores of this machine, see `mujoco.batch.Batch`."""

    name = "mujoco"

    def __init__(self, model: mujoco.MjModel, substeps: int = 4, num_threads: int = 0):
        super().__init__(model, substeps)
        keep_programs_that_call_back()
        with suppress(OSError, ValueError, StopIteration):  # then there is a log file
            _quiet()
        self.num_threads = num_threads
        # A callback may come from several threads; a Batch must not.
        self._lock = threading.Lock()
        self._batches: dict[tuple, Batch] = {}

    def step(self, state: PhysicsState, ctrl) -> PhysicsState:
        out = self._call(self._host_step, (*self._rows(state), ctrl), state.overrides)
        return PhysicsState(*out[:4], state.fault | out[4], state.overrides)

    def _start(self, qpos, qvel, overrides: Overrides) -> PhysicsState:
        idle = jnp.zeros(self.model.nv), jnp.zeros(self.model.nu)

        def one(qpos, qvel, overrides):
            return PhysicsState(*self._call(self._host_forward, (qpos, qvel, *idle), overrides), overrides)

        return jax.vmap(one)(qpos, qvel, overrides)

    @staticmethod
    def _rows(state: PhysicsState):
        return tuple(getattr(state, name) for name in _STATE)

    def _call(self, host, args, overrides: Overrides):
        m = self.model
        shapes = [jax.ShapeDtypeStruct((n,), jnp.float32) for n in (m.nq, m.nv, m.nv, m.nsensordata)]
        shapes.append(jax.ShapeDtypeStruct((), jnp.int32))
        return jax.pure_callback(host, shapes, args, overrides, vmap_method="broadcast_all")

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
            rows = batch.bind(name) if name == PUSH else batch.expand(name)
            rows[:] = np.reshape(value, rows.shape)
        return batch

    def _host_step(self, args, overrides):
        return self._host(lambda batch: batch.step(nstep=self.substeps), args, overrides)

    def _host_forward(self, args, overrides):
        return self._host(Batch.forward, args, overrides)

    def _host(self, advance: Callable[[Batch], None], args, overrides):
        began = time.perf_counter()
        *rows, ctrl = (np.asarray(a) for a in args)
        lead = ctrl.shape[:-1]
        with self._lock:
            batch = self._batch(lead, overrides)
            for name, value in zip((*_STATE, "ctrl"), (*rows, ctrl), strict=True):
                setattr(batch, name, value.reshape(batch.nsim, -1))
            faults = self._watch(batch, lambda: advance(batch))
            new = [getattr(batch, name) for name in (*_STATE, "sensordata")]
            out = [x.astype(np.float32).reshape(*lead, x.shape[-1]) for x in new]
            self.seconds += time.perf_counter() - began
            return *out, faults.reshape(lead)

    @staticmethod
    def _watch(batch: Batch, call: Callable[[], None]) -> np.ndarray:
        """Make the call; fault bits [n] from the errors and warnings it caused."""
        batch.warning[...] = 0  # a state that is not finite makes MuJoCo clear them, so that no rise would tell
        failed = np.zeros(batch.nsim, bool)
        try:
            call()
        except SimulationError:  # out of memory for contacts; these keep the state they had
            failed = batch.status != 0
        warned = batch.warning[..., 1] > 0
        unstable = warned[:, _BAD].any(1) | ~np.isfinite(batch.qpos).all(1)
        return (UNSTABLE * unstable + OVERFLOW * (failed | warned[:, _FULL].any(1))).astype(np.int32)
