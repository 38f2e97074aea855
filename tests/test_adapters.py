"""Other packages' checkers on the adapters, and what these add: partners, automatic resets, seeds."""

import subprocess
import sys
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import assistax
from assistax.adapters.partner import batch_of, find_player
from assistax.errors import UsageError
from assistax.human import Person
from assistax.policies import Player
from assistax.training.population import Population

gym = pytest.importorskip("gymnasium", reason="needs the extra gymnasium")
from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.wrappers import vector as wrappers  # noqa: E402

from assistax.adapters.gymnasium import AgentEnv, AgentVectorEnv  # noqa: E402

LENGTH = 6
NUM_ENVS, MEMBERS = 8, 5
SETTINGS = {"engine": "mujoco", "episode_length": LENGTH}


@pytest.fixture(scope="module")
def env():
    """What all tests here compile once."""
    return batch_of("scratch-v3", "mujoco", {"episode_length": LENGTH}).env


@dataclass(frozen=True)
class Counting:
    """Acts with its parameter times the steps of the episode so far."""

    def initial_carry(self):
        return jnp.int32(0)

    def act(self, params, carry, obs, reset, key):
        carry = jnp.where(reset, 1, carry + 1)
        return jnp.full(3, params * carry), carry


def actions(env, i, n=2):
    return np.random.default_rng(i).uniform(-1, 1, (n, env.action_sizes["robot"])).astype(np.float32)


# -- partners --------------------------------------------------------------------------------------


def test_a_population_brings_its_people_along():
    """As itself, and by name; what else the person is stays the user's to say."""
    people = Population.scripted("scratch-v3", [Person("weakness", "default")], ("shy", "offers"))
    one = AgentEnv("scratch-v3", partner=people, human={"visibility": "human"}, **SETTINGS)
    assert one._batch.env.config.human.people == people.people
    assert one.observation_space.shape == AgentEnv("scratch-v3", partner="still", **SETTINGS).observation_space.shape
    batch, players = one._batch, one._players
    _, state = batch.reset(players, jax.random.split(jax.random.key(0), NUM_ENVS))
    zeros = {"robot": jnp.zeros((NUM_ENVS, 7))}
    state, _ = batch.step("same_step", players, state, zeros)
    index = state.partners["human"]["index"].tolist()
    assert index == state.env.person.index.tolist() and set(index) == {0, 1}
    with pytest.raises(UsageError, match=r"env\.human\.people must be theirs"):
        AgentEnv(batch_of("scratch-v3", "mujoco", {"episode_length": LENGTH}).env, partner=people)


def test_a_partner_acts_as_it_would_in_the_functional_environment(env):
    batch, players = batch_of(env), {"human": Player.of(Counting(), *[jnp.float32(0.1)] * MEMBERS)}
    keys = jax.random.split(jax.random.key(0), NUM_ENVS)
    _, state = batch.reset(players, keys)
    plain, step = state.env, jax.jit(jax.vmap(env.step_env))
    for i in range(3):
        robot = actions(env, i, NUM_ENVS)
        state, out = batch.step("same_step", players, state, {"robot": robot})
        human = jnp.full((NUM_ENVS, 3), 0.1 * (i + 1))
        expected, plain, rewards, *_ = step(keys, plain, {"robot": robot, "human": human})
        np.testing.assert_allclose(out.obs["robot"], expected["robot"], atol=1e-5)
        np.testing.assert_allclose(out.reward, rewards["robot"], atol=1e-6)


@pytest.mark.parametrize(("mode", "between"), [("same_step", LENGTH), ("next_step", LENGTH + 1)])
def test_a_population_draws_a_member_for_every_episode_and_begins_it_afresh(env, mode, between):
    batch, players = batch_of(env), {"human": Player.of(Counting(), *jnp.linspace(0, 1, MEMBERS))}
    _, state = batch.reset(players, jax.random.split(jax.random.key(0), NUM_ENVS))
    members = []
    for i in range(3 * between - 1):
        members.append(np.asarray(state.partners["human"]["index"]))
        state, _ = batch.step(mode, players, state, {"robot": jnp.zeros((NUM_ENVS, 7))})
        counted = min(i % between + 1, LENGTH)  # the step that shows a new episode is none of it
        assert np.asarray(state.partners["human"]["carry"]).tolist() == [counted] * NUM_ENVS
    changes = (np.diff(members, axis=0) != 0).any(1).nonzero()[0] + 1
    assert changes.tolist() == [LENGTH, LENGTH + between] and len(np.unique(members)) > 2


def test_nothing_happens_in_a_step_that_shows_a_new_episode(env):
    batch, players = batch_of(env), {"human": Player.of(Counting(), jnp.float32(0.5))}
    _, state = batch.reset(players, jax.random.split(jax.random.key(0), NUM_ENVS))
    for _ in range(LENGTH + 1):
        state, out = batch.step("next_step", players, state, {"robot": jnp.ones((NUM_ENVS, 7))})
    assert not any(np.any(x) for x in jax.tree.leaves([out.info["reward_terms"], out.info["cost"], out.reward]))
    np.testing.assert_array_equal(out.info["final_observation"]["robot"], out.obs["robot"])


def test_who_stays_for_episodes_needs_automatic_resets():
    staying = assistax.make("scratch-v0", human={"redraw_every": 2})
    batch = batch_of(staying)
    _, state = batch.reset({}, jax.random.split(jax.random.key(0), 2))
    with pytest.raises(assistax.UsageError, match="stays over automatic resets only"):
        batch.step("disabled", {}, state, {agent: jnp.zeros((2, n)) for agent, n in staying.action_sizes.items()})


@pytest.mark.parametrize(
    ("agent", "who", "words"),
    [
        ("human", "stil", "Did you mean 'still'"),
        ("human", "expert", "Unknown human's policy"),
        ("humman", "still", "Did you mean 'human'"),
        ("human", "nowhere.safetensors", "nowhere.safetensors"),
        ("robot", Player.of(Counting(), jnp.float32(0.1)), "must act with 7 numbers"),
        ("human", Player(Counting(), jnp.zeros(3), members=2), "must be stacked"),
        ("human", Player.of(Counting(), {"w": jnp.zeros(3)}), "cannot act on the 44 numbers"),
    ],
)
def test_a_partner_that_does_not_fit_is_refused_in_one_line(env, agent, who, words):
    with pytest.raises(assistax.UsageError, match=words) as error:
        find_player(who, env, agent)
    assert "\n" not in str(error.value)


# -- Gymnasium -------------------------------------------------------------------------------------


def test_every_task_is_registered():
    assert {f"assistax/{task}" for task in assistax.TASKS} == {name for name in gym.registry if "assistax" in name}


def test_a_task_is_made_without_an_import():
    code = "import gymnasium; print(gymnasium.make('assistax.adapters.gymnasium:assistax/scratch-v3'))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "AgentEnv<assistax/scratch-v3>" in done.stdout, done.stderr


@pytest.mark.parametrize("agent", ["robot", "human"])
@pytest.mark.filterwarnings("ignore:.*infinity.*")  # joint speeds and forces have no bounds
def test_gymnasiums_checker(env, agent):
    one = gym.make("assistax/scratch-v3", agent=agent, **SETTINGS)
    check_env(one.unwrapped, skip_render_check=True)
    assert one.action_space == gym.spaces.Box(-1.0, 1.0, (env.action_sizes[agent],))


def test_an_episode_ends_at_the_time_limit_with_its_metrics(env):
    one = AgentEnv(env)
    one.reset(seed=0)
    steps = [one.step(actions(env, i)[0]) for i in range(LENGTH)]
    assert [truncated for *_, truncated, _ in steps] == [False] * (LENGTH - 1) + [True]
    assert not any(terminated for _, _, terminated, _, _ in steps)
    info = steps[-1][-1]
    assert info["metrics"]["length"] == LENGTH and info["is_success"] is False
    np.testing.assert_allclose(info["metrics"]["return"], sum(reward for _, reward, *_ in steps), rtol=1e-5)


def test_seeds_repeat_and_no_seed_goes_on(env):
    one = AgentEnv(env)
    first, again, on = (one.reset(seed=seed)[0] for seed in (3, 3, None))
    np.testing.assert_array_equal(first, again)
    assert (first != on).any()
    many = AgentVectorEnv(env, 2)
    np.testing.assert_array_equal(many.reset(seed=2)[0][1], first)
    np.testing.assert_array_equal(many.reset(seed=[3, None])[0][0], first)
    assert (many.reset()[0] != first).any()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_a_vector_environment_resets_as_gymnasiums_own(env, mode):
    """Up to and with the end of the first episodes all numbers agree; after that other episodes are drawn."""
    ours = AgentVectorEnv(env, 2, autoreset_mode=mode)
    theirs = gym.vector.SyncVectorEnv([lambda: AgentEnv(env)] * 2, autoreset_mode=ours.autoreset_mode)
    assert ours.observation_space == theirs.observation_space and ours.action_space == theirs.action_space
    assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"]
    np.testing.assert_array_equal(ours.reset(seed=0)[0], theirs.reset(seed=0)[0])
    ends = 0
    for i in range(2 * LENGTH + 2):
        (obs, *rest, info), (their_obs, *their_rest, their_info) = (e.step(actions(env, i)) for e in (ours, theirs))
        known = i < LENGTH - (mode == "SameStep")
        np.testing.assert_array_equal(obs, their_obs) if known else None
        for value, their_value in zip(rest[not known :], their_rest[not known :], strict=True):
            np.testing.assert_array_equal(value, their_value)
            assert value.dtype == their_value.dtype
        if not known and mode == "NextStep":
            assert (rest[0] == 0).tolist() == (their_rest[0] == 0).tolist()
        ended = (rest[1] | rest[2]).any()
        ends += ended
        if mode == "SameStep" and ended:
            assert (info["_final_obs"] == their_info["_final_obs"]).all()
            assert info["final_info"]["metrics"]["length"].tolist() == [LENGTH, LENGTH]
            for last, their_last in zip(info["final_obs"], their_info["final_obs"], strict=True):
                np.testing.assert_array_equal(last, their_last) if i < LENGTH else None
                assert (last != obs).any()
        masks = {name: mask for name, mask in info.items() if name.startswith("_")}
        for name in set(masks) | {name for name in their_info if name.startswith("_")}:
            if name != "_is_success":
                none = np.zeros(2, bool)
                np.testing.assert_array_equal(masks.get(name, none), their_info.get(name, none))
    assert ends == 2


def test_gymnasiums_wrappers_normalise_and_record(env):
    many = wrappers.RecordEpisodeStatistics(AgentVectorEnv(env, 2))
    many = wrappers.NormalizeReward(wrappers.NormalizeObservation(many))
    seen = [many.reset(seed=0)[0]]
    lengths = []
    for i in range(3 * LENGTH):
        obs, reward, *_, info = many.step(actions(env, i))
        assert np.isfinite(reward).all()
        seen.append(obs)
        if "episode" in info:
            lengths += info["episode"]["l"][info["_episode"]].tolist()
            metrics = info["metrics"]["return"]
            np.testing.assert_allclose(info["episode"]["r"], metrics, rtol=1e-5)
    assert lengths == [LENGTH] * 4
    assert np.abs(np.concatenate(seen)).mean() < 3


def test_without_automatic_resets_a_mask_says_who_begins_again(env):
    many = AgentVectorEnv(env, 2, autoreset_mode="Disabled")
    many.reset(seed=0)
    for i in range(LENGTH):
        obs, *_ = many.step(actions(env, i))
    with pytest.raises(assistax.UsageError, match="reset_mask"):
        many.step(actions(env, 0))
    fresh, _ = many.reset(options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(fresh[1], obs[1])
    assert (fresh[0] != obs[0]).any()
    many.reset(options={"reset_mask": np.array([False, True])})
    assert not many.step(actions(env, 0))[3].any()


def test_a_picture_of_what_it_is_at(env):
    one = AgentEnv(env, render_mode="rgb_array")
    one.reset(seed=0)
    before = one.render()
    for _ in range(LENGTH):
        one.step(np.ones(7, np.float32))
    after = one.render()
    one.close()
    assert before.shape == (480, 640, 3) and before.dtype == np.uint8 and before.std() > 10
    assert (before != after).any()


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda env: AgentEnv("scratc"), "Did you mean 'scratch'"),
        (lambda env: AgentEnv(env, agent="arm"), "Unknown agent 'arm'"),
        (lambda env: AgentEnv(env, engine="mjx"), "has its own engine and settings"),
        (lambda env: AgentEnv(env, render_mode="human"), "Unknown render_mode 'human'"),
        (lambda env: AgentEnv(env).step(np.zeros(7)), "Call reset before step"),
        (lambda env: AgentVectorEnv(env, 0), "num_envs must be 1 or more"),
        (lambda env: AgentVectorEnv(env, 2, autoreset_mode="Never"), "Unknown autoreset_mode 'Never'"),
        (lambda env: AgentVectorEnv(env, 2).reset(seed=[1]), "need as many seeds"),
    ],
)
def test_what_gymnasium_cannot_have_is_refused_in_one_line(env, call, words):
    with pytest.raises(assistax.UsageError, match=words) as error:
        call(env)
    assert "\n" not in str(error.value)


def test_an_action_that_cannot_be_is_refused(env):
    one = AgentEnv(env)
    one.reset(seed=0)
    with pytest.raises(assistax.UsageError, match=r"must have the shape \(7,\), not \(3,\)"):
        one.step(np.zeros(3))
    with pytest.raises(assistax.UsageError, match="not finite"):
        one.step(np.full(7, np.nan))


# -- PettingZoo ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def both(env):
    return pytest.importorskip("assistax.adapters.pettingzoo", exc_type=assistax.UsageError).parallel_env(env)


def test_pettingzoos_checker(env, both):
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    parallel_api_test(both, num_cycles=2 * LENGTH)
    parallel_seed_test(lambda: type(both)(env), num_cycles=LENGTH)


def test_both_agents_get_what_the_environment_gives(env, both):
    obs, _ = both.reset(seed=0)
    np.testing.assert_array_equal(obs["robot"], AgentEnv(env).reset(seed=0)[0])
    state, step = both._state.env, jax.jit(jax.vmap(env.step_env))
    for i in range(LENGTH):
        acts = {a: both.action_space(a).sample() for a in both.agents}
        expected, state, rewards, *_ = step(
            jax.random.split(jax.random.key(0), 1), state, {a: x[None] for a, x in acts.items()}
        )
        obs, reward, _, truncated, info = both.step(acts)
        for agent in env.agents:
            np.testing.assert_allclose(obs[agent], expected[agent][0], atol=1e-5)
            np.testing.assert_allclose(reward[agent], rewards[agent][0], atol=1e-6)
            assert truncated[agent] == (i == LENGTH - 1)
        np.testing.assert_allclose(both.state(), jax.vmap(env.global_obs)(state)[0], atol=1e-5)
        assert both.state_space.contains(both.state())
    assert info["human"]["metrics"]["length"] == LENGTH and both.agents == []


def test_what_pettingzoo_cannot_have_is_refused_in_one_line(both):
    both.reset(seed=0)
    with pytest.raises(assistax.UsageError, match="no action of the human"):
        both.step({"robot": np.zeros(7)})
    with pytest.raises(assistax.UsageError, match=r"The human's action must have the shape \(3,\)"):
        both.step({"robot": np.zeros(7), "human": np.zeros(7)})
    with pytest.raises(assistax.UsageError, match="Unknown agent 'arm'"):
        both.action_space("arm")


# -- JaxMARL ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("same_sizes", [True, False])
def test_jaxmarls_interface(env, same_sizes):
    """As its ippo_ff_mabrax.py uses it: one network for all agents, rollouts in a scan, steps under vmap."""
    from assistax.adapters.jaxmarl import MultiAgent

    marl = MultiAgent(env, same_sizes=same_sizes)
    spaces = {agent: (marl.observation_space(agent), marl.action_space(agent)) for agent in marl.agents}
    assert marl.num_agents == 2 and [list(classes) for classes in marl.agent_classes.values()] == [["robot"], ["human"]]
    if same_sizes:
        assert spaces["robot"] == spaces["human"] and spaces["robot"][1].shape == (7,)

    def sample(key):
        return {agent: action.sample(key) for agent, (_, action) in spaces.items()}

    @jax.jit
    def rollout(key):
        obs, state = jax.vmap(marl.reset)(jax.random.split(key, 2))

        def step(carry, key):
            acts = jax.vmap(sample)(jax.random.split(key, 2))
            obs, state, reward, done, info = jax.vmap(marl.step)(jax.random.split(key, 2), carry[1], acts)
            return (obs, state), (carry, acts, reward, done, info)

        return jax.lax.scan(step, (obs, state), jax.random.split(key, 2 * LENGTH))[1]

    ((obs, states), acts, reward, done, info) = rollout(jax.random.key(0))
    assert set(done) == set(reward) == {"robot", "human", "__all__"}
    ends = np.arange(1, 2 * LENGTH + 1) % LENGTH == 0
    np.testing.assert_array_equal(done["robot"], np.stack([ends, ends], 1))
    np.testing.assert_array_equal(info["truncated"], done["__all__"])
    first = jax.tree.map(lambda x: x[0], states)
    cut = {agent: acts[agent][0, :, : env.action_sizes[agent]] for agent in env.agents}
    expected, _, rewards, *_ = jax.jit(jax.vmap(env.step_env))(jax.random.split(jax.random.key(0), 2), first, cut)
    np.testing.assert_allclose(reward["__all__"][0], rewards["robot"], atol=1e-6)
    for i, agent in enumerate(env.agents):
        own = obs[agent][1]
        assert own.shape[1:] == spaces[agent][0].shape
        size = env.observation_sizes[agent]
        np.testing.assert_allclose(own[:, :size], expected[agent], atol=1e-5)
        if same_sizes:
            np.testing.assert_array_equal(own[:, -2:], np.broadcast_to(np.eye(2)[i], (2, 2)))
            assert not np.asarray(own[:, size:-2]).any()
        assert marl.get_avail_actions(first)[agent].shape == spaces[agent][1].shape
    np.testing.assert_array_equal(jax.vmap(marl.get_obs)(first)["human"], obs["human"][0])


# -- all of them -----------------------------------------------------------------------------------


@pytest.mark.parametrize("package", ["gymnasium", "pettingzoo", "brax", "torch", "torchrl", "benchmarl"])
def test_a_package_that_is_missing_is_named_with_its_extra(package, monkeypatch):
    for module in {package, *(name for name in sys.modules if name.startswith(f"{package}."))}:
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.delitem(sys.modules, f"assistax.adapters.{package}", raising=False)
    with pytest.raises(assistax.UsageError, match=rf"pip install 'assistax\[{package}\]'") as error:
        __import__(f"assistax.adapters.{package}")
    assert "\n" not in str(error.value)
