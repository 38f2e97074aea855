"""PPO and its parts, against numbers worked by hand and a game whose optimum is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats as scipy_stats

from assistax.errors import UsageError
from assistax.learning.gae import gae
from assistax.learning.networks import gaussian_entropy, gaussian_log_prob, init_mlp, mlp
from assistax.learning.normalizer import init_stats, normalize, update_stats
from assistax.learning.ppo import PPO, PPOConfig, clip_networks, clipped_policy_loss
from assistax.learning.presets import PRESETS


def test_gae_by_hand():
    """Four steps, gamma 0.5, lambda 0.5; step 1 is a time limit, step 2 a true end."""
    rewards, values = jnp.array([1.0, 2.0, 3.0, 4.0]), jnp.array([1.0, 1.0, 1.0, 1.0])
    next_values = jnp.array([2.0, 6.0, 8.0, 10.0])
    terminated, done = jnp.array([False, False, True, False]), jnp.array([False, True, True, False])
    # deltas: 1 + 0.5*2 - 1 = 1; 2 + 0.5*6 - 1 = 4 (bootstrapped); 3 - 1 = 2 (not); 4 + 5 - 1 = 8
    # back: a3 = 8; a2 = 2 (cut); a1 = 4 (cut); a0 = 1 + 0.25*4 = 2
    advantages = gae(rewards, values, next_values, terminated, done, 0.5, 0.5)
    np.testing.assert_allclose(advantages, [2.0, 4.0, 2.0, 8.0])


def test_clipped_loss_by_hand():
    """Advantages -1 and 1 after normalisation; ratios 2 and 2, clip 0.2."""
    loss = clipped_policy_loss(jnp.log(jnp.array([2.0, 2.0])), jnp.array([3.0, 5.0]), 0.2)
    # min(2 * -1, 1.2 * -1) = -2 (pessimistic: unclipped); min(2 * 1, 1.2 * 1) = 1.2
    np.testing.assert_allclose(loss, -(-2.0 + 1.2) / 2, rtol=1e-5)


def test_gradient_is_clipped_per_network():
    grads = {"robot": {"actor": {"w": jnp.array([3.0, 4.0])}, "critic": [jnp.array([0.3, 0.4])]}}
    clipped = clip_networks(grads, 1.0)["robot"]
    np.testing.assert_allclose(clipped["actor"]["w"], [0.6, 0.8], rtol=1e-5)
    np.testing.assert_allclose(clipped["critic"][0], [0.3, 0.4], rtol=1e-5)


def test_gaussian_against_scipy():
    x, mean, std = np.array([0.3, -1.0]), np.array([0.1, 0.4]), np.array([0.5, 2.0])
    expected = scipy_stats.norm(mean, std)
    np.testing.assert_allclose(gaussian_log_prob(x, mean, jnp.log(std)), expected.logpdf(x).sum(), rtol=1e-5)
    np.testing.assert_allclose(gaussian_entropy(jnp.log(std)), expected.entropy().sum(), rtol=1e-5)


def test_normaliser_equals_the_statistics_of_all_data():
    data = np.random.default_rng(0).normal(3.0, 2.0, (3, 50, 4)).astype(np.float32)
    stats = init_stats(4)
    np.testing.assert_array_equal(normalize(stats, data[0]), np.clip(data[0], -10, 10))
    for batch in data:
        stats = update_stats(stats, jnp.asarray(batch))
    flat = data.reshape(-1, 4)
    expected = (flat - flat.mean(0)) / flat.std(0)
    np.testing.assert_allclose(normalize(stats, flat), expected, atol=1e-4)


def test_mlp_is_orthogonal_and_has_the_right_shape():
    layers = init_mlp(jax.random.key(0), (8, 8, 3), out_scale=0.01)
    w = layers[0]["w"]
    np.testing.assert_allclose(w @ w.T, 2.0 * np.eye(8), atol=1e-5)
    np.testing.assert_allclose(layers[1]["w"].T @ layers[1]["w"], 1e-4 * np.eye(3), atol=1e-8)
    assert mlp(layers, jnp.zeros((5, 8)), "tanh").shape == (5, 3)


class Meeting:
    """A two-agent game of five steps with a known optimum.

    The context c in {-1, 1} is shown to both. The robot should play 0.5 c, the human -0.25 c and
    the two actions of the robot should agree; reward 1 - the squared errors. Optimum: 5 an episode.
    """

    agents, episode_length = ("robot", "human"), 5
    observation_sizes, action_sizes = {"robot": 2, "human": 1}, {"robot": 2, "human": 1}

    def reset(self, key, elapsed=0):
        c = jnp.where(jax.random.bernoulli(key), 1.0, -1.0)
        state = {"c": c, "t": jnp.int32(0) + elapsed, "return": jnp.float32(0.0)}
        return self._obs(state), state

    def _obs(self, state):
        return {"robot": jnp.stack([state["c"], 0.1 * state["t"]]), "human": state["c"][None]}

    def step(self, key, state, actions):
        error = jnp.sum((actions["robot"] - 0.5 * state["c"]) ** 2)
        error += jnp.sum((actions["human"] + 0.25 * state["c"]) ** 2)
        reward = 1.0 - error
        end = {"c": state["c"], "t": state["t"] + 1, "return": state["return"] + reward}
        done = end["t"] >= self.episode_length
        _, fresh = self.reset(key)
        state = jax.tree.map(lambda a, b: jnp.where(done, a, b), fresh, end)
        info = {
            "final_observation": self._obs(end),
            "metrics": {"return": end["return"]},
            "reward_terms": {"all": reward},
            "fault": jnp.int32(0),
        }
        rewards = dict.fromkeys(self.agents, reward)
        return self._obs(state), state, rewards, {"__all__": jnp.bool_(False)}, {"__all__": done}, info


def test_ppo_solves_a_game_with_a_known_optimum_to_two_percent():
    config = PPOConfig(
        learning_rate=3e-3, num_steps=16, num_minibatches=4, hidden=(32, 32), entropy_coef=0.0, gamma=0.9
    )
    ppo = PPO(Meeting(), config, num_envs=64, total_iterations=120)
    collect, improve = jax.jit(ppo.collect), jax.jit(ppo.improve)
    state = ppo.init(jax.random.key(0))
    for _ in range(120):
        state, batch = collect(state)
        state, _ = improve(state, batch)
    for c in (-1.0, 1.0):
        obs = {"robot": jnp.array([c, 0.2]), "human": jnp.array([c])}
        actions = {}
        for agent, seen in ppo._seen(state.normalizer, obs).items():
            actions[agent] = mlp(state.params[agent]["actor"]["layers"], seen, "tanh")
        _, _, rewards, *_ = Meeting().step(
            jax.random.key(0), {"c": jnp.float32(c), "t": jnp.int32(0), "return": jnp.float32(0)}, actions
        )
        assert rewards["robot"] > 0.98


def test_improve_starts_from_the_rollouts_own_log_probabilities(scratch):
    """With one epoch, one minibatch and a vanishing step, nothing may have been clipped or moved."""
    config = PPOConfig(num_steps=30, num_minibatches=1, update_epochs=1, learning_rate=1e-9)
    ppo = PPO(scratch, config, num_envs=4, total_iterations=1)
    state, stats = ppo.init(jax.random.key(0)), None
    step = jax.jit(lambda state: ppo.improve(*ppo.collect(state)))
    for _ in range(3):
        state, stats = step(state)
    for agent in scratch.agents:
        assert float(stats[agent]["approx_kl"]) < 1e-6
        assert float(stats[agent]["clip_fraction"]) == 0.0


def test_only_whole_episodes_are_reported_when_starts_are_staggered():
    ppo = PPO(Meeting(), PPOConfig(num_steps=20, num_minibatches=1), num_envs=8, total_iterations=1)
    state = ppo.init(jax.random.key(0))
    assert len(set(np.asarray(state.env_state["t"]).tolist())) > 1
    _, batch = ppo.collect(state)
    # 20 steps of 8 environments; the cut-short first episodes end in steps 1 to 5, three whole ones follow.
    reported = int(batch["log"]["episodes"])
    whole = 8 * 20 // 5 - sum(5 - t < 5 for t in np.asarray(state.env_state["t"]))
    assert reported == whole


def test_sizes_that_do_not_divide_are_refused():
    with pytest.raises(UsageError, match="do not divide"):
        PPO(Meeting(), PPOConfig(num_steps=16, num_minibatches=7), num_envs=64, total_iterations=1)


def test_paper_preset_is_the_papers_table():
    scratch = PRESETS["paper"]["ippo"]["scratch"]
    assert scratch == {
        "learning_rate": 3.34e-4,
        "update_epochs": 8,
        "num_minibatches": 16,
        "clip_eps": 0.169,
        "entropy_coef": 1.61e-3,
        "num_steps": 64,
    }
