"""People with habits: what each parameter does, against the scripted people that habits are made of."""

import dataclasses
import importlib
from itertools import combinations
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax
from assistax import scenes
from assistax.errors import UsageError
from assistax.policies.habits import HABITS, Habit, Habits, person
from assistax.policies.people import Muscles, Reflex, offer


@pytest.fixture(scope="module")
def env():
    return assistax.make("scratch-v3", engine="mujoco")


@pytest.fixture(scope="module")
def moment(env):
    """A policy's act in one moment of an episode: by habit, control steps since its start and the tool's velocity."""
    policy, offering, reflex = Habits(env), offer(env), Reflex(env, -1.0)
    _, state = jax.jit(env.reset)(jax.random.key(4))
    slices = scenes.sensor_slices(env.model)["tool_vel"]

    @jax.jit
    def act(params, steps, velocity):
        sensordata = state.physics.sensordata.at[slices].set(velocity)
        seen = dataclasses.replace(state, physics=dataclasses.replace(state.physics, sensordata=sensordata))
        carry = policy.initial_carry() | {"steps": steps}
        rest = seen, jnp.bool_(False), jax.random.key(1)
        action, after = policy.act(params, carry, *rest)
        return action, after["steps"], offering.act((), carry["offer"], *rest)[0], reflex.act((), (), *rest)[0]

    def of(habit: Habit, seconds=1.0, speed=0.0):
        params = {name: jnp.float32(value) for name, value in vars(habit).items()}
        return act(params, jnp.int32(round(seconds / env.dt)), jnp.array([speed, 0.0, 0.0]))

    return of


def test_who_offers_and_who_withdraws_are_the_scripted_people(moment):
    action, steps, offered, back = moment(HABITS["offers"])
    np.testing.assert_allclose(action, offered, atol=1e-6)
    assert steps == 126
    np.testing.assert_allclose(moment(HABITS["withdraws"])[0], back, atol=1e-6)
    assert not moment(HABITS["still"])[0].any()


@pytest.mark.parametrize(
    ("habit", "seconds", "active"),
    [
        ("hesitates", 1.4, False),
        ("hesitates", 1.6, True),
        ("rests", 1.4, True),
        ("rests", 1.6, False),
        ("rests", 2.3, True),
    ],
)
def test_when_they_do_something(moment, habit, seconds, active):
    follower = dataclasses.replace(HABITS[habit], offers=0.0, follows=1.0)  # always has something to do
    assert moment(follower, seconds)[0].any() == active


def test_the_shy_draw_back_from_a_fast_tool_that_is_near(moment):
    near = dataclasses.replace(HABITS["shy"], near=9.0)
    _, _, offered, back = moment(near)
    np.testing.assert_allclose(moment(near, speed=0.3)[0], back, atol=1e-6)
    np.testing.assert_allclose(moment(near, speed=0.2)[0], offered, atol=1e-6)
    np.testing.assert_allclose(moment(dataclasses.replace(near, near=0.0), speed=0.3)[0], offered, atol=1e-6)


def test_who_keeps_still_resists_like_springs_and_dampers(env):
    """60, 60 and 25 N m/rad, 4, 4 and 1 N m s/rad, of 10 N m."""
    keeper = person(env, "keeps_still")
    params = jax.tree.map(lambda x: x[0], keeper.params)
    _, state = jax.jit(env.reset)(jax.random.key(4))
    ids = scenes.qpos_ids(env.model, env.spec.scene.human_driven)
    moved = {"qpos": jnp.asarray(env.model.key("start").qpos, jnp.float32).at[ids].add(jnp.array([0.02, -0.05, 0.3]))}
    moved["qvel"] = jnp.zeros(env.model.nv).at[ids].set(jnp.array([0.1, 0.5, 3.0]))
    state = dataclasses.replace(state, physics=dataclasses.replace(state.physics, **moved))
    carry = keeper.policy.initial_carry()
    action, _ = keeper.policy.act(params, carry, state, jnp.bool_(False), jax.random.key(1))
    np.testing.assert_allclose(action, [-(60 * 0.02 + 4 * 0.1) / 10, (60 * 0.05 - 4 * 0.5) / 10, -1.0], atol=1e-5)


@pytest.mark.parametrize(("before", "force", "shown"), [(5.0, 0.0, -1), (3.7, 0.0, 0), (3.4, 6.0, -1), (1.5, 0.0, 1)])
def test_who_shows_what_they_like_draws_back_from_too_much_and_leans_into_too_little(env, before, force, shown):
    """Liked are 1.5 to 3.5 N. Felt is what was, but for the 0.008 s / 0.1 s of it in which what is now takes its place:
    of 5 N that end 4.6, of 3.7 N 3.40, of 3.4 N that become 6 3.61, of 1.5 N that end 1.38."""
    shows = person(env, "shows")
    params = jax.tree.map(lambda x: x[0], shows.params) | {"offers": jnp.float32(0.0)}
    _, state = jax.jit(env.reset)(jax.random.key(4))
    sensed = state.physics.sensordata.at[scenes.sensor_slices(env.model)["tool_force"]].set(jnp.array([0, 0, force]))
    state = dataclasses.replace(state, physics=dataclasses.replace(state.physics, sensordata=sensed))
    carry = shows.policy.initial_carry() | {"felt": jnp.float32(before)}
    action, after = shows.policy.act(params, carry, state, jnp.bool_(False), jax.random.key(1))
    np.testing.assert_allclose(after["felt"], before + 0.08 * (force - before), rtol=1e-5)
    expected = Reflex(env, 1.0).moving(state, 0.25 * shown) if shown else np.zeros_like(action)
    np.testing.assert_allclose(action, expected, atol=1e-6)
    forgotten = shows.policy.act(params, carry, state, jnp.bool_(True), jax.random.key(1))[1]["felt"]
    np.testing.assert_allclose(forgotten, 0.08 * force, rtol=1e-5)


def test_nobody_shows_what_nobody_touches(env):
    shows = person(env, "shows")
    params = jax.tree.map(lambda x: x[0], shows.params) | {"offers": jnp.float32(0.0)}
    _, state = jax.jit(env.reset)(jax.random.key(4))
    carry = shows.policy.initial_carry() | {"felt": jnp.float32(0.1)}
    assert not shows.policy.act(params, carry, state, jnp.bool_(False), jax.random.key(1))[0].any()


def test_vigour_and_noise(moment):
    follower = Habit(offers=0.0, follows=-1.0, vigour=0.2)
    action, *_, back = moment(follower)
    np.testing.assert_allclose(action, 0.2 * back, atol=1e-6)
    noisy = moment(Habit(offers=0.0, noise=0.3))[0]
    assert 0 < np.abs(noisy).max() <= 0.3


def test_an_unknown_habit_is_one_line(env):
    with pytest.raises(UsageError, match="habit"):
        person(env, "nice")


@pytest.mark.parametrize(("task", "ways"), [("scratch", 4), ("bed_bath", 3), ("feeding", 3), ("tooth_brushing", 2)])
def test_every_way_of_offering_has_postures_of_its_own(task, ways):
    """At 256 resets: every way moves the person in three of ten or more, but to brush, where one stays straight; two
    ways hardly ever into the same posture."""
    env = assistax.make(task, engine="mujoco")
    offering = offer(env)
    _, states = jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.key(4), 256))
    aims = np.array([jax.vmap(lambda s, k=k: offering.posture({}, s, k)[0])(states) for k in range(offering.ways)])
    turned = np.abs(aims - np.asarray(offering.rest)).max(-1) > 1e-3
    assert offering.ways == ways and (turned.mean(1).min() > 0.3 or task == "tooth_brushing")
    for i, j in combinations(range(ways), 2):
        both = turned[i] & turned[j]
        assert (both & (np.abs(aims[i] - aims[j]).max(-1) < 0.05)).mean() <= 0.05, (i, j)


def test_ways_are_dealt_postures_in_turn_and_none_near_another_way(monkeypatch):
    """One joint, two ways, rest and six postures: the first way takes 1.2, the best, so that 1.0 is too near for the
    second, which takes 2.0; then each takes what adds most to what it has."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "tools"))
    offers = importlib.import_module("offers")
    monkeypatch.setattr(offers, "OTHERS", 2)
    monkeypatch.setattr(offers, "DEALT", 2)
    postures = np.array([0.0, 1.0, 1.2, 2.0, 3.0, 4.0, 5.0])[:, None]
    worth = np.array([[0.0, 0], [0.9, 0.3], [0.8, 0.8], [0.1, 0.95], [0.92, 0.1], [0.2, 0.5], [0.0, 0.0]])
    assert offers.deal(2, postures, worth) == [[0, 2, 4], [0, 3, 5]]
    usual = np.array([[0.0], [1.1], [4.2]])
    assert offers.fresh(usual, postures, worth).ravel().tolist() == [0.0, 2.0, 3.0]
    monkeypatch.setattr(offers, "DEALT", 5)
    worth[6] = 0.01
    assert offers.fresh(usual, postures, worth).ravel().tolist() == [0.0, 2.0, 3.0, 5.0]


@pytest.mark.parametrize("body", ["none", "tremor", "weakness"])
def test_muscles_are_springs_that_tense_against_a_tremor_and_try_harder_where_they_are_weak(body):
    """Shoulders have 60 N m/rad and 4 N m s/rad, the elbow 25 and 1; full torque is 10 N m, of the weak 4."""
    env = assistax.make("scratch-v3", engine="mujoco", human={"disability": body})
    _, state = jax.jit(env.reset)(jax.random.key(0))
    driven = scenes.qpos_ids(env.model, env.spec.scene.human_driven)
    speeds = jnp.array([0.1, -0.2, 0.5])
    qvel = state.physics.qvel.at[driven].set(speeds)
    state = dataclasses.replace(state, physics=dataclasses.replace(state.physics, qvel=qvel))
    posture = state.physics.qpos[driven] + jnp.array([0.05, 0.0, -0.02])
    damping = np.array([4.0, 4.0, 1.0]) * (3.0 if body == "tremor" else 1.0)
    torque = np.array([60.0, 60.0, 25.0]) * [0.05, 0.0, -0.02] - damping * speeds
    full = 4.0 if body == "weakness" else 10.0
    np.testing.assert_allclose(Muscles(env).toward(posture, state), torque / full, atol=1e-5)
