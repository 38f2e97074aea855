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
        ctrl = jax.vmap(lambda a, s: env._trembling(env._ctrl(a), s))(actions, state)
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
    env, physics, ctrl = in_contact

    def run(engine):
        def step(state, ctrl):
            state = jax.vmap(engine.step)(state, ctrl)
            return state, (state.qpos, state.sensordata)

        state, out = jax.jit(lambda s, c: jax.lax.scan(step, s, c))(physics, ctrl[:steps])
        check_faults(state.fault, engine.name)
        return map(np.asarray, out)

    (qpos, sensors), (qpos_c, sensors_c) = run(make_engine(name, env.model)), run(env.engine)
    places = [env._slices[f"{force}_force"] for force in ("tool", "robot")]
    force, force_c = (np.stack([np.linalg.norm(s[..., p], axis=-1) for p in places]) for s in (sensors, sensors_c))
    print(f"{env.name} {name}: qpos {np.abs(qpos - qpos_c).max():.1e} rad, force {np.abs(force - force_c).max():.2g} N")
    assert (force_c > 0.5).any()
    np.testing.assert_allclose(qpos, qpos_c, atol=1e-3)
    np.testing.assert_allclose(force, force_c, atol=0.05 * force_c.max())


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
