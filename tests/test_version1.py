"""Version 1 of the tasks: help measured as the body part feels it, against MuJoCo's MjData in float64."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from assistax import scenes
from assistax.physics import make_engine
from assistax.tasks import task_spec

ARM = dataclasses.replace(task_spec("arm_assist-v0").scene, relative_to=("upper_arm", "forearm", "head"))


def velocity(model, data, kind, thing):
    """(linear, angular) [3] of a site's or body's own frame, in world axes."""
    out = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, kind, thing.id, out, 0)
    return out[3:], out[:3]


def seen_from(model, data, part):
    """Velocity [3] of the tool point as a body sees it, in that body's axes: v_tip - v_body - ω_body × r."""
    tip, body = data.site("tool_tip"), data.body(scenes.WORKED_ON[part])
    v_tip, _ = velocity(model, data, mujoco.mjtObj.mjOBJ_SITE, tip)
    v_body, spin = velocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body)
    return body.xmat.reshape(3, 3).T @ (v_tip - v_body - np.cross(spin, tip.xpos - body.xpos))


@pytest.mark.parametrize("name", ["mujoco", *(pytest.param(one, marks=pytest.mark.slow) for one in ("warp", "mjx"))])
def test_relative_velocities_are_those_of_the_formula(name):
    model = scenes.build(ARM, visuals=False).compile()
    engine, places = make_engine(name, model), scenes.sensor_slices(model)
    rng = np.random.default_rng(0)
    qpos = model.key("start").qpos + rng.normal(size=(4, model.nq)) * 0.1
    qvel = rng.normal(size=(4, model.nv)) * 2.0
    sensed = jax.jit(jax.vmap(engine.init))(jnp.asarray(qpos), jnp.asarray(qvel)).sensordata
    data = mujoco.MjData(model)
    for q, v, row in zip(qpos, qvel, np.asarray(sensed), strict=True):
        data.qpos, data.qvel = q, v
        mujoco.mj_forward(model, data)
        for part in ARM.relative_to:
            np.testing.assert_allclose(row[places[f"tool_vel_{part}"]], seen_from(model, data, part), atol=2e-4)
        wrist, _ = velocity(model, data, mujoco.mjtObj.mjOBJ_SITE, data.site("wrist_target"))
        np.testing.assert_allclose(row[places["wrist_target_vel"]], wrist, atol=2e-4)
