"""Disabilities and preferences: against the paper's formulas, and as they show in the simulation."""

import dataclasses
import hashlib
import json
import sys
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import random_actions

import assistax
from assistax import cli
from assistax.env import EnvConfig
from assistax.errors import UsageError
from assistax.evaluation.playing import evaluate
from assistax.human import DISABILITIES, HumanConfig, Person, disability, expression, population, preference, variety
from assistax.human.profile import stack, unstack
from assistax.human.wandering import wander
from assistax.policies import scripted_team
from assistax.settings import with_settings
from assistax.tasks import TASKS
from assistax.training.checkpoint import load_checkpoint, save_checkpoint


def same(tree, other):
    """Whether two pytrees are equal to the bit."""
    return jax.tree.all(jax.tree.map(lambda a, b: np.array_equal(a, b), tree, other))


NAMES = ["scratch-v0", "bed_bath-v0", "arm_assist-v0", "feeding-v0", "tooth_brushing-v0"]


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
    assert {name: task[name] + 1000 * TASKS[f"{name}-v0"].preference_budget for name in task} == combined


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


def test_the_papers_population_is_the_same_on_every_machine():
    people = population.profiles()
    assert {leaf.shape[0] for leaf in jax.tree.leaves(people)} == {630} and len(set(population.names())) == 630
    for i, name in enumerate(DISABILITIES):
        rows = slice(90 * i, 90 * i + 90)
        assert population.names()[rows] == [f"{name}-{k:02d}" for k in range(90)]
        expected = disability.parse(name)
        for part in ("tremor", "tremor_hz", "strength", "motion"):
            assert (getattr(people.disability, part)[rows] == getattr(expected, part)).all()
    # The sweep again, in NumPy: from the same bits, rounded to float32 after every operation.
    keys = jax.random.split(jax.random.key(population.SEED), 630)
    bits = np.stack([jax.random.bits(key, (7,)) for key in keys])
    u = ((bits >> 9) * 2.0**-23).astype(np.float32).T
    f = np.float32
    slow, soft = f(0.03) + f(0.05) * u[0], f(1.0) + f(1.0) * u[2]
    fast = (slow + f(0.02)) + (f(0.2) - (slow + f(0.02))) * u[1]
    firm = (soft + f(0.5)) + (f(5.0) - (soft + f(0.5))) * u[3]
    weights = [f(0.1) + f(0.4) * u[4], f(0.1) + f(0.5) * u[5], f(-0.1) + f(0.09) * u[6], 0 * u[6]]
    liked = people.preference
    for got, expected in ((liked.speed, [slow, fast]), (liked.force, [soft, firm]), (liked.weights, weights)):
        np.testing.assert_array_equal(got, np.stack(expected, 1))
    content = b"".join(np.ascontiguousarray(leaf).tobytes() for leaf in jax.tree.leaves(people))
    assert hashlib.sha256(content).hexdigest() == "072fd3803173cd0fad4811f33a4b3c808de9a1b338889929cc01f9c15cdef81f"


def best_for_all(wanted) -> tuple[float, float, float]:
    """The speed and force with which one robot earns most with all of some preferences, and what share of all there is
    it earns: the paper's formulas in NumPy, on a grid of 0.005 m/s by 0.1 N."""
    speed, force, weights = (np.array([getattr(one, name) for one in wanted]) for name in ("speed", "force", "weights"))
    shares = weights[:, :2] / weights[:, :2].sum(1, keepdims=True)

    def liked(x, least, most):
        width = (most - least) / 2
        return np.where((least <= x) & (x <= most), 1.0, np.exp(-((x - (least + most) / 2) ** 2) / (2 * width**2)))

    grid = [(v, f) for v in np.arange(0.0, 0.2, 0.005) for f in np.arange(0.0, 5.0, 0.1)]
    return max(((shares[:, 0] * liked(v, *speed.T) + shares[:, 1] * liked(f, *force.T)).mean(), v, f) for v, f in grid)


def test_one_way_of_helping_pleases_nearly_all_of_the_papers_people_and_not_those_of_opposite_tastes():
    """docs/humans.md: why populations have a gentle and a brisk preference."""
    papers = [preference.parse(person.preference) for person in population.people("paper630")]
    share, speed, force = best_for_all(papers)
    assert (round(speed, 3), round(force, 1)) == (0.08, 2.0) and share == pytest.approx(0.967, abs=0.001)
    inside = [p.speed[0] <= speed <= p.speed[1] and p.force[0] <= force <= p.force[1] for p in papers]
    assert np.mean(inside) == pytest.approx(0.905, abs=0.001)
    share, *_ = best_for_all([preference.parse(words) for words in variety.PREFERENCES.values()])
    assert share == pytest.approx(0.728, abs=0.001)


def test_words_and_numbers_are_the_same_people():
    people = population.profiles()
    for here, there in zip(jax.tree.leaves(stack(unstack(people))), jax.tree.leaves(people), strict=True):
        np.testing.assert_array_equal(here, there)
    for text in ("none", *DISABILITIES, "tremor=0.2 tremor_hz=4 strength=0.5 motion=0.7"):
        assert disability.spell(disability.parse(text)) == text
    text = "speed=0.05:0.09 force=1.2:2 weights=0.3,0.35,-0.03"
    assert preference.spell(preference.parse(text)) == text
    assert preference.spell(preference.parse("weights=0.3,0,-0.03,0.25")).endswith("weights=0.3,0,-0.03,0.25")
    np.testing.assert_allclose(preference.vector(preference.parse("force=1:2")), [0.06, 0.14, 1, 2, 0.3, 0.35, -0.03])


@pytest.mark.parametrize("form", ["words", "profiles", "file", "paper630"])
def test_a_list_of_people_is_drawn_from_evenly_and_survives_its_file(form, tmp_path):
    listed = (Person("weakness", "force=1:2"), Person("none", "default"), Person("tremor=0.2", "speed=0.1:0.2"))
    path = tmp_path / "people.json"
    path.write_text(json.dumps([vars(person) for person in listed]))
    given = {"words": listed, "profiles": stack(listed), "file": str(path), "paper630": "paper630"}[form]
    config = with_settings(EnvConfig(), {"human": {"people": given}})
    path.unlink()
    again = with_settings(EnvConfig(), json.loads(json.dumps(dataclasses.asdict(config))))
    everyone = population.profiles() if form == "paper630" else stack(listed)
    drawn = jax.jit(jax.vmap(again.human.draw))(jax.random.split(jax.random.key(0), 6000))
    for got, wanted in zip(jax.tree.leaves(drawn), jax.tree.leaves(everyone), strict=True):
        np.testing.assert_array_equal(got, wanted[np.asarray(drawn.index)])
    counts, expected = np.bincount(drawn.index), 6000 / len(everyone.index)
    assert len(counts) == len(everyone.index) and np.abs(counts - expected).max() < 5 * expected**0.5
    assert again.human.disabled and again.human.preferring


def test_people_are_drawn_by_their_weights():
    """Those of weight 0 never; and who it is goes on saying which row."""
    weights = 0, 3, 0, 1, 4, 0
    listed = tuple(Person(f"tremor=0.{i}") for i in range(1, 7))
    config = with_settings(EnvConfig(), {"human.people": listed, "human.weights": weights})
    again = with_settings(EnvConfig(), json.loads(json.dumps(dataclasses.asdict(config))))
    drawn = jax.jit(jax.vmap(again.human.draw))(jax.random.split(jax.random.key(0), 8000))
    counts, expected = np.bincount(drawn.index, minlength=6), 1000 * np.array(weights)
    assert (counts[expected == 0] == 0).all() and (np.abs(counts - expected) <= 5 * expected**0.5).all()
    np.testing.assert_array_equal(drawn.disability.tremor, stack(listed).disability.tremor[drawn.index])
    assert again.human.draw(jax.random.key(0), 2).index == 2


def test_people_are_drawn_alike_on_every_engine():
    human = {"disability": "standard", "preference": "sweep"}
    envs = [assistax.make("scratch-v0", engine, human=human) for engine in ("mujoco", "warp", "mjx")]
    keys = jax.random.split(jax.random.key(3), 8)
    drawn = [jax.jit(jax.vmap(lambda key, env=env: env._draw(key).person))(keys) for env in envs]
    for other in drawn[1:]:
        assert same(drawn[0], other)
    assert len(np.unique(drawn[0].preference.speed[:, 0])) == 8


def test_people_travel_with_the_state_and_change_at_a_reset(tmp_path):
    """Two seeds of six environments, through a checkpoint, past a reset of every environment."""
    env = assistax.make("scratch-v0", engine="mujoco", episode_length=3, human={"people": "paper630"})
    keys = jax.random.split(jax.random.key(0), (2, 6))
    state = jax.jit(jax.vmap(jax.vmap(env.reset)))(keys)[1]
    assert len(np.unique(state.person.index)) > 8
    alone = jax.jit(jax.vmap(lambda key: env._draw(key).person))(keys[1])  # the second seed by itself
    assert same(jax.tree.map(lambda x: x[1], state.person), alone)

    save_checkpoint(tmp_path / "x.safetensors", state, {})
    states = [state, load_checkpoint(tmp_path / "x.safetensors", state)]
    step = jax.jit(jax.vmap(jax.vmap(env.step)))
    fresh = jax.random.split(jax.random.key(1), (2, 6))
    for i in range(4):
        before, actions = states[0].person, random_actions(env, jax.random.key(i), (2, 6))
        states = [step(fresh, state, actions)[1] for state in states]
        assert same(*states)
        assert same(before, states[0].person) == (i != 2)
        gain = states[0].physics.overrides["actuator_gainprm"][..., 0, 0]
        np.testing.assert_allclose(gain / 10.0, states[0].person.disability.strength, rtol=1e-6)
    assert (np.asarray(states[0].person.index) != np.asarray(state.person.index)).mean() > 0.5


PEOPLE = {"none": {}, **DISABILITIES, "stiff": {"motion": 0.1}}


@pytest.fixture(scope="module", params=NAMES)
def moves(request):
    """moves[name, action]: sensors [250, ...] of one of PEOPLE, who holds the same action on every joint
    for 2 s while the robot is still; and with them the "gain" and "limits" of that person's model."""
    env = assistax.make(request.param, engine="mujoco", human={"disability": "standard"}, reset_noise=0.0)
    start = env._draw(jax.random.key(0))

    def roll(person, action):
        overrides = env._body.overrides(person, True)
        person = dataclasses.replace(start.person, disability=person)
        physics = env.engine.init(start.qpos, start.qvel, overrides)
        state = env._begin(physics, start._replace(person=person, overrides=overrides), 0)
        actions = {"robot": jnp.zeros(7), "human": jnp.full(env.action_sizes["human"], action)}

        def step(state, _):
            state = env.step_env(jax.random.key(0), state, actions)[1]
            return state, env.sensors(state.physics)

        sensors = jax.lax.scan(step, state, None, 250)[1]
        return sensors | {"gain": overrides["actuator_gainprm"][0, 0], "limits": overrides["jnt_range"]}

    cases = [(name, action) for name in PEOPLE for action in (0.0, -1.0, 1.0)]
    people = [disability.disability(**PEOPLE[name]) for name, _ in cases]
    people = jax.tree.map(lambda *x: np.stack(x), *people)
    sensors = jax.jit(jax.vmap(roll))(people, np.array([action for _, action in cases], np.float32))
    return {case: jax.tree.map(lambda x, i=i: np.asarray(x[i]), sensors) for i, case in enumerate(cases)}


def test_tremor_has_its_frequency_and_no_mean(moves):
    shaking = moves["tremor", 0.0]
    for torque in shaking["torque_human"].T:
        spectrum = np.abs(np.fft.rfft(torque))
        assert np.fft.rfftfreq(250, 0.008)[spectrum.argmax()] == pytest.approx(5.0, abs=0.26)
        assert abs(torque.mean()) < 1e-3 * shaking["gain"]
        assert np.abs(torque).max() == pytest.approx(0.3 * shaking["gain"], rel=0.02)


def test_weakness_scales_torque(moves):
    for action in (-1.0, 1.0):
        weak, healthy = moves["weakness", action], moves["none", action]
        assert np.abs(healthy["torque_human"]).min() > 0.1
        np.testing.assert_allclose(weak["torque_human"], 0.4 * healthy["torque_human"], rtol=1e-4)


def test_limited_range_is_that_of_the_driven_joints(moves):
    widths = {name: np.ptp(moves[name, 0.0]["limits"], axis=1) for name in ("none", "stiff")}
    narrower = widths["stiff"] < 0.11 * widths["none"]
    assert narrower.sum() == moves["none", 0.0]["torque_human"].shape[1]
    np.testing.assert_allclose(widths["stiff"][narrower], 0.1 * widths["none"][narrower], rtol=1e-3)
    np.testing.assert_array_equal(widths["stiff"][~narrower], widths["none"][~narrower])


def test_every_part_of_the_standard_settings_shows(moves):
    """Alone and beside the others: tremor moves a person at rest, weakness slows, limited range shortens."""

    def at_rest(name):
        return np.abs(moves[name, 0.0]["dtheta_driven"]).mean()

    def speed(name):
        return max(np.abs(moves[name, action]["dtheta_driven"][:25]).mean() for action in (-1.0, 1.0))

    def travel(name):  # [directions x joints] rad
        both = (moves[name, action]["theta_human"] for action in (-1.0, 1.0))
        return np.concatenate([np.abs(theta - theta[0]).max(0) for theta in both])

    for name in DISABILITIES:
        parts = name.split("+")
        without = {part: "+".join(p for p in parts if p != part) or "none" for part in parts}
        if "tremor" in parts:
            assert at_rest(name) > 1.5 * at_rest(without["tremor"]) + 0.002
        if "weakness" in parts:
            assert speed(name) < 0.85 * speed(without["weakness"])
        if "limited_range" in parts:
            before, after = travel(without["limited_range"]), travel(name)
            moved = before > 0.02
            assert (after[moved] / before[moved]).min() < 0.95


@pytest.mark.parametrize("task", NAMES)
def test_a_reset_starts_within_narrow_limits(task):
    """Of the least motion that can be asked for, and with far more noise than the limits leave room for."""
    env = assistax.make(task, engine="mujoco", reset_noise=0.5, human={"disability": "motion=0.05"})
    start = jax.jit(jax.vmap(env._draw))(jax.random.split(jax.random.key(0), 64))
    limits, qpos = np.asarray(start.overrides["jnt_range"]), np.asarray(start.qpos)
    assert (limits[..., 0] <= qpos).all() and (qpos <= limits[..., 1]).all()
    resting = np.asarray(env.model.key("start").qpos, np.float32)
    assert (limits[..., 0] <= resting).all() and (resting <= limits[..., 1]).all()
    driven = np.ptp(limits, axis=2)[0] < 0.1 * np.ptp(env.model.jnt_range, axis=1)
    assert driven.sum() == env.action_sizes["human"]
    assert (np.ptp(qpos, axis=0)[driven] > 0).all() and len(np.unique(np.asarray(start.phase)[:, 0])) == 64


@pytest.mark.parametrize(("visibility", "robot", "human", "everyone"), [
    ("both", 41, 45, 59), ("human", 34, 45, 59), ("none", 34, 38, 52), ("shown", 36, 45, 61),
])  # fmt: skip
def test_who_sees_the_preference(visibility, robot, human, everyone):
    env = assistax.make("scratch-v0", engine="mujoco", human={"preference": "default", "visibility": visibility})
    assert env.observation_sizes == {"robot": robot, "human": human} and env.global_size == everyone
    obs, state = env.reset(jax.random.key(0))
    if visibility != "none":
        np.testing.assert_allclose(
            obs["human"][env.obs_layout("human")["preference"]], preference.vector(preference.preference())
        )
    assert env.global_obs(state).shape == (everyone,)


@pytest.mark.parametrize(("felt", "speed", "face"), [
    (2.0, 0.1, (0.0, 0.0)),  # N, m/s; liked are 1 to 3 N and 0.06 to 0.14 m/s
    (3.25, 0.15, (-0.25, -1 / 3)),
    (9.0, 0.5, (-1.0, -1.0)),
    (0.5, 0.051, (0.5, 0.3)),
    (0.2, 0.0, (0.8, 1.0)),
    (0.09, 0.0, (0.0, 0.0)),  # untouched
])  # fmt: skip
def test_a_face_says_what_is_too_much_and_too_little(felt, speed, face):
    found = expression.expression(jnp.float32(felt), jnp.float32(speed), preference.parse("force=1:3"))
    np.testing.assert_allclose(found, face, atol=1e-5)


def test_the_robot_sees_in_the_face_what_was_felt_over_a_tenth_of_a_second():
    """3 N pressed since long, then nothing: 2.77 N show after a step, 0.003 N more than the 1.5 to 2.767 N liked."""
    human = {"preference": "force=1.5:2.767", "visibility": "shown"}
    env = assistax.make("scratch-v3", engine="mujoco", human=human)
    _, state = jax.jit(env.reset)(jax.random.key(0))
    still = {agent: jnp.zeros(size) for agent, size in env.action_sizes.items()}
    pressed = dataclasses.replace(state, felt=jnp.float32(3.0))
    obs, after, *_ = jax.jit(env.step_env)(jax.random.key(1), pressed, still)
    now = 3.0 * np.exp(-0.008 / 0.1)
    np.testing.assert_allclose(after.felt, now, rtol=1e-5)
    face = obs["robot"][env.obs_layout("robot")["expression"]]
    slow = min(1.0, (0.06 - float(env.task.tool_speed(env.sensors(after.physics), after.task))) / 0.03)
    np.testing.assert_allclose(face, [-(now - 2.767), slow], atol=1e-5)
    assert "preference" not in env.obs_layout("robot") and "expression" not in env.obs_layout("human")
    ended = dataclasses.replace(pressed, t=jnp.int32(env.episode_length - 1))
    obs, after, *_ = jax.jit(env.step)(jax.random.key(1), ended, still)
    assert after.felt == 0.0 and not obs["robot"][env.obs_layout("robot")["expression"]].any()


def test_nobody_shows_what_they_do_not_have():
    assert "expression" not in assistax.make("scratch", human={"visibility": "shown"}).obs_layout("robot")


def test_task_and_preference_returns_are_reported_apart():
    env = assistax.make("scratch-v0", engine="mujoco", human={"preference": "default"})
    _, state = env.reset(jax.random.key(0))
    step, totals = jax.jit(env.step_env), {}
    for i in range(5):
        key = jax.random.key(i)
        _, state, rewards, _, _, info = step(key, state, random_actions(env, key))
        for name, term in info["reward_terms"].items():
            totals[name] = totals.get(name, 0.0) + float(term)
        np.testing.assert_allclose(rewards["robot"], sum(info["reward_terms"].values()), rtol=1e-5)
    liked = sum(value for name, value in totals.items() if name.startswith("prefer"))
    np.testing.assert_allclose(info["metrics"]["preference_return"], liked, rtol=1e-5)
    np.testing.assert_allclose(info["metrics"]["task_return"], sum(totals.values()) - liked, rtol=1e-5)
    np.testing.assert_allclose(info["metrics"]["return"], sum(totals.values()), rtol=1e-5)


TOO_WEAK = dataclasses.replace(population.profiles().disability, strength=np.zeros(630, np.float32))


def test_evaluations_show_both_returns():
    env = assistax.make("scratch-v0", engine="mujoco", episode_length=5, human={"people": "paper630"})
    report = evaluate(env, scripted_team("random", env), 4)
    apart = [report[name]["mean"] for name in ("task_return", "preference_return")]
    np.testing.assert_allclose(sum(apart), report["mean_return"], rtol=1e-5)
    liked = sum(value for name, value in report["terms"].items() if name.startswith("prefer"))
    np.testing.assert_allclose(apart[1], liked, rtol=1e-5)


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
    (lambda: disability.disability(tremor=float("nan")), r"tremor must be in \[0, 1\]"),
    (lambda: preference.preference(force=(1.0, float("inf"))), r"within \[0, 100\] N"),
    (lambda: preference.preference(weights=(0.3, 0.3, 0.3)), r"weight of touch must be in \[-1, 0\]"),
    (lambda: Person(preference="sweep"), "Unknown preference 'sweep'"),
    (lambda: HumanConfig(people=()), "must hold a list"),
    (lambda: HumanConfig(disability="standard", weights=(1.0,)), "a number for each of the 7 people"),
    (lambda: HumanConfig(weights=(0.0,)), r"not all 0, not \(0\.0,\)"),
    (lambda: HumanConfig(disability="standard", weights=(2.0,) * 6 + (-1.0,)), "0 or more"),
    (lambda: HumanConfig(weights=(float("nan"),)), "0 or more"),
    (lambda: HumanConfig(weights=(float("inf"),)), "0 or more"),
    (lambda: HumanConfig(people="paper63"), "Did you mean 'paper630'"),
    (lambda: HumanConfig(people=stack((Person(),)), disability="tremor"), "leave out env.human.disability"),
    (lambda: HumanConfig(people=(Person(), Person(preference="default"))), "either all people have a preference"),
    (lambda: HumanConfig(people=jax.tree.map(lambda x: x[0], population.profiles())), "stacked along one axis"),
    (lambda: HumanConfig(people=dataclasses.replace(population.profiles(), disability=TOO_WEAK)), "strength must be"),
])  # fmt: skip
def test_impossible_people_are_refused_in_one_line(call, words):
    with pytest.raises(assistax.UsageError, match=words) as error:
        call()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("setting", "words"), [
    ("disability=tremmor", "Did you mean 'tremor'"),
    ("disability=strength=2", "strength must be in [0.01, 1], not 2"),
    ("disability=tremor=0.1 tremor=0.2", "tremor is given twice"),
    ("preference=speed=0.2:0.1", "preferred speed must be a range LEAST:MOST within [0, 1] m/s"),
    ("preference=force=1", "force must be a range LEAST:MOST, not '1'"),
    ("preference=weights=0,0,-0.1", "must not all be zero"),
    ("preference=speeed=1:2", "Did you mean 'speed'"),
    ("people=nobody.json", "Cannot read nobody.json: No such file"),
    ("people=folk.json", "folk.json, person 1: A disability's strength must be in [0.01, 1], not 7"),
    ("people=torn.json", "Cannot read torn.json: it is not JSON"),
    ("people=one.json", "one.json must hold a list"),
])  # fmt: skip
def test_the_command_line_refuses_impossible_people_before_it_compiles(setting, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folk.json").write_text('[{"disability": "tremor"}, {"disability": "strength=7"}]')
    (tmp_path / "torn.json").write_text('[{"disabil')
    (tmp_path / "one.json").write_text('{"disability": "tremor"}')
    monkeypatch.setattr("assistax.env.Env.__init__", lambda *_: pytest.fail("an environment was made"))
    for command in (["train", "scratch"], ["evaluate", "scratch", "--policy", "still"]):
        monkeypatch.setattr(sys, "argv", ["assistax", *command, "--set", f"env.human.{setting}"])
        with pytest.raises(SystemExit) as end:
            cli.main()
        assert end.value.code == 2
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1 and lines[0].startswith("assistax: ") and words in lines[0]
    assert not (tmp_path / "runs").exists()


def test_the_list_that_humans_prints_is_a_file_of_people(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["assistax", "humans", "--people", "paper630", "--json"])
    cli.main()
    path = tmp_path / "people.json"
    path.write_text(capsys.readouterr().out)
    for here, there in zip(
        jax.tree.leaves(stack(population.people(str(path)))), jax.tree.leaves(population.profiles()), strict=True
    ):
        np.testing.assert_array_equal(here, there)


def test_wandering_is_slow_random_motion():
    """Rough noise would average out at 125 steps a second, and everybody's must be another."""
    phases = 2.0 * np.pi * np.random.default_rng(0).uniform(size=400)
    paths = np.array(jax.vmap(wander, (None, 0), 1)(jnp.asarray(phases, jnp.float32), jnp.arange(1000) * 0.008))
    assert np.abs(paths).max() <= 1.0 and 0.3 < paths.std() < 0.5 and abs(paths.mean()) < 0.02
    assert (paths[:, :-25] * paths[:, 25:]).mean() > 0.5 * paths.var()  # still much the same after 0.2 s
    assert abs((paths[:, :-500] * paths[:, 500:]).mean()) < 0.1 * paths.var()  # forgotten after 4 s
    alike = np.abs(np.corrcoef(paths)[np.triu_indices(400, 1)])
    assert np.median(alike) < 0.3, np.median(alike)
    start = paths[:, 0]
    assert abs(start.mean()) < 0.06 and start.std() > 0.3


def test_a_share_of_the_action_is_random():
    actions = {"robot": jnp.zeros(7)}
    found = {}
    for share in (0.0, 0.25, 1.0):
        env = assistax.make("scratch-v3", human={"random_share": share})
        _, state = env.reset(jax.random.key(3))
        actions["human"] = jnp.linspace(-2.0, 1.0, env.action_sizes["human"])
        found[share] = np.asarray(env.motors.wandering(actions, state.phase, state.t * env.dt)["human"])
        ctrl = env.motors.disturbed(actions, state.person, state.phase, state.t * env.dt)  # what a step applies
        np.testing.assert_allclose(ctrl, env.motors.controls(actions | {"human": found[share]}), atol=1e-6)
    wanted = np.clip(np.linspace(-2.0, 1.0, len(found[0.0])), -1.0, 1.0)
    np.testing.assert_allclose(np.clip(found[0.0], -1.0, 1.0), wanted, atol=1e-6)
    np.testing.assert_allclose(found[0.25], 0.75 * wanted + 0.25 * found[1.0], atol=1e-6)
    assert np.abs(found[1.0]).max() <= 1.0 and np.ptp(found[1.0]) > 0.1
    with pytest.raises(assistax.UsageError, match=r"random_share must be 0 to 1, not 1\.5"):
        assistax.make("scratch", human={"random_share": 1.5})


def test_a_person_stays_for_as_many_episodes_as_asked_for():
    listed = [{"disability": f"motion={m} strength=0.5", "preference": "default"} for m in (0.3, 0.5, 0.7, 0.9)]
    env = assistax.make("scratch-v3", episode_length=2, human={"people": listed, "redraw_every": 3})
    keys = jax.random.split(jax.random.key(0), 12)
    _, state = jax.vmap(env.reset)(keys)
    still = {agent: jnp.zeros((12, size)) for agent, size in env.action_sizes.items()}

    def step(state, key):
        _, after, *_ = jax.vmap(env.step, (0, 0, 0))(jax.random.split(key, 12), state, still)
        low = state.physics.overrides["jnt_range"].sum((1, 2))
        return after, (state.person.index, state.person.disability.motion, jax.vmap(env.met_before)(state), low)

    _, seen = jax.jit(lambda s: jax.lax.scan(step, s, jax.random.split(jax.random.key(1), 48)))(state)
    who, motion, before, body = (np.asarray(x)[::2] for x in seen)  # by episode
    assert (np.asarray(seen[0])[::2] == np.asarray(seen[0])[1::2]).all()
    for meetings in who.reshape(8, 3, 12).transpose(0, 2, 1).reshape(-1, 3):
        assert (meetings == meetings[0]).all()
    assert set(np.unique(who)) == {0, 1, 2, 3} and (np.diff(who[::3], axis=0) != 0).mean() > 0.5
    np.testing.assert_array_equal(before, np.tile([[False], [True], [True]], (8, 12)))
    np.testing.assert_allclose(motion, np.array([0.3, 0.5, 0.7, 0.9], np.float32)[who])
    for person in range(4):  # the joints' limits are this person's
        assert np.ptp(body[who == person]) < 1e-3 and (body[who != person] != body[who == person][0]).all()
    with pytest.raises(assistax.UsageError, match=r"redraw_every must be 1 or more"):
        assistax.make("scratch", human={"redraw_every": 0})


def test_people_by_how_many_bodies_and_preferences():
    bodies = ["none", *DISABILITIES]
    assert [one.disability for one in variety.people("8")] == bodies
    assert variety.people("7") == tuple(map(Person, DISABILITIES))
    healthy = [Person("none", one) for one in variety.PREFERENCES.values()]
    assert variety.people("8x3")[:4] == (*healthy, Person("tremor", "default")) and len(variety.people("8x3")) == 24
    drawn = population.people("paper630")
    four = variety.people("7x4")
    assert len(four) == len(set(four)) == 28 and [one.disability for one in four[::4]] == list(DISABILITIES)
    assert {one.preference for one in four[3::4]} == {drawn[0].preference}
    assert variety.people("paper630") == drawn and len(set(variety.people("8x93"))) == 8 * 93
    opposite = variety.people("opposite")
    assert [one.disability for one in opposite[::2]] == bodies == [one.disability for one in opposite[1::2]]
    gentle = [one.preference == variety.PREFERENCES["gentle"] for one in opposite]
    assert sum(gentle) == 8 and all(a != b for a, b in zip(gentle[::2], gentle[1::2], strict=True))
    assert [sum(gentle[way::4]) for way in range(4)] == [2, 2, 2, 2]  # of four people with each way
    for name, said in (
        ("8x94", "1 to 93 preferences"),
        ("7x0", "1 to 93"),
        ("9x3", "Known: 8x3, 8, 7x4, opposite, paper630"),
    ):
        with pytest.raises(UsageError, match=said):
            variety.people(name)
