"""Where does the time of a step go? MuJoCo's stages one by one, and what is around the physics."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax.diagnostics.bench import bench, check_seconds, random_actions
from assistax.env import Env
from assistax.errors import UsageError
from assistax.settings import check_count

POSES = 64  # of an episode with random actions, at which the stages are timed
REPEATS = 20
# In MuJoCo's own order. Each may be called again on a state that has passed it, and leaves it as it is.
STAGES: dict[str, tuple[Callable[..., Any], ...]] = {
    "kinematics": (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_camlight),
    "inertia": (mujoco.mj_makeM, mujoco.mj_factorM),
    "collision": (mujoco.mj_collision,),
    "constraint": (mujoco.mj_makeConstraint, mujoco.mj_transmission, mujoco.mj_projectConstraint),
    "velocity": (mujoco.mj_fwdVelocity,),
    "actuation": (mujoco.mj_fwdActuation, mujoco.mj_fwdAcceleration),
    "solver": (mujoco.mj_fwdConstraint,),
    "sensors": (mujoco.mj_sensorPos, mujoco.mj_sensorVel, mujoco.mj_sensorAcc),
}


def profile(env: Env, num_envs: int, seconds: float = 10.0) -> dict[str, Any]:
    """Microseconds on one core by stage of a physics step, and on this machine by part of a control step.

    Args:
      env: of the mujoco engine.
      num_envs: stepped side by side, for the parts of the control step.
      seconds: to measure for, after compilation.

    Returns a dict ready for JSON: "physics_step_us" by stage, with "integration" the rest of it, "contacts" and
    "constraints" on average, and "control_step_us" by part: "physics" is the bare engine's, "transfer" to the engine
    and back, "reset" the automatic one, "task" all the rest: observation, reward, outcomes, harm.

    Raises:
      UsageError: another engine.
    """
    check_count("num_envs", num_envs)
    check_seconds(seconds)
    if env.engine.name != "mujoco":
        raise UsageError(f"A profile is of the mujoco engine's stages, and this environment has {env.engine.name}.")
    stages, contacts, constraints = stage_times(env)
    report = bench(env, num_envs, seconds / 2)
    step, bare = (1e6 / report[name] for name in ("env_steps_per_s", "engine_steps_per_s"))
    through_jax = _through_jax(env, num_envs, seconds / 2)
    reset = report["reset_share"] * step
    parts = {"physics": bare, "transfer": max(0.0, through_jax - bare), "reset": reset}
    parts["task"] = max(0.0, step - sum(parts.values()))
    return {
        **{name: report[name] for name in ("task", "engine", "num_envs", "substeps", "env_steps_per_s")},
        "physics_step_us": {name: round(x, 2) for name, x in stages.items()},
        "contacts": round(contacts, 1),
        "constraints": round(constraints, 1),
        "control_step_us": {name: round(x, 2) for name, x in parts.items()},
    }


def stage_times(env: Env) -> tuple[dict[str, float], float, float]:
    """Microseconds by stage, medians over poses of an episode with random actions; contacts and constraints there."""
    model, rng = env.model, np.random.default_rng(0)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    every = max(1, env.config.episode_length // POSES)
    times: dict[str, list[float]] = {name: [] for name in (*STAGES, "step")}
    found: list[tuple[int, int]] = []
    nothing = _seconds(mujoco.mj_tendon, model, data)  # there is none: what calling from Python takes
    for _ in range(POSES):
        for _ in range(every):
            actions = {agent: jnp.asarray(rng.uniform(-1, 1, size)) for agent, size in env.action_sizes.items()}
            data.ctrl = np.asarray(env.motors.controls(actions))
            mujoco.mj_step(model, data, env.engine.substeps)
        mujoco.mj_forward(model, data)
        found.append((data.ncon, data.nefc))
        for name, calls in STAGES.items():
            times[name].append(sum(_seconds(call, model, data) - nothing for call in calls))
        again = mujoco.MjData(model)
        mujoco.mj_copyData(again, model, data)
        times["step"].append(_seconds(mujoco.mj_step, model, again) - nothing)
    median = {name: 1e6 * float(np.median(xs)) for name, xs in times.items()}
    step = median.pop("step")
    contacts, constraints = np.mean(found, 0)
    return median | {"integration": max(0.0, step - sum(median.values()))}, float(contacts), float(constraints)


def _seconds(call: Callable[..., Any], model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Of one call, the least of several: what else the machine does only adds to it."""
    least = np.inf
    for _ in range(REPEATS):
        began = time.perf_counter()
        call(model, data)
        least = min(least, time.perf_counter() - began)
    return least


def _through_jax(env: Env, num_envs: int, seconds: float) -> float:
    """Microseconds per control step of the engine alone as a JAX program calls it, with random actions."""
    steps = 20
    _, state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), num_envs))

    @jax.jit
    def run(physics, key):
        def step(physics, key):
            ctrl = jax.vmap(env.motors.controls)(random_actions(env, num_envs, key))
            physics = jax.vmap(env.engine.step)(physics, ctrl)
            return dataclasses.replace(physics, overrides=state.physics.overrides), physics.qpos.sum()

        return jax.lax.scan(step, physics, jax.random.split(key, steps))

    jax.block_until_ready(run(state.physics, jax.random.key(1)))
    rounds, deadline = [], time.perf_counter() + seconds
    while time.perf_counter() < deadline or len(rounds) < 3:
        began = time.perf_counter()
        jax.block_until_ready(run(state.physics, jax.random.key(len(rounds))))
        rounds.append(time.perf_counter() - began)
    return 1e6 * float(np.median(rounds)) / (num_envs * steps)
