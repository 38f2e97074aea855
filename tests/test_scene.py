"""The scenes against the specification's numbers and against independent physics."""

import mujoco
import numpy as np
import pytest

from assistax import scenes
from assistax.tasks import TASKS

HUMAN_MASSES = {
    "pelvis": 6.6162, "waist": 2.2619, "torso": 5.8538, "head": 3.0536,
    "upper_arm": 1.6611, "forearm": 1.2295, "thigh": 4.7518, "shin": 2.7557, "foot": 1.7671,
}  # fmt: skip
HUMAN_RANGES = {
    "neck_yaw": (-1.3, 1.3), "neck_pitch": (-0.7, 0.5), "trunk_pitch": (-0.5236, 1.3090),
    "right_shoulder1": (-1.4835, 1.0472), "right_shoulder2": (-1.4835, 1.0472),
    "left_shoulder1": (-1.0472, 1.4835), "left_shoulder2": (-1.0472, 1.4835),
    "right_elbow": (-1.5708, 0.8727), "left_elbow": (-1.5708, 0.8727),
}  # fmt: skip
PANDA_LIMITS = [(-2.8973, 2.8973), (-1.7628, 1.7628), (-2.8973, 2.8973), (-3.0718, -0.0698),
                (-2.8973, 2.8973), (-0.0175, 3.7525), (-2.8973, 2.8973)]  # fmt: skip
# per link: offset (m), quarter turns about x, mass (kg), centre of mass (m), inertia (xx yy zz xy xz yz)
PANDA = [
    ((0, 0, 0.333), 0, 4.970684, (0.003875, 0.002081, -0.04762),
     (0.70337, 0.70661, 0.009117, -0.000139, 0.006772, 0.019169)),
    ((0, 0, 0), -1, 0.646926, (-0.003141, -0.02872, 0.003495),
     (0.007962, 0.02811, 0.025995, -0.003925, 0.010254, 0.000704)),
    ((0, -0.316, 0), 1, 3.228604, (0.027518, 0.039252, -0.066502),
     (0.037242, 0.036155, 0.01083, -0.004761, -0.011396, -0.012805)),
    ((0.0825, 0, 0), 1, 3.587895, (-0.05317, 0.104419, 0.027454),
     (0.025853, 0.019552, 0.028323, 0.007796, -0.001332, 0.008641)),
    ((-0.0825, 0.384, 0), -1, 1.225946, (-0.011953, 0.041065, -0.038437),
     (0.035549, 0.029474, 0.008627, -0.002117, -0.004037, 0.000229)),
    ((0, 0, 0), 1, 1.666555, (0.060149, -0.014117, -0.010517),
     (0.001964, 0.004354, 0.005433, 0.000109, -0.001158, 0.000341)),
    ((0.088, 0, 0), 1, 0.735522, (0.010517, -0.004252, 0.061597),
     (0.012516, 0.010027, 0.004815, -0.000428, -0.001196, -0.000741)),
]  # fmt: skip
TOOL_TIP = {"scratcher": (0, 0, 0.075), "wiper": (0, 0, 0.03), "hook": (-0.05, 0, 0.09), "spoon": (0, 0, 0.1),
            "toothbrush": (-0.006, 0, 0.1)}  # fmt: skip
TOOL_MASS = {"scratcher": 0.2516, "wiper": 0.3360, "hook": 0.1728, "spoon": 0.2334, "toothbrush": 0.2269}


@pytest.fixture(scope="module", params=list(TASKS))
def scene(request):
    config = TASKS[request.param].scene
    model = scenes.build(config).compile()
    return config, model


def start(model):
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.keyframe("start").id)
    mujoco.mj_forward(model, data)
    return data


def rot(axis, angle):
    """Rotation about a coordinate axis, without MuJoCo (Rodrigues)."""
    x = np.cross(np.eye(3), np.eye(3)["xyz".index(axis)])
    return np.eye(3) + np.sin(angle) * x + (1 - np.cos(angle)) * x @ x


def reach(model, data, point, steps=300):
    """Bring the tool point to a place by damped least squares, from the ready pose; returns the distance."""
    ids, limits = scenes.qpos_ids(model, scenes.PANDA.joints), np.array(PANDA_LIMITS)
    site, jac = model.site("tool_tip").id, np.zeros((3, model.nv))
    for _ in range(steps):
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        error = point - data.site_xpos[site]
        mujoco.mj_jacSite(model, data, jac, None, site)
        j = jac[:, ids]
        move = j.T @ np.linalg.solve(j @ j.T + 1e-3 * np.eye(3), np.clip(error, -0.03, 0.03))
        data.qpos[ids] = np.clip(data.qpos[ids] + move, *limits.T)
    return np.linalg.norm(error)


def touch(model):
    """A state in which the tool presses on the right upper arm."""
    data = start(model)
    arm = model.geom("right_upper_arm").id
    reach(model, data, data.geom_xpos[arm] + (0, 0, 0.01))
    mujoco.mj_forward(model, data)
    return data


def test_layout(scene):
    config, model = scene
    assert model.nq == model.nv == 16
    motors = [*config.human_driven, *scenes.PANDA.joints]
    actuators = [model.actuator(i).name for i in range(model.nu)]
    assert actuators[: len(motors)] == motors
    assert len(actuators) == len(motors) * (3 if config.speed_limits else 1)
    names = [model.sensor(i).name for i in range(model.nsensor)]
    driven = [*config.human_driven, *scenes.PANDA.joints]
    assert names[: len(driven)] == [f"torque_{j}" for j in driven]
    assert names[len(driven) :][:4] == ["tool_pos", "tool_quat", "tool_vel", "tool_angvel"]
    forces = [name for name in names if name.startswith(("tool_force", "robot_force"))]
    assert names[-len(forces) :] == forces and forces[:2] == ["tool_force", "robot_force"]
    data = start(model)
    rng = np.random.default_rng(0)
    data.qpos[:], data.qvel[:] = rng.normal(size=(2, 16))
    mujoco.mj_forward(model, data)
    at = scenes.sensor_slices(model)
    for segment in ("upper_arm", "forearm"):
        assert data.sensordata[at[f"{segment}_pos"]] == pytest.approx(data.body(f"right_{segment}").xpos)
        assert data.sensordata[at[f"{segment}_quat"]] == pytest.approx(data.body(f"right_{segment}").xquat)


def resting(config):
    """The joints that lie at their limit, on the furniture."""
    return tuple(set(scenes.POSTURES[config.posture].held) - set(config.human_driven))


def stopped(config):
    """Limits in rad by joint: where shoulders that are not driven are stopped a little below rest."""
    if not config.supported:
        return {}
    rest = dict(zip(scenes.HUMAN_JOINTS, scenes.POSTURES[config.posture].rest, strict=True))
    free = set(scenes.HUMAN_JOINTS) - set(config.human_driven) - set(resting(config))
    down = {"right_shoulder1": 1, "right_shoulder2": -1, "left_shoulder1": -1, "left_shoulder2": 1}
    return {name: (sign, rest[name] + sign * 0.005) for name, sign in down.items() if name in free}


def test_human_masses_and_ranges(scene):
    config, model = scene
    total = 0.0
    for name, mass in HUMAN_MASSES.items():
        sides = [name] if name in ("pelvis", "waist", "torso", "head") else [f"right_{name}", f"left_{name}"]
        for body in sides:
            assert model.body(body).mass[0] == pytest.approx(mass, rel=0.01), body
            total += model.body(body).mass[0]
    assert model.body_subtreemass[model.body("human").id] == pytest.approx(total)  # nothing else weighs
    assert total == pytest.approx(42.1, rel=0.01)
    for name, limits in HUMAN_RANGES.items():
        if name in resting(config):
            angle = start(model).qpos[scenes.qpos_ids(model, (name,))[0]]
            limits = (angle, limits[1])
        if name in stopped(config):
            sign, stop = stopped(config)[name]
            limits = (stop, limits[1]) if sign < 0 else (limits[0], stop)
        assert model.joint(name).range == pytest.approx(limits, abs=1e-4), name


def test_panda_inertials_and_limits(scene):
    config, model = scene
    for i, (_, _, mass, com, (xx, yy, zz, xy, xz, yz)) in enumerate(PANDA, start=1):
        body = model.body(f"link{i}")
        assert body.mass[0] == pytest.approx(mass, rel=1e-5)
        assert body.ipos == pytest.approx(com, abs=1e-6)
        axes = np.empty(9)
        mujoco.mju_quat2Mat(axes, body.iquat)
        axes = axes.reshape(3, 3)
        full = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert axes @ np.diag(body.inertia) @ axes.T == pytest.approx(full, abs=2e-5)
        assert model.joint(f"joint{i}").range == pytest.approx(PANDA_LIMITS[i - 1])
        assert (model.joint(f"joint{i}").damping[0], model.joint(f"joint{i}").armature[0]) == (1.0, 0.1)
    assert model.body("hand").mass[0] == 0.73
    tool = model.body("tool_mount").mass[0] + model.body("tool").mass[0]
    assert tool == pytest.approx(TOOL_MASS[config.tool], rel=0.01)


def test_panda_kinematics(scene):
    config, model = scene
    data, rng = start(model), np.random.default_rng(1)
    for q in [np.array(scenes.PANDA.ready), *rng.uniform(*np.array(PANDA_LIMITS).T, size=(5, 7))]:
        data.qpos[scenes.qpos_ids(model, scenes.PANDA.joints)] = q
        mujoco.mj_forward(model, data)
        pos, frame = np.array(config.robot_pos), rot("z", config.robot_yaw)
        for (offset, turn, *_), angle in zip(PANDA, q, strict=True):
            pos = pos + frame @ offset
            frame = frame @ rot("x", turn * np.pi / 2) @ rot("z", angle)
        pos, frame = pos + frame @ (0, 0, 0.107), frame @ rot("z", -np.pi / 4)
        assert data.body("hand").xpos == pytest.approx(pos, abs=1e-5)
        assert data.body("hand").xmat.reshape(3, 3) == pytest.approx(frame, abs=1e-5)
        tip = pos + frame @ ((0, 0, 0.1) + rot("z", np.pi) @ TOOL_TIP[config.tool])
        assert data.site("tool_tip").xpos == pytest.approx(tip, abs=1e-5)


def test_start_pose(scene):
    config, model = scene
    data = start(model)
    ids = scenes.qpos_ids(model, scenes.PANDA.joints)
    if config.tool == "spoon":  # level, its tip toward the mouth: a spoon has up = -x, tip = +z
        way = data.site("mouth").xpos - data.site("tool_tip").xpos
        frame = data.site("tool_tip").xmat.reshape(3, 3)
        assert -frame[2, 0] > 0.999 and frame[:, 2] @ way > 0.95 * np.linalg.norm(way)
        assert 0.3 < np.linalg.norm(way) < 0.6
    else:
        assert data.qpos[ids] == pytest.approx(config.ready or scenes.PANDA.ready)
    margin = np.minimum(data.qpos - model.jnt_range[:, 0], model.jnt_range[:, 1] - data.qpos)
    at_limit = scenes.qpos_ids(model, resting(config))
    near = scenes.qpos_ids(model, tuple(stopped(config)))
    assert np.delete(margin, [*at_limit, *near.astype(int)]).min() > 0.01  # the reset noise of 0.005 stays inside
    assert margin[at_limit] == pytest.approx(0.0, abs=1e-6)
    assert min(data.contact.dist, default=0) > -0.002
    assert 1 not in model.geom_contype[data.contact.geom]  # the robot hovers
    arm_driven = "right_elbow" in config.human_driven
    assert (len(data.contact) > 0) == arm_driven  # an arm that can be lifted lies on something


def test_an_arm_that_is_not_driven_does_not_sink_into_the_furniture(scene):
    """10 N from above, for two seconds: 61 to 196 mm in version 0, whose shoulders are springs alone."""
    config, model = scene
    for side in ("right", "left"):
        if not config.supported or set(scenes.RIGHT_ARM if side == "right" else scenes.LEFT_ARM) & set(
            config.human_driven
        ):
            continue
        for part in ("upper_arm", "forearm", "hand"):
            data, geom = start(model), model.geom(f"{side}_{part}").id
            before = data.geom_xpos[geom].copy()
            for _ in range(1000):
                data.qfrc_applied[:] = 0.0
                place, body = data.geom_xpos[geom], model.geom_bodyid[geom]
                mujoco.mj_applyFT(model, data, np.array([0, 0, -10.0]), np.zeros(3), place, body, data.qfrc_applied)
                mujoco.mj_step(model, data)
            assert np.linalg.norm(data.geom_xpos[geom] - before) < 0.005


def test_resting_person_and_robot_stay(scene):
    _, model = scene
    data = start(model)
    begin = data.xpos.copy()
    furthest = 0.0
    for _ in range(4000):
        mujoco.mj_step(model, data)
        furthest = max(furthest, np.linalg.norm(data.xpos - begin, axis=1).max())
    assert furthest < 1e-3  # the specification asks for 0.01; the balanced springs give 1e-4
    hand = model.body("hand").id
    assert np.linalg.norm(data.xpos[hand] - begin[hand]) < 1e-3


def test_human_motors(scene):
    config, model = scene
    data = start(model)
    data.ctrl[: len(config.human_driven)] = 1.0
    mujoco.mj_forward(model, data)
    torque = np.zeros(16)
    torque[scenes.qpos_ids(model, config.human_driven)] = 10.0 * config.human_strength
    assert data.qfrc_actuator == pytest.approx(torque)
    gain = model.actuator_gainprm[: len(config.human_driven), 0]  # where a profile sets the strength
    assert gain == pytest.approx(10.0 * config.human_strength)


def test_contact_sensors(scene):
    """The force sensors are the sum of the contact forces on the person, in the world frame."""
    _, model = scene
    data, at = touch(model), scenes.sensor_slices(model)
    under = model.body_rootid == model.body("human").id
    robot = model.body_rootid == model.body("robot").id
    force = {"tool_force": np.zeros(3), "robot_force": np.zeros(3)}
    for i, contact in enumerate(data.contact):
        first, second = model.geom_bodyid[contact.geom]
        if not (under[first] and robot[second]) and not (robot[first] and under[second]):
            continue
        local = np.zeros(6)
        mujoco.mj_contactForce(model, data, i, local)
        on_second = contact.frame.reshape(3, 3).T @ local[:3]
        on_person = on_second if under[second] else -on_second
        force["robot_force"] += on_person
        if model.body("tool").id in (first, second):
            force["tool_force"] += on_person
    assert np.linalg.norm(force["tool_force"]) > 1.0
    for name, value in force.items():
        assert data.sensordata[at[name]] == pytest.approx(value, abs=1e-6), name


def test_an_arm_and_a_mattress_named_as_pairs_touch_as_by_type(scene):
    """Wherever the joints are: all contacts to the bit and in the order in which MuJoCo finds them by contype alone."""
    config, _ = scene
    by_name, by_type = (scenes.build(config, visuals=False) for _ in range(2))
    for pair in list(by_type.pairs):
        by_type.delete(pair)
    if config.furniture == "bed":
        by_type.geom("mattress").conaffinity = 3
    models = by_name.compile(), by_type.compile()
    named, typed = (mujoco.MjData(model) for model in models)
    low, high = models[0].jnt_range.T
    pairs = {*zip(models[0].pair_geom1, models[0].pair_geom2, strict=True)}
    rng, touched = np.random.default_rng(0), 0
    for _ in range(1000):
        qpos = rng.uniform(low, high)
        for model, data in zip(models, (named, typed), strict=True):
            data.qpos = qpos
            mujoco.mj_forward(model, data)
        for field in ("geom", "dist", "pos", "frame", "dim", "friction", "solref", "solimp"):
            np.testing.assert_array_equal(getattr(named.contact, field), getattr(typed.contact, field))
        touched += sum((a, b) in pairs or (b, a) in pairs for a, b in named.contact.geom)
    assert models[1].npair == 0
    assert (len(pairs), touched > 100) == ((3, True) if config.furniture == "bed" else (0, False))


def test_solver_converges(scene):
    """The chosen iterations give what a hundred give, while the tool presses on the arm."""
    _, model = scene
    data = touch(model)
    for _ in range(20):
        mujoco.mj_step(model, data)
        kept = model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance
        model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 100, 50, 1e-10
        mujoco.mj_forward(model, data)
        exact = data.qacc.copy()
        model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = kept
        mujoco.mj_forward(model, data)
        few = data.qacc
        assert few == pytest.approx(exact, rel=2e-4, abs=2e-3)  # rad/s²


def test_without_visuals_is_the_same_physics(scene):
    config, model = scene
    bare = scenes.build(config, visuals=False).compile()
    assert bare.ngeom < model.ngeom
    # Merging fixed bodies moves the point at which MuJoCo rates a body's contact stiffness: merge both.
    spec = scenes.build(config)
    spec.compiler.fusestatic = True
    model = spec.compile()
    full, lean = touch(model), touch(bare)
    for _ in range(20):
        mujoco.mj_step(model, full)
        mujoco.mj_step(bare, lean)
    assert lean.sensordata == pytest.approx(full.sensordata, abs=1e-9)


def test_wrong_config_is_refused():
    base = dict(furniture="wheelchair", posture="seated", tool="scratcher", robot_pos=(0, 0, 0), robot_yaw=0.0)
    with pytest.raises(ValueError, match="control"):
        scenes.SceneConfig(**base, human_driven=(), control="velocity")
    with pytest.raises(ValueError, match="human_driven"):
        scenes.SceneConfig(**base, human_driven=("joint1",))
