"""The three engines: against MuJoCo, against each other, and when things go wrong."""

import dataclasses
import sys
from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from kinematics import touching_pose

from assistax import scenes
from assistax.errors import SimulationError
from assistax.physics import PUSH, check_faults, make_engine, resolve_engine
from assistax.physics.engine import OVERFLOW, UNSTABLE
from assistax.tasks import task_spec


@pytest.fixture(scope="module")
def model():
    return scenes.build(task_spec("scratch-v0").scene, visuals=False).compile()


@pytest.fixture(scope="module")
def engine(model):
    return make_engine("mujoco", model)


@pytest.fixture(scope="module")
def warp(model):
    return make_engine("warp", model)


@cache
def started(engine):
    """`init` of a batch, compiled once."""
    return jax.jit(jax.vmap(engine.init))


@pytest.fixture(scope="module")
def pressing(model):
    """(qpos [2, nq], ctrl [50, 2, nu]): the tool presses on either arm segment with 8 N and a little wavering."""
    poses = [touching_pose(model, body) for body in ("right_forearm", "right_upper_arm")]
    # A joint exactly at its limit is on either side of it, depending on the engine's rounding.
    poses = [np.minimum(pose, model.jnt_range[:, 1]) + 1e-4 * (pose - model.jnt_range[:, 0] < 1e-5) for pose in poses]
    rng = np.random.default_rng(0)
    robot = model.nu - 7
    ctrl = rng.uniform(-0.2, 0.2, (50, 2, model.nu))
    data, jac = mujoco.MjData(model), np.zeros((3, model.nv))
    ids = scenes.qpos_ids(model, scenes.PANDA.joints)
    for i, pose in enumerate(poses):
        data.qpos = pose
        mujoco.mj_forward(model, data)
        mujoco.mj_jacSite(model, data, jac, None, model.site("tool_tip").id)
        body = data.body(("right_forearm", "right_upper_arm")[i])
        inward = data.geom_xpos[model.geom(body.name).id] - data.site("tool_tip").xpos
        ctrl[:, i, robot:] += 8.0 * jac[:, ids].T @ inward / np.linalg.norm(inward)
    return jnp.asarray(np.array(poses), jnp.float32), jnp.asarray(ctrl, jnp.float32)


def run(engine, qpos, ctrl, overrides=None):
    """First sensordata [n, ...], qpos and sensordata [T, n, ...] of an open-loop run; the last state."""
    state = started(engine)(qpos, jnp.zeros_like(qpos), overrides or {})
    first = state.sensordata

    def step(state, ctrl):
        state = jax.vmap(engine.step)(state, ctrl)
        return state, (state.qpos, state.sensordata)

    state, out = jax.jit(lambda s, c: jax.lax.scan(step, s, c))(state, ctrl)
    return first, *map(np.asarray, out), state


def forces(model, sensordata):
    place = scenes.sensor_slices(model)
    return np.stack([np.linalg.norm(sensordata[..., place[n]], axis=-1) for n in ("tool_force", "robot_force")], -1)


def test_c_engine_is_mujoco_to_the_bit(model, engine, pressing):
    qpos, ctrl = pressing
    _, got_qpos, got_sensors, _ = run(engine, qpos, ctrl[:5])
    for env in range(2):
        data = mujoco.MjData(model)
        data.qpos = qpos[env]
        mujoco.mj_forward(model, data)
        for t in range(5):
            # The state travels as float32 between control steps.
            for name in ("qpos", "qvel", "qacc_warmstart"):
                setattr(data, name, getattr(data, name).astype(np.float32))
            data.ctrl = ctrl[t, env]
            for _ in range(4):
                mujoco.mj_step(model, data)
            np.testing.assert_array_equal(got_qpos[t, env], data.qpos.astype(np.float32))
            np.testing.assert_array_equal(got_sensors[t, env], data.sensordata.astype(np.float32))


@pytest.mark.parametrize("steps", [8, pytest.param(50, marks=pytest.mark.slow)])
def test_warp_agrees_with_c_in_contact(model, engine, warp, pressing, steps):
    qpos, ctrl = pressing
    first_c, qpos_c, sensors_c, _ = run(engine, qpos, ctrl[:steps])
    first_w, qpos_w, sensors_w, state = run(warp, qpos, ctrl[:steps])
    force_c, force_w = forces(model, sensors_c), forces(model, sensors_w)
    assert (force_c[..., 0] > 0.5).mean() > 0.3  # the tool does touch
    np.testing.assert_allclose(first_w, first_c, atol=2e-3 * np.abs(first_c).max())
    np.testing.assert_allclose(qpos_w, qpos_c, atol=1e-3)
    np.testing.assert_allclose(force_w, force_c, atol=0.05 * force_c.max())
    check_faults(state.fault, "warp")


def test_mjx_reads_the_forces_that_mujoco_has(model, pressing):
    """From the same contacts: compiling all of MJX takes minutes, so that its steps are compared in slow tests."""
    from mujoco import mjx  # takes seconds, which no other file needs

    engine, data = make_engine("mjx", model), mujoco.MjData(model)
    for qpos in np.asarray(pressing[0]):
        data.qpos = qpos
        mujoco.mj_forward(model, data)
        read, _ = engine._read(mjx.put_data(model, data, impl="jax"))
        for name in ("tool_force", "robot_force"):
            place = scenes.sensor_slices(model)[name]
            assert np.linalg.norm(data.sensordata[place]) > 0.5
            np.testing.assert_allclose(read[place], data.sensordata[place], rtol=1e-4, atol=1e-3)


def test_a_push_is_mujocos_to_the_bit(model, engine):
    """On one of two environments, and gone when it is taken out."""
    push = np.zeros((2, model.nbody, 6), np.float32)
    push[0, model.body("right_forearm").id] = 0.0, 5.0, -10.0, 0.1, 0.0, 0.2
    start, ctrl = jnp.tile(jnp.asarray(model.key("start").qpos, jnp.float32), (2, 1)), jnp.zeros((2, model.nu))
    state = jax.vmap(engine.init)(start, 0 * start)
    step = jax.jit(jax.vmap(engine.step))
    pushed = step(dataclasses.replace(state, overrides={PUSH: jnp.asarray(push)}), ctrl)
    for env in range(2):
        data = mujoco.MjData(model)
        data.qpos, data.xfrc_applied = start[env], push[env]
        data.qacc_warmstart = state.qacc_warmstart[env]
        for _ in range(4):
            mujoco.mj_step(model, data)
        np.testing.assert_array_equal(pushed.qvel[env], data.qvel.astype(np.float32))
    assert np.abs(pushed.qvel[0] - pushed.qvel[1]).max() > 0.01
    np.testing.assert_array_equal(step(state, ctrl).qvel[0], pushed.qvel[1])


@pytest.mark.parametrize("name", ["mujoco", "warp"])
def test_joint_limits_and_strength_per_environment(model, name):
    """The same model, actions and start; one person is strong, one weak, one cannot bend the elbow."""
    engine = make_engine(name, model)
    start = jnp.asarray(model.key("start").qpos, jnp.float32)
    elbow = model.joint("right_elbow").id
    q = int(model.jnt_qposadr[elbow])
    gain = np.tile(model.actuator_gainprm, (3, 1, 1)).astype(np.float32)
    gain[1, :, 0] = 0.0
    ranges = np.tile(model.jnt_range, (3, 1, 1)).astype(np.float32)
    ranges[2, elbow] = start[q] - 0.01, start[q] + 0.01
    overrides = {"actuator_gainprm": jnp.asarray(gain), "jnt_range": jnp.asarray(ranges)}
    ctrl = jnp.zeros(model.nu).at[model.actuator("right_elbow").id].set(1.0)
    state = jax.jit(jax.vmap(engine.init, (None, None, 0)))(start, jnp.zeros(model.nv), overrides)
    state = jax.jit(lambda s: jax.lax.fori_loop(0, 40, lambda _, s: jax.vmap(engine.step, (0, None))(s, ctrl), s))(
        state
    )
    bent = np.abs(np.asarray(state.qpos[:, q]) - float(start[q]))
    assert bent[0] > 0.3 and bent[1] < 0.02 and bent[2] < 0.1


def test_reinit_touches_only_the_masked(engine, warp, pressing):
    for candidate in (engine, warp):
        qpos, ctrl = (jnp.tile(x, (1,) * (x.ndim - 2) + (20, 1)) for x in pressing)
        step = jax.jit(jax.vmap(candidate.step))
        state = step(started(candidate)(qpos, 0 * qpos, {}), ctrl[0])
        mask = jnp.arange(40) % 7 == 3
        fresh = started(candidate)(qpos + 0.01, 0 * qpos, {})
        after = jax.jit(jax.vmap(candidate.reinit, (0, 0, 0, 0, None)))(state, mask, qpos + 0.01, 0 * qpos, {})
        for name in ("qpos", "qvel", "qacc_warmstart", "sensordata", "fault"):
            old, new, got = (np.asarray(getattr(s, name)) for s in (state, fresh, after))
            np.testing.assert_array_equal(got[~mask], old[~mask])
            np.testing.assert_allclose(got[mask], new[mask], rtol=1e-4, atol=1e-2 * np.abs(new).max())


def test_nested_vmap_equals_flat_in_every_engine(engine, warp, pressing):
    qpos, ctrl = pressing
    for candidate in (engine, warp):
        state = started(candidate)(qpos, 0 * qpos, {})
        flat = jax.jit(jax.vmap(candidate.step))(state, ctrl[0])
        fold = lambda tree: jax.tree.map(lambda x: x[:, None], tree)  # noqa: E731
        nested = jax.jit(jax.vmap(jax.vmap(candidate.step)))(fold(state), fold(ctrl[0]))
        np.testing.assert_allclose(nested.qpos[:, 0], flat.qpos, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "buffers", "setting"),
    [
        ("warp", {"contacts_per_env": 1}, "contacts_per_env"),
        ("warp", {"constraints_per_env": 3}, "constraints_per_env"),
        ("mujoco", {}, "memory"),
    ],
)
def test_lost_contacts_are_an_error_that_names_the_setting(pressing, name, buffers, setting):
    qpos, _ = pressing
    spec = scenes.build(task_spec("scratch-v0").scene, visuals=False)
    if name == "mujoco":
        spec.memory = 12_000
    engine = make_engine(name, spec.compile(), **buffers)
    state = jax.vmap(engine.init)(qpos, 0 * qpos)
    assert (np.asarray(state.fault) & OVERFLOW).any()
    with pytest.raises(SimulationError, match=setting):
        check_faults(state.fault, name)


@pytest.mark.parametrize(
    ("platform", "there", "engine"),
    [("cpu", True, "mujoco"), ("gpu", True, "warp"), ("gpu", False, "mjx"), ("tpu", True, "mjx")],
)
def test_auto_takes_what_fits(platform, there, engine, monkeypatch):
    monkeypatch.setattr("jax.default_backend", lambda: platform)
    if not there:
        monkeypatch.setitem(sys.modules, "warp", None)
    assert resolve_engine("auto")[0] == engine


@pytest.mark.parametrize("name", ["mujoco", "warp"])
def test_a_state_that_is_not_finite_is_an_error(model, name):
    engine = make_engine(name, model)
    start = jnp.asarray(model.key("start").qpos, jnp.float32)
    state = jax.vmap(engine.init)(jnp.stack([start, start]), jnp.zeros((2, model.nv)))
    qvel = state.qvel.at[1, 3].set(jnp.nan)
    state = dataclasses.replace(state, qvel=qvel)
    fault = np.asarray(jax.jit(jax.vmap(engine.step))(state, jnp.zeros((2, model.nu))).fault)
    assert fault[0] == 0 and fault[1] & UNSTABLE
    with pytest.raises(SimulationError, match="non-finite in 1 of 2"):
        check_faults(fault, name)
    again = np.asarray(jax.jit(jax.vmap(engine.step))(state, jnp.zeros((2, model.nu))).fault)
    assert again[0] == 0 and again[1] & UNSTABLE  # not the first time alone
