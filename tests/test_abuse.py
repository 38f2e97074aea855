"""Misuse of an environment: one clear line, or an episode that ends and poisons nothing."""

import copy
import dataclasses
import pickle
import subprocess
import sys
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax
from assistax.errors import UsageError
from assistax.physics import UNSTABLE
from assistax.settings import check_measures


@pytest.fixture(scope="module")
def env():
    return assistax.make("scratch", engine="mujoco", episode_length=20)


@pytest.fixture(scope="module")
def functions(env):
    """Reset and step of three environments at once."""
    return jax.jit(jax.vmap(env.reset)), jax.jit(jax.vmap(env.step))


def still(env, n=3):
    return {agent: jnp.zeros((n, size)) for agent, size in env.action_sizes.items()}


@pytest.mark.parametrize(
    ("change", "message"),
    [({"robot": jnp.zeros((3, 1))}, r"The robot's action must be 7 numbers, shape \(7,\), not float32 of shape \(1,\)"),
     ({"human": jnp.zeros((3, 7))}, r"The human's action must be 3 numbers"),
     ({"human": jnp.zeros((3, 3), bool)}, r"not bool of shape \(3,\)"),
     ({"human": None}, r"There is no action for the human; step takes one of each of robot, human")],
)  # fmt: skip
def test_actions_that_do_not_fit_are_refused_when_traced(env, functions, change, message):
    reset, step = functions
    keys = jax.random.split(jax.random.key(0), 3)
    actions = {agent: a for agent, a in (still(env) | change).items() if a is not None}
    with pytest.raises(UsageError, match=message):
        step(keys, reset(keys)[1], actions)


def test_no_environments_at_all_is_one_line(env):
    with pytest.raises(UsageError, match="one environment or more, not 0"):
        jax.vmap(env.reset)(jax.random.split(jax.random.key(0), 0))


def test_whole_numbers_are_actions_too(env, functions):
    reset, step = functions
    keys = jax.random.split(jax.random.key(0), 3)
    _, state = reset(keys)
    whole = {agent: jnp.ones(a.shape, jnp.int32) for agent, a in still(env).items()}
    same = {agent: a.astype(jnp.float32) for agent, a in whole.items()}
    assert_same(step(keys, state, whole), step(keys, state, same))


def assert_same(one, other):
    jax.tree.map(np.testing.assert_array_equal, one, other)


def rows(tree, ids):
    return jax.tree.map(lambda x: np.asarray(x)[np.array(ids)], tree)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_an_action_that_is_not_finite_ends_its_episode_and_nothing_else(env, functions, bad):
    reset, step = functions
    keys = jax.random.split(jax.random.key(0), 3)
    _, state = reset(keys)
    _, state, *_ = step(keys, state, still(env))
    good = still(env) | {"robot": jnp.full((3, 7), 0.5)}
    bad = good | {"robot": good["robot"].at[1, 2].set(bad)}
    fine, broken = step(keys, state, good), step(keys, state, bad)
    assert_same(rows(fine, (0, 2)), rows(broken, (0, 2)))
    _, after, rewards, terminated, truncated, info = rows(broken, (1,))
    assert terminated["__all__"].all() and terminated["robot"].all() and not truncated["__all__"].any()
    assert (info["fault"] != 0).all() and (rewards["robot"] == 0).all() and (after.t == 0).all()
    for leaf in jax.tree.leaves(broken):
        if jnp.issubdtype(leaf.dtype, jnp.floating):
            assert np.isfinite(leaf).all()
    assert_same(info["metrics"]["return"], rows(state.episode["return"], (1,)))  # as it was before


def test_physics_that_fails_ends_the_episode_with_what_was_before(env):
    _, state = env.reset(jax.random.key(0))
    torn = dataclasses.replace(state.physics, qpos=jnp.full(16, jnp.nan), fault=jnp.int32(UNSTABLE))
    physics, broken = env._unbroken(torn, state.physics, jnp.int32(0))
    assert broken and physics.fault == UNSTABLE
    assert_same(physics.qpos, state.physics.qpos)


def test_an_environment_can_be_copied_and_pickled(env):
    key = jax.random.key(3)
    env = assistax.make("scratch", engine="mujoco", episode_length=20, force=2.0, human={"disability": "tremor"})
    actions = {agent: jnp.full(n, 0.3) for agent, n in env.action_sizes.items()}
    expected = env.step(key, env.reset(key)[1], actions)
    for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert (other.name, other.config, other.task_config) == (env.name, env.config, env.task_config)
        assert_same(other.step(key, other.reset(key)[1], actions), expected)


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"force": -1.0}, "task_config.force must be 0 or more, not -1.0"), ({"near": float("nan")}, "near"),
     ({"scratch_force": (6.0, 1.0)}, "task_config.scratch_force must be two finite numbers, the smaller first"),
     ({"reset_noise": float("nan")}, "reset_noise"), ({"reset_noise": -1.0}, "env.reset_noise must be 0 or more"),
     ({"force_limit": float("inf")}, "force_limit")],
)  # fmt: skip
def test_settings_that_cannot_be_are_one_line(settings, message):
    with pytest.raises(UsageError, match=message):
        assistax.make("scratch", engine="mujoco", **settings)


def test_a_field_may_say_that_it_is_signed():
    @dataclass(frozen=True)
    class Config:
        lean: float = field(default=-0.5, metadata={"signed": True})

    check_measures("task_config", Config())
    with pytest.raises(UsageError, match=r"task_config\.lean must be finite"):
        check_measures("task_config", Config(lean=float("nan")))


def test_warnings_of_mujoco_leave_no_file_behind(tmp_path):
    code = """
import jax, jax.numpy as jnp, assistax
env = assistax.make("scratch", engine="mujoco", episode_length=5)
_, state = env.reset(jax.random.key(0))
physics = env.engine.step(state.physics, jnp.full(env.model.nu, jnp.nan))
print(int(physics.fault))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1"] and not list(tmp_path.iterdir()), done.stderr


def test_position_control_starts_where_the_arm_is():
    env = assistax.make("scratch", engine="mujoco", control="position", reset_noise=0.0)
    zero, full = ({"robot": jnp.full(7, x), "human": jnp.zeros(3)} for x in (0.0, 1.0))
    np.testing.assert_allclose(env.motors.controls(zero)[3:10], env.spec.scene.start, atol=1e-6)
    for action, end in ((full, 1), ({"robot": -full["robot"], "human": full["human"]}, 0)):
        np.testing.assert_allclose(
            env.motors.controls(action)[3:10], env.model.actuator_ctrlrange[3:10, end], atol=1e-6
        )
    _, state = env.reset(jax.random.key(0))
    start = state.physics.qpos
    step = jax.jit(env.step_env)
    for _ in range(40):
        _, state, *_ = step(jax.random.key(0), state, zero)
    assert np.abs(state.physics.qpos - start).max() < 0.02


def test_a_camera_that_is_left_open_is_closed_when_python_stops(tmp_path):
    code = "from assistax.evaluation.film import Camera\ncamera = Camera('scratch', 64, 64)\n"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stderr == ""
