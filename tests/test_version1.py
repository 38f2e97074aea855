"""Version 1 of the tasks: help measured as the body part feels it, against MuJoCo's MjData in float64."""

import dataclasses
from functools import cache

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from kinematics import solve, touching_pose

import assistax
from assistax import scenes
from assistax.errors import UsageError
from assistax.human import harm
from assistax.physics import make_engine
from assistax.tasks import task_spec

ARM = dataclasses.replace(task_spec("arm_assist-v0").scene, worked_on=("upper_arm", "forearm", "head"))


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
        for part in ARM.worked_on:
            np.testing.assert_allclose(row[places[f"tool_vel_{part}"]], seen_from(model, data, part), atol=2e-4)
        wrist, _ = velocity(model, data, mujoco.mjtObj.mjOBJ_SITE, data.site("wrist_target"))
        np.testing.assert_allclose(row[places["wrist_target_vel"]], wrist, atol=2e-4)


DT = 0.008  # s


@cache
def env_of(name):
    return assistax.make(f"{name}-v1", engine="mujoco", episode_length=20)


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


def test_a_bare_name_is_version_1_and_its_packaged_team_the_newest_there_is():
    from assistax.training.team_file import TRAINED, trained_file

    for name in ("scratch", "bed_bath", "arm_assist", "feeding", "tooth_brushing"):
        assert task_spec(name).id == f"{name}-v1"
        newest = max((1, 0), key=lambda version: ((TRAINED / f"{name}-v{version}.safetensors").exists(), version))
        assert trained_file(name) == TRAINED / f"{name}-v{newest}.safetensors"
        assert trained_file(f"{name}-v0") == TRAINED / f"{name}-v0.safetensors"


# -- scratch ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("distance", "speed", "force", "counts"),
    [(0.03, 0.1, 3.0, True), (0.05, 0.1, 3.0, False), (0.03, 0.02, 3.0, False), (0.03, 0.4, 3.0, False),
     (0.03, 0.1, 0.5, False), (0.03, 0.1, 7.0, False)],
)  # fmt: skip
def test_scratching_is_near_the_itch_firm_and_moving(distance, speed, force, counts):
    env, s = at_rest("scratch")
    state = dataclasses.replace(env.task.reset(jax.random.key(0)), segment=jnp.int32(1))
    frame = np.asarray(scenes.geometry.matrix(jnp.asarray(s["forearm_quat"][0])))
    s["tool_pos"] = s["forearm_pos"] + frame @ np.asarray(state.itch) + [0, 0, distance]
    s["tool_vel_forearm"] = np.array([[0, speed, 0.0]])
    s["tool_force_forearm"] = s["tool_force"] = np.array([[0, 0, force]])
    assert bool(play(env, s, state).scratch_seconds > 0) == counts
    s |= {"tool_force_forearm": np.zeros((1, 3)), "tool_force_upper_arm": np.array([[0, 0, force]])}
    assert play(env, s, state).scratch_seconds == 0  # the stick is on the other segment


def test_the_wrong_side_of_the_arm_does_not_itch():
    """The stick on the far side of the forearm, which version 0 took for the itch 6 cm away."""
    env, s = at_rest("scratch")
    limb = scenes.geometry.capsule(env.model, "right_forearm")
    normal = np.cross(limb.axis, [1.0, 0, 0])
    normal /= np.linalg.norm(normal)
    state = env.task.reset(jax.random.key(0))
    itch = limb.centre + limb.radius * normal
    state = dataclasses.replace(state, segment=jnp.int32(1), itch=jnp.asarray(itch, jnp.float32))
    frame = np.asarray(scenes.geometry.matrix(jnp.asarray(s["forearm_quat"][0])))
    s["tool_vel_forearm"], s["tool_force_forearm"] = np.array([[0, 0.1, 0.0]]), np.array([[0, 0, 3.0]])
    for side, counts in ((1.0, True), (-1.0, False)):
        s["tool_pos"] = s["forearm_pos"] + frame @ (limb.centre + side * limb.radius * normal)
        assert bool(play(env, s, state).scratch_seconds > 0) == counts


def test_itches_are_uniform_over_all_of_the_skin_between_shoulder_and_wrist():
    env, _ = at_rest("scratch")
    states = jax.vmap(env.task.reset)(jax.random.split(jax.random.key(0), 4000))
    height, angle = jax.vmap(env.task.place)(states)
    limbs = [scenes.geometry.capsule(env.model, f"right_{part}") for part in ("upper_arm", "forearm")]
    for x, span in ((np.asarray(height), 1.0), (np.asarray(angle), np.pi)):
        counts, _ = np.histogram(x, 8, (-span, span))
        assert counts.sum() == 4000 and abs(counts - 500).max() < 100
    skin = np.array([limb.radius * limb.half_length for limb in limbs])
    assert np.mean(states.segment) == pytest.approx(skin[1] / skin.sum(), abs=0.03)
    for i in range(20):
        limb, itch = limbs[int(states.segment[i])], np.asarray(states.itch[i], float)
        along = (itch - limb.centre) @ limb.axis
        assert np.linalg.norm(itch - limb.centre - along * limb.axis) == pytest.approx(limb.radius, abs=1e-6)
        assert along / limb.half_length == pytest.approx(float(height[i]), abs=1e-5)


def around(env, s, body, point):
    """The outward normal [3] at a place [3] on the skin of a limb, in world axes, and the way to it from the tool in m:
    straight, and then around the limb from the side that the tool is on."""
    data = mujoco.MjData(env.model)
    data.qpos = env.model.key("start").qpos
    mujoco.mj_forward(env.model, data)
    limb, body = scenes.geometry.capsule(env.model, body), data.body(body)
    frame = body.xmat.reshape(3, 3)
    flat = np.eye(3) - np.outer(limb.axis, limb.axis)
    normal, tool = (flat @ (x - limb.centre) for x in (point, frame.T @ (s["tool_pos"][0] - body.xpos)))
    angle = np.arccos(np.clip(normal @ tool / np.linalg.norm(normal) / np.linalg.norm(tool), -1, 1))
    straight = np.linalg.norm(s["tool_pos"][0] - body.xpos - frame @ point)
    return frame @ normal / limb.radius, straight + limb.radius * angle


@pytest.mark.parametrize("place", range(6))
def test_the_side_of_an_itch_is_seen_and_reach_leads_around_the_arm_to_it(place):
    env, s = at_rest("scratch")
    state = env.task.reset(jax.random.key(place))
    body = ("right_upper_arm", "right_forearm")[int(state.segment)]
    off = np.random.default_rng(place).normal(size=3) * 0.2
    s["tool_pos"] = s["tool_pos"] * 0.0 + np.asarray(s[f"{body.removeprefix('right_')}_pos"]) + off
    normal, way = around(env, s, body, np.asarray(state.itch, float))
    now = {name: jnp.asarray(x[0], jnp.float32) for name, x in s.items()}
    np.testing.assert_allclose(env.task.observe(now, state)["target_normal"], normal, atol=1e-5)
    assert float(env.task.reward_terms(now, state)["reach"]) == pytest.approx(np.exp(-(way**2) / 0.1), abs=1e-5)


def test_the_other_side_of_the_arm_is_paid_much_less_for_being_near():
    """The stick on the skin opposite the itch: straight through the arm it would be paid 0.9."""
    env, s = at_rest("scratch")
    limb = scenes.geometry.capsule(env.model, "right_upper_arm")
    state = dataclasses.replace(env.task.reset(jax.random.key(0)), segment=jnp.int32(0))
    normal = np.cross(limb.axis, [1.0, 0, 0]) / np.linalg.norm(np.cross(limb.axis, [1.0, 0, 0]))
    state = dataclasses.replace(state, itch=jnp.asarray(limb.centre + limb.radius * normal, jnp.float32))
    frame = np.asarray(scenes.geometry.matrix(jnp.asarray(s["upper_arm_quat"][0])))
    paid = []
    for side in (1.0, -1.0):
        s["tool_pos"] = s["upper_arm_pos"] + frame @ (limb.centre + side * limb.radius * normal)
        now = {name: jnp.asarray(x[0], jnp.float32) for name, x in s.items()}
        paid.append(float(env.task.reward_terms(now, state)["reach"]))
    assert paid[0] == pytest.approx(1.0, abs=1e-4) and paid[1] < 0.7


# -- bed bath --------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", range(4))
def test_the_nearest_dirt_is_the_nearest_around_the_arm(place):
    env, s = at_rest("bed_bath")
    state = env.task.reset(jax.random.key(place))
    s["tool_pos"] = s["forearm_pos"] + np.random.default_rng(place).normal(size=3) * 0.1
    bodies = ["right_upper_arm"] * 29 + ["right_forearm"] * 23
    points = np.concatenate([np.asarray(x, float) for x in env.task.points])
    normals, ways = zip(*(around(env, s, body, point) for body, point in zip(bodies, points, strict=True)), strict=True)
    nearest = np.where(np.asarray(state.visited), np.inf, ways).argmin()
    now = {name: jnp.asarray(x[0], jnp.float32) for name, x in s.items()}
    np.testing.assert_allclose(env.task.observe(now, state)["target_normal"], normals[nearest], atol=1e-5)
    reach = env.task.reward_terms(now, state)["reach"]
    assert float(reach) == pytest.approx(np.exp(-(ways[nearest] ** 2) / 0.1), abs=1e-5)


def dirty_all_over(env):
    state = env.task.reset(jax.random.key(0))
    return dataclasses.replace(state, dirty=jnp.ones(52, bool), visited=jnp.zeros(52, bool))


def washing(env, s, point, force=5.0, speed=0.1):
    frame = np.asarray(scenes.geometry.matrix(jnp.asarray(s["forearm_quat"][0])))
    s = dict(s)
    s["tool_pos"] = s["forearm_pos"] + frame @ np.asarray(env.task.points[1][point])
    s["tool_force_forearm"], s["tool_vel_forearm"] = np.array([[0, 0, force]]), np.array([[speed, 0, 0.0]])
    return s


def test_a_point_is_washed_after_80_ms_of_rubbing_and_one_touch_of_the_pad_washes_none():
    env, s = at_rest("bed_bath")
    rub, all_dirty = washing(env, s, 4), dirty_all_over(env)
    assert not play(env, repeated(rub, 1), all_dirty).visited.any()  # one 8 ms contact, eleven points in version 0
    nine = play(env, repeated(rub, 9), all_dirty)
    assert not nine.visited.any()
    ten = play(env, rub, nine)
    far = np.linalg.norm(np.asarray(env.task.to_points({k: jnp.asarray(x[0]) for k, x in rub.items()})), axis=1)
    np.testing.assert_array_equal(np.flatnonzero(ten.visited), [i for i in range(29, 52) if far[i] < 0.05])
    assert ten.newly == ten.visited.sum() > 0 and play(env, rub, ten).newly == 0
    for force, speed in ((0.4, 0.1), (16.0, 0.1), (5.0, 0.01), (5.0, 1.2)):
        assert not play(env, repeated(washing(env, s, 4, force, speed), 50), all_dirty).visited.any()


def test_bath_points_lie_evenly_all_around_both_segments():
    env, _ = at_rest("bed_bath")
    areas = []
    for body, points, normals in zip(
        ("right_upper_arm", "right_forearm"), env.task.points, env.task.normals, strict=True
    ):
        limb = scenes.geometry.capsule(env.model, body)
        off = np.asarray(points, float) - limb.centre
        height = off @ limb.axis
        square = off - height[:, None] * limb.axis
        np.testing.assert_allclose(np.linalg.norm(square, axis=1), limb.radius, atol=1e-6)
        np.testing.assert_allclose(square / limb.radius, normals, atol=1e-5)
        assert np.abs(height).max() < limb.half_length
        apart = np.linalg.norm(off[:, None] - off, axis=-1) + np.eye(len(off))
        assert apart.min() > 0.03 and apart.min(1).max() < 0.055
        # Nowhere on the skin is a point further than 5 cm.
        turns, along = np.meshgrid(np.linspace(0, 2 * np.pi, 40), np.linspace(-1, 1, 20) * limb.half_length)
        other = np.cross(limb.axis, square[0] / limb.radius)
        around = np.cos(turns)[..., None] * square[0] + np.sin(turns)[..., None] * limb.radius * other
        skin = along[..., None] * limb.axis + around
        assert np.linalg.norm(skin[:, :, None] - off, axis=-1).min(-1).max() < 0.05
        areas.append(limb.radius * limb.half_length / len(off))
    assert max(areas) < 1.05 * min(areas)


def test_a_third_of_the_arm_is_dirty_on_a_side_that_the_reset_draws_and_the_rest_counts_for_nothing():
    env, s = at_rest("bed_bath")
    states = jax.vmap(env.task.reset)(jax.random.split(jax.random.key(0), 500))
    dirty = np.asarray(states.dirty)
    assert (dirty.sum(1) >= 14).all() and (dirty.sum(1) <= 21).all()
    assert np.abs(dirty.mean(0) - 1 / 3).max() < 0.1  # every place as often
    assert (states.visited == ~dirty).all()
    bodies = np.concatenate([np.asarray(x) for x in env.task.normals])
    for row in dirty[:20]:
        for of in (env.task.segment == 0, env.task.segment == 1):  # all within 120°, so none is opposite another
            assert (bodies[of & row] @ bodies[of & row].T).min() >= -0.5 - 1e-5
    state = jax.tree.map(lambda x: x[0], states)
    assert env.task.outcomes(state)["fraction_visited"] == 0 and not env.task.success(state)
    clean = int(np.flatnonzero(~dirty[0] & (env.task.segment == 1))[0]) - 29
    after = play(env, repeated(washing(env, s, clean), 50), state)
    assert after.visited.sum() - state.visited.sum() == (after.visited & dirty[0]).sum()
    washed = dataclasses.replace(state, visited=jnp.ones(52, bool), newly=jnp.int32(dirty[0].sum()))
    terms = env.task.reward_terms({k: jnp.asarray(x[0], jnp.float32) for k, x in s.items()}, washed)
    assert terms["wipe"] == pytest.approx(624.0)  # whatever was dirty
    assert env.task.success(washed)


def test_a_bath_that_is_done_pays_the_rest_of_the_episode():
    env = env_of("bed_bath")
    _, state = env.reset(jax.random.key(0))
    done = dataclasses.replace(state.task, visited=jnp.ones(52, bool))
    actions = {agent: jnp.zeros(n) for agent, n in env.action_sizes.items()}
    step = jax.jit(env.step_env)
    for t in (0, 12, 19):
        late = dataclasses.replace(state, t=jnp.int32(t))
        one = step(jax.random.key(0), late, actions)[-1]["reward_terms"]
        _, _, rewards, terminated, _, info = step(jax.random.key(0), dataclasses.replace(late, task=done), actions)
        assert terminated["__all__"]
        every = env.task.reward_terms(env.sensors(step(jax.random.key(0), late, actions)[1].physics), done)
        np.testing.assert_allclose(info["reward_terms"]["reach"], (20 - t) * every["reach"], rtol=1e-5)
        assert one["reach"] <= 1.0 and rewards["robot"] <= 20 - t + 1e-5


# -- arm assist ------------------------------------------------------------------------------------


def test_the_arm_must_be_carried_to_the_waist_and_lie_still_there():
    env, s = at_rest("arm_assist")
    there = s | {"wrist_target_pos": s["waist_target_pos"] + [0, 0.05, 0]}

    def arm(where, speed, steps):
        return repeated(where | {"wrist_target_vel": np.array([[0, speed, 0.0]])}, steps)

    def seconds(*moves):
        state = None
        for move in moves:
            state = play(env, arm(*move), state)
        return float(state.seconds_at_waist)

    assert seconds((s, 0.3, 50), (there, 0.05, 63)) == pytest.approx(63 * DT, rel=1e-4)
    assert seconds((there, 0.2, 63)) == 0.0  # passing by
    assert seconds((s, 0.9, 5), (there, 0.05, 500)) == 0.0  # thrown
    assert seconds((s, 0.3, 5), (there, 0.9, 5), (there, 0.05, 500)) == 0.0  # dropped
    assert seconds((s, 0.9, 5), (s, 0.05, 1), (s, 0.3, 50), (there, 0.05, 10)) > 0  # laid down, then carried
    assert bool(env.task.success(play(env, arm(there, 0.05, 63))))
    assert not bool(env.task.success(play(env, arm(there, 0.05, 62))))


def test_the_hook_is_led_to_where_the_forearm_lies_free():
    """7.5 cm from its middle toward the hand; the mattress is below its middle."""
    env, s = at_rest("arm_assist")
    wrist = np.asarray(s["wrist_target_pos"][0], float)
    axis = np.zeros(9)
    mujoco.mju_quat2Mat(axis, np.asarray(s["wrist_target_quat"][0], float))
    axis = axis.reshape(3, 3)[:, 2]  # to the elbow
    assert axis @ (np.asarray(s["upper_arm_pos"][0], float) - wrist) > 0.0
    place = wrist - 0.075 * axis
    for tool in (place, place + 0.06, wrist, wrist + 0.1):
        now = {name: jnp.asarray(x[0], jnp.float32) for name, x in (s | {"tool_pos": tool[None]}).items()}
        terms = env.task.reward_terms(now, env.task.reset(jax.random.key(0)))
        assert float(terms["reach"]) == pytest.approx(np.exp(-((tool - place) @ (tool - place)) / 0.1), abs=1e-5)


def test_the_robot_starts_beside_the_arm_with_its_hook_turned_to_it():
    _, s = at_rest("arm_assist")
    frames = np.zeros((2, 9))
    for frame, name in zip(frames, ("tool_quat", "wrist_target_quat"), strict=True):
        mujoco.mju_quat2Mat(frame, np.asarray(s[name][0], float))
    turned = frames[0].reshape(3, 3).T @ frames[1].reshape(3, 3)
    assert np.trace(turned) > 2.9
    wrist, waist, tool = (
        np.asarray(s[name][0], float) for name in ("wrist_target_pos", "waist_target_pos", "tool_pos")
    )
    away = (wrist - waist) * [1, 1, 0]
    assert (tool - wrist) @ away / np.linalg.norm(away) > 0.15 and 0.0 < tool[2] - wrist[2] < 0.1


# -- feeding ---------------------------------------------------------------------------------------


def spoon(s, bearing=0.0, up=(0, 0, 1.0), tip=None, distance=0.036, speed=0.05):
    """A spoon at the mouth, its tip at its centre, coming from `bearing` rad around the vertical."""
    face = np.asarray(scenes.geometry.matrix(jnp.asarray(s["mouth_quat"][0])), float)
    c, sn = np.cos(bearing), np.sin(bearing)
    tip = -(c * face[:, 0] + sn * face[:, 1]) if tip is None else np.asarray(tip, float)
    up = np.asarray(up, float) - tip * (tip @ up)
    up /= np.linalg.norm(up)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, np.stack([-up, np.cross(tip, -up), tip], axis=1).ravel())
    return s | {
        "tool_quat": quat[None], "tool_pos": s["mouth_pos"] - distance * tip, "tool_vel": np.zeros((1, 3)),
        "tool_vel_head": np.array([[speed, 0, 0.0]]),
    }  # fmt: skip


def test_a_spoon_feeds_from_the_front_with_its_tip_in_and_its_food_up():
    env, s = at_rest("feeding")

    def fed(*args, **kwargs):
        return bool(env.task.success(play(env, repeated(spoon(s, *args, **kwargs), 63))))

    assert fed() and fed(bearing=0.9) and fed(up=(0, 0.7, 1.0))
    assert not fed(bearing=1.2)  # from the side
    assert not fed(up=(0, 0, -1.0))  # upside down
    assert not fed(tip=(0, 0, 1.0), up=(0, 1.0, 0))  # from below
    assert not fed(speed=0.15) and not fed(distance=0.07)
    face = np.asarray(scenes.geometry.matrix(jnp.asarray(s["mouth_quat"][0])), float)
    under = spoon(s)  # level, its tip at the chin
    under |= {"tool_pos": under["tool_pos"] - 0.032 * face[:, 2]}
    assert not bool(env.task.success(play(env, repeated(under, 63))))


def test_food_falls_by_gravity_as_the_bowl_feels_it():
    """Against a float64 filter of the spoon's acceleration along shaken and tilted trajectories."""
    env, s = at_rest("feeding")
    rng, lost = np.random.default_rng(0), []
    for case in range(12):
        n, t = 60, np.arange(60) * DT
        amplitude, hertz, tilt = rng.uniform(0, 0.12), rng.uniform(1, 6), rng.uniform(0, 0.9)
        velocity = np.zeros((n, 3))
        velocity[:, 0] = amplitude * 2 * np.pi * hertz * np.sin(2 * np.pi * hertz * t)
        row = spoon(s, up=(0, np.sin(tilt), np.cos(tilt)), distance=0.3)
        up = -np.asarray(scenes.geometry.matrix(jnp.asarray(row["tool_quat"][0])), float)[:, 0]
        a, before, tipped, spilled = np.zeros(3), np.zeros(3), 0, False
        for v in velocity:
            a += (1 - np.exp(-DT / 0.05)) * ((v - before) / DT - a)
            before, felt = v, np.array([0, 0, 9.81]) + a
            angle = np.arccos(up @ felt / np.linalg.norm(felt))
            tipped += angle > np.pi / 4
            spilled |= tipped * DT > 0.1 or angle > np.pi / 2
        got = play(env, repeated(row, n) | {"tool_vel": velocity})
        assert bool(got.spilled) == spilled, case
        lost.append(spilled)
    assert 2 < sum(lost) < 10
    once = repeated(spoon(s, up=(0, 1.0, 0.5)), 1)  # over 60° at the mouth, where it may
    assert not play(env, once).spilled
    assert play(env, repeated(spoon(s, up=(0, 0, -1.0)), 1)).spilled  # turned over anywhere
    fed = play(env, repeated(spoon(s), 63))
    assert env.task.success(play(env, repeated(spoon(s, up=(0, 0, -1.0)), 5), fed))  # it is eaten


# -- tooth brushing --------------------------------------------------------------------------------


def test_shaking_head_and_brush_together_brushes_nothing():
    """Both move at 4.6 Hz, the brush by 0.2 m/s in the room and by nothing to the mouth: MjData's own velocities."""
    env = env_of("tooth_brushing")
    model = env.model
    qpos = model.key("start").qpos.copy()
    data = mujoco.MjData(model)
    data.qpos = qpos
    mujoco.mj_forward(model, data)
    jac = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jac, None, model.site("tool_tip").id)
    robot, yaw = scenes.qpos_ids(model, scenes.PANDA.joints), model.joint("neck_yaw").qposadr[0]
    tip, body, rows = data.site("tool_tip").xpos, data.body("head"), []
    for together in (True, False):
        velocity = np.zeros(model.nv)
        velocity[yaw] = 1.0
        if together:  # the tip moves as a point fixed to the head would
            spin = data.xaxis[model.joint("neck_yaw").id] * velocity[yaw]
            velocity[robot] = np.linalg.pinv(jac[:, robot]) @ np.cross(spin, tip - body.xpos)
        rows.append(velocity)
    force = {"tool_force": np.array([0, 1.0, 0]), "tool_force_head": np.array([0, 1.0, 0])}
    s = sensors(env, [qpos, qpos], rows, force)
    assert np.linalg.norm(s["tool_vel"][0]) > 0.03 and np.linalg.norm(s["tool_vel_head"][0]) < 1e-9
    face = np.asarray(scenes.geometry.matrix(jnp.asarray(s["mouth_quat"][0])), float)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, face.ravel())
    at_mouth = {"tool_quat": np.repeat(quat[None], 2, 0), "tool_pos": s["mouth_pos"] + 0.01 * face[:, 0]}
    s |= at_mouth | {"tool_vel_head": s["tool_vel_head"] * [[1.0], [0.1 / np.linalg.norm(s["tool_vel_head"][1])]]}
    assert play(env, {name: x[:1] for name, x in s.items()}).brush_seconds == 0
    assert play(env, {name: x[1:] for name, x in s.items()}).brush_seconds > 0
    back = np.empty(4)
    mujoco.mju_mat2Quat(back, (face * [-1, -1, 1]).ravel())  # bristles away from the face
    assert play(env, {name: x[1:] for name, x in s.items()} | {"tool_quat": back[None]}).brush_seconds == 0


# -- preferences -----------------------------------------------------------------------------------


def test_preferences_pay_only_while_the_robot_helps_and_touches_always_cost():
    from assistax.human import preference

    person = preference.preference()
    paid, unpaid = (
        preference.reward_terms(person, 0.1, 2.5, 0.0, jnp.zeros(7), 1.0, jnp.bool_(helping))
        for helping in (True, False)
    )
    assert paid["prefer_speed"] > 0.4 and paid["prefer_force"] > 0.5 and paid["prefer_touch"] < 0
    assert unpaid["prefer_speed"] == unpaid["prefer_force"] == 0
    assert unpaid["prefer_touch"] == paid["prefer_touch"]
    for name in ("scratch", "bed_bath", "arm_assist", "feeding", "tooth_brushing"):
        env, s = at_rest(name)
        row = {k: jnp.asarray(x[0], jnp.float32) for k, x in s.items()}
        assert env.spec.preferences_need_help and not env.task.helping(row, env.task.reset(jax.random.key(0)))


# -- harm ------------------------------------------------------------------------------------------


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
        np.testing.assert_allclose(got[:3].sum(), truth[:3].sum(), rtol=2e-2, atol=2e-2)
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


def test_clamping_lasts_impact_peaks_and_cost_is_never_negative():
    """Against NumPy in float64 on random forces."""
    rng = np.random.default_rng(1)
    comfort, clamping, impact, _ = (np.array([x[i] for x in harm.REGIONS.values()], object) for i in range(4))
    comfort, clamping, impact = (x.astype(float) for x in (comfort, clamping, impact))
    advance, seen = jax.jit(harm.advance, static_argnums=2), set()
    for case in range(12):
        level = rng.uniform(0, 1.6, 7) * (clamping if case % 2 else 8.0)
        force = np.abs(level + rng.normal(size=(120, 7)) * 3.0) * (rng.random((120, 1)) < (1.0 if case % 4 else 0.9))
        state, low, run, seconds, impulse = harm.begin(), np.zeros(7), np.zeros(7), 0.0, 0.0
        peak, clamped = np.zeros(7), False
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
    hurt = dataclasses.replace(state.harm, peak=jnp.zeros(7).at[0].set(91.0))  # N on the face
    metrics = env.metrics(dataclasses.replace(state, harm=hurt))
    assert metrics["success"] == 1.0 and metrics["safe_success"] == 0.0 and metrics["impact"] == 1.0
    from assistax.evaluation.playing import evaluate
    from assistax.policies import scripted_team

    report = evaluate(env, scripted_team("still", env), 2)
    assert report["safe_success_rate"] == 0.0 and set(report["harm"]) == set(harm.OUTCOMES)


# -- joint speeds ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["scratch", "feeding"])
def test_full_action_for_a_second_keeps_joints_within_their_speeds(name):
    env = env_of(name)
    model, scene = env.model, env.spec.scene
    names = (*scenes.PANDA.joints, *scene.human_driven)
    ids = scenes.qpos_ids(model, names)
    limit = np.array([*scenes.PANDA.speed, *(scenes.HUMAN_SPEED[joint] for joint in scene.human_driven)])
    data, rng, fastest, driven = (
        mujoco.MjData(model),
        np.random.default_rng(0),
        np.zeros(len(ids)),
        len(scene.human_driven),
    )
    for _ in range(12):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.ctrl[:driven] = rng.choice([-1, 1], driven)
        full = env.config.torque_scale * np.array(scenes.PANDA.torque)
        data.ctrl[driven : driven + 7] = full * rng.choice([-1, 1], 7)
        for _ in range(500):
            mujoco.mj_step(model, data)
            fastest = np.maximum(fastest, np.abs(data.qvel[ids]) / limit)
    assert (fastest[:7] > 0.85).any()
    assert fastest.max() < 1.05, dict(zip(names, fastest.round(3), strict=True))


def test_an_engine_that_gets_the_brakes_wrong_is_refused():
    with pytest.raises(UsageError, match="mjx engine cannot keep scratch-v1 to its joint speeds"):
        assistax.make("scratch", engine="mjx")


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
