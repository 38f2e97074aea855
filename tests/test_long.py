"""What takes minutes: `uv run pytest -m slow`. All engines on all tasks with all kinds of people; soaks."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_tasks import SIZES, SUPREMA

import assistax
from assistax.physics import check_faults, make_engine
from assistax.policies import scripted_policy

pytestmark = pytest.mark.slow
STARTS = 64
PEOPLE = {"disability": "standard"}


def playing(env, robot, num_envs, random_robot=0.0):
    """(first state, step): the robot's scripted policy against a random human; with auto-reset."""
    policy, sizes = scripted_policy(robot, env, "robot"), env.action_sizes

    def one(state, carry, reset, key):
        human_key, robot_key, act_key, key = jax.random.split(key, 4)
        action, carry = policy.act((), carry, state, reset, act_key)
        noise = jax.random.uniform(robot_key, (sizes["robot"],), minval=-1.0, maxval=1.0)
        human = jax.random.uniform(human_key, (sizes["human"],), minval=-1.0, maxval=1.0)
        actions = {"robot": jnp.where(jax.random.uniform(key) < random_robot, noise, action), "human": human}
        obs, state, _, terminated, truncated, info = env.step(key, state, actions)
        return (state, carry, terminated["__all__"] | truncated["__all__"]), (actions, obs, info)

    def step(carry, key):
        return jax.vmap(one)(*carry, jax.random.split(key, num_envs))

    _, state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), num_envs))
    carry = jax.tree.map(lambda x: jnp.broadcast_to(x, (num_envs, *jnp.shape(x))), policy.initial_carry())
    return (state, carry, jnp.ones(num_envs, bool)), step


@pytest.fixture(scope="module", params=SIZES)
def in_contact(request):
    """(env, physics states of 8 different people in contact with the tool, ctrl [50, 8, nu] of the expert)."""
    env = assistax.make(request.param, engine="mujoco", human=PEOPLE)
    start, step = playing(env, "expert", 8)

    def record(carry, key):
        state = carry[0]
        carry, (actions, _, _) = step(carry, key)
        ctrl = jax.vmap(lambda a, s: env.motors.disturbed(a, s.person, s.phase, s.t * env.dt))(actions, state)
        force = jax.vmap(lambda s: jnp.linalg.norm(env.sensors(s.physics)["tool_force"]))(state)
        return carry, (state.physics, ctrl, force)

    _, (physics, ctrl, force) = jax.jit(lambda c, k: jax.lax.scan(record, c, k))(
        start, jax.random.split(jax.random.key(1), 700)
    )
    busy = np.convolve((np.asarray(force) > 0.5).mean(1), np.ones(50), "valid")[:650]
    at = int(busy.argmax())
    assert busy[at] > 10  # of 50 steps, on average over the people
    return env, jax.tree.map(lambda x: x[at], physics), ctrl[at : at + 50]


@pytest.mark.parametrize(("name", "steps"), [("warp", 50), ("mjx", 3)])
def test_engines_agree_in_contact_with_everyone(in_contact, name, steps):
    """Each person's path is the C engine's path from this state, or from one that float32 cannot tell from it.

    A pad may be about to tip over this edge or that one: there the C engine parts from itself too.
    """
    env, physics, ctrl = in_contact
    places = [env.sensors.places[f"{force}_force"] for force in ("tool", "robot")]

    def run(engine, starts):
        """qpos [T, starts, people, nq] and forces [2, T, starts, people]."""

        def step(state, ctrl):
            state = jax.vmap(jax.vmap(engine.step), (0, None))(state, ctrl)
            return state, (state.qpos, state.sensordata)

        state, (qpos, sensors) = jax.jit(lambda s, c: jax.lax.scan(step, s, c))(starts, ctrl[:steps])
        check_faults(state.fault, engine.name)
        return np.asarray(qpos), np.stack([np.linalg.norm(sensors[..., p], axis=-1) for p in places])

    nudges = 1e-6 * jax.random.normal(jax.random.key(3), (STARTS, *physics.qpos.shape)).at[0].set(0.0)
    nudged = jax.tree.map(lambda x: jnp.broadcast_to(x, (STARTS, *x.shape)), physics)
    nudged = dataclasses.replace(nudged, qpos=nudged.qpos + nudges)
    qpos_c, force_c = run(env.engine, nudged)
    qpos, force = run(make_engine(name, env.model), jax.tree.map(lambda x: x[None], physics))
    assert (force_c > 0.5).any()
    apart = np.abs(qpos - qpos_c).max((0, 3))  # [starts, people]
    force_apart = np.abs(force - force_c).max((0, 1))
    print(f"{env.name} {name}: {apart[0].max():.1e} rad, {force_apart[0].max():.2g} N of {force_c.max():.2g};", end=" ")
    print(f"from the nearest start {apart.min(0).max():.1e} rad, {force_apart.min(0).max():.2g} N")
    assert (np.maximum(apart / 1e-3, force_apart / (0.05 * force_c.max())).min(0) < 1).all()


@pytest.mark.parametrize(("engine", "num_envs", "steps"), [("mujoco", 1000, 1000), ("warp", 1000, 100)])
@pytest.mark.parametrize("name", SIZES)
def test_soak(name, engine, num_envs, steps):
    """A million steps (Warp: a tenth) of expert and noise: finite, nothing lost, no term above its supremum."""
    env = assistax.make(name, engine=engine, human=PEOPLE)
    start, step = playing(env, "expert", num_envs, random_robot=0.5)
    # As in training, their episodes do not end together.
    start = (dataclasses.replace(start[0], t=jnp.arange(num_envs) * 1000 // num_envs), *start[1:])

    def check(carry, key):
        carry, (_, obs, info) = step(carry, key)
        terms = info["reward_terms"] | {"": sum(info["reward_terms"].values())}
        finite = jnp.array([jnp.isfinite(x).all() for x in jax.tree.leaves((obs, terms))]).all()
        return carry, (finite, jax.tree.map(jnp.max, terms), info["fault"].max())

    _, (finite, most, fault) = jax.jit(partial(jax.lax.scan, check))(start, jax.random.split(jax.random.key(2), steps))
    assert finite.all()
    check_faults(fault, engine)
    most = {term: float(values.max()) for term, values in most.items()}
    print(f"{name} {engine}: largest " + ", ".join(f"{t or 'sum'} {v:.3f}" for t, v in most.items()))
    for term, value in most.items():
        assert value <= SUPREMA[name][term] + 1e-4, term
