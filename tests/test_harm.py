"""Harm by region of the body, safe success and cost, against MuJoCo's contact list and by hand."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from instants import DT, env_of
from kinematics import solve, touching_pose

from assistax import scenes
from assistax.human import harm
from assistax.training.presets import TASKS


def region_truth(model, data):
    """Largest force [N] by region from MuJoCo's contact list; on the head by where the contacts are.

    And whether these are where friction, which turns a force by up to 17°, cannot make it another of its regions.
    """
    by_geom, places, clear = {}, [], True
    for i in range(data.ncon):
        contact, wrench = data.contact[i], np.zeros(6)
        names = [model.geom(g).name for g in contact.geom]
        robot = [model.body_rootid[model.geom_bodyid[g]] == model.body("robot").id for g in contact.geom]
        skin = [name in scenes.TOUCHED for name in names]
        if not ((skin[0] and robot[1]) or (skin[1] and robot[0])):
            continue
        mujoco.mj_contactForce(model, data, i, wrench)
        force = contact.frame.reshape(3, 3).T @ wrench[:3] * (1 if skin[1] else -1)
        name = names[skin.index(True)]
        by_geom[name] = by_geom.get(name, 0.0) + force
        if name == "head":
            places.append((contact.pos - data.body("head").xpos) @ data.body("head").xmat.reshape(3, 3))
    found = dict.fromkeys(harm.REGIONS, 0.0)
    for name, force in by_geom.items():
        if name == "head":
            x, _, z = np.mean(places, axis=0) / np.linalg.norm(np.mean(places, axis=0))
            region = "neck" if z < -0.8 else "face" if x > 0.5 else "skull"
            clear = abs(np.arccos(x) - np.pi / 3) > 0.3 and abs(np.arccos(-z) - np.arccos(0.8)) > 0.3
        else:
            region = next(region for region, limits in harm.REGIONS.items() if name in limits.geoms)
        found[region] = max(found[region], np.linalg.norm(force))
    return np.array(list(found.values())), clear


@pytest.mark.parametrize("name", TASKS)
def test_all_that_the_robot_can_touch_of_the_person_belongs_to_a_region(name):
    """Cheat: the table of the task is served, and the robot beats what nobody looks at."""
    model = env_of(name).model
    root = {body: model.body(body).id for body in ("robot", "human")}
    mine, theirs = (
        [g for g in range(model.ngeom) if model.body_rootid[model.geom_bodyid[g]] == root[body]] for body in root
    )
    can = {
        model.geom(g).name
        for g in theirs
        for r in mine
        if model.geom_contype[g] & model.geom_conaffinity[r] or model.geom_contype[r] & model.geom_conaffinity[g]
    }
    regions = {geom for limits in harm.REGIONS.values() for geom in limits.geoms} | {"head"}
    assert can and can <= regions


@pytest.mark.parametrize("name", ["scratch", "tooth_brushing"])
def test_forces_by_region_are_those_of_the_contact_list(name):
    env = env_of(name)
    model, key = env.model, jax.random.key(0)
    data, felt = mujoco.MjData(model), set()
    step = jax.jit(lambda state, qpos: harm.forces(env.sensors(env.engine.init(qpos, jnp.zeros(model.nv)))))
    _, state = env.reset(key)
    rng = np.random.default_rng(0)
    base = touching_pose(model) if name == "scratch" else face_pose(model)
    for _ in range(60):
        qpos = base + 0.03 * rng.normal(size=model.nq)
        data.qpos, data.qvel = np.float32(qpos), 0.0
        mujoco.mj_forward(model, data)
        truth, clear = region_truth(model, data)
        got = np.asarray(step(state, jnp.asarray(qpos, jnp.float32)))
        np.testing.assert_allclose(got[:3].max(), truth[:3].max(), rtol=2e-2, atol=2e-2)
        np.testing.assert_allclose(got[3:], truth[3:], rtol=2e-2, atol=2e-2)
        if clear:
            np.testing.assert_allclose(got, truth, rtol=2e-2, atol=2e-2)
            felt |= {region for region, force in zip(harm.REGIONS, truth, strict=True) if force > 1.0}
    assert felt >= ({"forearm"} if name == "scratch" else {"face"})


def face_pose(model):
    """A pose in which the tool presses into the face."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    mouth = data.site("mouth")
    return solve(model, mouth.xpos + 0.005 * mouth.xmat.reshape(3, 3)[:, 0], tolerance=2e-3)


@pytest.mark.parametrize(("newtons", "mm"), [(3.0, 2.4), (40.0, 3.9), (90.0, 4.5)])
def test_skin_gives_way_the_less_the_deeper(newtons, mm):
    """The stick pressed on the forearm with a constant force for 1.2 s: what the page of all tasks says."""
    model = env_of("scratch").model
    data, jac = mujoco.MjData(model), np.zeros((3, model.nv))
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos = touching_pose(model)
    arm, limb, tip = scenes.qpos_ids(model, scenes.PANDA.joints), data.geom("right_forearm"), data.site("tool_tip")
    motors = [model.actuator(joint).id for joint in scenes.PANDA.joints]
    mujoco.mj_forward(model, data)
    for _ in range(600):
        mujoco.mj_jacSite(model, data, jac, None, tip.id)
        axis, way = limb.xmat.reshape(3, 3)[:, 2], limb.xpos - tip.xpos
        way = way - axis * (axis @ way)
        data.ctrl[motors] = newtons * jac[:, arm].T @ way / np.linalg.norm(way) - 8.0 * data.qvel[arm]
        mujoco.mj_step(model, data)
    tool = [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == model.body("tool").id]
    depths = [-contact.dist for contact in data.contact if limb.id in contact.geom and set(tool) & set(contact.geom)]
    assert region_truth(model, data)[0][list(harm.REGIONS).index("forearm")] == pytest.approx(newtons, rel=0.05)
    assert 1e3 * max(depths) == pytest.approx(mm, abs=0.2)


def test_clamping_lasts_impact_peaks_and_cost_is_never_negative():
    """Against NumPy in float64 on random forces."""
    rng, n = np.random.default_rng(1), len(harm.REGIONS)
    comfort, clamping, impact, _ = (np.array([x[i] for x in harm.REGIONS.values()], object) for i in range(4))
    comfort, clamping, impact = (x.astype(float) for x in (comfort, clamping, impact))
    advance, seen = jax.jit(harm.advance, static_argnums=2), set()
    for case in range(12):
        level = rng.uniform(0, 1.6, n) * (clamping if case % 2 else 8.0)
        force = np.abs(level + rng.normal(size=(120, n)) * 3.0) * (rng.random((120, 1)) < (1.0 if case % 4 else 0.9))
        state, low, run, seconds, impulse = harm.begin(), np.zeros(n), np.zeros(n), 0.0, 0.0
        peak, clamped = np.zeros(n), False
        for f in force:
            state = advance(jnp.asarray(f), state, DT)
            low = low + (1 - np.exp(-DT / harm.FILTER_SECONDS)) * (f - low)
            run = np.where(low > clamping, run + 1, 0)
            peak, clamped = np.maximum(peak, low), clamped or (run * DT > 0.5 + 1e-9).any()
            over = np.maximum(f - comfort, 0)
            seconds, impulse = seconds + DT * (over > 0).any(), impulse + DT * over.sum()
            assert float(harm.cost(jnp.asarray(f))) == pytest.approx((over / (clamping - comfort)).sum(), rel=1e-4)
        got = harm.outcomes(state)
        hit = bool((peak > impact).any())
        assert (got["clamping"], got["impact"]) == (clamped, hit) and bool(harm.safe(state)) == (not clamped | hit)
        assert got["seconds_above_comfort"] == pytest.approx(seconds, rel=1e-3)
        assert got["impulse_above_comfort"] == pytest.approx(impulse, rel=1e-3)
        np.testing.assert_allclose([got[f"peak_force_{name}"] for name in harm.REGIONS], peak, rtol=1e-4)
        seen |= {"clamped"} if clamped else {"free"}
    assert seen == {"clamped", "free"}


def test_success_that_harms_is_not_safe():
    env = env_of("tooth_brushing")
    _, state = env.reset(jax.random.key(0))
    state = dataclasses.replace(state, task=dataclasses.replace(state.task, brush_seconds=jnp.float32(3.0)))
    assert env.metrics(state)["safe_success"] == env.metrics(state)["success"] == 1.0
    hurt = dataclasses.replace(state.harm, peak=jnp.zeros(len(harm.REGIONS)).at[0].set(91.0))  # N on the face
    metrics = env.metrics(dataclasses.replace(state, harm=hurt))
    assert metrics["success"] == 1.0 and metrics["safe_success"] == 0.0 and metrics["impact"] == 1.0
    from assistax.evaluation.playing import evaluate
    from assistax.policies import scripted_team

    report = evaluate(env, scripted_team("still", env), 2)
    assert report["safe_success_rate"] == 0.0 and set(report["harm"]) == set(harm.OUTCOMES)


def test_an_episodes_cost_is_the_sum_of_its_steps_costs():
    env = env_of("scratch")
    base = np.float32(touching_pose(env.model, depth=0.02))
    key = jax.random.key(0)
    _, state = env.reset(key)
    physics = env.engine.init(jnp.asarray(base), jnp.zeros(env.model.nv))
    state, step, total = dataclasses.replace(state, physics=physics), jax.jit(env.step_env), 0.0
    for _ in range(5):
        actions = {"robot": jnp.zeros(7), "human": jnp.zeros(3)}
        _, state, _, _, _, info = step(key, state, actions)
        total += float(info["cost"])
        assert float(info["metrics"]["cost"]) == pytest.approx(total, rel=1e-5)
    assert total > 0


def test_a_spoon_against_the_throat_is_felt_there_and_goes_no_further():
    """Pushed against it below the chin with 20 N for a second; until version 2 of feeding it went through."""
    past, radius = {}, 0.04
    for version in (2, 3):
        model = env_of(f"feeding-v{version}").model
        data, tip, jac = mujoco.MjData(model), model.site("tool_tip").id, np.zeros((3, model.nv))
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_kinematics(model, data)
        ahead, torso = data.site("mouth").xmat.reshape(3, 3)[:, 0], data.body("torso")
        throat = torso.xpos + torso.xmat.reshape(3, 3) @ [0.0, 0.0, 0.085]
        data.qpos = solve(model, throat + 0.12 * ahead, tolerance=2e-3)
        arm = scenes.qpos_ids(model, scenes.PANDA.joints)
        motors = [model.actuator(joint).id for joint in scenes.PANDA.joints]
        for _ in range(500):
            mujoco.mj_jacSite(model, data, jac, None, tip)
            data.ctrl[motors] = jac[:, arm].T @ (-20.0 * ahead - 60.0 * jac @ data.qvel)
            mujoco.mj_step(model, data)
        past[version] = (throat - data.site_xpos[tip]) @ ahead
    assert past[2] > radius and past[3] < -radius
    assert 10.0 < np.linalg.norm(data.sensor("robot_force_throat").data) < 30.0
