"""PPO and its parts, against numbers worked by hand, loops in NumPy and games whose optimum is known."""

import time
from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from games import Cue, Meeting, trained
from scipy import stats as scipy_stats

from assistax.errors import UsageError
from assistax.learning.actors import Actor
from assistax.learning.gae import gae
from assistax.learning.networks import gaussian_entropy, gaussian_log_prob, init_mlp, mlp, remember
from assistax.learning.normalizer import init_stats, normalize, update_stats
from assistax.learning.partners import Partners
from assistax.learning.ppo import PPO, PPOConfig, adapted_rate, clip_networks, clipped_policy_loss
from assistax.learning.sac import SACConfig
from assistax.learning.tuned import tunable
from assistax.policies import Player, Random, Still
from assistax.tasks import TASKS
from assistax.training.checkpoint import load_checkpoint, save_checkpoint
from assistax.training.presets import PRESETS, preset


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


def test_pace_by_hand():
    """Within a factor of two of the desired KL it stays; beyond, it changes by half; it never exceeds 1."""
    kl = jnp.array([0.041, 0.039, 0.011, 0.009])
    np.testing.assert_allclose(adapted_rate(jnp.full(4, 0.3), kl, 0.02), [0.2, 0.3, 0.3, 0.45], rtol=1e-6)
    np.testing.assert_allclose(adapted_rate(jnp.full(4, 0.9), kl, 0.02), [0.6, 0.9, 0.9, 1.0], rtol=1e-6)
    np.testing.assert_array_equal(adapted_rate(jnp.ones(4), kl, 0.0), jnp.ones(4))


def test_gaussian_against_scipy():
    x, mean, std = np.array([0.3, -1.0]), np.array([0.1, 0.4]), np.array([0.5, 2.0])
    expected = scipy_stats.norm(mean, std)
    np.testing.assert_allclose(gaussian_log_prob(x, mean, jnp.log(std)), expected.logpdf(x).sum(), rtol=1e-5)
    np.testing.assert_allclose(gaussian_entropy(jnp.log(std)), expected.entropy().sum(), rtol=1e-5)


def judged(**settings):
    """(loss, statistics by agent) on three samples whose values the rollout knew otherwise, see below."""
    ppo = PPO(Meeting(), PPOConfig(hidden=(4,), num_minibatches=1, normalize_obs=False, **settings), 4, 1)
    params = ppo.networks.init(jax.random.key(0), ppo.config.initial_log_std)
    obs = {agent: jnp.linspace(-1.0, 1.0, 3 * n).reshape(3, n) for agent, n in Meeting.observation_sizes.items()}
    part = {"obs": obs, "reset": jnp.zeros(3, bool), "kept": None}
    for agent, n in Meeting.action_sizes.items():
        part[agent] = {"action": jnp.zeros((3, n)), "log_prob": jnp.zeros(3), "advantage": jnp.array([-1.0, 0.0, 1.0])}
        values = np.asarray(ppo.networks.value(params[agent]["critic"], agent, obs, ()), np.float64)
        # The first value has moved up by 0.5 since the rollout, the second down by 0.1, the third not at all.
        old, target = values - np.array([0.5, -0.1, 0.0]), values + np.array([1.0, 2.0, 3.0])
        part[agent]["critic"] = {"old": old, "target": target}
    return ppo._loss(ppo.config, params, part, {"robot": (), "human": ()})


def test_the_entropy_bonus_rewards_noise():
    """The loss falls by its coefficient times the entropy of a standard normal in three dimensions of action."""
    fell = judged(entropy_coef=0.0)[0] - judged(entropy_coef=0.5)[0]
    np.testing.assert_allclose(fell, 0.5 * 3 * scipy_stats.norm.entropy(), rtol=1e-4)


def test_value_clipping_takes_the_worse_error_of_the_value_and_its_clipped_change():
    plain, clipped = (judged(clip_value=c, clip_eps=0.2)[1]["robot"]["value_loss"] for c in (False, True))
    np.testing.assert_allclose(plain, 0.5 * np.mean([1.0, 4.0, 9.0]), rtol=1e-4)
    # The first may have moved up by 0.2 only, so that it is 0.3 lower and 1.3 away; the others moved by less.
    np.testing.assert_allclose(clipped, 0.5 * np.mean([1.3**2, 4.0, 9.0]), rtol=1e-4)


def test_the_learning_rate_falls_in_a_line_to_zero():
    """The same step after 0, 1, 2, 3 of 4 updates, with annealing and without."""
    moved = {}
    for anneal in (False, True):
        settings = {"num_minibatches": 1, "update_epochs": 1, "num_steps": 4, "hidden": (4,)}
        ppo = PPO(Meeting(), PPOConfig(anneal_learning_rate=anneal, learning_rate=1e-2, **settings), 2, 4)
        state, batch = jax.jit(lambda key, ppo=ppo: ppo.collect(ppo.init(key)))(jax.random.key(0))
        improve = jax.jit(ppo.improve)
        for done in range(4):
            adam = state.opt_state[0]._replace(count=jnp.int32(done))
            after, _ = improve(replace(state, opt_state=(adam, *state.opt_state[1:])), batch)
            change = jax.tree.map(lambda x, y: y - x, state.params, after.params)["robot"]["critic"]
            moved[anneal, done] = np.concatenate([np.ravel(x) for x in jax.tree.leaves(change)])
    for done in range(4):
        np.testing.assert_allclose(moved[True, done], (1 - done / 4) * moved[False, done], atol=1e-6)
        assert np.abs(moved[False, done]).max() > 1e-3


def test_normaliser_equals_the_statistics_of_all_data():
    data = np.random.default_rng(0).normal(3.0, 2.0, (3, 50, 4)).astype(np.float32)
    stats = init_stats(4)
    np.testing.assert_array_equal(normalize(stats, data[0]), np.clip(data[0], -10, 10))
    for batch in data:
        stats = update_stats(stats, jnp.asarray(batch))
    flat = data.reshape(-1, 4)
    expected = (flat - flat.mean(0)) / flat.std(0)
    np.testing.assert_allclose(normalize(stats, flat), expected, atol=1e-4)


def test_an_input_that_did_not_vary_says_nothing_when_it_does():
    """A preference that all partners of training shared, and a joint that moved by a tenth of a milliradian."""
    data = np.random.default_rng(0).normal(0.2, 1.0, (3, 500, 3)).astype(np.float32)
    data[..., 1], data[..., 2] = 0.12, 1.0 + 1e-4 * data[..., 2]
    stats = init_stats(3)
    for batch in data:
        stats = update_stats(stats, jnp.asarray(batch))
    stranger = jnp.array([0.2, 0.3, 1.1])
    usual = jnp.array([0.2, 0.12, 1.0])
    np.testing.assert_array_equal(normalize(stats, stranger), normalize(stats, usual))
    assert normalize(stats, stranger + jnp.array([1.0, 0.0, 0.0]))[0] == pytest.approx(1.0, abs=0.1)


def test_mlp_is_orthogonal_and_has_the_right_shape():
    layers = init_mlp(jax.random.key(0), (8, 8, 3), out_scale=0.01)
    w = layers[0]["w"]
    np.testing.assert_allclose(w @ w.T, 2.0 * np.eye(8), atol=1e-5)
    np.testing.assert_allclose(layers[1]["w"].T @ layers[1]["w"], 1e-4 * np.eye(3), atol=1e-8)
    assert mlp(layers, jnp.zeros((5, 8)), "tanh").shape == (5, 3)


# -- the update learns from the rollout's own numbers ----------------------------------------------


def loop(net, x, carry, reset):
    """A network with or without memory, one environment, step by step in float64: outputs and memories."""
    net, x = jax.tree.map(lambda a: np.asarray(a, np.float64), (net, x))
    outputs, carries = [], []
    for now, first in zip(x, reset, strict=True):
        for i, layer in enumerate(net["layers"]):
            now = now @ layer["w"] + layer["b"]
            if i == 0 and carry is not None:
                carry = now = gru_by_the_book(net["gru"], now, np.zeros_like(carry) if first else carry)
            elif i + 1 < len(net["layers"]):
                now = np.tanh(now)
        outputs.append(now)
        carries.append(carry)
    return np.array(outputs), carries


def gru_by_the_book(gru, x, h, np=np):
    """One step of a GRU, gate by gate."""
    xf, xu, xn = np.split(x, 3)
    hf, hu, hn = (h @ w for w in np.split(gru["w"], 3, axis=1))
    forget, update = (1.0 / (1.0 + np.exp(-z)) for z in (xf + hf, xu + hu))
    return (1.0 - update) * np.tanh(xn + forget * (hn + gru["b"])) + update * h


def test_the_gradient_of_a_gru_is_that_of_a_plain_loop():
    """The weights', the inputs' and the first memory's, with resets, for which JAX differentiates the loop itself."""
    keys = jax.random.split(jax.random.key(0), 5)
    gru = {"w": jax.random.normal(keys[0], (4, 12)), "b": jax.random.normal(keys[1], (4,))}
    x, carry = jax.random.normal(keys[2], (5, 2, 12)), jax.random.normal(keys[3], (2, 4))
    matters = jax.random.normal(keys[4], (5, 2, 4))
    reset = jnp.array([[1, 0], [0, 0], [0, 1], [0, 0], [1, 0]], bool)

    def plainly(gru, x, carry):
        total = 0.0
        for i in range(2):
            h = carry[i]
            for t in range(5):
                h = gru_by_the_book(gru, x[t, i], jnp.where(reset[t, i], 0.0, h), jnp)
                total += h @ matters[t, i]
        return total

    def at_once(gru, x, carry):
        return jnp.sum(remember(gru, x, carry, reset) * matters)

    found, expected = (jax.jit(jax.value_and_grad(f, (0, 1, 2)))(gru, x, carry) for f in (at_once, plainly))
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-4, atol=1e-5), found, expected)


variants = pytest.mark.parametrize(
    "variant",
    [("recurrent", "central_critic"), ("central_critic", "share_parameters"), ("recurrent", "share_parameters")],
    ids="+".join,
)


@cache
def third_rollout(variant):
    """(trainer, the state before it, the state after it, batch) of a small game with ends of both kinds inside."""
    settings = {"num_steps": 12, "num_minibatches": 2, "update_epochs": 2, "hidden": (8, 8)}
    ppo, state, *_ = trained(Meeting(ending=0.2), 2, 4, **settings, **dict.fromkeys(variant, True))
    return ppo, state, *jax.jit(ppo.collect)(state)


@variants
def test_samples_are_what_a_step_by_step_loop_computes(variant):
    """Log-probabilities, values and advantages of a rollout.

    The loop knows nothing of batches: every environment by itself, in float64, with the padded and
    labelled inputs that a shared network is defined by.
    """
    ppo, _, state, batch = third_rollout(variant)
    game, agents = ppo.env, ppo.env.agents
    samples = jax.jit(ppo._samples)(state, batch)
    reset, done = np.asarray(batch["reset"]), np.asarray(batch["done"])
    terminated = np.asarray(batch["terminated"])
    assert (done[:-1] & ~terminated[:-1]).any() and terminated[:-1].any() and (reset[1:] == done[:-1]).all()
    c = ppo.config
    scale = max(1 - c.gamma, 1 / game.episode_length)

    def seen(view, x):
        return np.asarray(normalize(state.normalizer[view], x))

    def shown(agent, x):
        """What the network that knows several agents is shown: padded to the longest, and labelled."""
        if not c.share_parameters:
            return x
        padded = np.pad(x, ((0, 0), (0, width - x.shape[-1])))
        return np.concatenate([padded, np.tile(np.eye(2)[agents.index(agent)], (len(x), 1))], -1)

    for agent in agents:
        own = state.params["shared" if c.share_parameters else agent]
        view = "global" if c.central_critic else agent
        n = game.action_sizes[agent]
        log_std = np.asarray(own["actor"]["log_std"])[:n]
        for i in range(4):
            width, memory = 2, np.asarray(batch["memory"][agent][i]) if c.recurrent else None
            x, final = (seen(agent, batch[name][agent][:, i]) for name in ("obs", "final_obs"))
            mean, memories = loop(own["actor"], shown(agent, x), memory, reset[:, i])
            after = [
                loop(own["actor"], shown(agent, f[None]), h, [False])[1][0]
                for f, h in zip(final, memories, strict=True)
            ]
            expected = scipy_stats.norm(mean[:, :n], np.exp(log_std)).logpdf(batch["actions"][agent][:, i]).sum(-1)
            np.testing.assert_allclose(batch["log_probs"][agent][:, i], expected, atol=2e-5)
            judged, ahead = (seen(view, batch[name][view][:, i]) for name in ("obs", "final_obs"))
            if c.recurrent:
                judged, ahead = np.hstack([memories, judged]), np.hstack([after, ahead])
                width += 8
            values = loop(own["critic"], shown(agent, judged), None, reset[:, i])[0][:, 0]
            following = loop(own["critic"], shown(agent, ahead), None, reset[:, i])[0][:, 0]
            np.testing.assert_allclose(samples[agent]["critic"]["old"][:, i], values, atol=2e-5)
            advantage, expected = 0.0, np.zeros(12)
            for t in reversed(range(12)):
                to_come = 0.0 if terminated[t, i] else c.gamma * following[t]
                delta = scale * float(batch["rewards"][agent][t, i]) + to_come - values[t]
                advantage = delta + (0.0 if done[t, i] else c.gamma * c.gae_lambda * advantage)
                expected[t] = advantage
            np.testing.assert_allclose(samples[agent]["advantage"][:, i], expected, atol=1e-4)


@pytest.mark.parametrize("recurrent", [False, True])
def test_improve_starts_from_the_rollouts_own_numbers(recurrent):
    """With one epoch and a vanishing step, no log-probability and no value may move."""
    config = PPOConfig(num_steps=30, num_minibatches=2, update_epochs=1, learning_rate=1e-9, recurrent=recurrent)
    config = replace(config, noise_correlation=0.8)
    ppo = PPO(Meeting(ending=0.2), config, num_envs=4, total_iterations=1)
    state, stats = jax.jit(ppo.init)(jax.random.key(0)), {}
    step = jax.jit(lambda state: ppo.improve(*ppo.collect(state)))
    for _ in range(3):
        state, stats = step(state)
    for agent in Meeting.agents:
        assert float(stats[agent]["approx_kl"]) < 1e-6
        assert float(stats[agent]["clip_fraction"]) == 0.0
        assert float(stats[agent]["value_change"]) < 1e-5


def test_the_first_batch_is_seen_with_its_own_statistics_later_ones_with_the_rollouts(monkeypatch):
    ppo = PPO(Meeting(), PPOConfig(num_steps=8, num_minibatches=1), num_envs=4, total_iterations=1)
    counts, samples = [], ppo._samples

    def spy(state, batch):
        jax.debug.callback(lambda count: counts.append(int(count)), state.normalizer["human"].count)
        return samples(state, batch)

    monkeypatch.setattr(ppo, "_samples", spy)
    state, step = jax.jit(ppo.init)(jax.random.key(0)), jax.jit(lambda state: ppo.improve(*ppo.collect(state))[0])
    for _ in range(3):
        state = step(state)
    jax.effects_barrier()
    assert counts == [32, 32, 64] and int(state.normalizer["human"].count) == 96


@pytest.mark.parametrize("shared", [False, True])
def test_a_policy_that_moves_further_than_desired_is_slowed_down_and_its_critic_is_not(shared):
    quick = {"num_steps": 16, "num_minibatches": 4, "hidden": (8,), "share_parameters": shared, "learning_rate": 3e-2}
    moved = {}
    for desired in (0.0, 0.005):
        _, state, stats, _ = trained(Meeting(), 60, 16, desired_kl=desired, **quick)
        moved[desired] = float(stats["robot"]["approx_kl"])
        assert set(state.rate_scale) == set(state.params)
        assert all((pace < 1.0) == (desired > 0.0) for pace in state.rate_scale.values())
    assert moved[0.005] < 0.015 and moved[0.0] > 3 * moved[0.005], moved

    ppo, state, _, batch = trained(Meeting(), 1, 16, **quick)
    stopped = next(iter(state.rate_scale))
    after, _ = jax.jit(ppo.improve)(replace(state, rate_scale=state.rate_scale | {stopped: jnp.float32(0.0)}), batch)
    moved = {
        (name, network): any(jax.tree.leaves(jax.tree.map(lambda x, y: bool((x != y).any()), before, then)))
        for name in state.params
        for network, before in state.params[name].items()
        for then in [after.params[name][network]]
    }
    assert not moved.pop((stopped, "actor")) and all(moved.values()), moved


def test_a_shared_network_has_no_dummy_dimensions():
    """Entropy and log-probability of the human, who has one action, know nothing of the robot's second."""
    ppo = PPO(Meeting(), PPOConfig(num_steps=8, num_minibatches=1, share_parameters=True), 4, 1)
    state = jax.jit(ppo.init)(jax.random.key(0))
    assert set(state.params) == {"shared"} and state.params["shared"]["actor"]["log_std"].shape == (2,)
    human, robot = (ppo.policy_params(state)[a]["actor"] for a in ("human", "robot"))
    assert human["log_std"].shape == (1,) and robot["log_std"].shape == (2,)
    np.testing.assert_array_equal(human["layers"][1]["w"], robot["layers"][1]["w"])


# -- frozen partners --------------------------------------------------------------------------------


@variants
def test_a_frozen_actor_acts_exactly_as_in_the_run_that_trained_it(variant):
    """Played again on what it saw: the log-probabilities of the run's own actions come out."""
    ppo, state, _, batch = third_rollout(variant)
    before = ppo.policy_params(state)
    # Two members: the second is the one that played, the first somebody else.
    stacked = jax.tree.map(lambda x: jnp.stack([x + 1.0, x]), before["human"])
    frozen = Partners(ppo.env, 4, {"human": Player(ppo.policy(), stacked, 2)})
    act = jax.jit(lambda playing, obs, reset, key: frozen.act(playing, None, obs, reset, key))
    playing = {"human": {"index": jnp.ones(4, jnp.int32), "carry": (state.memory["human"], jnp.zeros((4, 2)))}}
    assert np.asarray(batch["reset"])[1:].any()
    for t in range(12):
        obs = {a: x[t] for a, x in batch["obs"].items()}
        actions, playing = act(playing, obs, batch["reset"][t], jax.random.key(t))
        log_std = before["human"]["actor"]["log_std"]
        log_prob = gaussian_log_prob(batch["actions"]["human"][t], actions["human"], log_std)
        np.testing.assert_allclose(log_prob, batch["log_probs"]["human"][t], atol=1e-5)


@pytest.mark.parametrize("iteration, correlation", [(0, 0.8), (1, 0.8), (2, 0.0)])
def test_exploration_is_correlated_within_episodes_alike_in_training_and_as_a_partner(iteration, correlation):
    """For as many steps as it is asked to, here two iterations."""
    config = PPOConfig(num_steps=9, num_minibatches=1, hidden=(8,), stagger=False)
    config = replace(config, noise_correlation=0.8, correlated_steps=2 * 9 * 2000)
    ppo = PPO(Meeting(), config, 2000, total_iterations=iteration + 1)
    state = replace(jax.jit(ppo.init)(jax.random.key(0)), iteration=jnp.int32(iteration))
    state, batch = jax.jit(ppo.collect)(state)
    policy, params = ppo.policy(deterministic=False), ppo.policy_params(state)

    def play(carry, now):
        obs, reset, key = now
        action, carry = jax.vmap(policy.act, (None, 0, 0, 0, 0))(params["human"], carry, obs, reset, key)
        return carry, action

    keys = jax.random.split(jax.random.key(1), (9, 2000))
    carry = jax.tree.map(lambda x: jnp.broadcast_to(x, (2000, *x.shape)), policy.initial_carry())
    _, played = jax.lax.scan(play, carry, (batch["obs"]["human"], batch["reset"], keys))
    for actions in (batch["actions"]["human"], played):  # a fresh actor's mean is near zero
        np.testing.assert_allclose(actions.std(1), 1.0, atol=0.06)
        for t in range(8):
            expected = 0.0 if t == 4 else correlation  # the first episode has five steps
            assert abs(np.corrcoef(actions[t, :, 0], actions[t + 1, :, 0])[0, 1] - expected) < 0.07


def test_a_frozen_partner_is_left_alone():
    """The human is played by three constant policies; only the robot has parameters, and it learns its part."""

    class Constant:
        def initial_carry(self):
            return jnp.int32(0)  # counts the steps since the reset

        def act(self, params, carry, obs, reset, key):
            carry = jnp.where(reset, 0, carry) + 1
            return params, carry

    constants = jnp.array([[0.1], [0.2], [0.3]])
    partners = {"human": Player(Constant(), constants, 3)}
    ppo = PPO(Meeting(), PPOConfig(num_steps=20, num_minibatches=2, hidden=(8,)), 64, 3, partners)
    state = jax.jit(ppo.init)(jax.random.key(0))
    assert set(state.params) == set(state.normalizer) == {"robot"}
    first = np.asarray(state.partner_state["human"]["index"])
    state, batch = jax.jit(ppo.collect)(state)
    assert set(batch["actions"]) == {"robot"}
    np.testing.assert_array_equal(np.bincount(first, minlength=3) > 10, True)
    # 20 steps after staggered starts all episodes of 5 steps have ended: fresh draws, counts as old as the episodes.
    assert (np.asarray(state.partner_state["human"]["index"]) != first).any()
    np.testing.assert_array_equal(state.partner_state["human"]["carry"] % 5, state.env_state["t"] % 5)
    # 1 - (squared errors): what the partners' constants cost is in the rewards.
    error = jnp.square(batch["actions"]["robot"] - 0.5 * batch["obs"]["robot"][..., :1]).sum(-1)
    left = 1.0 - error - batch["rewards"]["robot"]  # (constant + 0.25 c)²
    constant = jnp.sqrt(left) * 1.0
    c = batch["obs"]["robot"][..., 0]
    options = jnp.abs(constants[:, 0] + 0.25 * c[..., None])
    assert float(jnp.abs(options - constant[..., None]).min(-1).max()) < 1e-3
    state, stats = jax.jit(ppo.improve)(state, batch)
    assert set(stats) == {"robot"}


def test_members_are_drawn_afresh_only_where_an_episode_ended():
    frozen = Partners(Meeting(), 4000, {"robot": Player(Still(2), jnp.zeros((5, 1)), 5)})
    assert frozen.learners == ("human",)
    playing = frozen.init(jax.random.key(0))
    done = jnp.arange(4000) < 2000
    drawn = frozen.redraw(playing, (), done, jax.random.key(1))
    old, new = (np.asarray(s["robot"]["index"]) for s in (playing, drawn))
    np.testing.assert_array_equal(old[2000:], new[2000:])
    for index in (old, new):
        assert np.abs(np.bincount(index, minlength=5) - 800).max() < 120  # 800 ± 4.7 standard deviations
    assert abs((old == new)[:2000].mean() - 0.2) < 0.05


def test_partners_that_do_not_fit_are_refused():
    still = Player(Still(1))
    with pytest.raises(UsageError, match="Did you mean 'human'"):
        Partners(Meeting(), 2, {"humann": still})
    with pytest.raises(UsageError, match="leave one to learn"):
        Partners(Meeting(), 2, {"human": still, "robot": still})
    with pytest.raises(UsageError, match="stacked"):
        Partners(Meeting(), 2, {"human": Player(Still(1), jnp.zeros((3, 1)), 4)})
    with pytest.raises(UsageError, match="one member or more"):
        Player(Still(1), (), 0)


def test_a_step_costs_the_same_with_630_members_as_with_two():
    """Medians of alternating rounds in one process."""
    layers = [jnp.ones((630, m, n)) for m, n in ((38, 128), (128, 128), (128, 3))]
    actor = {"layers": [{"w": w, "b": w[:, 0]} for w in layers], "log_std": jnp.zeros((630, 3))}
    obs, reset, key = {"human": jnp.ones((256, 1))}, jnp.zeros(256, bool), jax.random.key(0)
    actor["layers"][0]["w"] = actor["layers"][0]["w"][:, :1]
    steps = {}
    for members in (2, 630):
        params = jax.tree.map(lambda x, m=members: x[:m], {"actor": actor, "normalizer": ()})
        game = Meeting()
        frozen = Partners(game, 256, {"human": Player(Actor(normalize_obs=False), params, members)})
        steps[members] = jax.jit(lambda s, k, frozen=frozen: frozen.act(s, None, obs, reset, k)), frozen.init(key)
    times = {2: [], 630: []}
    for _ in range(15):
        for members, (act, playing) in steps.items():
            began = time.perf_counter()
            jax.block_until_ready(act(playing, key))
            times[members].append(time.perf_counter() - began)
    assert np.median(times[630][3:]) < 4.0 * np.median(times[2][3:])


# -- resuming ---------------------------------------------------------------------------------------


def test_resume_equals_uninterrupted_to_the_bit_with_memory_and_partners(scratch, tmp_path):
    config = PPOConfig(num_steps=12, num_minibatches=2, update_epochs=1, hidden=(8, 8), recurrent=True)
    partners = {"human": Player(Random(scratch.action_sizes["human"]))}
    ppo = PPO(scratch, config, 4, 4, partners)
    step = jax.jit(lambda state: ppo.improve(*ppo.collect(state))[0])
    state = jax.jit(ppo.init)(jax.random.key(0))
    for i in range(4):
        if i == 2:
            save_checkpoint(tmp_path / "c", state, {})
        state = step(state)
    resumed = load_checkpoint(tmp_path / "c", jax.eval_shape(ppo.init, jax.random.key(0)))
    for _ in range(2):
        resumed = step(resumed)
    for a, b in zip(jax.tree.leaves(state), jax.tree.leaves(resumed), strict=True):
        if jnp.issubdtype(a.dtype, jax.dtypes.prng_key):
            a, b = jax.random.key_data(a), jax.random.key_data(b)
        np.testing.assert_array_equal(a, b)


def test_only_whole_episodes_are_reported_when_starts_are_staggered():
    ppo = PPO(Meeting(), PPOConfig(num_steps=20, num_minibatches=1), num_envs=8, total_iterations=1)
    state = jax.jit(ppo.init)(jax.random.key(0))
    assert len(set(np.asarray(state.env_state["t"]).tolist())) > 1
    _, batch = jax.jit(ppo.collect)(state)
    # 20 steps of 8 environments; the cut-short first episodes end in steps 1 to 5, three whole ones follow.
    reported = int(batch["log"]["episodes"])
    whole = 8 * 20 // 5 - sum(5 - t < 5 for t in np.asarray(state.env_state["t"]))
    assert reported == whole


def test_tuned_settings_stand_in_for_those_of_the_configuration():
    """All at once as the configuration has them; each that is the default instead makes a difference."""
    others = {"learning_rate": 3e-2, "clip_eps": 0.05, "entropy_coef": 0.1, "value_coef": 2.0, "gamma": 0.5}
    others |= {"gae_lambda": 0.3, "max_grad_norm": 0.1, "initial_log_std": -1.0, "noise_correlation": 0.9}
    others |= {"desired_kl": 1e-3}
    assert set(others) == tunable(PPOConfig()) - {"teaching_coef", "teaching_floor", "teaching_kl"}  # nobody teaches
    quick = {"num_steps": 10, "num_minibatches": 2, "update_epochs": 2, "hidden": (8,)}

    def params(config):
        ppo = PPO(Cue(), config, 8, 3)

        def iterations(tuned):
            step = lambda state, _: (ppo.improve(*ppo.collect(state))[0], None)  # noqa: E731
            return jax.lax.scan(step, ppo.init(jax.random.key(0), tuned), length=3)[0].params

        return jax.jit(iterations)

    expected, tuned = params(PPOConfig(**quick, **others))({}), params(PPOConfig(**quick))

    def error(settings):
        found = tuned({name: jnp.float32(value) for name, value in settings.items()})
        return max(jax.tree.leaves(jax.tree.map(lambda x, y: float(jnp.abs(x - y).max()), found, expected)))

    assert error(others) < 1e-4
    for name in others:
        assert error(others | {name: getattr(PPOConfig(), name)}) > 1e-3, name


def test_sizes_that_do_not_divide_are_refused():
    with pytest.raises(UsageError, match="samples do not divide"):
        PPO(Meeting(), PPOConfig(num_steps=16, num_minibatches=7), num_envs=64, total_iterations=1)
    with pytest.raises(UsageError, match="64 sequences do not divide"):
        PPO(Meeting(), PPOConfig(num_steps=6, num_minibatches=3, recurrent=True), num_envs=64, total_iterations=1)


def test_a_critic_that_is_to_know_partners_needs_some():
    with pytest.raises(UsageError, match="critic_knows_partner needs a partner of several"):
        PPO(Meeting(), PPOConfig(critic_knows_partner=True), 64, 1)


# -- the paper's tables -----------------------------------------------------------------------------


def test_paper_presets_are_the_papers_tables():
    """Rows picked from both tables, against the paper's own numbers."""
    assert preset("paper", "ippo", "scratch") == {
        "learning_rate": 3.34e-4,
        "update_epochs": 8,
        "num_minibatches": 16,
        "clip_eps": 0.169,
        "entropy_coef": 1.61e-3,
        "num_steps": 64,
    }
    row = preset("paper", "mappo", "tooth_brushing", recurrent=True)
    assert (row["learning_rate"], row["num_steps"]) == (2.56e-3, 128)
    row = preset("paper", "masac", "feeding")
    assert (row["updates"], row["num_steps"], row["batch_size"], row["tau"]) == (128, 8, 128, 2.73e-4)
    with pytest.raises(UsageError, match="no settings for isac with a GRU"):
        preset("paper", "isac", "scratch", recurrent=True)


def test_every_preset_is_a_valid_configuration():
    for name, algorithms in PRESETS.items():
        for row, tasks in algorithms.items():
            assert set(tasks) == {spec.name for spec in TASKS.values()}
            for task in tasks:
                algorithm = row.removesuffix("_rnn")
                settings = preset(name, algorithm, task, recurrent=row.endswith("_rnn"))
                (SACConfig if algorithm.endswith("sac") else PPOConfig)(**settings)


def test_exploration_comes_down_to_what_is_asked_for(scratch):
    """By hand: after iteration i of n at most initial + i / (0.75 n) of the way; what is quieter already stays so."""
    config = PPOConfig(num_steps=4, num_minibatches=1, initial_log_std=-1.0, final_log_std=-3.0)
    ppo = PPO(scratch, config, 2, 8)
    params = jax.jit(ppo.init)(jax.random.key(0)).params
    params["robot"]["actor"]["log_std"] = params["robot"]["actor"]["log_std"].at[0].set(-9.0)
    for done, most in ((0, -1.0 - 2.0 / 6), (2, -2.0), (5, -3.0), (7, -3.0)):
        quiet = ppo._quieter(config, params, jnp.int32(done))
        np.testing.assert_allclose(quiet["human"]["actor"]["log_std"], most, rtol=1e-6)
        np.testing.assert_allclose(quiet["robot"]["actor"]["log_std"], [-9.0] + [most] * 6, rtol=1e-6)
        assert quiet["robot"]["critic"] is params["robot"]["critic"]
    timed = replace(config, exploration_steps=32)  # 4 iterations of 2 x 4 steps, however long the run
    for done, most in ((0, -1.5), (3, -3.0), (7, -3.0)):
        for length in (4, 100):
            quiet = PPO(scratch, timed, 2, length)._quieter(timed, params, jnp.int32(done))
            np.testing.assert_allclose(quiet["human"]["actor"]["log_std"], most, rtol=1e-6)
    with pytest.raises(UsageError, match=r"ppo\.exploration_steps must be 0"):
        PPOConfig(exploration_steps=-1)
