"""Version 1 of the tasks: help measured as the body part feels it, against MuJoCo's MjData in float64."""

import dataclasses
from itertools import product

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from instants import at_rest, env_of

import assistax
from assistax import scenes
from assistax.errors import UsageError
from assistax.physics import make_engine
from assistax.tasks import task_spec
from assistax.training.team_file import load_team, trained_file

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


def test_a_bare_name_is_the_newest_version_and_its_packaged_team_the_newest_there_is():
    from assistax.training.team_file import TRAINED, trained_file

    for name in ("scratch", "bed_bath", "arm_assist", "feeding", "tooth_brushing"):
        assert task_spec(name).id == f"{name}-v{3 if name in ('scratch', 'bed_bath', 'feeding') else 2}"
        newest = max((3, 2, 1, 0), key=lambda version: ((TRAINED / f"{name}-v{version}.safetensors").exists(), version))
        assert trained_file(name) == TRAINED / f"{name}-v{newest}.safetensors"
        assert trained_file(f"{name}-v0") == TRAINED / f"{name}-v0.safetensors"


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


# -- joint speeds ----------------------------------------------------------------------------------


def fastest(name, episodes, steps):
    """By joint, of its limit, when both act with all they have, from rest: in `episodes` [n, m, joints] of directions,
    each of them for so many physics steps."""
    env = env_of(name)
    limits = scenes.HUMAN_SPEED | dict(zip(scenes.PANDA.joints, scenes.PANDA.speed, strict=True))
    robot = env.config.torque_scale * np.array(scenes.PANDA.torque)
    full = np.array([*[1.0] * len(env.spec.scene.human_driven), *robot])
    ids, limit = scenes.qpos_ids(env.model, joints(name)), np.array([limits[joint] for joint in joints(name)])
    data, most = mujoco.MjData(env.model), np.zeros(len(ids))
    for directions in episodes:
        mujoco.mj_resetDataKeyframe(env.model, data, 0)
        for direction in directions:
            data.ctrl[: len(ids)] = full * direction
            for _ in range(steps):
                mujoco.mj_step(env.model, data)
                most = np.maximum(most, np.abs(data.qvel[ids]) / limit)
    return dict(zip(joints(name), most.round(3), strict=True))


def joints(name):
    """That somebody drives, in the order of motors."""
    return (*env_of(name).spec.scene.human_driven, *scenes.PANDA.joints)


@pytest.mark.parametrize("number", [32, pytest.param(1024, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["scratch", "bed_bath", "arm_assist", "feeding", "tooth_brushing"])
def test_full_action_for_a_second_keeps_joints_within_their_speeds(name, number):
    """In either direction of every joint: some of these 512 or 1024 combinations, or all of them."""
    directions = np.random.default_rng(0).permutation([*product((-1, 1), repeat=len(joints(name)))])
    found = fastest(name, directions[:number, None], 500)
    most = {"right_elbow": 1.13} if name == "arm_assist" else {}  # the robot pushes it
    assert any(found[joint] > 0.85 for joint in scenes.PANDA.joints)
    assert all(found[joint] < most.get(joint, 1.08) for joint in found), found


def test_brakes_do_not_throw_a_joint_that_ran_into_its_stop():
    """The worst of 300 episodes of `benchmarks/joint_speeds.py`: 4.0 of a limit with brakes of a largest torque."""
    episodes = np.random.default_rng(21).choice([-1, 1], (191, 80, len(joints("scratch"))))
    found = fastest("scratch", episodes[190:], 50)
    assert 1.2 < max(found.values()) < 1.5, found  # it runs into its stop


def test_an_engine_that_gets_the_brakes_wrong_is_refused():
    with pytest.raises(UsageError, match="mjx engine cannot keep scratch-v3 to its joint speeds"):
        assistax.make("scratch", engine="mjx")


@pytest.mark.parametrize(
    ("name", "version", "seconds", "success"),
    [("tooth_brushing", 0, "brush_seconds", 2.0), ("feeding", 1, "mouth_seconds", 0.5)],
)
def test_what_a_packaged_team_got_for_no_help_the_next_version_does_not_count(name, version, seconds, success):
    """The team shakes head and brush together, or holds the spoon at the chin. The same four episodes, counted twice:
    the next version by sensors of its own scene at the same joints and speeds."""
    env, team = load_team(trained_file(f"{name}-v{version}"), engine="mujoco")
    judge = env_of(f"{name}-v{version + 1}")

    def step(carry, now):
        state, obs, carries, judged = carry
        actions = {}
        for agent, player in team.items():
            actions[agent], carries[agent] = player.act(
                player.member(0), carries[agent], obs[agent], state, now == 0, jax.random.key(now)
            )
        obs, state, *_ = env.step_env(jax.random.key(now), state, actions)
        felt = judge.engine.init(state.physics.qpos, state.physics.qvel)
        return (state, obs, carries, judge.task.advance(judge.sensors(felt), judged)), None

    def one(key):
        obs, state = env.reset(key)
        start = state, obs, {agent: player.initial_carry() for agent, player in team.items()}, judge.task.reset(key)
        (state, *_, judged), _ = jax.lax.scan(step, start, jnp.arange(1000))
        return getattr(state.task, seconds), getattr(judged, seconds)

    before, now = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(0), 4))
    assert before.min() > success and now.max() < 0.25 * success


def test_the_way_around_an_arm_is_the_shorter_one():
    """From wherever the pad is, to each point of the skin: by the angle between two directions from the limb's axis."""
    env = env_of("bed_bath")
    task, (_, state) = env.task, env.reset(jax.random.key(0))
    s = dict(env.sensors(state.physics))
    ways = []
    for where in np.random.default_rng(0).normal(scale=0.3, size=(20, 3)):
        s["tool_pos"] = s["forearm_pos"] + where
        vectors, normals, got = task.places(s)
        axes, radius = (np.asarray(x, float)[task.segment] for x in (task.axes(s), task._radius))
        off = radius[:, None] * np.asarray(normals, float) - np.asarray(vectors, float)
        side = off - axes * (off * axes).sum(1, keepdims=True)
        cosine = (side * normals).sum(1) / np.linalg.norm(side, axis=1)
        ways.append(radius * np.arccos(np.clip(cosine, -1.0, 1.0)))
        np.testing.assert_allclose(got, np.linalg.norm(vectors, axis=1) + ways[-1], atol=2e-4)
    assert np.ptp(ways) > 0.1
