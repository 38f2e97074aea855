"""Evaluations: the same numbers however many episodes are played at once, in memory that does not grow with them."""

import dataclasses
import tracemalloc
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stored import small, train_without_pictures

import assistax
from assistax.errors import SimulationError, UsageError
from assistax.evaluation import playing
from assistax.evaluation.distribution import Distribution
from assistax.evaluation.playing import play, summarize, typical
from assistax.evaluation.statistics import bootstrap_ci
from assistax.physics.engine import OVERFLOW
from assistax.policies import Player, Still, scripted_team
from assistax.training.run import Run


@dataclass(frozen=True)
class Wrong:
    """Acts for a body of another size, or forgets to return what it remembers."""

    numbers: int
    remembers: bool = True

    def initial_carry(self):
        return jnp.zeros(2)

    def act(self, params, carry, obs, reset, key):
        action = jnp.tanh(params[: self.numbers] @ obs)
        return (action, carry[:1]) if self.remembers else action


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda team: {"robot": team["robot"]}, "a player for robot and human, not robot"),
        (lambda team: list(team.values()), "a player for robot and human, not list"),
        (lambda team: team | {"human": Still(3)}, "plays the human must be a Player"),
        (lambda team: team | {"robot": Player(Still(3))}, "robot must act with 7 numbers, not with the shape"),
        (lambda team: team | {"robot": Player.of(Wrong(7), jnp.zeros((7, 41)))}, "robot cannot act on the 34 numbers"),
        (lambda team: team | {"robot": Player.of(Wrong(7), jnp.zeros((7, 34)))}, "carry of the same shapes"),
        (lambda team: team | {"robot": Player.of(Wrong(7, False), jnp.zeros((7, 34)))}, "robot cannot act on"),
    ],
)
def test_a_team_that_cannot_play_is_one_line(scratch, change, words):
    with pytest.raises(UsageError, match=words) as error:
        play(scratch, change(scripted_team("still", scratch)), 1)
    assert "\n" not in str(error.value)


def test_episodes_played_in_turns_are_those_played_at_once(scratch, monkeypatch):
    team = scripted_team("random", scratch)
    whole = play(scratch, team, 5)
    monkeypatch.setattr(playing, "MOST_AT_ONCE", 2)
    turns = play(scratch, team, 5)
    for name in ("metrics", "terms", "person"):
        jax.tree.map(np.testing.assert_array_equal, turns[name], whole[name])
    assert summarize(turns) == summarize(whole)
    first = play(scratch, team, 2)["filmed"]  # of the first turn only
    np.testing.assert_array_equal(turns["filmed"].qpos, first.qpos)


def test_the_filmed_episode_tells_what_was_so_far(scratch):
    result = play(scratch, scripted_team("random", scratch), 5)
    filmed, episode = result["filmed"], typical(result["metrics"]["return"], 5)
    assert filmed.qpos.shape == (20, scratch.model.nq) and filmed.marker.shape == filmed.force.shape == (20, 3)
    for name, values in result["metrics"].items():
        assert filmed.metrics[name].shape == (20,) and filmed.metrics[name][-1] == values[episode]
    peaks = np.maximum.accumulate(np.linalg.norm(filmed.force, axis=1))
    np.testing.assert_allclose(filmed.metrics["peak_force"], peaks, rtol=1e-6)
    assert filmed.metrics["length"].tolist() == list(range(1, 21)) and not filmed.spots
    arrays = [filmed.qpos, filmed.marker, filmed.force, *filmed.metrics.values()]
    assert all(x.base is None for x in arrays)  # the other episodes are not kept along with it


def test_the_film_shows_the_median_or_what_is_nearest_to_it():
    returns = np.array([5.0, 1.0, 4.0, 3.0, 2.0])
    assert typical(returns, 5) == 3
    assert typical(returns, 3) == 2


def test_the_distribution_of_forces_is_numpys():
    rng = np.random.default_rng(0)
    parts = [np.where(rng.random(n) < 0.3, rng.gamma(1.0, 8.0, n), 0.0).astype(np.float32) for n in (1, 999, 5000)]
    force, all_of_it = Distribution(), np.concatenate(parts).astype(np.float64)
    for part in parts:
        force.add(part)
    assert force.mean == pytest.approx(all_of_it.mean(), rel=1e-12) and force.peak == all_of_it.max()
    assert force.mean_positive == pytest.approx(all_of_it[all_of_it > 0].mean(), rel=1e-12)
    for q in (0.5, 0.8, 0.95, 0.99):
        assert force.quantile(q) == pytest.approx(np.quantile(all_of_it, q), rel=2.5e-4, abs=1e-30)
    assert Distribution().mean == Distribution().mean_positive == 0.0
    one = Distribution()
    one.add(np.float32([7.0]))
    assert one.quantile(0.95) == pytest.approx(7.0, rel=2.5e-4)


def test_the_bootstrap_is_the_plain_one_in_flat_memory():
    values = np.random.default_rng(1).normal(size=1500)
    ids = np.random.default_rng(0).integers(1500, size=(2000, 1500))
    assert bootstrap_ci(values, 2000) == tuple(np.percentile(values[ids].mean(1), [2.5, 97.5]))
    tracemalloc.start()
    bootstrap_ci(np.ones(100_000), 100)
    assert tracemalloc.get_traced_memory()[1] < 40e6  # at once 160 MB
    tracemalloc.stop()


def test_what_follows_an_early_end_does_not_count(monkeypatch):
    env = assistax.make("scratch-v0", engine="mujoco", episode_length=20)

    def later(sensors, state):
        return dataclasses.replace(state, scratch_seconds=state.scratch_seconds + 1.0)

    monkeypatch.setattr(env.task, "advance", later)
    monkeypatch.setattr(env.task, "terminated", lambda state: state.scratch_seconds >= 7.0)
    result = play(env, scripted_team("random", env), 3)
    assert result["metrics"]["length"].tolist() == [7] * 3 and len(result["filmed"].qpos) == 7
    np.testing.assert_allclose(result["metrics"]["return"], sum(result["terms"].values()), rtol=1e-5)
    assert result["force"]._counts.sum() == 21


def test_lost_contacts_stop_an_evaluation_and_a_training(tmp_path, monkeypatch):
    def overflowing(env):
        step = env.engine.step
        lost = lambda state, ctrl: dataclasses.replace(step(state, ctrl), fault=jnp.int32(OVERFLOW))  # noqa: E731
        monkeypatch.setattr(env.engine, "step", lost)
        return env

    env = overflowing(assistax.make("scratch-v0", engine="mujoco", episode_length=3))
    with pytest.raises(SimulationError, match="memory"):
        play(env, scripted_team("still", env), 2)
    run = Run.create(small(steps=64), tmp_path / "run")
    overflowing(run.env)
    with pytest.raises(SimulationError, match="memory"):
        train_without_pictures(run)
