"""Version 1 over many episodes and steps, which takes minutes: `uv run pytest -m slow`.

Who helps and who does not; and a million random and a hundred thousand hostile steps, judged by MuJoCo's own contacts.
"""

from functools import cache, partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import assistax
from assistax import scenes
from assistax.evaluation.playing import evaluate
from assistax.evaluation.statistics import proportion_ci
from assistax.policies import scripted_team
from assistax.scenes import geometry

pytestmark = pytest.mark.slow
TASKS = ("scratch", "bed_bath", "arm_assist", "feeding", "tooth_brushing")
NEEDS_TWO = ("scratch", "bed_bath")
EPISODES = 64


@cache
def env_of(name):
    return assistax.make(f"{name}-v1", engine="mujoco")


@cache
def report(name, team):
    return evaluate(env_of(name), scripted_team(team, env_of(name)), EPISODES)


@pytest.mark.parametrize("name", TASKS)
def test_the_scripted_pair_helps_four_in_five_safely(name):
    assert report(name, "offer")["success_rate"] >= 0.8
    assert report(name, "offer")["safe_success_rate"] >= 0.8


@pytest.mark.parametrize("name", NEEDS_TWO)
def test_beside_a_person_who_keeps_still_the_robot_helps_clearly_less_often(name):
    alone, together = (round(EPISODES * report(name, team)["success_rate"]) for team in ("expert", "offer"))
    assert proportion_ci(alone, EPISODES)[1] < proportion_ci(together, EPISODES)[0]


@pytest.mark.parametrize("team", ["still", "random"])
@pytest.mark.parametrize("name", TASKS)
def test_nobody_and_noise_help_nobody(name, team):
    assert report(name, team)["success_rate"] <= 0.02


def hostile(env):
    """The robot drives its tool at the target with all it has; the person moves at random."""
    tip = geometry.Chain(env.model, "tool_tip", env.robot.joints)

    def act(key, state):
        pos, _, jacobian = tip(state.physics.qpos)
        push = jacobian[:3].T @ geometry.unit(env.markers(state) - pos)
        return {"robot": jnp.sign(push), "human": random(key, env.action_sizes["human"])}

    return act


def random(key, size):
    return jax.random.uniform(key, (size,), minval=-1.0, maxval=1.0)


def noise(env):
    def act(key, state):
        robot, human = jax.random.split(key)
        return {"robot": random(robot, env.action_sizes["robot"]), "human": random(human, env.action_sizes["human"])}

    return act


def through_furniture(env, poses):
    """By how many m anything that moves is inside of furniture in poses [n, nq], at most, by MuJoCo's contacts."""
    model, data = env.model, mujoco.MjData(env.model)
    moved = model.body_weldid[model.geom_bodyid] != 0
    deepest = 0.0
    for qpos in poses:
        data.qpos = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        pairs = data.contact.geom
        world = ~moved[pairs].all(1)
        deepest = max(deepest, -data.contact.dist[world].min(initial=0.0))
    return deepest


@pytest.mark.parametrize(("acting", "steps"), [(noise, 1_000_000), (hostile, 100_000)])
@pytest.mark.parametrize("name", TASKS)
def test_whatever_anybody_does_it_stays_finite_within_limits_and_out_of_the_furniture(name, acting, steps):
    env, num_envs = env_of(name), 500
    act, names = acting(env), (*env.robot.joints, *env.spec.scene.human_driven)
    ids = scenes.qpos_ids(env.model, names)

    def step(state, key):
        def one(state, key):
            act_key, step_key = jax.random.split(key)
            obs, state, rewards, _, _, info = env.step(step_key, state, act(act_key, state))
            finite = jnp.isfinite(jnp.concatenate([*obs.values(), rewards["robot"][None], info["cost"][None]])).all()
            return state, (finite, info["fault"], state.physics.qvel[ids], state.physics.qpos)

        state, (finite, fault, qvel, qpos) = jax.vmap(one)(state, jax.random.split(key, num_envs))
        some = jax.random.randint(key, (4,), 0, num_envs)
        return state, (finite.all(), fault.max(), jnp.abs(qvel).max(0), qpos[some])

    keys = jax.random.split(jax.random.key(1), steps // num_envs)
    _, state = jax.vmap(partial(env.reset))(jax.random.split(jax.random.key(0), num_envs), jnp.arange(num_envs) * 2)
    _, (finite, fault, fastest, poses) = jax.jit(partial(jax.lax.scan, step))(state, keys)
    assert finite.all() and fault.max() == 0
    limits = np.array([*env.robot.speed, *(scenes.HUMAN_SPEED[joint] for joint in env.spec.scene.human_driven)])
    share = dict(zip(names, (np.asarray(fastest).max(0) / limits).round(2), strict=True))
    poses = np.asarray(poses).reshape(-1, env.model.nq)
    beyond = env.model.jnt_range[ids] * [[1, -1]]  # joints are hinges, one number each
    past = np.maximum(beyond[:, 0] - poses[:, ids], poses[:, ids] + beyond[:, 1]).max()
    deepest = through_furniture(env, poses)
    print(f"{name} {acting.__name__}: speeds {share}; {past:.3f} rad past a limit; {1e3 * deepest:.1f} mm deep")
    assert max(share.values()) < 1.25 and past < 0.05 and deepest < 0.015
