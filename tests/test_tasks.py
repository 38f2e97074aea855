"""Every task against NumPy in float64 on MuJoCo's own MjData, its bounds, its targets and its ends."""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from conftest import random_actions
from kinematics import joints_after, solve
from test_env import contact_force, mujoco_says

import assistax
from assistax import scenes
from assistax.tasks import task_spec

SIZES = {  # robot, human, global observation; human's action
    "scratch": (34, 38, 52, 3),
    "bed_bath": (34, 38, 52, 3),
    "arm_assist": (47, 51, 65, 3),
    "feeding": (40, 44, 58, 2),
    "tooth_brushing": (40, 44, 58, 2),
}
SUPREMA = {  # of each term and, last, of their sum, per step
    "scratch": {"reach": 1.0, "scratch": 4 / np.e**2, "": 1 + 4 / np.e**2},
    "bed_bath": {"reach": 1.0, "wipe": 156.0, "": 157.0},
    "arm_assist": {"reach": 1.0, "waist": 10.0, "rotation": 0.1 * 8**0.5, "": 11 + 0.1 * 8**0.5},
    "feeding": {
        "reach": 2.0, "orientation": 1.65, "approach": 1.0, "contact": 1 / np.e, "": 3 + 2**0.5 + 1 / np.e
    },
    "tooth_brushing": {"reach": 2.0, "align": 1.0, "brush": 1 / np.e**2, "": 3 + 1 / np.e**2},
}  # fmt: skip
NEW = [name for name in SIZES if name != "scratch"]  # test_env.py has the same for scratch


@pytest.fixture(scope="module")
def envs():
    return {name: assistax.make(f"{name}-v0", engine="mujoco", episode_length=20) for name in SIZES}


def rest(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_forward(model, data)
    return data


def touching(env):
    """A pose [nq] in which the tool's working surface presses on the person, near the task's target."""
    data = rest(env.model)
    target = {
        "bed_bath": data.geom("right_forearm").xpos + np.array([0, 0, 0.035]),
        "arm_assist": data.site("wrist_target").xpos + np.array([0, 0, 0.06]),
    }.get(env.spec.name, data.site("mouth").xpos)

    def pressed(data):
        return 1.0 < np.linalg.norm(contact_force(env.model, data, tool_only=True)) < 300.0

    rng = np.random.default_rng(0)
    for seed in range(60):
        point = target + 0.01 * rng.normal(size=3)
        pose = solve(env.model, point, seed=seed, restarts=4, tolerance=1e-3, accept=pressed)
        if pose is not None:
            return pose
    raise AssertionError(f"no touching pose in {env.spec.name}")


def rollout(env, steps, start_touching):
    """(MjData at the sensors' instant, state, obs, info) along a random rollout."""
    key = jax.random.key(3)
    _, state = env.reset(key)
    if start_touching:
        physics = env.engine.init(jnp.asarray(touching(env)), jnp.zeros(env.model.nv))
        state = dataclasses.replace(state, physics=physics)
    step = jax.jit(env.step_env)
    for i in range(steps):
        actions = random_actions(env, jax.random.fold_in(key, i))
        if start_touching:
            actions = jax.tree.map(lambda a: 0.2 * a, actions)
        before = state.physics
        obs, state, _, _, _, info = step(key, state, actions)
        yield mujoco_says(env, before, actions), state, obs, info


class Truth:
    """The specification's quantities from MjData alone, in float64."""

    def __init__(self, env, data):
        self.model, self.data = env.model, data
        tool = data.site("tool_tip")
        self.tool, self.frame = tool.xpos, tool.xmat.reshape(3, 3)
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(env.model, data, mujoco.mjtObj.mjOBJ_SITE, tool.id, velocity, 0)
        self.velocity = velocity[3:]
        self.v = np.linalg.norm(self.velocity)
        self.force = contact_force(env.model, data, tool_only=True)
        self.f = np.linalg.norm(self.force)

    def site(self, name):
        site = self.data.site(name)
        return site.xpos, site.xmat.reshape(3, 3)

    def body_blocks(self):
        human, robot = (scenes.qpos_ids(self.model, j) for j in (scenes.HUMAN_JOINTS, scenes.PANDA.joints))
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, self.frame.ravel())
        qpos, qvel = joints_after(self.model, self.data)
        return {
            "theta_robot": qpos[robot],
            "dtheta_robot": qvel[robot],
            "tool_pos": self.tool,
            "tool_quat": quat,
            "tool_force": self.force,
            "theta_human": qpos[human],
            "dtheta_human": qvel[human],
        }

    def arm_blocks(self):
        return {
            "forearm_pos": self.data.body("right_forearm").xpos,
            "upper_arm_pos": self.data.body("right_upper_arm").xpos,
        }


def target_blocks(vector, rotation=None):
    blocks = {"target_vector": vector, "target_distance": [np.linalg.norm(vector)]}
    return blocks if rotation is None else blocks | {"target_rotation": rotation.ravel()}


def bed_bath_truth(env, truth, memory):
    points = []
    for body, local in zip(("right_upper_arm", "right_forearm"), env.task.points, strict=True):
        frame = truth.data.body(body)
        points.append(frame.xpos + np.asarray(local, float) @ frame.xmat.reshape(3, 3).T)
    vectors = np.concatenate(points) - truth.tool
    distance = np.linalg.norm(vectors, axis=1)
    visited = memory.setdefault("visited", np.zeros(52, bool))
    newly = (distance < 0.05) & (truth.f > 0) & ~visited
    visited |= newly
    nearest = vectors[np.argmin(np.where(visited, np.inf, distance))]
    d = np.linalg.norm(nearest)
    terms = {"reach": np.exp(-(d**2) / 0.1), "wipe": 3 * newly.sum()}
    return truth.arm_blocks() | target_blocks(nearest), terms


def arm_assist_truth(env, truth, memory):
    (wrist, r_wrist), (waist, _) = truth.site("wrist_target"), truth.site("waist_target")
    vector, d_h = wrist - truth.tool, np.linalg.norm(waist - wrist)
    blocks = truth.arm_blocks() | target_blocks(vector, truth.frame.T @ r_wrist)
    terms = {
        "reach": np.exp(-(vector @ vector) / 0.1),
        "waist": 10 * (1 - np.tanh(d_h / 0.1)),
        "rotation": 0.1 * (2 * 2**0.5 - np.linalg.norm(truth.frame - r_wrist)),
    }
    return blocks | {"waist_vector": waist - wrist, "waist_distance": [d_h]}, terms


def feeding_truth(env, truth, memory):
    mouth, head = truth.site("mouth")
    vector = mouth - truth.tool
    d = np.linalg.norm(vector)
    towards, p = vector / d, np.exp(-150 * d**2)
    up, tip = -truth.frame[:, 0], truth.frame[:, 2]
    t = (1 - p) * np.array([0, 0, 1]) + p * towards
    terms = {
        "reach": 2 * np.exp(-3 * d),
        "orientation": t @ up / np.linalg.norm(t) + (0.3 + 0.7 * p) * (tip @ towards),
        "approach": np.exp(-((truth.v - 0.2 * (1 - p)) ** 2) / 0.01),
        "contact": truth.f * np.exp(-truth.f),
    }
    return {"mouth_pos": mouth} | target_blocks(vector, truth.frame.T @ head), terms


def tooth_brushing_truth(env, truth, memory):
    mouth, head = truth.site("mouth")
    vector = mouth - truth.tool
    d = np.linalg.norm(vector)
    towards = vector / d
    bristle, handle = -truth.frame[:, 0], -truth.frame[:, 2]
    across = np.linalg.norm(np.cross(truth.velocity, towards)) / 0.1
    brush = (d < 0.05) * across * np.exp(-across) * truth.f * np.exp(-truth.f)
    terms = {
        "reach": 2 * np.exp(-3 * d),
        "align": 0.5 * (bristle @ towards + 1 - abs(handle[2])) * np.exp(-3 * d),
        "brush": brush,
    }
    return {"mouth_pos": mouth} | target_blocks(vector, truth.frame.T @ head), terms


TRUTHS = {
    "bed_bath": bed_bath_truth,
    "arm_assist": arm_assist_truth,
    "feeding": feeding_truth,
    "tooth_brushing": tooth_brushing_truth,
}


@pytest.mark.parametrize("name", SIZES)
def test_sizes_are_the_specifications(envs, name):
    env = envs[name]
    robot, human, everything, driven = SIZES[name]
    assert env.observation_sizes == {"robot": robot, "human": human}
    assert env.global_size == everything
    assert env.action_sizes == {"robot": 7, "human": driven}
    obs, state = env.reset(jax.random.key(0))
    assert {agent: o.shape for agent, o in obs.items()} == {"robot": (robot,), "human": (human,)}
    assert env.global_obs(state).shape == (everything,)


@pytest.mark.parametrize("start_touching", [False, True])
@pytest.mark.parametrize("name", NEW)
def test_slices_and_reward_terms_equal_the_formulas_on_mujocos_data(envs, name, start_touching):
    env, memory, felt = envs[name], {}, 0.0
    for data, state, obs, info in rollout(env, 12, start_touching):
        truth = Truth(env, data)
        felt = max(felt, truth.f)
        blocks, terms = TRUTHS[name](env, truth, memory)
        expected = truth.body_blocks() | blocks
        seen = {agent: obs[agent] for agent in env.agents} | {"global": env.global_obs(state)}
        for agent, vector in seen.items():
            layout = env.obs_layout(agent)
            hidden = {"robot": "_human", "human": "_robot", "global": "never"}[agent]
            assert list(layout) == [block for block in expected if not block.endswith(hidden)]
            for block, place in layout.items():
                got = np.asarray(vector[place])
                if block == "tool_quat":
                    got = got * np.sign(got @ expected[block])
                atol = 2e-4 * max(1.0, np.abs(expected[block]).max())
                np.testing.assert_allclose(got, expected[block], atol=atol, err_msg=f"{agent} {block}")
        assert set(info["reward_terms"]) == set(terms)
        for term, value in terms.items():
            np.testing.assert_allclose(info["reward_terms"][term], value, atol=2e-3, err_msg=term)
    assert (felt > 0.5) == start_touching
    if name == "bed_bath":
        assert memory["visited"].any() == start_touching
        np.testing.assert_array_equal(state.task.visited, memory["visited"])


def random_sensors(key, env, n):
    """Sensors [n, ...] of no scene at all: distances from 0.1 mm to metres, every rotation, any force."""
    keys = iter(jax.random.split(key, 200))
    s = {}
    for name, place in scenes.sensor_slices(env.model).items():
        x = jax.random.normal(next(keys), (n, place.stop - place.start))
        if name.endswith("quat"):
            x /= jnp.linalg.norm(x, axis=-1, keepdims=True)
        elif not name.startswith("torque_"):
            x *= 10.0 ** jax.random.uniform(next(keys), (n, 1), minval=-4.0, maxval=1.0)
        s[name] = x
    return s


def random_task_state(env, key):
    state = env.task.reset(key)
    if env.spec.name == "bed_bath":
        return dataclasses.replace(state, newly=jax.random.randint(key, (), 0, 53))
    return state


@pytest.mark.parametrize("name", SIZES)
def test_no_input_gets_more_than_the_suprema(envs, name):
    env, n = envs[name], 100_000
    s = random_sensors(jax.random.key(1), env, n)
    states = jax.vmap(lambda key: random_task_state(env, key))(jax.random.split(jax.random.key(2), n))
    terms = jax.jit(jax.vmap(env.task.reward_terms))(s, states)
    assert set(terms) == set(SUPREMA[name]) - {""}
    for term, values in (terms | {"": sum(terms.values())}).items():
        assert np.isfinite(values).all()
        assert values.max() <= SUPREMA[name][term] + 1e-5, term


@pytest.mark.parametrize("name", SIZES)
def test_suprema_are_reached(envs, name):
    """All terms at their maxima at once, in sensors made for it."""
    env = envs[name]
    _, state = env.reset(jax.random.key(0))
    s, task = dict(env.sensors(state.physics)), state.task
    level = jnp.array([1.0, 0.0, 0.0, 0.0])
    s |= {key: level for key in s if key.endswith("quat")}
    if name == "scratch":
        segment = ("upper_arm", "forearm")[int(task.segment)]
        s |= {"tool_pos": s[f"{segment}_pos"] + task.itch, "tool_vel": jnp.array([0.1, 0, 0])}
        s["tool_force"] = jnp.array([0, 0, 3.0])
    elif name == "bed_bath":
        s["tool_pos"] = s["forearm_pos"] + env.task.points[1][0]
        task = dataclasses.replace(task, visited=jnp.ones(52, bool), newly=jnp.int32(52))
    elif name == "arm_assist":
        s["tool_pos"] = s["waist_target_pos"] = s["wrist_target_pos"]
    else:
        # The mouth a hair away along a direction halfway between up (-x) and tip (+z) of the spoon,
        # or along the bristles (-x) of a brush that lies level.
        feeding = name == "feeding"
        s["tool_quat"] = level if feeding else jnp.array([0.5**0.5, 0.5**0.5, 0, 0])
        towards = jnp.array([-(0.5**0.5), 0, 0.5**0.5]) if feeding else jnp.array([-1.0, 0, 0])
        s["tool_pos"] = s["mouth_pos"] - 1e-4 * towards
        s["tool_vel"] = jnp.zeros(3) if feeding else jnp.array([0, 0, 0.1])
        s["tool_force"] = jnp.array([1.0, 0, 0])
    terms = env.task.reward_terms(s, task)
    for term, value in (terms | {"": sum(terms.values())}).items():
        if (name, term) != ("feeding", "orientation"):  # its own supremum is not where the sum's is
            np.testing.assert_allclose(value, SUPREMA[name][term], atol=2e-3, err_msg=term)


def test_the_spoons_orientation_reaches_its_supremum_at_half_proximity():
    """p = ½ and the mouth straight below: t ⊥ û in the limit, so r_o tends to 1 + 0.3 + 0.7 · ½."""
    from assistax.tasks.rewards import orientation

    d, tilt = np.sqrt(np.log(2) / 150) * (1 + 1e-4), 1e-2
    to_mouth = d * np.array([np.sin(tilt), 0, -np.cos(tilt)])
    values = []
    for angle in np.linspace(-0.1, 0.1, 81):
        up, tip = np.array([[np.cos(angle), 0, np.sin(angle)], [np.sin(angle), 0, -np.cos(angle)]])
        values.append(float(orientation(jnp.asarray(to_mouth), up, tip)))
    assert 1.62 < max(values) <= 1.65 + 1e-5


def bath_points(env):
    """World positions [2, 26, 3] and outward normals of the points at rest, and MjData."""
    data = rest(env.model)
    points, normals = [], []
    for body, local in zip(("right_upper_arm", "right_forearm"), env.task.points, strict=True):
        frame, geom = data.body(body), data.geom(body)
        world = frame.xpos + np.asarray(local, float) @ frame.xmat.reshape(3, 3).T
        inside = (world - geom.xpos) @ geom.xmat.reshape(3, 3)
        inside[:, 2] = 0
        normals.append(inside / np.linalg.norm(inside, axis=1, keepdims=True) @ geom.xmat.reshape(3, 3).T)
        points.append(world)
    return np.array(points), np.array(normals), data


def test_bath_points_lie_evenly_on_the_exposed_skin(envs):
    env = envs["bed_bath"]
    model = env.model
    points, _, data = bath_points(env)
    assert points.shape == (2, 26, 3)
    for body, group in zip(("right_upper_arm", "right_forearm"), points, strict=True):
        geom = data.geom(body)
        radius, half = model.geom(body).size[:2]
        local = (group - geom.xpos) @ geom.xmat.reshape(3, 3)
        np.testing.assert_allclose(np.hypot(local[:, 0], local[:, 1]), radius, atol=1e-3)
        assert (np.abs(local[:, 2]) <= half + 1e-6).all()
        apart = np.linalg.norm(group[:, None] - group, axis=-1) + 9 * np.eye(26)
        assert apart.min(1).max() < 1.15 * apart.min(1).min()
        assert apart.min() > 0.02
    everything = points.reshape(-1, 3)
    assert (everything[:, 2] > 0.67 + 0.01).all()  # the mattress's top
    for body in ("chest", "belly", "pelvis"):
        geom = data.geom(body)
        local = (everything - geom.xpos) @ geom.xmat.reshape(3, 3)
        radius, half = model.geom(body).size[:2]
        local[:, 2] -= np.clip(local[:, 2], -half, half)
        assert (np.linalg.norm(local, axis=1) > radius + 0.01).all(), body


def test_every_bath_point_is_reachable(envs):
    """A pose visits it: the pad on the arm, its centre within 0.05 m, and nothing else touched."""
    env = envs["bed_bath"]
    model = env.model
    points, normals, _ = bath_points(env)
    tool = model.site("tool_tip").id

    def visits(point):
        def accept(data):
            touched = False
            for contact in data.contact[: data.ncon]:
                bodies = {model.body(model.geom_bodyid[g]).name for g in contact.geom}
                wiping = "tool" in bodies and bodies & {"right_upper_arm", "right_forearm"}
                if bodies & {"link5", "link6", "link7", "tool"} and contact.dist < (-0.02 if wiping else -0.003):
                    return False
                touched |= bool(wiping)
            return touched and np.linalg.norm(data.site_xpos[tool] - point) < 0.05

        return accept

    # The pad lies flat on the ridge of the arm; the trunk is in the way of pressing on its inner side.
    for body, group, out in zip(("right_upper_arm", "right_forearm"), points, normals, strict=True):
        radius, up = model.geom(body).size[0], out[9]  # of the middle row
        for point, normal in zip(group, out, strict=True):
            above = point - radius * normal + (radius + 0.004) * up
            pose = solve(model, above, facing=-up, tolerance=5e-3, accept=visits(point))
            assert pose is not None, point


@pytest.mark.parametrize(("name", "site"), [("arm_assist", "wrist_target"), ("arm_assist", "waist_target"),
                                            ("feeding", "mouth"), ("tooth_brushing", "mouth")])  # fmt: skip
def test_targets_are_within_the_arms_reach(envs, name, site):
    model = envs[name].model
    point = rest(model).site(site).xpos
    assert solve(model, point, tolerance=5e-3) is not None


def test_visiting_the_last_point_ends_the_episode_as_terminated(envs):
    env = envs["bed_bath"]
    pose = jnp.asarray(touching(env))
    _, state = env.reset(jax.random.key(0))
    state = dataclasses.replace(state, physics=env.engine.init(pose, jnp.zeros(env.model.nv)))
    nearest = int(jnp.argmin(jnp.linalg.norm(env.task.to_points(env.sensors(state.physics)), axis=-1)))
    visited = jnp.ones(52, bool).at[nearest].set(False)
    for t in (3, env.episode_length - 1):  # also when time is up in the same step
        late = dataclasses.replace(state, task=env.task.reset(None), t=jnp.int32(t))
        almost = dataclasses.replace(late, task=dataclasses.replace(late.task, visited=visited))
        actions = {agent: jnp.zeros(n) for agent, n in env.action_sizes.items()}
        _, after, _, terminated, truncated, info = jax.jit(env.step_env)(jax.random.key(0), almost, actions)
        assert terminated["__all__"] and not truncated["__all__"]
        assert info["reward_terms"]["wipe"] == 3.0
        assert info["metrics"]["success"] == 1.0 and info["metrics"]["fraction_visited"] == 1.0
        _, after, _, terminated, _, info = jax.jit(env.step)(jax.random.key(1), almost, actions)
        assert terminated["__all__"] and not after.task.visited.any() and after.t == 0
        assert np.isfinite(info["final_observation"]["robot"]).all()


def test_a_point_counts_once(envs):
    env = envs["bed_bath"]
    s = dict(env.sensors(env.reset(jax.random.key(0))[1].physics))
    s["tool_pos"] = s["tool_pos"] + env.task.to_points(s)[0]
    state = env.task.reset(None)
    assert env.task.advance(s, state).newly == 0  # over it, but not touching
    s["tool_force"] = jnp.array([0, 0, 1.0])
    first = env.task.advance(s, state)
    assert first.newly == first.visited.sum() > 0
    assert env.task.advance(s, first).newly == 0


def test_a_bite_is_taken_with_the_bowl_from_its_middle_to_its_tip(envs):
    """Against many points of the bowl that touches. The face is solid: a straight spoon's middle stays 3.6 cm away."""
    task, model = envs["feeding"].task, scenes.build(task_spec("feeding-v0").scene).compile()
    of_tool = model.geom_bodyid == model.body("tool").id
    [half] = model.geom_size[of_tool & (model.geom_contype > 0)]
    s = dict(envs["feeding"].sensors(envs["feeding"].reset(jax.random.key(0))[1].physics))
    mouth, start = np.array(s["mouth_pos"], float), task.reset(None)

    @jax.jit
    def eats(pos, quat):
        return task.advance(s | {"tool_pos": pos, "tool_quat": quat}, start).mouth_seconds > 0

    rng, said = np.random.default_rng(0), []
    for _ in range(100):
        quat, matrix = rng.normal(size=4), np.empty(9)
        quat /= np.linalg.norm(quat)
        mujoco.mju_quat2Mat(matrix, quat)
        tip = matrix.reshape(3, 3)[:, 2]
        pos = mouth + rng.normal(size=3) * 0.025
        nearest = np.linalg.norm(pos + np.linspace(0, half[2], 500)[:, None] * tip - mouth, axis=1).min()
        if abs(nearest - 0.03) > 1e-4:
            said.append(bool(eats(pos, quat)))
            assert said[-1] == (nearest < 0.03)
        assert eats(mouth - half[2] * tip, quat) and not eats(mouth + half[2] * tip, quat)
    assert 20 < sum(said) < len(said) - 20


def test_feeding_succeeds_only_if_nothing_was_spilled_on_the_way(envs):
    env = envs["feeding"]
    task = env.task
    s = dict(env.sensors(env.reset(jax.random.key(0))[1].physics))
    mouth = s["mouth_pos"]

    def spoon(tilt, distance):  # up is -x of the frame; turned by half a turn less the tilt from z-down
        angle = np.pi / 2 + tilt
        quat = jnp.array([np.cos(angle / 2), 0, np.sin(angle / 2), 0])
        return s | {"tool_quat": quat, "tool_pos": mouth + jnp.array([distance, 0, 0])}

    def play(*moves):
        state = task.reset(None)
        for tilt, distance, steps in moves:
            for _ in range(steps):
                state = task.advance(spoon(tilt, distance), state)
        return bool(task.success(state)), float(task.outcomes(state)["spilled"])

    assert play((0.1, 0.3, 1), (0.7, 0.3, 1), (1.2, 0.05, 1), (0.6, 0.02, 63)) == (True, 0.0)
    assert play((0.1, 0.3, 1), (0.9, 0.3, 1), (0.6, 0.02, 63)) == (False, 1.0)  # tipped over on the way
    assert play((0.1, 0.02, 63), (0.9, 0.3, 1)) == (False, 1.0)  # or on the way back
    assert play((0.1, 0.3, 1), (0.6, 0.02, 61)) == (False, 0.0)  # too short: 0.488 s
    assert play((0.1, 0.3, 1), (0.6, 0.02, 40), (0.1, 0.2, 5), (0.6, 0.02, 23))[0]  # in all, not at a stretch


def test_outcomes_count_seconds_within_their_bands(envs):
    env = envs["tooth_brushing"]
    s = dict(env.sensors(env.reset(jax.random.key(0))[1].physics))
    s["tool_pos"] = s["mouth_pos"] - jnp.array([0.03, 0, 0])
    for force, across, along, counts in [
        (1.0, 0.1, 0.0, True), (0.2, 0.1, 0.0, False), (3.5, 0.1, 0.0, False),
        (1.0, 0.02, 0.0, False), (1.0, 0.4, 0.0, False), (1.0, 0.0, 0.1, False),
    ]:  # fmt: skip
        s |= {"tool_force": jnp.array([0, force, 0]), "tool_vel": jnp.array([along, 0, across])}
        after = env.task.advance(s, env.task.reset(None))
        assert (float(after.brush_seconds) > 0) == counts
    env = envs["arm_assist"]
    s = dict(env.sensors(env.reset(jax.random.key(0))[1].physics))
    for distance in (0.09, 0.11):
        s["wrist_target_pos"] = s["waist_target_pos"] + jnp.array([0, distance, 0])
        state = env.task.reset(None)
        for _ in range(63):
            state = env.task.advance(s, state)
        assert bool(env.task.success(state)) == (distance < 0.1)


@pytest.mark.parametrize("name", ["scratch", "bed_bath", "arm_assist", "feeding", "tooth_brushing"])
def test_the_marker_in_films_is_what_is_observed_as_the_target(name):
    env = assistax.make(name, engine="mujoco")
    obs, state = jax.jit(env.reset)(jax.random.key(0))
    at = env.obs_layout("robot")
    place = obs["robot"][at["tool_pos"]] + obs["robot"][at["target_vector"]]
    np.testing.assert_allclose(env.markers(state), place, atol=1e-5)
