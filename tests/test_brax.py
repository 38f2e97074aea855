"""The Brax adapter with Brax's own wrappers and training, and ours beside the functional environment."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax
from assistax.adapters.partner import batch_of
from assistax.policies import Player, Still

pytest.importorskip("brax", reason="needs the extra brax")
from brax.envs.wrappers import training as theirs

from assistax.adapters.brax import AgentEnv, wrap

LENGTH, NUM_ENVS = 6, 2


@pytest.fixture(scope="module")
def env():
    return batch_of("scratch-v3", "mujoco", {"episode_length": LENGTH}).env


def actions(size, i):
    return np.random.default_rng(i).uniform(-1, 1, (NUM_ENVS, size)).astype(np.float32)


@pytest.fixture(scope="module")
def functional(env):
    step, keys = jax.jit(jax.vmap(env.step_env)), jax.random.split(jax.random.key(0), NUM_ENVS)
    return lambda state, robot, human: step(keys, state, {"robot": robot, "human": human})


def test_brax_wrappers_play_what_the_functional_environment_gives(env, functional):
    one = AgentEnv(env)
    assert (one.observation_size, one.action_size, one.backend) == (env.observation_sizes["robot"], 7, "mujoco")
    many = theirs.wrap(one, episode_length=LENGTH)
    reset, step = jax.jit(many.reset), jax.jit(many.step)
    state = first = reset(jax.random.split(jax.random.PRNGKey(0), NUM_ENVS))
    assert state.obs.shape == (NUM_ENVS, one.observation_size) and not state.done.any()
    plain, total = jax.tree.map(lambda x: x[:, 0], state.pipeline_state.env), 0.0
    for i in range(LENGTH):
        robot, before = actions(7, i), state
        state = step(state, robot)
        # Brax puts the state of the first episode back at an end, but keeps what is drawn with.
        assert state.pipeline_state.key is None and (state.info["key"] != before.info["key"]).any()
        obs, plain, rewards, _, truncated, info = functional(plain, robot, jnp.zeros((NUM_ENVS, 3)))
        total += rewards["robot"]
        np.testing.assert_allclose(state.reward, rewards["robot"], atol=1e-5)
        last = i == LENGTH - 1
        assert state.done.tolist() == state.info["truncation"].tolist() == [float(last)] * NUM_ENVS
        np.testing.assert_allclose(state.obs, first.obs if last else obs["robot"], atol=1e-5)
        outcome = info["metrics"]["peak_force"] if last else np.zeros(NUM_ENVS)
        np.testing.assert_allclose(state.metrics["peak_force"], outcome, atol=1e-5)
        for name, term in info["reward_terms"].items():
            np.testing.assert_allclose(state.metrics[f"reward/{name}"], term, atol=1e-5)
    assert truncated["robot"].all()
    np.testing.assert_allclose(state.info["episode_metrics"]["sum_reward"], total, rtol=1e-5)


def test_both_agents_as_one_with_fresh_episodes(env, functional):
    both = AgentEnv(env, agent="both")
    assert (both.observation_size, both.action_size) == (env.global_size, 7 + 3)
    many = wrap(both, LENGTH)
    state = jax.jit(many.reset)(jax.random.split(jax.random.PRNGKey(0), NUM_ENVS))
    step, first, starts, plain = jax.jit(many.step), state.obs, [], state.pipeline_state.env
    for i in range(2 * LENGTH):
        action, before = actions(10, i), state
        state = step(state, action)
        assert state.done.tolist() == state.info["time_out"].tolist() == [float(i % LENGTH == LENGTH - 1)] * NUM_ENVS
        assert state.info["steps"].tolist() == [i % LENGTH + 1] * NUM_ENVS
        if i < LENGTH:
            _, plain, rewards, *_ = functional(plain, action[:, :7], action[:, 7:])
            np.testing.assert_allclose(state.reward, rewards["robot"], atol=1e-5)
            if i < LENGTH - 1:
                np.testing.assert_allclose(state.obs, jax.vmap(env.global_obs)(plain), atol=1e-5)
        if state.done.all():
            starts.append(state.obs)
            np.testing.assert_allclose(state.info["episode_metrics"]["length"], LENGTH)
            outcome = before.pipeline_state.env.episode["peak_force"] <= state.metrics["peak_force"]
            assert outcome.all()
    assert (starts[0] != starts[1]).any() and (starts[0] != first).any()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda env: AgentEnv(env, agent="arm"), "Unknown agent 'arm'"),
        (lambda env: AgentEnv(env, partner="stil"), "Did you mean 'still'"),
        (lambda env: AgentEnv(env, agent="both", partner="random"), "nobody is left for a partner"),
        (lambda env: AgentEnv(env, partner=Player(Still(7))), "must act with 3 numbers"),
        (lambda env: wrap(AgentEnv(env), 1000), "make it with episode_length=1000"),
        (lambda env: wrap(AgentEnv(env), LENGTH, 2), "action_repeat must be 1"),
        (lambda env: wrap(AgentEnv(env), LENGTH, 1, lambda sys, rng: sys), "no randomization_fn"),
    ],
)
def test_what_brax_cannot_have_is_refused_in_one_line(env, call, words):
    with pytest.raises(assistax.UsageError, match=words) as error:
        call(env)
    assert "\n" not in str(error.value)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("wrapping", [wrap, theirs.wrap])
def test_brax_trains(env, wrapping):
    from brax.training.agents.ppo import train as ppo
    from brax.training.agents.ppo.networks import make_ppo_networks

    told = []
    make_policy, params, _ = ppo.train(
        AgentEnv(env),
        num_timesteps=256,
        episode_length=LENGTH,
        wrap_env_fn=wrapping,
        num_envs=8,
        num_eval_envs=4,
        unroll_length=4,
        batch_size=8,
        num_minibatches=1,
        num_evals=2,
        network_factory=functools.partial(make_ppo_networks, policy_hidden_layer_sizes=(8,)),
        progress_fn=lambda steps, metrics: told.append(metrics),
    )
    assert told[-1]["eval/avg_episode_length"] == LENGTH and np.isfinite(told[-1]["training/total_loss"])
    assert {"eval/episode_success", "eval/episode_peak_force"} <= set(told[-1])
    terms = [told[-1][name] for name in told[-1] if name.startswith("eval/episode_reward/") and "_std" not in name]
    np.testing.assert_allclose(sum(terms), told[-1]["eval/episode_reward"], rtol=1e-4)
    obs = jnp.zeros(env.observation_sizes["robot"])
    assert make_policy(params, deterministic=True)(obs, jax.random.PRNGKey(0))[0].shape == (7,)
