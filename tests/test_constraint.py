"""Learning with a limit on cost: its parts by hand, a game whose constrained optimum is known, what stays the same."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from games import Fines, Meeting

from assistax.errors import UsageError
from assistax.learning.ppo import PPO, PPOConfig
from assistax.learning.ppo.constraint import combined, excess, init_constraint, updated
from assistax.policies import Player, Still
from assistax.training.checkpoint import load_checkpoint, save_checkpoint
from assistax.training.configuration import configure

QUICK = PPOConfig(learning_rate=3e-3, entropy_coef=0.0, hidden=(16,), num_steps=10, update_epochs=4, num_minibatches=2)
QUICK = replace(QUICK, initial_log_std=-2.0, gamma=0.9)


def test_excess_by_hand():
    """A quarter of the cost too much; half of the limit not used; nothing allowed and nothing, or something, done."""
    found = [
        float(excess(jnp.float32(cost), limit)) for cost, limit in ((8.0, 6.0), (3.0, 6.0), (0.0, 0.0), (2.0, 0.0))
    ]
    assert found == [0.25, -0.5, 0.0, 1.0]


def test_the_multiplier_by_hand():
    """Gains 2 of the excess, 0.5 of its sum, 1 of its rise; the limit 6, and the costs of each iteration's episodes."""
    constraint, found = init_constraint(3), []
    for cost in (8.0, 12.0, np.nan, 3.0, 0.0, 8.0):
        constraint = updated(constraint, jnp.float32(cost), 6.0, (2.0, 0.5, 1.0))
        found.append((float(constraint.cost), float(constraint.integral), float(constraint.multiplier)))
    # excess 1/4, 1/2, (no episode), -1/2, -1, 1/4; the sum times its gain 1/8, 3/8, -, 1/8, 0 (not -3/8), 1/8
    # 2/4 + 1/8 + 1/4; 2/2 + 3/8 + 1/4; unchanged; -1 + 1/8 < 0; < 0; 2/4 + 1/8 + the rise from -1, 5/4
    multipliers = (0.875, 1.625, 1.625, 0.0, 0.0, 1.875)
    assert found == list(zip((8, 12, 12, 3, 0, 8), (0.125, 0.375, 0.375, 0.125, 0, 0.125), multipliers, strict=True))


def test_combined_advantages_by_hand():
    """The spreads of rewards' are 2 and 4, those of costs' 0.5 and 1, so a multiplier of 3 weighs a cost by twelve."""
    advantages = {"robot": jnp.array([2.0, -2.0, 2.0, -2.0]), "human": jnp.array([8.0, 0.0, 8.0, 0.0])}
    costs = {"robot": jnp.array([0.5, 0.5, -0.5, -0.5]), "human": jnp.array([1.0, -1.0, -1.0, 1.0])}
    found = combined(advantages, costs, jnp.float32(3.0))
    np.testing.assert_allclose(found["robot"], [-1.0, -2.0, 2.0, 1.0], rtol=1e-6)
    np.testing.assert_allclose(found["human"], [-1.0, 3.0, 5.0, -3.0], rtol=1e-6)
    jax.tree.map(np.testing.assert_array_equal, combined(advantages, costs, jnp.float32(0.0)), advantages)


def trained(config, limits, iterations, partners=None):
    """(states, stats [limits, iterations], means of the learners' actions [limits, learners]), one lane a limit."""
    ppo = PPO(Fines(), config, 16, iterations, partners)

    def train(limit):
        step = lambda state, _: ppo.improve(*ppo.collect(state))  # noqa: E731
        tuned = {"cost_limit": limit} if config.constrained else {}
        state, stats = jax.lax.scan(step, ppo.init(jax.random.key(0), tuned), length=iterations)
        policy, params = ppo.policy(), ppo.policy_params(state)
        act = lambda p: policy.act(p, policy.initial_carry(), jnp.ones(1), jnp.bool_(True), jax.random.key(0))  # noqa: E731
        return state, stats, jnp.stack([act(params[agent])[0][0] for agent in ppo.learners])

    return jax.jit(jax.vmap(train))(jnp.array(limits))


def test_a_team_reaches_the_constrained_optimum():
    """See Fines for what should be played, at most 1.5 or 2 a step in episodes of 5; free, 3 a step is best."""
    limits = (7.5, 10.0, 20.0)
    _, stats, actions = trained(replace(QUICK, cost_limit=1.0), limits, 250)
    cost, multiplier = stats["constraint"]["cost"], stats["constraint"]["multiplier"]
    np.testing.assert_allclose(cost[:2, -50:].mean(1), limits[:2], rtol=0.03)
    np.testing.assert_allclose(actions, [[0.7, 0.4], [0.8, 0.6], [1.0, 1.0]], atol=0.04)
    # Both advantages are linear in the noise there, so their spreads are alike.
    np.testing.assert_allclose(multiplier[:2, -50:].mean(1), 1.0, atol=0.15)
    assert (multiplier[2] == 0.0).all() and float(cost[2, -50:].mean()) > 14.0


def test_a_limit_never_reached_changes_nothing():
    """To the bit, as runs compile it."""

    def played(limit):
        ppo = PPO(Fines(), replace(QUICK, cost_limit=limit), 16, 4)
        state, stats, collect, improve = (
            jax.jit(ppo.init)(jax.random.key(0)),
            {},
            *map(jax.jit, (ppo.collect, ppo.improve)),
        )
        for _ in range(4):
            state, stats = improve(*collect(state))
        return state, stats

    (limited, limited_stats), (free, free_stats) = played(20.0), played(None)
    assert "constraint" not in free_stats and free.constraint == () and limited_stats["constraint"]["cost"] > 0.0
    for agent in Fines.agents:
        own = {name: limited.params[agent][name] for name in ("actor", "critic")}
        jax.tree.map(np.testing.assert_array_equal, own, free.params[agent])


@pytest.mark.parametrize("variant", [("recurrent",), ("central_critic", "share_parameters")], ids="+".join)
def test_every_variant_keeps_its_limit(variant):
    """The recurrent robot plays with a partner that stands still and costs nothing: it may play 0.4."""
    alone = "recurrent" in variant
    partners = {"human": Player(Still(1))} if alone else {}
    config = replace(QUICK, learning_rate=1e-3, cost_limit=1.0, **dict.fromkeys(variant, True))
    states, stats, _ = trained(config, (2.0 if alone else 7.5,), 240, partners)
    assert all("cost_critic" in networks for networks in states.params.values())
    np.testing.assert_allclose(stats["constraint"]["cost"][0, -60:].mean(), 2.0 if alone else 7.5, rtol=0.1)


def test_cost_values_are_those_of_a_plain_loop():
    """Targets of the cost critic and combined advantages, in NumPy, from the rollout's own values."""
    ppo = PPO(Fines(), replace(QUICK, cost_limit=1.0), 4, 1)
    state, batch = jax.jit(lambda key: ppo.collect(ppo.init(key)))(jax.random.key(0))
    state = replace(state, constraint=replace(state.constraint, multiplier=jnp.float32(0.5), per_step=jnp.float32(2.0)))
    actions = {agent: np.asarray(action)[..., 0] for agent, action in batch["actions"].items()}
    cost = np.maximum(actions["robot"], 0) + 2.0 * np.maximum(actions["human"], 0)
    np.testing.assert_allclose(batch["cost"], cost, rtol=1e-6)
    assert (cost > 0).any()
    # Starts are staggered: environment i is at step 5 i // 4, and of its first episode only a whole one counts.
    sums = [cost[t - 4 : t + 1, i].sum() for i in range(4) for t in range(4, 10) if (t + 5 * i // 4 + 1) % 5 == 0]
    np.testing.assert_allclose(batch["episode_cost"], np.mean(sums), rtol=1e-5)
    everyone = jax.jit(ppo._samples)(state, batch)
    samples = everyone["robot"]
    value, done = np.asarray(samples["cost_critic"]["old"]), np.asarray(batch["done"])
    expected, advantage = np.zeros_like(cost), np.zeros(4)
    for t in reversed(range(10)):  # what is seen never changes, so neither does the value
        delta = cost[t] / 2.0 / 5.0 + 0.9 * value[t] - value[t]
        advantage = expected[t] = delta + np.where(done[t], 0.0, 0.9 * 0.95 * advantage)
    np.testing.assert_allclose(samples["cost_critic"]["target"] - value, expected, atol=1e-5)
    spread = {
        critic: sum(
            np.std(everyone[agent][critic]["target"] - everyone[agent][critic]["old"]) for agent in Fines.agents
        )
        for critic in ("critic", "cost_critic")
    }
    reward = np.asarray(samples["critic"]["target"] - samples["critic"]["old"])
    both = (reward - 0.5 * spread["critic"] / spread["cost_critic"] * expected) / 1.5
    np.testing.assert_allclose(samples["advantage"], both, atol=1e-5)


def test_resume_equals_uninterrupted_to_the_bit(tmp_path):
    ppo = PPO(Fines(7), replace(QUICK, cost_limit=0.5, hidden=(8,)), 4, 4)
    step = jax.jit(lambda state: ppo.improve(*ppo.collect(state))[0])
    state = jax.jit(ppo.init)(jax.random.key(0))
    for i in range(4):
        if i == 2:
            save_checkpoint(tmp_path / "c", state, {})
        state = step(state)
    resumed = step(step(load_checkpoint(tmp_path / "c", jax.eval_shape(ppo.init, jax.random.key(0)))))
    assert float(state.constraint.multiplier) > 0 and (state.constraint.so_far > 0).any()
    jax.tree.map(
        np.testing.assert_array_equal,
        replace(state, key=jax.random.key_data(state.key)),
        replace(resumed, key=jax.random.key_data(resumed.key)),
    )


def test_limits_that_mean_nothing_are_refused():
    for limit in (-1.0, "low", float("nan"), True):
        with pytest.raises(UsageError, match="a number of 0 or more, or None"):
            PPOConfig(cost_limit=limit)
    with pytest.raises(UsageError, match="three numbers"):
        PPOConfig(multiplier_gains=(1.0, 0.1))
    with pytest.raises(UsageError, match='needs a cost, and Meeting has no "cost"'):
        PPO(Meeting(), replace(QUICK, cost_limit=1.0), 4, 1)
    with pytest.raises(UsageError, match="cost_limit does not exist for masac"):
        configure("scratch", {"ppo.cost_limit": 1.0}, algorithm="masac")
    assert not PPOConfig(cost_limit=float("inf")).constrained and not PPOConfig().constrained
