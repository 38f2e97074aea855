"""How fast is it here? Environment against bare engine, in turns, so that ratios hold on busy machines."""

import dataclasses
import math
import time
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax.env import Env
from assistax.errors import UsageError
from assistax.physics import check_faults
from assistax.settings import check_count
from assistax.stamp import peak_memory_mb, stamp
from assistax.training.memory import check_environments, check_memory


def bench(env: Env, num_envs: int, seconds: float = 10.0) -> dict[str, Any]:
    """Open loop: random actions, observations, rewards and auto-reset, in one jitted scan.

    Returns a dict ready for JSON; rates are medians over alternating rounds:
      env_steps_per_s: of the whole environment.
      engine_steps_per_s: control steps/s of the bare engine, same scene, states and kind of actions;
        on the C engine that is `mujoco.batch.Batch.step` itself, without JAX.
      reset_share: the part of the step time that auto-reset takes.
    """
    check_seconds(seconds)
    loop = OpenLoop(env, num_envs)
    rounds, deadline = [], time.perf_counter() + seconds
    while time.perf_counter() < deadline or len(rounds) < 3:
        rounds.append(loop.round())
    rates = {name: np.array([one[name] for one in rounds]) for name in rounds[0]}
    median = {name: float(np.median(values)) for name, values in rates.items()}
    ratio = float(np.median(rates["env"] / rates["engine"]))
    reset = float(np.median(1.0 - rates["env"] / rates["no_reset"]))
    return {
        "task": env.name,
        "engine": env.engine.name,
        "num_envs": num_envs,
        "substeps": env.engine.substeps,
        "env_steps_per_s": round(median["env"]),
        "engine_steps_per_s": round(median["engine"]),
        "env_over_engine": round(ratio, 3),
        "reset_share": round(max(0.0, reset), 3),
        "physics_steps_per_s": round(median["env"] * env.engine.substeps),
        "simulated_seconds_per_s": round(median["env"] * env.dt, 1),
        "compile_s": round(loop.compile_s, 2),
        "first_reset_s": round(loop.started_s, 2),
        "peak_memory_mb": round(peak_memory_mb()),
        "rounds": len(rounds),
        **stamp(),
    }


class OpenLoop:
    """Environments with random actions, beside the same without resets and beside their bare engine, compiled."""

    def __init__(self, env: Env, num_envs: int, steps: int = 20):
        check_count("num_envs", num_envs)
        check_environments(env, num_envs)
        self.env, self.num_envs, self.steps = env, num_envs, steps  # steps of a round
        keys = jax.random.split(jax.random.key(0), num_envs)
        began = time.perf_counter()
        _, self._state = jax.block_until_ready(jax.jit(jax.vmap(env.reset))(keys))
        self.started_s = time.perf_counter() - began
        self._key = jax.random.key(1)
        self._bare = _BareBatch(env, num_envs, self.steps) if env.engine.name == "mujoco" else None
        self._rollouts, self.compile_s = {}, 0.0
        for name, body in self._bodies().items():
            began = time.perf_counter()
            compiled = _rollout(body, self.steps).lower(self._state, self._key).compile()
            self.compile_s = time.perf_counter() - began if name == "env" else self.compile_s
            jax.block_until_ready(compiled(self._state, jax.random.key(0)))
            self._rollouts[name] = compiled

    def round(self) -> dict[str, float]:
        """Control steps/s of "env", "no_reset" and "engine", from the states in which the last round left them."""
        self._key, key = jax.random.split(self._key)
        count, state, rates = self.num_envs * self.steps, self._state, {}
        for name, rollout in self._rollouts.items():
            began = time.perf_counter()
            after, _ = jax.block_until_ready(rollout(state, key))
            rates[name] = count / (time.perf_counter() - began)
            check_faults(int(np.max(after.physics.fault)), self.env.engine.name)
            if name == "env":
                self._state = after
        if self._bare:
            rates["engine"] = count / self._bare.time(state)
        return rates

    def _bodies(self):
        env, num_envs = self.env, self.num_envs
        act = partial(random_actions, env, num_envs)

        def with_reset(state, key):
            actions = act(key)
            obs, state, reward, _, _, info = jax.vmap(env.step)(jax.random.split(key, num_envs), state, actions)
            return state, _used(obs, reward, info)

        def without_reset(state, key):
            actions = act(key)
            obs, state, reward, _, _, info = jax.vmap(env.step_env)(jax.random.split(key, num_envs), state, actions)
            return state, _used(obs, reward, info)

        def engine_only(state, key):
            ctrl = jax.vmap(env.motors.controls)(act(key))
            physics = jax.vmap(env.engine.step)(state.physics, ctrl)
            return dataclasses.replace(state, physics=physics), physics.fault.max()

        bodies = {"env": with_reset, "no_reset": without_reset}
        return bodies if env.engine.name == "mujoco" else bodies | {"engine": engine_only}


def random_actions(env: Env, num_envs: int, key: jax.Array) -> dict[str, jax.Array]:
    """By agent, [num_envs, n] in [-1, 1]."""
    sizes = env.action_sizes.items()
    return {agent: jax.random.uniform(key, (num_envs, n), minval=-1.0, maxval=1.0) for agent, n in sizes}


def _used(obs, reward, info):
    """Depend on everything a user would read, so that none of it is compiled away."""
    sums = jax.tree.map(lambda x: jnp.sum(x, dtype=jnp.float32), (obs, reward, info))
    return sum(jax.tree.leaves(sums))


def _rollout(body, steps: int):
    @jax.jit
    def rollout(state, key):
        return jax.lax.scan(body, state, jax.random.split(key, steps))

    return rollout


class _BareBatch:
    """`mujoco.batch.Batch` alone, with random controls drawn beforehand."""

    def __init__(self, env: Env, num_envs: int, steps: int):
        from mujoco.batch import Batch

        self.batch, self.substeps = Batch(env.model, num_envs, env.config.num_threads), env.engine.substeps
        self.batch.bind("sensordata")
        rng = np.random.default_rng(0)
        actions = {a: jnp.asarray(rng.uniform(-1, 1, (steps, num_envs, n))) for a, n in env.action_sizes.items()}
        self.ctrl = np.asarray(jax.vmap(jax.vmap(env.motors.controls))(actions), np.float64)

    def time(self, state) -> float:
        """Seconds for the steps, from the states of `state`."""
        for name in ("qpos", "qvel", "qacc_warmstart"):
            setattr(self.batch, name, np.asarray(getattr(state.physics, name)))
        began = time.perf_counter()
        for ctrl in self.ctrl:
            self.batch.ctrl = ctrl
            self.batch.step(nstep=self.substeps)
        return time.perf_counter() - began


def check_seconds(seconds: float) -> None:
    """Raise UsageError unless something can be measured in that time."""
    if not 0 < seconds < math.inf:
        raise UsageError(f"seconds must be above 0, not {seconds}.")


def bench_training(
    task: str, engine: str, num_envs: int | None, seconds: float = 10.0, preset: str = "default", num_seeds: int = 1
) -> dict[str, Any]:
    """IPPO as `assistax train` runs it, without evaluations; rates are medians over iterations.

    Args:
      num_envs: per seed; None: the preset's.
      num_seeds: trained side by side on an accelerator, in turns on a CPU.

    Returns a dict ready for JSON; "rollout_steps_per_s" is of environments and policies, without the updates.
    """
    from assistax.training.configuration import configure
    from assistax.training.seeds import Seeds

    check_seconds(seconds)
    config = configure(task, {}, engine=engine, preset=preset, num_envs=num_envs, num_seeds=num_seeds)
    env = Env(config.task, config.engine, config.env, config.task_config)
    trainer, seeds = config.trainer(env, {}), Seeds(config.seeds)
    check_memory(trainer, num_seeds)
    collect, improve = seeds.jit(trainer.collect), seeds.jit(trainer.improve)
    began = time.perf_counter()
    state, _ = jax.block_until_ready(improve(*collect(seeds.init(trainer.init))))
    first_s = time.perf_counter() - began
    times, deadline = [], time.perf_counter() + seconds
    while time.perf_counter() < deadline or len(times) < 3:
        marks = [time.perf_counter()]
        state, batch = jax.block_until_ready(collect(state))
        marks.append(time.perf_counter())
        state, _ = jax.block_until_ready(improve(state, batch))
        times.append(np.diff([*marks, time.perf_counter()]))
    collect_s, improve_s = np.median(times, 0)
    steps = trainer.steps_per_iteration * num_seeds
    return {
        "task": env.name,
        "engine": env.engine.name,
        "preset": preset,
        "num_envs": config.num_envs,
        "num_seeds": num_seeds,
        "training_steps_per_s": round(steps / float(np.median(np.sum(times, 1)))),
        "rollout_steps_per_s": round(steps / float(collect_s)),
        "collect_s": round(float(collect_s), 3),
        "update_s": round(float(improve_s), 3),
        "first_update_s": round(first_s, 1),
        "peak_memory_mb": round(peak_memory_mb()),
        "rounds": len(times),
        **stamp(),
    }
