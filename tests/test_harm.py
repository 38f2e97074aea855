"""Harm by hand: filter, clamping, impact, comfort, and what may not count as either."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import assistax
from assistax import scenes
from assistax.evaluation import play, summarize
from assistax.human import harm
from assistax.policies import scripted_team
from assistax.tasks import TaskSpec, register_task, task_spec

DT = 0.008
REGIONS = list(harm.LIMITS)


def after(series, region="forearm"):
    """The state after forces [T] in N on one region."""
    state = harm.begin()
    for newtons in series:
        state = harm.advance(state, jnp.zeros(len(REGIONS)).at[REGIONS.index(region)].set(newtons), DT)
    return state


def filtered(series):
    """The low-pass filter, exactly: a first-order lag between samples that hold."""
    value, values = 0.0, []
    for newtons in np.asarray(series, np.float64):
        value = newtons + (value - newtons) * np.exp(-DT / harm.FILTER_SECONDS)
        values.append(value)
    return np.array(values)


def test_limits_are_the_published_ones():
    table = {name: (limit.clamping, limit.impact) for name, limit in harm.LIMITS.items()}
    assert table["head"] == (65, 90) and table["forearm"] == (160, 220) and table["torso"] == (140, 210)
    assert all(limit.comfort < limit.clamping < limit.impact for limit in harm.LIMITS.values())


@pytest.mark.parametrize("region", REGIONS)
def test_clamping_is_a_long_force_and_not_a_short_one(region):
    limit, steps = harm.LIMITS[region].clamping, int(harm.CLAMPING_SECONDS / DT)
    assert not after([limit + 1] * steps, region).clamped.any()  # half a second is not longer than half a second
    assert after([limit + 1] * (steps + 2), region).clamped.any()
    assert not after(([limit + 1] * steps + [limit - 1]) * 3, region).clamped.any()  # let go in between
    assert not after([limit - 1] * 1000, region).clamped.any()


@pytest.mark.parametrize("region", REGIONS)
def test_impact_is_a_filtered_peak_and_not_one_step_of_it(region):
    limit = harm.LIMITS[region].impact
    for series in ([2.4 * limit], [2.6 * limit], [1.5 * limit] * 2, [1.5 * limit] * 3):
        assert bool(after(series, region).hit.any()) == (filtered(series).max() > limit)
    np.testing.assert_allclose(
        after([100.0, 50.0, 0.0, 70.0]).peak, filtered([100.0, 50.0, 0.0, 70.0]).max(), rtol=1e-6
    )


def test_comfort_counts_time_and_newton_seconds():
    state = after([4.0, 11.0, 30.0, 9.0])
    np.testing.assert_allclose(state.uncomfortable, 2 * DT)
    np.testing.assert_allclose(state.impulse, DT * (1.0 + 20.0), rtol=1e-6)
    forces = jnp.zeros(len(REGIONS)).at[jnp.array([0, 3])].set(jnp.array([8.0, 12.0]))  # head and forearm
    np.testing.assert_allclose(harm.cost(forces, DT), DT * (3.0 + 2.0), rtol=1e-6)
    assert harm.cost(jnp.zeros(len(REGIONS)), DT) == 0.0
    assert harm.harmless(state) and not harm.harmless(after([1000.0] * 5))
    assert harm.outcomes(after([1000.0] * 100))["clamping"] == 1.0


def test_forces_by_region_are_those_of_mujocos_contacts():
    """Of a robot that is put anywhere into the body, from the contact list in float64."""
    assert set(scenes.REGIONS) == set(harm.LIMITS)
    felt = dict.fromkeys(harm.LIMITS, 0)
    for task in ("scratch-v0", "feeding-v0", "bed_bath-v0"):
        scene = dataclasses.replace(task_spec(task).scene, harm=True)
        model = scenes.build(scene, visuals=False).compile()
        data, places = mujoco.MjData(model), scenes.sensor_slices(model)
        rng = np.random.default_rng(0)
        robot = {g for g in range(model.ngeom) if _below(model, model.geom_bodyid[g], model.body("robot").id)}
        of = {
            "head": ["head"],
            "torso": ["chest", "belly"],
            **{name: [f"right_{name}"] for name in ("upper_arm", "forearm", "hand")},
            "left_arm": [f"left_{name}" for name in ("upper_arm", "forearm", "hand")],
        }
        for _ in range(1500):
            data.qpos = model.key("start").qpos
            data.qpos[scenes.qpos_ids(model, scene.arm.joints)] += rng.normal(size=7) * 0.8
            mujoco.mj_forward(model, data)
            forces = []
            for i, contact in enumerate(data.contact):
                wrench = np.zeros(6)
                mujoco.mj_contactForce(model, data, i, wrench)
                forces.append((contact.geom.tolist(), contact.frame.reshape(3, 3).T @ wrench[:3]))
            for region, names in of.items():
                geoms, total = {model.geom(name).id for name in names}, np.zeros(3)
                for (first, second), force in forces:
                    total += force * ((first in robot and second in geoms) * 1.0)
                    total -= force * ((second in robot and first in geoms) * 1.0)
                sensed = data.sensordata[places[f"force_on_{region}"]]
                np.testing.assert_allclose(sensed, total, atol=1e-6 + 1e-6 * np.abs(total).max())
                felt[region] += np.linalg.norm(total) > 1.0
    del felt["left_arm"]  # out of reach of all of them
    assert min(felt.values()) > 0, felt


def _below(model, body, root):
    while body not in (root, 0):
        body = model.body_parentid[body]
    return body == root


def test_an_environment_reports_harm_where_its_scene_measures_it(scratch, registries):
    scene = dataclasses.replace(task_spec("scratch-v0").scene, harm=True)
    spec = TaskSpec("scratch_with_harm", 0, task_spec("scratch-v0").task, scene)
    register_task(spec)
    env = assistax.make("scratch_with_harm", engine="mujoco", episode_length=30)
    plain = play(scratch, scripted_team("random", scratch), 2)
    measured = play(env, scripted_team("random", env), 2)
    np.testing.assert_array_equal(measured["qpos"][:, :20], plain["qpos"])  # sensors do not change the physics
    found = summarize(measured)
    assert set(found["harm"]) == set(harm.OUTCOMES) and found["safe_success_rate"] <= found["success_rate"]
    _, state = env.reset(jax.random.key(0))
    info = env.step(jax.random.key(0), state, {a: jnp.zeros(n) for a, n in env.action_sizes.items()})[-1]
    assert info["cost"] == 0.0 and "cost" not in summarize(plain)
