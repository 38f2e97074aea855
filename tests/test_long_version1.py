"""The newest versions over many episodes and steps, which takes minutes: `uv run pytest -m slow`.

Who helps and who does not; and a million random and a hundred thousand hostile steps, judged by MuJoCo's own contacts.
"""

import dataclasses
from functools import cache, partial
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import assistax
from assistax import scenes
from assistax.evaluation.playing import evaluate
from assistax.evaluation.statistics import proportion_ci, student_t
from assistax.human import harm
from assistax.physics import make_engine
from assistax.policies import scripted_team
from assistax.scenes import geometry
from assistax.training import journal
from assistax.training.configuration import configure
from assistax.training.loop import train
from assistax.training.run import Run

pytestmark = pytest.mark.slow
TASKS = ("scratch", "bed_bath", "arm_assist", "feeding", "tooth_brushing")
NEEDS_TWO = ("scratch", "bed_bath")
EPISODES = 64
RESULTS = Path(__file__).parents[1] / "results/version2"


@cache
def env_of(name):
    return assistax.make(name, engine="mujoco")


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


def test_training_by_warp_comes_to_what_training_by_the_c_engine_does(tmp_path):
    """Version 2 of feeding after the default's first twelve iterations, beside its five seeds.

    The mean return has to lie where a sixth seed would, by Student's t. Success says nothing yet: these have the spoon
    at the lips for 0.5 to 6 s, where 0.5 s count.
    """
    seeds = [journal.read(folder, "evaluations")[0] for folder in RESULTS.glob("feeding-ippo-default-2M-?")]
    returns, steps = [np.mean(one["episodes"]["return"]) for one in seeds], seeds[0]["steps"]
    apart = student_t(len(seeds) - 1) * np.std(returns, ddof=1) * np.sqrt(1 + 1 / len(seeds))
    few = {"evaluations": 1, "evaluation_episodes": EPISODES}
    summary = train(Run.create(configure("feeding-v2", few, engine="warp", steps=steps), tmp_path / "run"))
    print(f"Warp {summary['mean_return']:.0f}, C {np.mean(returns):.0f} +- {apart:.0f}")
    assert len(seeds) == 5 and abs(summary["mean_return"] - np.mean(returns)) < apart


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
    """By how many m anything is inside of furniture in poses [n, nq], at most, by MuJoCo's contacts."""
    model, data = env.model, mujoco.MjData(env.model)
    furniture = np.array([model.geom(i).name.startswith(("chair_", "mattress", "pillow")) for i in range(model.ngeom)])
    assert furniture.any()
    deepest = 0.0
    for qpos in poses:
        data.qpos = qpos
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        deepest = max(deepest, -data.contact.dist[furniture[data.contact.geom].any(1)].min(initial=0.0))
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
        some = jax.random.randint(key, (4_000_000 // steps,), 0, num_envs)
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


def largest(forces, dt):
    """Of forces [T, n, regions] the largest after the filter [n, regions], one of them every dt s."""
    start = jax.tree.map(lambda x: jnp.broadcast_to(x, (forces.shape[1], *x.shape)), harm.begin())
    book = jax.vmap(partial(harm.advance, dt=dt))
    return np.asarray(jax.lax.scan(lambda state, force: (book(force, state), None), start, forces)[0].peak)


@pytest.mark.parametrize("name", ["tooth_brushing", "scratch"])
def test_of_blows_one_physics_step_in_four_tells_what_they_are_on_average_and_not_one_by_one(name):
    """64 hostile episodes of 3.2 s against the record of every physics step, at 500 Hz."""
    env, episodes = env_of(name), 64
    act, fine = hostile(env), make_engine("mujoco", env.model, substeps=1)

    def step(state, key):
        def one(state, key):
            ctrl = env.motors.controls(act(key, state))

            def substep(physics, _):
                physics = fine.step(physics, ctrl)
                return physics, harm.forces(env.sensors(physics))

            physics, forces = jax.lax.scan(substep, state.physics, length=4)
            return dataclasses.replace(state, physics=physics), forces

        return jax.vmap(one, out_axes=(0, 1))(state, jax.random.split(key, episodes))

    _, state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), episodes))
    _, forces = jax.jit(partial(jax.lax.scan, step))(state, jax.random.split(jax.random.key(1), 400))
    forces = forces.reshape(-1, *forces.shape[2:])
    record, seen = largest(forces, 0.002), largest(forces[3::4], 0.008)
    hard, impact = record > 20.0, np.array([limits.impact for limits in harm.REGIONS.values()])
    off = seen[hard] / record[hard] - 1.0
    hit, told = (record > impact).any(1), (seen > impact).any(1)
    print(
        f"{name}: {hard.sum()} blows, off by {np.percentile(off, (5, 50, 95)).round(2)}; of {episodes} episodes",
        end=" ",
    )
    print(f"{hit.sum()} with impact, {told.sum()} told so, {(hit == told).sum()} rightly")
    # Some four episodes are told wrongly, more often an impact too many: in three draws of scratch 4, 3 and 0 more.
    assert abs(np.median(off)) < 0.03 and abs(told.sum() - hit.sum()) <= 5 and (hit == told).mean() > 0.9
