"""Disabilities and preferences: against the paper's formulas, and as they show in the simulation."""

import dataclasses
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import random_actions

import assistax
from assistax.human import DISABILITIES, HumanConfig, disability, preference


def test_liking_is_the_papers_gaussian_on_its_whole_domain():
    for low, high in ((0.06, 0.14), (1.5, 3.5)):
        x = np.linspace(-1.0, 8.0, 2001)
        centre, width = (low + high) / 2, (high - low) / 2
        expected = np.where((low <= x) & (x <= high), 1.0, np.exp(-((x - centre) ** 2) / (2 * width**2)))
        got = jax.vmap(preference.liking, (0, None))(jnp.asarray(x), jnp.array([low, high]))
        np.testing.assert_allclose(got, expected, atol=2e-5)


def test_positive_terms_add_up_to_the_budget_whatever_the_weights():
    for seed in range(20):
        person = preference.sample(jax.random.key(seed))
        perfect = preference.reward_terms(
            person, person.speed.mean(), person.force.mean(), person.force.mean(), jnp.zeros(7), 1.88
        )
        np.testing.assert_allclose(sum(perfect.values()), 1.88, rtol=1e-5)
    thrifty = preference.preference(weights=(0.2, 0.2, -0.05, 0.4))
    terms = preference.reward_terms(thrifty, 0.1, 2.0, 2.0, jnp.zeros(7), 1.0)
    np.testing.assert_allclose(terms["prefer_action"], 0.5, rtol=1e-5)


def test_combined_maxima_are_the_papers_table():
    task = {"scratch": 1000, "bed_bath": 1156, "arm_assist": 11280, "feeding": 4700, "tooth_brushing": 3140}
    combined = {"scratch": 2000, "bed_bath": 2312, "arm_assist": 15792, "feeding": 6580, "tooth_brushing": 4396}
    assert {name: task[name] + 1000 * preference.BUDGET[name] for name in task} == combined


def test_a_touch_counts_once():
    person = preference.preference()
    forces = [0.0, 0.05, 0.2, 3.0, 0.09, 0.09, 0.1, 0.2]
    touches = [
        float(preference.reward_terms(person, 0.0, now, before, jnp.zeros(7), 1.0)["prefer_touch"]) < 0
        for before, now in pairwise(forces)
    ]
    assert touches == [False, True, False, False, False, True, False]


def test_sweep_stays_in_the_papers_ranges_and_is_never_too_narrow():
    drawn = jax.vmap(preference.sample)(jax.random.split(jax.random.key(0), 5000))
    speed, force, weights = (np.asarray(x) for x in (drawn.speed, drawn.force, drawn.weights))
    for low, high, values in (
        (0.03, 0.08, speed[:, 0]), (0.05, 0.20, speed[:, 1]), (1.0, 2.0, force[:, 0]), (1.5, 5.0, force[:, 1]),
        (0.1, 0.5, weights[:, 0]), (0.1, 0.6, weights[:, 1]), (-0.1, -0.01, weights[:, 2]),
    ):  # fmt: skip
        assert low - 1e-6 <= values.min() and values.max() <= high + 1e-6
        assert np.ptp(values) > 0.9 * (high - low)
    assert (np.diff(speed) >= 0.02 - 1e-6).all() and (np.diff(force) >= 0.5 - 1e-6).all()
    np.testing.assert_allclose(preference.vector(preference.preference()), [0.06, 0.14, 1.5, 3.5, 0.3, 0.35, -0.03])


def test_the_seven_standard_settings():
    assert list(DISABILITIES) == [
        "tremor", "weakness", "limited_range", "tremor+weakness", "tremor+limited_range",
        "weakness+limited_range", "tremor+weakness+limited_range",
    ]  # fmt: skip
    draw = jax.vmap(HumanConfig(disability="standard").draw)(jax.random.split(jax.random.key(0), 300))
    kinds = np.unique(np.stack([draw.disability.tremor, draw.disability.strength, draw.disability.motion]), axis=1)
    assert kinds.shape[1] == 7


@pytest.fixture(scope="module", params=["scratch", "bed_bath", "arm_assist", "feeding", "tooth_brushing"])
def play(request):
    """play(disability, action, steps): sensors by name [T, ...] while the robot is still and the human's
    action constant; and the last state. One compilation per task: a person is data."""
    env = assistax.make(request.param, engine="mujoco", human={"disability": "standard"}, reset_noise=0.0)
    start = env.reset(jax.random.key(0))[1]
    actions = {"robot": jnp.zeros(7), "human": jnp.ones(env.action_sizes["human"])}

    def roll(state, action):
        def step(state, _):
            state = env.step_env(state, {"robot": actions["robot"], "human": action * actions["human"]})[0]
            return state, env.sensors(state.physics)

        return jax.lax.scan(step, state, None, 250)

    roll = jax.jit(roll)

    def play(action=0.0, **parts):
        person = disability.disability(**parts)
        physics = env.engine.init(start.physics.qpos, start.physics.qvel, env._body.overrides(person))
        person = dataclasses.replace(start.person, disability=person)
        state, sensors = roll(dataclasses.replace(start, physics=physics, person=person), action)
        return {name: np.asarray(value) for name, value in sensors.items()}, state

    return play


def test_tremor_has_its_frequency_and_no_mean(play):
    still, _ = play()
    shaking, state = play(tremor=0.3, tremor_hz=5.0)
    full = float(state.physics.overrides["actuator_gainprm"][0, 0])
    torque = shaking["torque_human"][:, 0]
    spectrum = np.abs(np.fft.rfft(torque))
    assert np.fft.rfftfreq(250, 0.008)[spectrum.argmax()] == pytest.approx(5.0, abs=0.26)
    assert abs(torque.mean()) < 1e-3 * full
    assert np.abs(torque).max() == pytest.approx(0.3 * full, rel=0.02)
    moved = [np.ptp(s["theta_human"], axis=0).max() for s in (still, shaking)]
    assert moved[1] > 3 * moved[0] + 0.002


def test_weakness_scales_torque_and_limited_range_limits_motion(play):
    def travel(sensors, steps=250):
        return np.abs(sensors["theta_human"][:steps] - sensors["theta_human"][0]).max()

    furthest = {}
    for action in (-1.0, 1.0):
        healthy, _ = play(action)
        weak, _ = play(action, strength=0.4)
        stiff, state = play(action, motion=0.1)
        np.testing.assert_allclose(weak["torque_human"], 0.4 * healthy["torque_human"], rtol=1e-4)
        # Strength shows at once, before the limits do; the range shows in the end.
        furthest[travel(healthy)] = travel(weak, 15) / travel(healthy, 15), travel(stiff) / travel(healthy)
    slower, shorter = zip(*furthest.values(), strict=True)  # by direction; one may be blocked by furniture
    assert min(slower) < 0.8 and min(shorter) < 0.7
    limits = np.asarray(state.physics.overrides["jnt_range"])
    whole = np.asarray(play()[1].physics.overrides["jnt_range"])
    narrower = (limits[:, 1] - limits[:, 0]) < 0.11 * (whole[:, 1] - whole[:, 0])
    assert narrower.sum() == weak["torque_human"].shape[1]  # the driven joints and no others


def test_a_reset_starts_within_narrow_limits():
    env = assistax.make("scratch", engine="mujoco", human={"disability": "motion=0.05"})
    _, state = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(0), 64))
    limits = np.asarray(state.physics.overrides["jnt_range"])
    qpos = np.asarray(state.physics.qpos)
    assert (limits[..., 0] - 1e-6 <= qpos).all() and (qpos <= limits[..., 1] + 1e-6).all()
    assert len(np.unique(np.asarray(state.phase)[:, 0])) == 64


def test_a_person_travels_with_the_state_and_changes_at_a_reset():
    env = assistax.make(
        "scratch", engine="mujoco", episode_length=5, human={"disability": "standard", "preference": "sweep"}
    )
    keys = jax.random.split(jax.random.key(0), 16)
    _, state = jax.jit(jax.vmap(env.reset))(keys)
    step = jax.jit(jax.vmap(env.step))
    people = [np.asarray(state.person.preference.speed)]
    for i in range(6):
        _, state, *_ = step(keys, state, random_actions(env, jax.random.key(i), (16,)))
        people.append(np.asarray(state.person.preference.speed))
    for i, (before, after) in enumerate(pairwise(people)):
        assert (before == after).all() == (i != 4)
    strength = state.physics.overrides["actuator_gainprm"][:, 0, 0] / 10.0
    np.testing.assert_allclose(strength, state.person.disability.strength, rtol=1e-6)


@pytest.mark.parametrize(("visibility", "robot", "human", "everyone"), [
    ("both", 41, 45, 59), ("human", 34, 45, 59), ("none", 34, 38, 52),
])  # fmt: skip
def test_who_sees_the_preference(visibility, robot, human, everyone):
    env = assistax.make("scratch", engine="mujoco", human={"preference": "default", "visibility": visibility})
    assert env.observation_sizes == {"robot": robot, "human": human} and env.global_size == everyone
    obs, state = env.reset(jax.random.key(0))
    if visibility != "none":
        np.testing.assert_allclose(
            obs["human"][env.obs_layout("human")["preference"]], preference.vector(preference.preference())
        )
    assert env.global_obs(state).shape == (everyone,)


def test_task_and_preference_returns_are_reported_apart():
    env = assistax.make("scratch", engine="mujoco", human={"preference": "default"})
    _, state = env.reset(jax.random.key(0))
    step, totals = jax.jit(env.step_env), {}
    for i in range(5):
        state, _, rewards, _, _, info = step(state, random_actions(env, jax.random.key(i)))
        for name, term in info["reward_terms"].items():
            totals[name] = totals.get(name, 0.0) + float(term)
        np.testing.assert_allclose(rewards["robot"], sum(info["reward_terms"].values()), rtol=1e-5)
    liked = sum(value for name, value in totals.items() if name.startswith("prefer"))
    np.testing.assert_allclose(info["metrics"]["preference_return"], liked, rtol=1e-5)
    np.testing.assert_allclose(info["metrics"]["task_return"], sum(totals.values()) - liked, rtol=1e-5)
    np.testing.assert_allclose(info["metrics"]["return"], sum(totals.values()), rtol=1e-5)


@pytest.mark.parametrize(("call", "words"), [
    (lambda: HumanConfig(disability="tremmor"), "Did you mean 'tremor'"),
    (lambda: HumanConfig(disability="strength=2"), r"strength must be in \[0.01, 1\]"),
    (lambda: HumanConfig(disability="strenght=1"), "Did you mean 'strength'"),
    (lambda: HumanConfig(disability="strength=big"), "must be a number"),
    (lambda: HumanConfig(preference="swep"), "Did you mean 'sweep'"),
    (lambda: preference.preference(speed=(0.2, 0.1)), "preferred speed must be a range"),
    (lambda: preference.preference(force=(1.0, 1.2)), "at least 0.5 wide"),
    (lambda: preference.preference(weights=(0.0, 0.0, -0.1)), "must not all be zero"),
    (lambda: disability.disability(tremor_hz=20), r"tremor_hz must be in \[3, 7\]"),
])  # fmt: skip
def test_impossible_people_are_refused_in_one_line(call, words):
    with pytest.raises(assistax.UsageError, match=words) as error:
        call()
    assert "\n" not in str(error.value)
