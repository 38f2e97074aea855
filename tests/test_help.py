"""What counts as help, and a cheat for each task that scores nothing."""

import dataclasses
import importlib
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from instants import DT, at_rest, env_of, play, repeated, sensors

from assistax import scenes

# -- scratch ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("distance", "speed", "force", "counts"),  # in these versions
    [(0.015, 0.1, 3.0, (1, 2)), (0.03, 0.1, 3.0, (1,)), (0.05, 0.1, 3.0, ()), (0.015, 0.02, 3.0, ()),
     (0.015, 0.4, 3.0, ()), (0.015, 0.1, 0.5, ()), (0.015, 0.1, 7.0, ())],
)  # fmt: skip
@pytest.mark.parametrize("version", [1, 2])
def test_scratching_is_near_the_itch_firm_and_moving(version, distance, speed, force, counts):
    env, s = at_rest(f"scratch-v{version}")
    state = dataclasses.replace(env.task.reset(jax.random.key(0)), segment=jnp.int32(1))
    frame = np.asarray(scenes.geometry.matrix(jnp.asarray(s["forearm_quat"][0])))
    s["tool_pos"] = s["forearm_pos"] + frame @ np.asarray(state.itch) + [0, 0, distance]
    s["tool_vel_forearm"] = np.array([[0, speed, 0.0]])
    s["tool_force_forearm"] = s["tool_force"] = np.array([[0, 0, force]])
    assert bool(play(env, s, state).scratch_seconds > 0) == (version in counts)
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
    state = dataclasses.replace(state, strokes=jnp.full((2, 3), 0.06))  # as before
    frame = np.asarray(scenes.geometry.matrix(jnp.asarray(s["forearm_quat"][0])))
    s["tool_vel_forearm"], s["tool_force_forearm"] = np.array([[0, 0.1, 0.0]]), np.array([[0, 0, 3.0]])
    for side, counts in ((1.0, True), (-1.0, False)):
        s["tool_pos"] = s["forearm_pos"] + frame @ (limb.centre + side * limb.radius * normal)
        assert bool(play(env, s, state).scratch_seconds > 0) == counts


SWINGS = {  # Hz, mm to either side over the skin, and how much of that is the tool's own
    "strokes": (1.5, 10.0, 1.0),
    "trembles": (15.0, 1.3, 1.0),
    "rests": (1.5, 10.0, 0.0),
    "hardly moves": (1.5, 10.0, 0.2),
    "is carried along": (1.5, 0.0, 1.0),
}


def on_the_itch():
    env, s = at_rest("scratch")
    state = dataclasses.replace(env.task.reset(jax.random.key(0)), segment=jnp.int32(1))
    frame = np.asarray(scenes.geometry.matrix(jnp.asarray(s["forearm_quat"][0])), float)
    s["tool_pos"] = s["forearm_pos"] + frame @ np.asarray(state.itch)
    s["tool_force_forearm"] = np.array([[0, 0, 3.0]])
    return env, s, state, lambda after: after.scratch_seconds


def on_the_dirt():
    env, s = at_rest("bed_bath")
    return env, washing(env, s, 4), dirty_all_over(env), lambda after: after.seconds[29 + 4]


@pytest.mark.parametrize(
    ("place", "least", "most", "long"), [(on_the_itch, 0.03, 0.3, 1.0), (on_the_dirt, 0.05, 0.4, 0.5)]
)
def test_strokes_count_and_what_trembles_or_rests_on_an_arm_that_moves_does_not(place, least, most, long):
    """Against a float64 filter of both velocities, of the tool over the skin and in the room, along swings."""
    env, s, state, counter = place()
    frame = np.asarray(scenes.geometry.matrix(jnp.asarray(s["forearm_quat"][0])), float)
    t, seconds = DT * np.arange(250), {}
    for name, (hertz, mm, own) in SWINGS.items():
        wave = 2 * np.pi * hertz * 0.001 * np.cos(2 * np.pi * hertz * t)[:, None] * np.array([0.0, 0.6, 0.8])
        felt, moved = wave * mm, wave * own * (mm or 10.0)
        filtered, counted = np.zeros((2, 3)), 0
        for now in zip(felt @ frame.T, moved, strict=True):
            filtered += (1 - np.exp(-DT / 0.1)) * (np.array(now) - filtered)
            counted += least <= np.linalg.norm(filtered, axis=1).min() <= most
        row = repeated(s, len(t)) | {"tool_vel_forearm": felt, "tool_vel": moved}
        seconds[name] = float(counter(play(env, row, state)))
        assert seconds[name] == pytest.approx(counted * DT, abs=1e-4)
    assert seconds.pop("strokes") > long and not any(seconds.values())


def test_itches_are_uniform_over_all_of_the_skin_between_shoulder_and_wrist():
    env = env_of("scratch-v1")
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


@pytest.mark.slow
def test_two_in_five_itches_are_touched_only_if_the_person_moves(monkeypatch):
    """By inverse kinematics over both bodies, in the postures in which people offer the arm.

    Scratching counts near the itch, too: in version 1 within 4 cm, so that most could be done while the arm rests.
    """
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "tools"))
    offers = importlib.import_module("offers")
    reach = offers.Reach("scratch")
    rest, _ = reach.touched(reach.rest[reach.person])
    ways = json.loads(offers.OFFERS.read_text())["scratch"]
    moved = [reach.touched(np.array(posture))[0] for way in ways for posture in way["postures"][1:]]
    assert rest.mean() == pytest.approx(0.58, abs=0.02)
    apart = np.linalg.norm(reach.points[:, None] - reach.points[rest], axis=-1)
    apart[reach.segment[:, None] != reach.segment[rest]] = np.inf
    for near, share in ((0.04, 0.92), (reach.env.task_config.scratch_distance, 0.70)):
        assert (apart.min(1) < near).mean() == pytest.approx(share, abs=0.03)
    assert np.logical_or.reduce([rest, *moved]).mean() > 0.95


def around(env, s, body, point):
    """The outward normal [3] at a point [3] of the skin of a limb, the way to it from the tool in m, straight and then
    around the limb from the side that the tool is on, and where the point is; in world axes."""
    data = mujoco.MjData(env.model)
    data.qpos = env.model.key("start").qpos
    mujoco.mj_forward(env.model, data)
    limb, body = scenes.geometry.capsule(env.model, body), data.body(body)
    frame = body.xmat.reshape(3, 3)
    flat = np.eye(3) - np.outer(limb.axis, limb.axis)
    normal, tool = (flat @ (x - limb.centre) for x in (point, frame.T @ (s["tool_pos"][0] - body.xpos)))
    angle = np.arccos(np.clip(normal @ tool / np.linalg.norm(normal) / np.linalg.norm(tool), -1, 1))
    straight = np.linalg.norm(s["tool_pos"][0] - body.xpos - frame @ point)
    return frame @ normal / limb.radius, straight + limb.radius * angle, body.xpos + frame @ point


def facing(env, normal, place):
    """How far a normal [3] at a place [3] points to the robot and 45° up, from 0 to 1."""
    level = (np.array(env.spec.scene.robot_pos) - place)[:2]
    return 0.5 + 0.5 * normal @ np.append(level / np.linalg.norm(level), 1.0) / np.sqrt(2.0)


@pytest.mark.parametrize("place", range(6))
def test_the_side_of_an_itch_is_seen_and_reach_leads_around_the_arm_to_it(place):
    env, s = at_rest("scratch")
    state = env.task.reset(jax.random.key(place))
    body = ("right_upper_arm", "right_forearm")[int(state.segment)]
    off = np.random.default_rng(place).normal(size=3) * 0.2
    s["tool_pos"] = s["tool_pos"] * 0.0 + np.asarray(s[f"{body.removeprefix('right_')}_pos"]) + off
    normal, way, _ = around(env, s, body, np.asarray(state.itch, float))
    now = {name: jnp.asarray(x[0], jnp.float32) for name, x in s.items()}
    seen, frame = env.task.observe(now, state), np.zeros(9)
    np.testing.assert_allclose(seen["target_normal"], normal, atol=1e-5)
    mujoco.mju_quat2Mat(frame, s[f"{body.removeprefix('right_')}_quat"][0].astype(float))
    limb = scenes.geometry.capsule(env.model, body)
    np.testing.assert_allclose(seen["target_axis"], frame.reshape(3, 3) @ limb.axis, atol=1e-5)
    assert float(env.task.reward_terms(now, state)["reach"]) == pytest.approx(np.exp(-(way**2) / 0.1), abs=1e-5)


def test_it_itches_everywhere_but_where_nobody_can_scratch():
    """Version 2 spares a twelfth of the forearm's girth; all else itches evenly, and the upper arm as often."""
    env = env_of("scratch-v2")
    states = jax.vmap(env.task.reset)(jax.random.split(jax.random.key(0), 20_000))
    height, angle = (np.asarray(x) for x in jax.vmap(env.task.place)(states))
    fore, degrees = np.asarray(states.segment) == 1, np.degrees(angle) % 360.0
    assert not (fore & (degrees > 90.01) & (degrees < 119.99)).any()
    counts = {part: np.histogram(degrees[of], np.arange(0, 361, 30))[0] for part, of in (("f", fore), ("u", ~fore))}
    for part, bins in (("f", [i for i in range(12) if i != 3]), ("u", range(12))):
        share = counts[part][bins] / counts[part].sum()
        np.testing.assert_allclose(share, 1.0 / len(bins), rtol=0.2)
    limbs = [scenes.geometry.capsule(env.model, f"right_{part}") for part in ("upper_arm", "forearm")]
    skin = [limb.radius * limb.half_length for limb in limbs]
    assert fore.mean() == pytest.approx(11 / 12 * skin[1] / (skin[0] + 11 / 12 * skin[1]), abs=0.01)
    assert np.abs(height).max() <= 1.001 and np.histogram(height, 10)[0].min() > 1700


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
def test_the_dirt_that_is_best_to_reach_is_seen_and_every_dirty_point_pays_its_share_of_reach(place):
    env, s = at_rest("bed_bath")
    turned = np.random.default_rng(place).normal(size=4)
    s["tool_quat"] = (turned / np.linalg.norm(turned))[None]
    state = env.task.reset(jax.random.key(place))
    washed = np.flatnonzero(np.asarray(state.dirty))[:place]
    state = dataclasses.replace(state, visited=state.visited.at[washed].set(True))
    s["tool_pos"] = s["forearm_pos"] + np.random.default_rng(place).normal(size=3) * 0.1
    bodies = ["right_upper_arm"] * 29 + ["right_forearm"] * 23
    points = np.concatenate([np.asarray(x, float) for x in env.task.points])
    found = [around(env, s, body, point) for body, point in zip(bodies, points, strict=True)]
    normals, ways, places = zip(*found, strict=True)
    pad = np.zeros(9)
    mujoco.mju_quat2Mat(pad, np.asarray(s["tool_quat"][0], float))
    flat = [0.5 - 0.5 * normal @ pad.reshape(3, 3)[:, 2] for normal in normals]
    worse = [
        0.6 * (1.0 - facing(env, normal, where)) + 0.2 * (1.0 - lies)
        for normal, where, lies in zip(normals, places, flat, strict=True)
    ]
    best = np.where(np.asarray(state.visited), np.inf, np.array(ways) + worse).argmin()
    now = {name: jnp.asarray(x[0], jnp.float32) for name, x in s.items()}
    seen = env.task.observe(now, state)
    np.testing.assert_allclose(seen["target_normal"], normals[best], atol=1e-5)
    np.testing.assert_allclose(seen["target_vector"], places[best] - s["tool_pos"][0], atol=1e-5)
    left = ~np.asarray(state.visited)
    for i, segment in enumerate((slice(0, 29), slice(29, 52))):
        body = env.model.body(bodies[segment.start]).id
        limb = scenes.geometry.capsule(env.model, bodies[segment.start])
        data = mujoco.MjData(env.model)
        mujoco.mj_resetDataKeyframe(env.model, data, env.model.key("start").id)
        mujoco.mj_kinematics(env.model, data)
        np.testing.assert_allclose(
            seen["arm_axes"][3 * i : 3 * i + 3], data.xmat[body].reshape(3, 3) @ limb.axis, atol=1e-5
        )
        normal = np.mean(np.array(normals)[segment][left[segment]], 0) if left[segment].any() else np.zeros(3)
        np.testing.assert_allclose(seen["dirt_normals"][3 * i : 3 * i + 3], normal, atol=1e-5)
        vector = (
            np.mean(np.array(places)[segment][left[segment]], 0) - s["tool_pos"][0] if left[segment].any() else normal
        )
        np.testing.assert_allclose(seen["dirt_vectors"][3 * i : 3 * i + 3], vector, atol=1e-5)
        assert float(seen["dirt_left"][i]) == pytest.approx(left[segment].sum() / np.asarray(state.dirty).sum())
    # Around both limbs from their upper sides, in a frame that lies with the limb.
    around_limb = []
    for body, point in zip(bodies, points, strict=True):
        limb = scenes.geometry.capsule(env.model, body)
        up = scenes.geometry.upward(env.model, body, limb)
        out = (point - limb.centre - limb.axis * (limb.axis @ (point - limb.centre))) / limb.radius
        around_limb.append([out @ up, out @ np.cross(limb.axis, up)])
    middle = np.mean(np.array(around_limb)[np.asarray(state.dirty)], 0)
    np.testing.assert_allclose(seen["dirty_side"], middle, atol=1e-5)
    paid = []
    for i in np.flatnonzero(np.asarray(state.dirty)):
        paid.append(np.exp(-(ways[i] ** 2) / 0.1) * (1.0 + facing(env, normals[i], places[i]) + flat[i]) / 3.0)
        if i in washed:
            paid[-1] = 1.0
    assert float(env.task.reward_terms(now, state)["reach"]) == pytest.approx(np.mean(paid), abs=1e-5)


def test_washing_a_point_costs_nothing_later_wherever_the_pad_is():
    """When reach was paid for the nearest dirt alone, who washed it lost its reach to the end of the episode."""
    env, s = at_rest("bed_bath")
    rng = np.random.default_rng(0)
    reach = jax.jit(lambda s, state: env.task.reward_terms(s, state)["reach"])
    for i in range(40):
        state = env.task.reset(jax.random.key(i))
        s["tool_pos"] = s["forearm_pos"] + rng.normal(size=3) * 0.15
        turned = rng.normal(size=4)
        s["tool_quat"] = (turned / np.linalg.norm(turned))[None]
        now = {name: jnp.asarray(x[0], jnp.float32) for name, x in s.items()}
        before = float(reach(now, state))
        for point in rng.permutation(np.flatnonzero(np.asarray(state.dirty))):
            state = dataclasses.replace(state, visited=state.visited.at[point].set(True))
            after = float(reach(now, state))
            assert after > before - 1e-6
            before = after
        assert before == pytest.approx(1.0, abs=1e-6)


def dirty_all_over(env):
    state = env.task.reset(jax.random.key(0))
    return dataclasses.replace(state, dirty=jnp.ones(52, bool), visited=jnp.zeros(52, bool))


def washing(env, s, point, force=5.0, speed=0.1):
    """The pad on a point of the forearm, and moving over it as it did before."""
    frame = np.asarray(scenes.geometry.matrix(jnp.asarray(s["forearm_quat"][0])))
    s = dict(s)
    s["tool_pos"] = s["forearm_pos"] + frame @ np.asarray(env.task.points[1][point])
    s["tool_force_forearm"], s["tool_vel_forearm"] = np.array([[0, 0, force]]), np.array([[speed, 0, 0.0]])
    s["tool_vel"] = np.array([[speed, 0, 0.0]])
    return s


@pytest.mark.parametrize(("version", "steps", "slow"), [(1, 10, 0.01), (2, 10, 0.01), (3, 25, 0.04)])
def test_a_point_is_washed_after_so_long_of_rubbing_and_one_touch_of_the_pad_washes_none(version, steps, slow):
    env, s = at_rest(f"bed_bath-v{version}")

    def rub(count, state, force=5.0, speed=0.1):
        state = dataclasses.replace(state, strokes=jnp.full((3, 3), jnp.array([speed, 0.0, 0.0])))  # as before
        return play(env, repeated(washing(env, s, 4, force, speed), count), state)

    all_dirty = dirty_all_over(env)
    assert not rub(1, all_dirty).visited.any()  # one 8 ms contact, eleven points in version 0
    nearly = rub(steps - 1, all_dirty)
    assert not nearly.visited.any()
    washed = rub(1, nearly)
    now = {k: jnp.asarray(x[0]) for k, x in washing(env, s, 4).items()}
    far = np.linalg.norm(np.asarray(env.task.to_points(now)), axis=1)
    np.testing.assert_array_equal(np.flatnonzero(washed.visited), [i for i in range(29, 52) if far[i] < 0.05])
    assert washed.newly == washed.visited.sum() > 0 and rub(1, washed).newly == 0
    for force, speed in ((0.4, 0.1), (16.0, 0.1), (5.0, slow), (5.0, 1.2)):
        assert not rub(50, all_dirty, force, speed).visited.any()


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


def test_whether_the_arm_was_thrown_is_seen_and_a_thrown_arm_is_no_help():
    env, s = at_rest("arm_assist")
    there = s | {"wrist_target_pos": s["waist_target_pos"] + [0, 0.05, 0]}
    fast = there | {"wrist_target_vel": np.array([[0, 0.3, -0.6]])}
    for moves, thrown in (((there,), 0.0), ((fast, there), 1.0)):
        state = None
        for move in moves:
            state = play(env, move, state)
        now = {name: jnp.asarray(x[0], jnp.float32) for name, x in move.items()}
        assert env.task.observe(now, state)["thrown"] == thrown and env.task.helping(now, state) == (not thrown)
    seen = env.task.observe({name: jnp.asarray(x[0], jnp.float32) for name, x in fast.items()}, state)
    np.testing.assert_allclose(seen["target_velocity"], [0, 0.3, -0.6], rtol=1e-6)


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


def spoon(s, bearing=0.0, up=(0, 0, 1.0), tip=None, distance=0.036, speed=0.05, force=1.0):
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
        "tool_vel_head": np.array([[speed, 0, 0.0]]), "tool_force_head": np.array([[-force, 0, 0.0]]),
    }  # fmt: skip


def test_a_spoon_feeds_from_the_front_with_its_tip_in_and_its_food_up():
    env, s = at_rest("feeding")

    def fed(*args, **kwargs):
        return bool(env.task.success(play(env, repeated(spoon(s, *args, **kwargs), 63))))

    assert fed() and fed(bearing=0.9) and fed(up=(0.7, 0, 1.0))
    assert not fed(bearing=1.2)  # from the side
    assert not fed(up=(0, 0, -1.0))  # upside down
    assert not fed(tip=(0, 0, 1.0), up=(0, 1.0, 0))  # from below
    assert not fed(speed=0.15) and not fed(distance=0.07)
    assert fed(force=0.11) and not fed(force=0.09)  # before the lips


@pytest.mark.parametrize(
    ("left", "up", "versions"),
    [(0.0, 0.008, (1, 2, 3)), (0.0, -0.008, (1, 2, 3)), (-0.018, 0.0, (1, 2, 3)), (0.0, -0.021, (1,)),
     (0.0, 0.012, (1,)), (0.022, 0.0, (1,)), (0.0, -0.032, ())],
)  # fmt: skip
def test_a_spoon_feeds_at_the_lips_and_not_at_chin_nose_or_cheek(left, up, versions):
    """A level spoon with its tip at the face, off the middle of the mouth by so many m as the person sees it."""
    for version in (1, 2, 3):
        env, s = at_rest(f"feeding-v{version}")
        face = np.asarray(scenes.geometry.matrix(jnp.asarray(s["mouth_quat"][0])), float)
        held = spoon(s)
        held |= {"tool_pos": held["tool_pos"] + left * face[:, 1] + up * face[:, 2]}
        assert bool(env.task.success(play(env, repeated(held, 63)))) == (version in versions)


def test_food_falls_by_gravity_as_the_bowl_feels_it():
    """Against a float64 filter of the spoon's acceleration along shaken and tilted trajectories."""
    env, s = at_rest("feeding")
    rng, lost = np.random.default_rng(0), []
    for case in range(12):
        n, t = 60, np.arange(60) * DT
        amplitude, hertz, tilt = rng.uniform(0, 0.04), rng.uniform(1, 6), rng.uniform(0, 0.9)
        velocity = np.zeros((n, 3))
        velocity[:, 0] = amplitude * 2 * np.pi * hertz * np.sin(2 * np.pi * hertz * t)
        row = spoon(s, up=(np.sin(tilt), 0, np.cos(tilt)), distance=0.3)
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
    for version, where, steps, spills in ((2, 0.07, 188, False), (3, 0.07, 12, False), (3, 0.07, 13, True)):
        former, s = at_rest(f"feeding-v{version}")  # over 60° before the mouth
        assert play(former, repeated(spoon(s, up=(1.0, 0, 0.5), distance=where), steps)).spilled == spills
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
    env = env_of("tooth_brushing-v1")  # in version 2 the brush itself would have to move in the second case, too
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


@pytest.mark.parametrize(
    ("aside", "above", "own", "versions"),
    [(0.0, 0.0, 0.1, (1, 2)), (0.02, -0.01, 0.1, (1, 2)), (0.0, 0.0, 0.02, (1,)), (0.0, 0.0, 0.0, (1,)),
     (0.03, 0.0, 0.1, (1,)), (-0.03, 0.0, 0.1, (1,)), (0.0, 0.02, 0.1, (1,)), (0.0, -0.02, 0.1, (1,)),
     (0.0, 0.06, 0.1, ())],
)  # fmt: skip
def test_a_brush_brushes_the_teeth_and_by_its_own_strokes(aside, above, own, versions):
    """Off the middle of the mouth by so many m; on it the bristles move by 0.1 m/s, in the room by `own`."""
    for version in (1, 2):
        env, s = at_rest(f"tooth_brushing-v{version}")
        face = np.asarray(scenes.geometry.matrix(jnp.asarray(s["mouth_quat"][0])), float)
        s["tool_quat"] = s["mouth_quat"]
        s["tool_pos"] = s["mouth_pos"] + aside * face[:, 1] + above * face[:, 2]
        s |= {"tool_force_head": np.array([[-1.0, 0, 0]]), "tool_vel_head": np.array([[0.4, 0, 0.1]])}  # and presses
        s["tool_vel"] = (0.4 * face[:, 0] + own * face[:, 1])[None]
        if version == 1:
            s["tool_vel_head"] = np.array([[0.0, 0.07, 0.07]])
        assert bool(play(env, s).brush_seconds > 0) == (version in versions)


def test_an_arm_must_be_at_the_waist_at_the_end():
    for version, stays, succeeds in ((1, True, True), (1, False, True), (2, True, True), (2, False, False)):
        env, s = at_rest(f"arm_assist-v{version}")
        s["wrist_target_vel"] = np.zeros((1, 3))
        there = s | {"wrist_target_pos": s["waist_target_pos"] + [0, 0.05, 0]}
        state = play(env, repeated(there, 70))
        assert bool(env.task.success(play(env, repeated(there if stays else s, 10), state))) == succeeds
