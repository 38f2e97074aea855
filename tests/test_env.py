"""The environment against MuJoCo's own MjData in float64, and the step contract."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from conftest import random_actions
from kinematics import joints_after, solve, touching_pose

import assistax
from assistax import scenes
from assistax.spaces import Box

STEP = 4  # physics steps per control step


def mujoco_says(env, physics, actions):
    """MjData after the same control step; qpos and qvel are those of the sensors' instant."""
    model = env.model
    data = mujoco.MjData(model)
    data.qpos, data.qvel = physics.qpos, physics.qvel
    data.qacc_warmstart = physics.qacc_warmstart
    limits = np.array(scenes.PANDA.torque) * env.config.torque_scale
    wanted = np.concatenate([actions["human"], limits * np.asarray(actions["robot"], float)])
    data.ctrl[: len(wanted)] = wanted  # version 1 has brakes behind them
    for _ in range(STEP):
        before = data.qpos.copy(), data.qvel.copy()
        mujoco.mj_step(model, data)
    data.qpos, data.qvel = before
    return data


def contact_force(model, data, tool_only):
    """Net force [3] of the robot (or only the tool's working surface) on the person, from the contacts."""

    def side(body):
        while body and model.body(body).name not in ("human", "robot", "tool"):
            body = model.body_parentid[body]
        return model.body(body).name

    total = np.zeros(3)
    for i in range(data.ncon):
        sides = [side(model.geom_bodyid[g]) for g in data.contact[i].geom]
        robot = ("tool",) if tool_only else ("tool", "robot")
        if "human" not in sides or not set(sides) & set(robot):
            continue
        wrench = np.zeros(6)
        mujoco.mj_contactForce(model, data, i, wrench)
        on_second = data.contact[i].frame.reshape(3, 3).T @ wrench[:3]
        total += on_second if sides[1] == "human" else -on_second
    return total


def rollout_states(env, steps, start_touching, seed=0):
    """(physics before, actions, state after, info) along a rollout."""
    key = jax.random.key(seed)
    _, state = env.reset(key)
    if start_touching:
        physics = env.engine.init(jnp.asarray(touching_pose(env.model)), jnp.zeros(env.model.nv))
        data = mujoco.MjData(env.model)
        data.qpos = physics.qpos
        mujoco.mj_kinematics(env.model, data)
        forearm = data.body("right_forearm")
        itch = forearm.xmat.reshape(3, 3).T @ (data.site("tool_tip").xpos - forearm.xpos)
        task = dataclasses.replace(state.task, segment=jnp.int32(1), itch=jnp.asarray(itch))
        state = dataclasses.replace(state, physics=physics, task=task)
    step = jax.jit(env.step_env)
    for i in range(steps):
        actions = random_actions(env, jax.random.fold_in(key, i))
        if start_touching:
            actions = jax.tree.map(lambda a: 0.2 * a, actions)
        before = state.physics
        obs, state, rewards, _, _, info = step(key, state, actions)
        yield before, actions, state, obs, rewards, info


@pytest.mark.parametrize("start_touching", [False, True])
def test_every_observation_slice_equals_mujocos_own_quantity(scratch, start_touching):
    env, model = scratch, scratch.model
    felt = 0.0
    human, robot = (scenes.qpos_ids(model, joints) for joints in (scenes.HUMAN_JOINTS, scenes.PANDA.joints))
    for before, actions, state, obs, _, _ in rollout_states(env, 15, start_touching):
        data = mujoco_says(env, before, actions)
        segment = data.body(["right_upper_arm", "right_forearm"][int(state.task.segment)])
        itch = segment.xpos + segment.xmat.reshape(3, 3) @ np.asarray(state.task.itch, float)
        tool = data.site("tool_tip")
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, tool.xmat)
        force = contact_force(model, data, tool_only=True)
        qpos, qvel = joints_after(model, data)
        felt = max(felt, np.linalg.norm(force))
        expected = {
            "theta_robot": qpos[robot],
            "dtheta_robot": qvel[robot],
            "tool_pos": tool.xpos,
            "tool_quat": quat,
            "tool_force": force,
            "theta_human": qpos[human],
            "dtheta_human": qvel[human],
            "forearm_pos": data.body("right_forearm").xpos,
            "upper_arm_pos": data.body("right_upper_arm").xpos,
            "target_vector": itch - tool.xpos,
            "target_distance": [np.linalg.norm(itch - tool.xpos)],
        }
        seen = {agent: obs[agent] for agent in env.agents} | {"global": env.global_obs(state)}
        for agent, vector in seen.items():
            layout = env.obs_layout(agent)
            hidden = {"robot": "_human", "human": "_robot", "global": "never"}[agent]
            assert set(layout) == {name for name in expected if not name.endswith(hidden)}
            for name, place in layout.items():
                scale = max(1.0, np.abs(expected[name]).max())
                got = np.asarray(vector[place])
                if name == "tool_quat":
                    got = got * np.sign(got @ quat)
                np.testing.assert_allclose(got, expected[name], atol=2e-4 * scale, err_msg=f"{agent} {name}")
    assert (felt > 0.5) == start_touching


def test_reward_terms_equal_the_papers_formulas_in_float64(scratch):
    env = scratch
    active = 0.0
    for before, actions, state, _, rewards, info in rollout_states(env, 15, start_touching=True):
        data = mujoco_says(env, before, actions)
        tool = data.site("tool_tip")
        segment = data.body(["right_upper_arm", "right_forearm"][int(state.task.segment)])
        itch = segment.xpos + segment.xmat.reshape(3, 3) @ np.asarray(state.task.itch, float)
        d = np.linalg.norm(itch - tool.xpos)
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(env.model, data, mujoco.mjtObj.mjOBJ_SITE, tool.id, velocity, 0)
        v, f = np.linalg.norm(velocity[3:]), np.linalg.norm(contact_force(env.model, data, tool_only=True))
        scratch_term = 4 * (d < 0.1) * (v / 0.1) * np.exp(-v / 0.1) * (f / 3) * np.exp(-f / 3)
        active = max(active, scratch_term)
        np.testing.assert_allclose(info["reward_terms"]["reach"], np.exp(-(d**2) / 0.1), atol=1e-4)
        np.testing.assert_allclose(info["reward_terms"]["scratch"], scratch_term, atol=2e-3)
        np.testing.assert_allclose(rewards["robot"], sum(info["reward_terms"].values()), rtol=1e-6)
        np.testing.assert_array_equal(rewards["robot"], rewards["human"])
        np.testing.assert_allclose(
            info["robot_force"],
            np.linalg.norm(contact_force(env.model, data, tool_only=False)),
            rtol=2e-3,
            atol=1e-3,
        )
    assert active > 0.01


def test_work_and_force_over_the_limit_are_sums_over_mujocos_own_numbers(scratch):
    """Torque times speed of every actuated joint, in J, and the seconds in which the robot pushes too hard."""
    limit = 1.0  # N; version 0's cost is how far above it the force is, in parts of it
    env = assistax.make("scratch-v0", engine="mujoco", episode_length=20, force_limit=limit)
    work, over, peak, metrics = {"robot": 0.0, "human": 0.0}, 0.0, 0.0, {}
    for before, actions, _, _, _, info in rollout_states(env, 15, start_touching=True):
        data, model = mujoco_says(env, before, actions), env.model
        joints = model.actuator_trnid[:, 0]
        dofs = model.jnt_dofadr[joints]
        power = np.abs(data.qfrc_actuator[dofs] * joints_after(model, data)[1][dofs])
        is_robot = np.array([model.joint(j).name in scenes.PANDA.joints for j in joints])
        work["robot"] += power[is_robot].sum() * env.dt
        work["human"] += power[~is_robot].sum() * env.dt
        force = np.linalg.norm(contact_force(model, data, tool_only=False))
        over += env.dt * (force > limit)
        np.testing.assert_allclose(info["cost"], max(force / limit - 1.0, 0.0), rtol=2e-3, atol=2e-3)
        peak, metrics = max(peak, force), info["metrics"]
    assert 0 < over < 15 * env.dt
    for agent, expected in work.items():
        np.testing.assert_allclose(metrics[f"work_{agent}"], expected, rtol=2e-3)
    np.testing.assert_allclose(metrics["seconds_over_force_limit"], over, rtol=1e-5)
    np.testing.assert_allclose(metrics["peak_force"], peak, rtol=2e-3)


def test_sizes_are_the_specifications(scratch):
    assert scratch.observation_sizes == {"robot": 34, "human": 38}
    assert scratch.global_size == 52
    assert scratch.action_sizes == {"robot": 7, "human": 3}
    obs, state = scratch.reset(jax.random.key(0))
    assert {a: o.shape for a, o in obs.items()} == {"robot": (34,), "human": (38,)}
    assert scratch.global_obs(state).shape == (52,)
    assert scratch.action_space("robot").shape == (7,)


def batch_of(env, n, seed=0):
    keys = jax.random.split(jax.random.key(seed), n)
    obs, state = jax.jit(jax.vmap(env.reset))(keys)
    return obs, state, jax.jit(jax.vmap(env.step))


def test_auto_reset_is_fresh_and_keeps_the_true_last_observation(scratch):
    n = 3
    obs, state, step = batch_of(scratch, n)
    step_env = jax.jit(jax.vmap(scratch.step_env))
    targets, seen_itches = [], []
    for i in range(3 * scratch.episode_length):
        key = jax.random.fold_in(jax.random.key(1), i)
        actions = random_actions(scratch, key, (n,))
        keys = jax.random.split(key, n)
        true_obs, true_end, *_ = step_env(keys, state, actions)
        obs, state, _, terminated, truncated, info = step(keys, state, actions)
        assert not terminated["__all__"].any()
        last = (i + 1) % scratch.episode_length == 0
        assert (np.asarray(truncated["__all__"]) == last).all()
        for agent in scratch.agents:
            np.testing.assert_array_equal(info["final_observation"][agent], true_obs[agent])
            assert (np.asarray(obs[agent]) == np.asarray(true_obs[agent])).all() == (not last)
        true_global = jax.vmap(scratch.global_obs)(true_end)
        np.testing.assert_allclose(info["final_global_observation"], true_global, atol=1e-6)
        if last:
            targets.append(np.asarray(state.task.itch))
            seen_itches.append(np.asarray(state.physics.qpos))
            assert (np.asarray(info["metrics"]["length"]) == scratch.episode_length).all()
            assert (np.asarray(state.t) == 0).all()
            assert (np.asarray(state.episode["return"]) == 0).all()
    for drawn in (targets, seen_itches):
        everything = np.concatenate(drawn)
        assert len(np.unique(everything.round(6), axis=0)) == 3 * n


def test_one_seed_gives_the_same_bits_twice(scratch):
    def run():
        _, state, step = batch_of(scratch, 4)
        rewards = []
        for i in range(30):
            key = jax.random.fold_in(jax.random.key(1), i)
            actions = random_actions(scratch, key, (4,))
            _, state, reward, *_ = step(jax.random.split(key, 4), state, actions)
            rewards.append(np.asarray(reward["robot"]))
        return np.array(rewards), np.asarray(state.physics.qpos)

    for first, second in zip(run(), run(), strict=True):
        np.testing.assert_array_equal(first, second)


def test_nested_vmap_equals_flat(scratch):
    keys = jax.random.split(jax.random.key(0), 6)
    actions = random_actions(scratch, keys[0], (6,))
    _, flat = jax.vmap(scratch.reset)(keys)
    obs, *_ = jax.jit(jax.vmap(scratch.step))(keys, flat, actions)

    def fold(tree):
        return jax.tree.map(lambda x: x.reshape(2, 3, *x.shape[1:]), tree)

    nested, *_ = jax.jit(jax.vmap(jax.vmap(scratch.step)))(fold(keys), fold(flat), fold(actions))
    for agent in scratch.agents:
        np.testing.assert_allclose(nested[agent].reshape(6, -1), obs[agent], atol=1e-5)


def test_actions_are_torques_as_documented():
    env = assistax.make("scratch-v0", engine="mujoco", torque_scale=0.3)
    ctrl = env.motors.controls({"robot": jnp.full(7, 5.0), "human": jnp.array([-1.0, 0.0, 0.5])})
    np.testing.assert_allclose(ctrl, [-1, 0, 0.5, *0.3 * np.array([87, 87, 87, 87, 12, 12, 12])], rtol=1e-6)


def test_every_itch_lies_on_the_skin_and_is_reachable(scratch):
    model = scratch.model
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_kinematics(model, data)
    states = jax.vmap(scratch.task.reset)(jax.random.split(jax.random.key(0), 60))
    segments = set()
    for segment, itch in zip(np.asarray(states.segment), np.asarray(states.itch, float), strict=True):
        body = ["right_upper_arm", "right_forearm"][segment]
        segments.add(body)
        geom = model.geom(body).id
        point = data.body(body).xpos + data.body(body).xmat.reshape(3, 3) @ itch
        local = data.geom_xmat[geom].reshape(3, 3).T @ (point - data.geom_xpos[geom])
        assert abs(np.hypot(local[0], local[1]) - model.geom_size[geom, 0]) < 1e-5
        assert abs(local[2]) <= model.geom_size[geom, 1] + 1e-6
        assert solve(model, point, tolerance=5e-3, accept=_nothing_in_the_way) is not None, (body, local)
    assert len(segments) == 2


def _nothing_in_the_way(data):
    """The stick's tip may sink into the soft arm by its own radius; nothing else of the robot touches anything."""
    model = data.model
    for contact in data.contact[: data.ncon]:
        names = {model.body(model.geom_bodyid[g]).name for g in contact.geom}
        robot = names & {"link5", "link6", "link7", "tool"}
        scratching = "tool" in names and names & {"right_upper_arm", "right_forearm"}
        if robot and contact.dist < (-0.015 if scratching else -0.003):
            return False
    return True


def test_a_still_person_stays_at_rest(scratch):
    """The scene test checks MuJoCo alone; this checks what the environment makes of it."""
    env = assistax.make("scratch-v0", engine="mujoco", reset_noise=0.0)
    _, state = env.reset(jax.random.key(0))
    still = {agent: jnp.zeros(n) for agent, n in env.action_sizes.items()}
    start = env.sensors(state.physics)
    key = jax.random.key(0)
    state, _ = jax.jit(lambda s: jax.lax.scan(lambda s, _: (env.step_env(key, s, still)[1], None), s, None, 1000))(
        state
    )
    end = env.sensors(state.physics)
    for name in ("forearm_pos", "upper_arm_pos", "mouth_pos"):
        assert np.linalg.norm(end[name] - start[name]) < 0.01


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: assistax.make("scratc"), "Did you mean 'scratch'"),
        (lambda: assistax.make("scratch-v0", engine="mujuco"), "Did you mean 'mujoco'"),
        (lambda: assistax.make("scratch-v0", torque_scal=1.0), "Did you mean 'torque_scale'"),
        (lambda: assistax.make("scratch-v0", episode_length=0), "env.episode_length must be 1 or more"),
        (lambda: assistax.make("scratch-v0", torque_scale="big"), "must be a number"),
    ],
)
def test_bad_settings_are_refused_in_one_line(call, words):
    with pytest.raises(assistax.UsageError, match=words) as error:
        call()
    assert "\n" not in str(error.value)


def test_the_same_key_at_every_step_still_gives_fresh_episodes(scratch):
    """What a loop that never splits its key gets; and different keys give different episodes from the same state."""
    step = jax.jit(scratch.step)
    key = jax.random.key(0)
    _, state = scratch.reset(key)
    still = {agent: jnp.zeros(n) for agent, n in scratch.action_sizes.items()}
    itches = [np.asarray(state.task.itch)]
    for _ in range(3):
        for _ in range(scratch.episode_length):
            before = state
            _, state, *_ = step(key, state, still)
        itches.append(np.asarray(state.task.itch))
    assert len(np.unique(np.round(itches, 6), axis=0)) == 4
    _, other, *_ = step(jax.random.key(1), before, still)
    assert (np.asarray(other.task.itch) != np.asarray(state.task.itch)).any()


def test_spaces_sample_what_they_contain():
    low, high = np.array([-1.0, 0.0, -np.inf, -np.inf]), np.array([1.0, np.inf, 3.0, np.inf])
    box = Box((4,), low, high)
    samples = np.asarray(jax.vmap(box.sample)(jax.random.split(jax.random.key(0), 4000)))
    assert np.isfinite(samples).all() and all(box.contains(x) for x in samples[:50])
    np.testing.assert_allclose(samples[:, 0].std(), 1 / np.sqrt(3), atol=0.03)  # uniform
    np.testing.assert_allclose(samples.mean(0)[1:], [1.0, 2.0, 0.0], atol=0.1)  # exponential, exponential, normal
    assert not box.contains(np.full(4, np.nan)) and not box.contains(np.zeros(3)) and not box.contains(low - 1)
    assert box == Box((4,), low, high) != Box((4,))
