"""Cross-play: every cell is its own pair, in the person's environment."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import pytest
from stored import small, stored_run

import assistax
from assistax.cli.crossplay import _entrants
from assistax.errors import UsageError
from assistax.evaluation.playing import Evaluator, summarize
from assistax.learning.actors import Actor
from assistax.policies import Player, scripted_policy, scripted_team
from assistax.teamwork import crossplay
from assistax.teamwork.crossplay import Entrant, cross_play, picture, table

EPISODES = 3


def entrant(name, env):
    return Entrant(name, env, scripted_team(name, env))


@dataclass(frozen=True)
class Steady:
    """Does the same at every step; its parameters are the action."""

    def initial_carry(self):
        return ()

    def act(self, params, carry, obs, reset, key):
        return params, carry


def test_rows_are_robots_and_columns_persons_with_their_bodies(scratch):
    """Against pairs put together by hand."""
    envs = (scratch, assistax.make("scratch-v0", engine="mujoco", episode_length=20, human={"disability": "tremor"}))
    does = [{agent: jnp.full(n, much) for agent, n in scratch.action_sizes.items()} for much in (0.7, -0.5)]
    teams = [{agent: Player.of(Steady(), params[agent]) for agent in params} for params in does]
    entrants = [Entrant(*one) for one in zip(("up", "down"), envs, teams, strict=True)]
    report = cross_play(entrants, EPISODES)
    assert report["robots"] == report["persons"] == ["up", "down"] and report["task"] == "scratch-v0"
    for j, env in enumerate(envs):
        evaluator = Evaluator(env, EPISODES)
        for i in range(2):
            wanted = summarize(evaluator({"robot": teams[i]["robot"], "human": teams[j]["human"]}))
            np.testing.assert_allclose(report["return"][i][j], wanted["mean_return"], rtol=1e-5)
            np.testing.assert_allclose(report["force_in_contact"][i][j], wanted["force"]["mean_in_contact"], rtol=1e-4)
            assert report["success"][i][j] == wanted["success_rate"]
    (a, b), (c, d) = report["return"]
    assert len({a, b, c, d}) == 4  # else rows and columns could not be told apart
    np.testing.assert_allclose(report["self_play"]["return"], (a + d) / 2)
    np.testing.assert_allclose(report["cross_play"]["return"], (b + c) / 2)


def test_a_player_of_several_teams_counts_once(scratch, monkeypatch):
    """The still person of "still" and "expert"; what a pair comes to is told by who plays."""

    class Told:
        def __init__(self, env, episodes): ...
        def __call__(self, team, seed, people):
            return 10 * team["robot"].members + team["human"].members

    def summary(value):
        return {"mean_return": float(value), "success_rate": 0.0, "force": {"mean_in_contact": 0.0}}

    monkeypatch.setattr(crossplay, "Evaluator", Told)
    monkeypatch.setattr(crossplay, "summarize", summary)
    policy = scripted_policy("still", scratch, "human")
    teams = {name: {"robot": Player(policy, (), i), "human": Player(policy, (), i)} for i, name in enumerate("abc", 1)}
    entrants = [
        Entrant("a", scratch, teams["a"]),
        Entrant("still", scratch, teams["b"], {"human": "nobody"}),
        Entrant("expert", scratch, teams["c"] | {"human": teams["b"]["human"]}, {"human": "nobody"}),
    ]
    report = cross_play(entrants)
    assert report["robots"] == ["a", "still", "expert"] and report["persons"] == ["a", "nobody"]
    assert report["return"] == [[11, 12], [21, 22], [31, 32]]
    assert report["self_play"]["return"] == (11 + 22 + 32) / 3 and report["cross_play"]["return"] == (12 + 21 + 31) / 3
    head, cells = table(report)
    assert head == ["robot of / person of", "a", "nobody"] and cells[2][0] == "expert"
    with pytest.raises(UsageError, match="a is there twice"):
        cross_play([entrants[0], entrants[0]])


def test_what_cannot_meet_is_one_line(scratch):
    still = entrant("still", scratch)
    with pytest.raises(UsageError, match="two teams"):
        cross_play([still])
    for settings, words in [
        ({"task": "feeding-v0"}, "task is scratch-v0 in still and feeding-v0 in expert"),
        ({"torque_scale": 0.5}, "env.torque_scale is 0.3 in still and 0.5 in expert"),
        ({"success_seconds": 1.0}, "task_config.success_seconds is 2.0 in still and 1.0 in expert"),
    ]:
        other = assistax.make(**{"task": "scratch-v0", "engine": "mujoco", "episode_length": 20} | settings)
        with pytest.raises(UsageError, match=words):
            cross_play([still, entrant("expert", other)])
    wishing = assistax.make("scratch-v0", engine="mujoco", episode_length=20, human={"preference": "sweep"})
    learned = Entrant("learned", scratch, scratch_team(scratch))
    with pytest.raises(UsageError, match="The robot of learned observes"):
        cross_play([learned, entrant("still", wishing)])


def scratch_team(env):
    params = {"actor": np.zeros(3), "normalizer": np.zeros(3)}
    return {agent: Player.of(Actor(), params) for agent in env.agents}


def test_the_picture_has_a_cell_per_pair():
    report = {"task": "scratch", "teams": ["a", "b"], "return": [[40.0, 1.0], [2.0, 30.0]]}
    axes = picture(report).axes[0]
    assert [text.get_text() for text in axes.texts] == ["40", "1", "2", "30"]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a", "b"]
    np.testing.assert_array_equal(axes.images[0].get_array(), report["return"])


def test_the_table_names_rows_and_numbers_columns():
    report = {"teams": ["a", "b"], "return": [[40.0, 1.0], [2.0, 30.0]], "success": [[1.0, 0.0], [0.5, 0.25]]}
    report |= {"self_play": {"return": 35.0, "success": 0.625}, "cross_play": {"return": 1.5, "success": 0.25}}
    head, cells = table(report)
    assert head[1:] == ["1", "2"]
    assert cells[:2] == [["1 a", "40 (100%)", "1 (0%)"], ["2 b", "2 (50%)", "30 (25%)"]]
    assert [row[1] for row in cells[2:]] == ["35 (62%)", "2 (25%)"] and {len(row) for row in cells} == {3}


def test_names_that_somebody_else_has_are_told_by_their_folder(tmp_path):
    places = [tmp_path / "one" / "team", tmp_path / "other" / "team", tmp_path / "expert"]
    for place in places:
        stored_run(place, small("scratch-v0"))
    found, _ = _entrants((*map(str, places), "expert"), None, (), ())
    assert [one.name for one in found] == [*map(str, places), "expert"]
