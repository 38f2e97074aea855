"""Three physics engines behind one protocol, chosen by one word."""

import mujoco

from assistax.errors import UsageError, choose
from assistax.physics.engine import PUSH, UNSTABLE, Engine, PhysicsState, check_faults

ENGINES = {
    "mujoco": "MuJoCo in C on all CPU cores (default without a GPU)",
    "warp": "MJX-Warp, for NVIDIA GPUs (default where one is found; also runs on CPUs, slowly)",
    "mjx": "MJX in pure JAX, for TPUs; version 0 of the tasks only",
}


def resolve_engine(name: str = "auto") -> tuple[str, str]:
    """Return the engine that `name` stands for and, in words, why."""
    import jax

    choose("engine", name, ["auto", *ENGINES])
    platform = jax.default_backend()
    if name != "auto":
        return name, "asked for"
    if platform == "gpu":
        try:
            import warp  # noqa: F401
        except ImportError:
            return "mjx", "JAX sees a GPU, but warp is not installed (pip install 'assistax[warp]')"
        return "warp", "JAX sees a GPU"
    if platform == "tpu":
        return "mjx", "JAX sees a TPU"
    return "mujoco", "JAX sees only the CPU"


def make_engine(
    name: str,
    model: mujoco.MjModel,
    *,
    substeps: int = 4,
    num_threads: int = 0,
    contacts_per_env: int = 24,
    constraints_per_env: int = 96,
) -> Engine:
    """Make the engine called `name`: "auto" or one of ENGINES.

    Args:
      model: the compiled scene; copied, so later changes to it have no effect.
      substeps: physics steps per control step.
      num_threads: threads of the `mujoco` engine; 0 takes every core.
      contacts_per_env: contact buffer of the `warp` engine, per environment.
      constraints_per_env: constraint-row buffer of the `warp` engine, per environment.
    """
    name, _ = resolve_engine(name)
    if substeps < 1:
        raise UsageError(f"substeps must be 1 or more, not {substeps}.")
    if name == "mujoco":
        from assistax.physics.mujoco_c import MujocoEngine

        return MujocoEngine(model, substeps, num_threads)
    from assistax.physics.mjx import MjxEngine, WarpEngine

    if name == "mjx":
        return MjxEngine(model, substeps)
    return WarpEngine(model, substeps, contacts_per_env, constraints_per_env)


__all__ = ["ENGINES", "PUSH", "UNSTABLE", "Engine", "PhysicsState", "check_faults", "make_engine", "resolve_engine"]
