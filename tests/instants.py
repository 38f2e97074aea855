"""Instants of the newest versions: sensors as MuJoCo has them in float64, and what a task makes of a row of them."""

from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import assistax
from assistax import scenes

DT = 0.008  # s


@cache
def env_of(name):
    return assistax.make(name, engine="mujoco", episode_length=20)


def sensors(env, poses, velocities, forces=None):
    """The scene's sensors by name [n, ...] in float64, from MjData; contact forces as given [n, 3], by name."""
    data, rows = mujoco.MjData(env.model), []
    for qpos, qvel in zip(poses, velocities, strict=True):
        data.qpos, data.qvel = qpos, qvel
        mujoco.mj_forward(env.model, data)
        rows.append(data.sensordata.copy())
    rows = np.array(rows)
    s = {name: rows[:, place] for name, place in scenes.sensor_slices(env.model).items()}
    return s | {name: np.broadcast_to(force, (len(rows), 3)) for name, force in (forces or {}).items()}


def play(env, s, state=None):
    """The task's state after these sensors [n, ...], one a control step."""
    state = env.task.reset(jax.random.key(0)) if state is None else state
    s = {name: jnp.asarray(x, jnp.float32) for name, x in s.items()}
    return jax.lax.scan(lambda state, row: (env.task.advance(row, state), None), state, s)[0]


def repeated(row, steps):
    return {name: np.repeat(x[:1], steps, axis=0) for name, x in row.items()}


def at_rest(name, forces=None):
    env = env_of(name)
    return env, sensors(env, [env.model.key("start").qpos], [np.zeros(env.model.nv)], forces)
