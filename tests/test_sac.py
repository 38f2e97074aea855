"""SAC and its parts, against numbers worked by hand and games whose optimum is computed."""

import math
import time
from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from games import Game

from assistax.errors import UsageError
from assistax.learning.actors import SquashedActor
from assistax.learning.networks import init_mlp, mlp
from assistax.learning.sac import SAC, SACConfig, temperature_loss
from assistax.learning.sac.replay import Packing, add, init_replay, sample
from assistax.learning.squashed import log_tanh_slope, sample_squashed, split_head, squashed_log_prob
from assistax.learning.tuned import tunable
from assistax.policies import Player, Still
from assistax.training import pieces
from assistax.training.seeds import Lanes


class Carrying(Game):
    """Two agents lift a load to a height c in {-1, 1} that both see; effort costs.

    Rewards 2 - (lift - c)² - effort, where lift = robot + human and the robot has a second action that
    should mirror the human's. Nothing but the clock is a state, so that the optimum is one quadratic's.
    Episodes end at the time limit; with `terminating` that is the end of the task.
    """

    observation_sizes, action_sizes, global_size = {"robot": 2, "human": 1}, {"robot": 2, "human": 1}, 2

    def __init__(self, episode_length=5, terminating=False, constant=False):
        self.episode_length, self.terminating, self.constant = episode_length, terminating, constant

    def begin(self, key):
        return {"c": jnp.where(jax.random.bernoulli(key), 1.0, -1.0)}

    def see(self, state):
        return {"robot": self.global_obs(state), "human": state["c"][None]}

    def global_obs(self, state):
        return jnp.stack([state["c"], 0.1 * state["t"]])

    def play(self, key, state, actions):
        return jnp.float32(1.0) if self.constant else self.reward(state["c"], **actions), {}

    @staticmethod
    def reward(c, robot, human):
        effort = 0.5 * robot[0] ** 2 + human[0] ** 2 + 0.5 * (robot[1] + human[0]) ** 2
        return 2.0 - (robot[0] + human[0] - c) ** 2 - effort

    def step(self, key, state, actions):
        obs, state, rewards, terminated, truncated, info = super().step(key, state, actions)
        ends = (truncated, terminated) if self.terminating else (terminated, truncated)
        return obs, state, rewards, *ends, info


def optimum(c):
    """The best reward of Carrying: where the gradient, linear in (robot 0, robot 1, human), is zero."""
    hessian = np.array([[3.0, 0.0, 2.0], [0.0, 1.0, 1.0], [2.0, 1.0, 5.0]])
    x = np.linalg.solve(hessian, [2.0 * c, 0.0, 2.0 * c])
    assert np.abs(x).max() < 1.0
    return Carrying.reward(c, x[:2], x[2:])


@cache
def jitted(trainer):
    """`init`, `collect` and `improve`, compiled once."""
    return jax.jit(trainer.init), *(jax.jit(f, donate_argnums=0) for f in (trainer.collect, trainer.improve))


def train(trainer, iterations, state=None):
    init, collect, improve = jitted(trainer)
    state = init(jax.random.key(0)) if state is None else state
    stats = None
    for _ in range(iterations):
        state, batch = collect(state)
        state, stats = improve(state, batch)
    return state, stats


QUICK = {
    "actor_learning_rate": 3e-3,
    "critic_learning_rate": 3e-3,
    "alpha_learning_rate": 1e-2,
    "tau": 0.02,
    "gamma": 0.5,
    "batch_size": 128,
    "buffer_size": 8192,
    "warmup": 256,
    "hidden": (32, 32),
}


# -- the parts -------------------------------------------------------------------------------------


def test_squashed_log_prob_is_the_density_of_the_squashed_action():
    """Against the derivative, in float64, of P(tanh(u) < a) = Phi((artanh a - mean) / std)."""
    mean, std, a = (0.3, -0.8), (0.5, 1.7), (0.6, -0.95)

    def cumulative(a, mean, std):
        return 0.5 * (1.0 + math.erf((math.atanh(a) - mean) / std / math.sqrt(2.0)))

    h = 1e-6
    densities = [
        (cumulative(x + h, m, s) - cumulative(x - h, m, s)) / (2 * h) for x, m, s in zip(a, mean, std, strict=True)
    ]
    found = squashed_log_prob(jnp.arctanh(jnp.array(a)), jnp.array(mean), jnp.log(jnp.array(std)))
    np.testing.assert_allclose(found, np.sum(np.log(densities)), rtol=1e-4)


def test_squashed_log_prob_far_out():
    """At u = 20, tanh is 1 in float32 and log(1 - 1) would be -inf; 1 - tanh² = 4 exp(-2u) there."""
    np.testing.assert_allclose(log_tanh_slope(jnp.array([20.0, -20.0])), math.log(4.0) - 40.0, rtol=1e-6)
    np.testing.assert_allclose(log_tanh_slope(jnp.float32(0.0)), 0.0, atol=1e-6)
    np.testing.assert_allclose(jax.grad(log_tanh_slope)(20.0), -2.0, rtol=1e-6)


def test_samples_come_with_their_own_log_prob_and_fill_the_box():
    mean, log_std = jnp.zeros((4096, 2)), jnp.full((4096, 2), jnp.log(0.5))
    action, log_prob = sample_squashed(mean, log_std, jax.random.normal(jax.random.key(0), mean.shape))
    np.testing.assert_allclose(log_prob, squashed_log_prob(jnp.arctanh(action), mean, log_std), atol=1e-3)
    # The median of |tanh(u)| is tanh of the median of |u|, 0.6745 standard deviations.
    np.testing.assert_allclose(jnp.median(jnp.abs(action)), math.tanh(0.5 * 0.6745), atol=0.01)


def test_log_std_stays_within_its_bounds():
    mean, log_std = split_head(jnp.array([1.0, 2.0, -100.0, 100.0]))
    np.testing.assert_allclose(mean, [1.0, 2.0])
    np.testing.assert_allclose(log_std, [-5.0, 2.0])


def test_temperature_rises_where_the_entropy_is_below_its_target():
    entropy, target = {"robot": jnp.float32(-9.0), "human": jnp.float32(1.0)}, {"robot": -7.0, "human": -3.0}
    slope = jax.grad(temperature_loss)(dict.fromkeys(entropy, jnp.float32(0.0)), entropy, target)
    assert slope == {"robot": -2.0, "human": 4.0}  # descent: up for the robot, down for the human


def test_replay_is_a_ring_of_whole_chunks():
    replay = init_replay({"x": jnp.float32(0.0)}, capacity=11, chunk=3)  # room for three chunks
    for i in range(4):
        replay = add(replay, {"x": 10.0 * (i + 1) + jnp.arange(3.0)})
        assert int(replay.size) == min(3 * (i + 1), 9)
    np.testing.assert_array_equal(replay.rows["x"], [40, 41, 42, 20, 21, 22, 30, 31, 32])  # the oldest are gone
    assert int(replay.next) == 3


def test_samples_are_of_what_was_written_and_uniform():
    replay = add(init_replay({"x": jnp.float32(0.0)}, 100, 4), {"x": jnp.arange(1.0, 5.0)})
    drawn = sample(replay, jax.random.key(0), 4000)["x"]
    counts = np.bincount(np.asarray(drawn, int), minlength=5)
    assert counts[0] == 0 and counts.sum() == 4000
    np.testing.assert_allclose(counts[1:], 1000, atol=120)  # 4.4 standard deviations


def test_packed_observations_come_back(scratch):
    for env in (scratch, Carrying()):
        obs, state = jax.jit(env.reset)(jax.random.key(1))
        packing = Packing(env)
        row = packing.pack(env.global_obs(state), obs)
        seen = packing.unpack(row)
        np.testing.assert_array_equal(seen["global"], env.global_obs(state))
        for agent in env.agents:
            np.testing.assert_array_equal(seen[agent], obs[agent])
    assert (
        Packing(scratch).pack(scratch.global_obs(scratch.reset(jax.random.key(0))[1]), {}).size == scratch.global_size
    )


@pytest.mark.parametrize("joint", [True, False])
def test_soft_targets_by_hand(joint):
    """Zero actors draw tanh of N(0, exp(-1.5)) in each dimension; the twin targets say 3 and 5 of everything."""
    trainer = SAC(Carrying(), SACConfig(joint_critics=joint, gamma=0.5), num_envs=1, total_iterations=1)
    shapes = jax.eval_shape(trainer.init, jax.random.key(0)).params
    params = jax.tree.map(lambda x: jnp.zeros(x.shape), shapes)
    params["log_alpha"] = {"robot": jnp.log(0.1), "human": jnp.log(0.2)}
    for pair in params["target"].values():
        for critic, says in zip(pair, (3.0, 5.0), strict=True):
            critic[-1]["b"] += says / 2.0  # networks say what a step is worth, and look two ahead
    n = 20_000
    rewards = {"team": 1.0, "robot": 1.0, "human": -2.0}
    x = {"reward": {name: jnp.full(n, rewards[name]) for name in trainer._critics}, "next_others": {}}
    x["terminated"] = jnp.arange(n) % 2 == 0
    seen = {"robot": jnp.zeros((n, 2)), "human": jnp.zeros((n, 1)), "global": jnp.zeros((n, 2))}
    targets = trainer.soft_targets(trainer.config, params, x, seen, jax.random.key(0))

    std, u = math.exp(-1.5), np.linspace(-3.0, 3.0, 100_001)
    density = np.exp(-0.5 * (u / std) ** 2) / std / math.sqrt(2.0 * math.pi)
    log_density = np.log(density) - np.log(1.0 - np.tanh(u) ** 2)
    entropy = -np.sum(density * log_density) * (u[1] - u[0])  # of one dimension
    bonus = {"robot": 0.1 * 2 * entropy, "human": 0.2 * entropy}
    bonus["team"] = bonus["robot"] + bonus["human"]
    for name, found in targets.items():
        np.testing.assert_array_equal(found[::2], rewards[name])  # nothing follows
        np.testing.assert_allclose(found[1::2].mean(), rewards[name] + 0.5 * (3.0 + bonus[name]), atol=0.005)


# -- what is replayed ------------------------------------------------------------------------------


@pytest.mark.parametrize("terminating", [False, True])
def test_transitions_end_in_the_true_final_observation(terminating):
    """Three steps an episode: the third leads to t = 3, which no first observation of an episode shows."""
    trainer = SAC(Carrying(3, terminating), SACConfig(num_steps=6, buffer_size=24, stagger=False), 4, 1)
    state, _ = jax.jit(trainer.collect)(jax.jit(trainer.init)(jax.random.key(0)))
    rows = jax.tree.map(lambda x: np.asarray(x).reshape(6, 4, *x.shape[1:]), state.replay.rows)
    seen, then = (trainer._packing.unpack(rows[name])["global"] for name in ("obs", "next_obs"))
    np.testing.assert_allclose(seen[..., 1], 0.1 * np.array([[0, 1, 2, 0, 1, 2]] * 4).T, rtol=1e-6)
    np.testing.assert_allclose(then[..., 1], 0.1 * np.array([[1, 2, 3, 1, 2, 3]] * 4).T, rtol=1e-6)
    np.testing.assert_array_equal(then[..., 0], seen[..., 0])  # the height of the episode that ended
    np.testing.assert_array_equal(rows["terminated"][:, 0], terminating * np.array([0, 0, 1, 0, 0, 1]))
    expected = jax.vmap(jax.vmap(Carrying.reward))(seen[..., 0], rows["actions"]["robot"], rows["actions"]["human"])
    np.testing.assert_allclose(rows["reward"]["team"], expected, rtol=1e-5)


@pytest.mark.parametrize(("joint", "terminating"), [(True, False), (False, True)])
def test_values_go_on_through_time_limits_and_not_through_ends(joint, terminating):
    """Reward 1 at every step, gamma 0.5, no entropy: worth 2 for ever; with ends after 2 steps 1.5, then 1."""
    settings = QUICK | {
        "initial_alpha": 1e-8,
        "alpha_learning_rate": 1e-8,
        "activation": "tanh",
        "normalize_obs": False,
    }
    trainer = SAC(Carrying(2, terminating, constant=True), SACConfig(joint_critics=joint, **settings), 32, 1)
    state, _ = train(trainer, 30)
    rows = jax.tree.map(lambda x: x[:64], state.replay.rows)
    seen = trainer._see(rows["obs"], state.normalizer)
    late = np.asarray(seen["robot"][:, 1]) > 0.05
    for name, pair in state.params["critic"].items():
        if name == "human" and terminating:
            continue  # it does not see the clock
        for value in trainer._judge(trainer.config, name, pair, seen, rows["actions"]):
            np.testing.assert_allclose(value, np.where(late, 1.0, 1.5) if terminating else 2.0, atol=0.15)


@pytest.mark.parametrize(
    ("joint", "frozen", "expected"),
    [
        (False, (), {"robot": -1.0, "human": 3.0}),
        (False, ("robot",), {"human": 3.0}),
        (True, (), {"team": 1.0}),  # the mean of the learners'
        (True, ("robot",), {"team": 3.0}),
    ],
)
def test_every_critic_foresees_the_rewards_of_its_own_learners(joint, frozen, expected):
    partners = {agent: Player(Still(Carrying.action_sizes[agent])) for agent in frozen}
    trainer = SAC(Carrying(), SACConfig(joint_critics=joint), 2, 1, partners)
    rewards = {"robot": -1.0, "human": 3.0}
    assert {name: trainer._reward(rewards, agents) for name, (_, agents) in trainer._critics.items()} == expected


# -- learning --------------------------------------------------------------------------------------


@pytest.mark.parametrize("joint", [True, False])
def test_solves_a_game_with_a_computed_optimum_to_two_percent(joint):
    trainer = SAC(Carrying(), SACConfig(joint_critics=joint, **QUICK), num_envs=32, total_iterations=60)
    state, stats = train(trainer, 60)
    policy, params = trainer.policy(deterministic=True), trainer.policy_params(state)
    for c in (-1.0, 1.0):
        obs = {"robot": jnp.array([c, 0.2]), "human": jnp.array([c])}
        actions = {a: policy.act(params[a], (), obs[a], False, jax.random.key(0))[0] for a in Carrying.agents}
        assert Carrying.reward(c, actions["robot"], actions["human"]) > 0.98 * optimum(c)
    for agent, size in Carrying.action_sizes.items():  # the temperature holds the entropy at its target
        assert abs(float(stats[agent]["entropy"]) + size) < 0.5


def test_exploration_is_correlated_alike_in_training_and_as_a_partner():
    config = SACConfig(num_steps=6, updates=1, buffer_size=12_000, warmup=0, noise_correlation=0.8)
    trainer = SAC(Carrying(), config, num_envs=2000, total_iterations=1)
    state = jax.jit(lambda key: trainer.collect(trainer.init(key))[0])(jax.random.key(0))
    policy, params = trainer.policy(deterministic=False), trainer.policy_params(state)

    def play(carry, now):
        action, carry = jax.vmap(policy.act, (None, 0, 0, None, 0))(params["robot"], carry, *now)
        return carry, action

    seen = trainer._packing.unpack(state.replay.rows["obs"])["robot"].reshape(6, 2000, -1)
    carry = jnp.broadcast_to(policy.initial_carry(), (2000, policy.longest_action))
    _, played = jax.lax.scan(play, carry, (seen, jnp.arange(6) == 0, jax.random.split(jax.random.key(1), (6, 2000))))
    for actions in (state.replay.rows["actions"]["robot"].reshape(6, 2000, -1), played):
        u = np.arctanh(actions[..., 0])
        np.testing.assert_allclose(u.std(1), u.std(), rtol=0.1)
        for t in range(5):
            assert abs(np.corrcoef(u[t], u[t + 1])[0, 1] - 0.8) < 0.05


def test_resumed_equals_uninterrupted(scratch, tmp_path, monkeypatch):
    monkeypatch.setattr(pieces, "PIECE", 512)
    config = SACConfig(num_steps=4, updates=2, batch_size=16, buffer_size=48, warmup=20)
    trainer = SAC(scratch, config, num_envs=4, total_iterations=6)
    half, _ = train(trainer, 3)
    lanes = Lanes(1)
    pieces.save(tmp_path / "half", lanes.join([half]), {})
    assert len(list(tmp_path.glob("pieces/*"))) > 10
    (loaded,) = lanes.split(pieces.load(tmp_path / "half", lanes.like(trainer.init, [jax.random.key(0)])))
    loaded, _ = train(trainer, 3, loaded)
    whole, _ = train(trainer, 6)
    assert int(whole.iteration) == 6 and int(whole.replay.size) == 48
    for (path, a), b in zip(jax.tree.leaves_with_path(whole), jax.tree.leaves(loaded), strict=True):
        if jnp.issubdtype(a.dtype, jax.dtypes.prng_key):
            a, b = jax.random.key_data(a), jax.random.key_data(b)
        np.testing.assert_array_equal(a, b, err_msg=jax.tree_util.keystr(path))


def test_tuned_settings_stand_in_for_those_of_the_configuration():
    """All at once as the configuration has them; each that is the default instead makes a difference."""
    others = {"actor_learning_rate": 3e-2, "critic_learning_rate": 2e-2, "alpha_learning_rate": 1e-2}
    others |= {"tau": 0.3, "gamma": 0.5, "initial_alpha": 0.1, "noise_correlation": 0.9}
    assert set(others) == tunable(SACConfig())
    quick = {"updates": 3, "batch_size": 32, "buffer_size": 1024, "warmup": 64, "hidden": (8,)}

    def params(config):
        trainer = SAC(Carrying(), config, num_envs=8, total_iterations=3)

        def iterations(tuned):
            step = lambda state, _: (trainer.improve(*trainer.collect(state))[0], None)  # noqa: E731
            return jax.lax.scan(step, trainer.init(jax.random.key(0), tuned), length=3)[0].params

        return jax.jit(iterations)

    expected, tuned = params(SACConfig(**quick, **others))({}), params(SACConfig(**quick))

    def error(settings):
        found = tuned({name: jnp.float32(value) for name, value in settings.items()})
        return max(jax.tree.leaves(jax.tree.map(lambda x, y: float(jnp.abs(x - y).max()), found, expected)))

    assert error(others) < 1e-4
    for name in others:
        assert error(others | {name: getattr(SACConfig(), name)}) > 1e-3, name


# -- partners --------------------------------------------------------------------------------------


def partners(members=3):
    layers = jax.vmap(lambda key: init_mlp(key, (1, 8, 2), out_scale=1.0))(jax.random.split(jax.random.key(5), members))
    return {"human": Player(SquashedActor(normalize_obs=False), {"actor": {"layers": layers}}, members)}


def test_a_frozen_partner_plays_its_own_actions_and_learns_nothing():
    config = SACConfig(num_steps=10, updates=2, buffer_size=60, stagger=False)
    frozen = partners()
    trainer = SAC(Carrying(), config, num_envs=6, total_iterations=1, partners=frozen)
    state, stats = train(trainer, 1)
    assert set(state.params["actor"]) == set(state.params["log_alpha"]) == set(stats) == {"robot"}
    rows = jax.tree.map(lambda x: np.asarray(x).reshape(10, 6, *x.shape[1:]), state.replay.rows)
    c = jnp.asarray(trainer._packing.unpack(rows["obs"])["human"])
    policy, members = frozen["human"].policy, frozen["human"].params

    def every_member(obs):
        return jax.vmap(lambda params: policy.act(params, (), obs, False, jax.random.key(0))[0])(members)

    own = np.asarray(jax.vmap(jax.vmap(every_member))(c))  # [10, 6, members, 1]
    played = rows["actions"]["human"]
    assert np.all(np.abs(own - played[:, :, None]).min(2) < 1e-6)
    chosen = np.abs(own - played[:, :, None]).argmin(2)[..., 0]
    assert np.all(chosen[:5] == chosen[0]) and np.all(chosen[5:] == chosen[5])  # one member an episode
    assert np.any(chosen[5] != chosen[0])  # and then another
    # The critics' next action is what the partner then did; at the time limit its last one.
    np.testing.assert_array_equal(
        rows["next_others"]["human"][:-1][[0, 1, 2, 3, 5, 6, 7, 8]], played[[1, 2, 3, 4, 6, 7, 8, 9]]
    )
    np.testing.assert_array_equal(rows["next_others"]["human"][4], played[4])


def test_critics_of_a_team_see_partners_and_those_of_one_agent_do_not():
    for joint, name, width in ((True, "team", 2 + 3), (False, "robot", 2 + 2)):
        trainer = SAC(Carrying(), SACConfig(joint_critics=joint), 6, 1, partners())
        params = jax.eval_shape(trainer.init, jax.random.key(0)).params
        assert set(params["critic"]) == set(params["target"]) == {name}
        assert params["critic"][name][0][0]["w"].shape == (width, 128)


def test_learns_with_a_frozen_partner():
    """The best answer to a human that plays h: robot[0] = 2 (c - h) / 3, robot[1] = -h."""
    trainer = SAC(Carrying(), SACConfig(**QUICK), num_envs=32, total_iterations=60, partners=partners(1))
    state, _ = train(trainer, 60)
    human = jax.tree.map(lambda x: x[0], partners(1)["human"].params)
    for c in (-1.0, 1.0):
        h = partners(1)["human"].policy.act(human, (), jnp.array([c]), False, jax.random.key(0))[0]
        obs, key = jnp.array([c, 0.2]), jax.random.key(0)
        robot, _ = trainer.policy(True).act(trainer.policy_params(state)["robot"], (), obs, False, key)
        best = Carrying.reward(c, jnp.array([2.0 * (c - h[0]) / 3.0, -h[0]]), h)
        assert Carrying.reward(c, robot, h) > best - 0.02 * abs(best)


# -- bounds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"tau": 0.0}, "sac.tau"),
        ({"gamma": 1.5}, "sac.gamma"),
        ({"updates": 0}, "sac.updates"),
        ({"warmup": -1}, "sac.warmup"),
        ({"critic_learning_rate": 0.0}, "sac.critic_learning_rate"),
        ({"activation": "rellu"}, "Did you mean 'relu'"),
    ],
)
def test_bad_settings_are_refused(settings, message):
    with pytest.raises(UsageError, match=message):
        SACConfig(**settings)


def test_a_replay_smaller_than_an_iteration_is_refused():
    with pytest.raises(UsageError, match="must hold the transitions"):
        SAC(Carrying(), SACConfig(buffer_size=100), num_envs=32, total_iterations=1)


# -- speed -----------------------------------------------------------------------------------------


def bare_loop(trainer, params, batch):
    """The same networks, losses and optimiser steps as MASAC's, straight: no replay, normaliser or switches."""
    adams = {"actor": optax.adam(1e-4), "critic": optax.adam(1e-4), "log_alpha": optax.adam(1e-4)}
    target_entropy = {agent: -n for agent, n in trainer.env.action_sizes.items()}
    seen, then = trainer._packing.unpack(batch["obs"]), trainer._packing.unpack(batch["next_obs"])

    def draw(actor, obs, key):
        mean, log_std = split_head(mlp(actor, obs, "relu"))
        return sample_squashed(mean, log_std, jax.random.normal(key, mean.shape))

    def judge(critic, obs, robot, human):
        return mlp(critic, jnp.concatenate([obs["global"], robot, human], -1), "relu")[:, 0]

    def step(carry, key):
        params, opts = dict(carry[0]), dict(carry[1])
        k = jax.random.split(key, 4)
        alpha = jax.tree.map(jnp.exp, params["log_alpha"])
        robot, robot_log = draw(params["actor"]["robot"], then["robot"], k[0])
        human, human_log = draw(params["actor"]["human"], then["human"], k[1])
        value = jnp.minimum(*[judge(q, then, robot, human) for q in params["target"]["team"]])
        value = value - alpha["robot"] * robot_log - alpha["human"] * human_log
        y = batch["reward"]["team"] + 0.99 * (1.0 - batch["terminated"]) * value

        def critic_loss(critic):
            actions = batch["actions"]
            return sum(jnp.mean((judge(q, seen, actions["robot"], actions["human"]) - y) ** 2) for q in critic["team"])

        def actor_loss(actor):
            robot, robot_log = draw(actor["robot"], seen["robot"], k[2])
            human, human_log = draw(actor["human"], seen["human"], k[3])
            value = jnp.minimum(*[judge(q, seen, robot, human) for q in params["critic"]["team"]])
            logs = {"robot": robot_log.mean(), "human": human_log.mean()}
            return alpha["robot"] * logs["robot"] + alpha["human"] * logs["human"] - value.mean(), logs

        def descend(name, grads):
            updates, opts[name] = adams[name].update(grads, opts[name])
            params[name] = optax.apply_updates(params[name], updates)

        descend("critic", jax.grad(critic_loss)(params["critic"]))
        grads, logs = jax.grad(actor_loss, has_aux=True)(params["actor"])
        descend("actor", grads)
        descend("log_alpha", {agent: -logs[agent] - target_entropy[agent] for agent in logs})
        params["target"] = jax.tree.map(lambda a, b: a + 0.005 * (b - a), params["target"], params["critic"])
        return (params, opts), None

    opts = {name: adam.init(params[name]) for name, adam in adams.items()}
    return jax.jit(lambda keys: jax.lax.scan(step, (params, opts), keys)[0][0])


def speed_ratio(trainer, state, repeats=7) -> tuple[float, float, float]:
    """Seconds of MASAC's `improve` over those of a bare loop over the same networks, and both per gradient step."""
    updates = trainer.config.updates
    batch = sample(state.replay, jax.random.key(0), trainer.config.batch_size)
    bare = bare_loop(trainer, state.params, batch)
    improve = jax.jit(lambda state: trainer.improve(state, {})[0].params)
    keys = jax.random.split(jax.random.key(1), updates)
    seconds = {"improve": [], "bare": []}
    for i in range(repeats + 1):
        for name, call in (("improve", lambda: improve(state)), ("bare", lambda: bare(keys))):
            start = time.perf_counter()
            jax.block_until_ready(call())
            if i:  # the first call compiles
                seconds[name].append((time.perf_counter() - start) / updates)
    ours, theirs = (float(np.median(seconds[name])) for name in ("improve", "bare"))
    return ours / theirs, ours, theirs


class Wide(Carrying):
    """Carrying with the sizes of scratch and nothing in them, for timing networks."""

    observation_sizes, action_sizes, global_size = {"robot": 34, "human": 38}, {"robot": 7, "human": 3}, 52

    def obs_layout(self, who):
        seen = {"robot": ("robot", "both"), "human": ("both", "human"), "global": ("robot", "both", "human")}[who]
        ends = np.cumsum([0, *({"robot": 14, "both": 20, "human": 18}[name] for name in seen)])
        return {name: slice(*ends[i : i + 2]) for i, name in enumerate(seen)}

    def see(self, state):
        return {agent: jnp.zeros(size) for agent, size in self.observation_sizes.items()}

    def global_obs(self, state):
        return jnp.zeros(self.global_size)


@pytest.mark.slow  # a timing: not for machines that are busy
def test_a_gradient_step_costs_what_its_networks_cost():
    """Within 1.3, measured alone; here with room for a machine that others use."""
    trainer = SAC(Wide(), SACConfig(buffer_size=20_000), num_envs=64, total_iterations=1)
    state = jitted(trainer)[0](jax.random.key(0))
    noise = jax.tree.map(lambda x: jax.random.uniform(jax.random.key(1), (512, *x.shape[1:])), state.replay.rows)
    noise["terminated"] = noise["terminated"] > 0.9
    assert speed_ratio(trainer, replace(state, replay=add(state.replay, noise)))[0] < 1.6
