"""Runs from Python: what is asked for is what is trained, and a run survives what happens to it."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
from safetensors.numpy import load_file
from stored import SMALL, store_checkpoint, train_without_pictures

from assistax.cli.export import export
from assistax.errors import UsageError
from assistax.files import write_json
from assistax.training import journal, loop, pieces
from assistax.training.checkpoint import read_metadata
from assistax.training.configuration import configure
from assistax.training.loop import train
from assistax.training.partners import find_partner
from assistax.training.run import Run
from assistax.training.team_file import load_team, read_measured, save_team


def small(algorithm="ippo", **choices):
    return configure("scratch", SMALL, algorithm=algorithm, num_envs=8, **choices)


def test_algorithm_and_switches_choose_trainer_and_row():
    plain, ours = configure("bed_bath", {}, preset="paper"), configure("bed_bath", {})
    central = configure("bed_bath", {}, algorithm="mappo", recurrent=True, preset="paper")
    assert (plain.num_envs, ours.num_envs, ours.method.gamma) == (1024, 256, 0.995)
    assert not plain.method.central_critic and not plain.method.recurrent and plain.method.clip_eps == 0.042
    assert central.method.central_critic and central.method.recurrent and central.method.clip_eps == 0.068
    assert configure("bed_bath", {"ppo.recurrent": True}, preset="paper").method.clip_eps == 0.066
    assert configure("scratch", {}, algorithm="mappo", recurrent=True).method.gamma == 0.995
    assert configure("scratch", {}, share_parameters=True).method.share_parameters
    joint, own = (configure("scratch", {}, algorithm=a, preset="paper") for a in ("masac", "isac"))
    assert joint.method.joint_critics and not own.method.joint_critics and joint.num_envs == 256
    assert joint.method.actor_learning_rate == 5.62e-5
    assert configure("feeding", {}, algorithm="isac").method.tau == 0.02


@pytest.mark.parametrize(
    ("settings", "choices", "words"),
    [
        ({}, {"algorithm": "mapo"}, "Did you mean 'mappo'"),
        ({"sac.tau": 0.1}, {}, "sac.tau does not exist for ippo; its settings are ppo.*"),
        ({"ppo.gamma": 0.9}, {"algorithm": "isac"}, "ppo.gamma does not exist for isac"),
        ({"ppo.central_critic": True}, {}, "ppo.central_critic is False for ippo; change --algorithm"),
        ({"ppo.hidden": ()}, {"recurrent": True}, "ppo.hidden"),
        ({"sac.taus": 1}, {"algorithm": "masac"}, "Did you mean 'sac.tau'"),
        ({}, {"algorithm": "masac", "recurrent": True}, "--recurrent does not exist for masac"),
        ({}, {"algorithm": "masac", "share_parameters": True}, "--share-parameters does not exist for masac"),
    ],
)
def test_what_an_algorithm_does_not_have_is_refused(settings, choices, words):
    with pytest.raises(UsageError) as error:
        configure("scratch", settings, **choices)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_a_checkpoint_of_something_else_is_refused_and_kept(tmp_path):
    run = Run.create(small(), tmp_path / "run")
    path = store_checkpoint(run, 0)
    before = path.read_bytes()
    config = json.loads((run.folder / "config.json").read_text())
    assert "sac" not in config and config["ppo"]["hidden"] == [8, 8]
    ppo = config["ppo"]
    for change in (
        {"algorithm": "mappo", "ppo": ppo | {"central_critic": True}},
        {"task": "feeding"},
        {"ppo": ppo | {"recurrent": True}},
        {"ppo": ppo | {"hidden": [8, 16]}},
        {"num_envs": 16},
    ):
        (run.folder / "config.json").write_text(json.dumps(config | change))
        if "task" in change:
            stored = config | change
            stored.pop("task_config")
            (run.folder / "config.json").write_text(json.dumps(stored))
        with pytest.raises(UsageError, match=path.name):
            train(Run.open(run.folder))
        assert path.read_bytes() == before and not list(run.folder.glob("*.part"))


def test_a_result_without_checkpoints_is_not_overwritten(tmp_path):
    run = Run.create(small(), tmp_path / "run")
    (run.folder / "checkpoints").rmdir()  # as in results/
    (run.folder / "evaluations.jsonl").write_text('{"steps": 64}\n')
    files = {path: path.read_bytes() for path in run.folder.iterdir()}
    again = Run.open(run.folder, steps=10**6)
    for use in (lambda: train(again), again.teams):
        with pytest.raises(UsageError, match="checkpoint"):
            use()
    assert {path: path.read_bytes() for path in run.folder.iterdir()} == files


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    """A finished run of two seeds, five iterations, four evaluations of three episodes."""
    settings = SMALL | {"evaluations": 4, "evaluation_episodes": 3}
    config = configure("scratch", settings, num_envs=8, steps=5 * 64, num_seeds=2)
    run = Run.create(config, tmp_path_factory.mktemp("runs") / "evaluated")
    return run, train_without_pictures(run)


def test_evaluations_are_even_and_whole_and_the_last_is_the_summary(evaluated):
    run, summary = evaluated
    rows = journal.read(run.folder, "evaluations")
    assert [(row["steps"], row["seed"]) for row in rows] == [(64 * i, seed) for i in (1, 2, 3, 5) for seed in (0, 1)]
    assert {len(values) for row in rows for part in ("episodes", "terms") for values in row[part].values()} == {3}
    for row, one in zip(rows[-2:], summary["evaluation"], strict=True):
        assert np.mean(row["episodes"]["return"]) == pytest.approx(one["mean_return"], abs=1e-3)
        for term, total in one["terms"].items():
            assert np.mean(row["terms"][term]) == pytest.approx(total, abs=1e-3)


def test_a_team_file_plays_as_its_run(evaluated, tmp_path):
    run, _ = evaluated
    save_team(tmp_path / "team.safetensors", run.teams()[1], run.config)
    env, team = load_team(tmp_path / "team.safetensors", {"env.episode_length": 4})
    assert env.config.episode_length == 4
    obs = {agent: jax.random.normal(jax.random.key(1), (env.observation_sizes[agent],)) for agent in env.agents}
    for agent, player in run.teams()[1].items():
        yes = np.bool_(True)
        actions = [
            one.policy.act(one.member(0), one.policy.initial_carry(), obs[agent], yes, jax.random.key(0))[0]
            for one in (player, team[agent])
        ]
        np.testing.assert_allclose(*actions, rtol=0.02, atol=1e-4)  # weights in half precision
        assert np.abs(actions[0]).max() > 1e-3
    with pytest.raises(UsageError, match="is a checkpoint, not a team"):
        load_team(run.newest_checkpoint())


def test_a_result_without_checkpoints_plays_and_is_no_run_to_go_on_with(evaluated, tmp_path):
    """Both seeds, each with its own weights, in half precision."""
    run, summary = evaluated
    folder = tmp_path / "result"
    folder.mkdir()
    for name in ("config.json", "summary.json", "policies.safetensors"):
        shutil.copy(run.folder / name, folder)
    result = Run.open(str(folder))
    assert result.measured(1)["mean_return"] == summary["evaluation"][1]["mean_return"]
    for mine, theirs in zip(result.teams(), run.teams(), strict=True):
        for agent, player in mine.items():
            pairs = zip(jax.tree.leaves(player.params), jax.tree.leaves(theirs[agent].params), strict=True)
            assert all(np.array_equal(a, np.asarray(b, np.float16)) for a, b in pairs if a.ndim > 2)
    first, second = (jax.tree.leaves(team["human"].params)[0] for team in result.teams())
    assert not np.array_equal(first, second)
    with pytest.raises(UsageError, match="without checkpoints, which cannot continue"):
        train(result)


def test_a_team_file_says_what_the_team_reached(evaluated, tmp_path):
    run, summary = evaluated
    path = tmp_path / "team.safetensors"
    export(run.folder, out=path, seed=1)
    measured = read_measured(path)
    assert measured["mean_return"] == summary["evaluation"][1]["mean_return"] != summary["evaluation"][0]["mean_return"]
    assert measured["steps"] == summary["steps"] and measured["commit"] == summary["commit"]
    save_team(path, run.teams()[1], run.config)
    assert read_measured(path) is None


def test_a_team_file_does_not_say_what_an_earlier_team_of_a_prolonged_run_reached(evaluated, tmp_path):
    run, summary = evaluated
    folder = shutil.copytree(run.folder, tmp_path / "prolonged")
    write_json(folder / "summary.json", summary | {"steps": summary["steps"] - run.steps_per_iteration})
    export(folder, out=tmp_path / "team.safetensors")
    assert read_measured(tmp_path / "team.safetensors") is None


def test_a_partner_comes_from_a_run(evaluated, tmp_path):
    run, _ = evaluated
    partner = find_partner(str(run.folder), run.env, "human").player
    assert partner.members == 2 and not partner.policy.deterministic  # acts as it was trained
    new = Run.create(small(partners=(f"human={run.folder}",), steps=64), tmp_path / "new")
    assert train_without_pictures(new) and new.trainer.learners == ("robot",)
    team = new.teams()[0]
    assert team["robot"].policy.deterministic and team["human"].members == 2
    for mine, theirs in zip(jax.tree.leaves(team["human"].params), jax.tree.leaves(partner.params), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    with pytest.raises(UsageError, match="the human did not learn"):
        save_team(tmp_path / "team.safetensors", new.teams()[0], new.config)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("dog=still", "Unknown agent 'dog'"),
        ("human", "AGENT=WHO"),
        ("human=expert", "Known: still, random, offer, offer_slowly, withdraw. Or name a habit, a run folder"),
        ("human=still,robot=still", "leave one to learn"),
    ],
)
def test_an_impossible_partner_is_refused(text, words):
    with pytest.raises(UsageError, match=words) as error:
        Run(Path("nowhere"), small(partners=tuple(text.split(","))))
    assert "\n" not in str(error.value)


# -- killed ----------------------------------------------------------------------------------------

ITERATIONS = 12


@pytest.fixture
def recurrent(monkeypatch):
    """The configuration of a run with memory, while runs save as often as they can."""
    monkeypatch.setattr(loop, "CHECKPOINT_SECONDS", 0.0)
    settings = SMALL | {"evaluations": 4, "evaluation_episodes": 3}
    return configure("scratch", settings, recurrent=True, num_envs=8, steps=64 * ITERATIONS)


def check_resumed(killed, alone):
    """That a run which was killed and resumed ended with the very numbers of one left alone."""
    ends = [load_file(Run.open(folder).newest_checkpoint()) for folder in (killed, alone)]
    assert ends[0].keys() == ends[1].keys() and any("gru" in name for name in ends[0])
    for name in ends[0]:
        np.testing.assert_array_equal(ends[0][name], ends[1][name], err_msg=name)
    rows = [[r["episode"]["return"] for r in journal.read(f, "metrics")] for f in (killed, alone)]
    assert len(rows[0]) == ITERATIONS and rows[0] == rows[1]
    evaluations = [journal.read(f, "evaluations") for f in (killed, alone)]
    assert len(evaluations[0]) == 4 and evaluations[0] == evaluations[1]


def test_a_run_goes_on_from_whatever_a_kill_leaves(recurrent, tmp_path, monkeypatch):
    """From the files as they were between an iteration's rows and its checkpoint; below, a process is killed."""
    alone, killed = tmp_path / "alone", tmp_path / "killed"
    save, moment = loop._Training._save, random.randrange(1, ITERATIONS)

    def copy_and_save(training, state, done):
        if done == moment:
            shutil.copytree(alone, killed)
        save(training, state, done)

    monkeypatch.setattr(loop._Training, "_save", copy_and_save)
    Run.create(recurrent, alone)
    assert train_without_pictures(Run.open(alone))
    with open(killed / "metrics.jsonl", "a") as file:
        file.write('{"steps": 999')  # a line that was torn
    (killed / "checkpoints" / "step_000000000001.safetensors.part").write_bytes(b"torn")
    assert Run.open(killed).newest_checkpoint().stem == f"step_{64 * (moment - 1):012d}"
    assert len(journal.read(killed, "metrics")) == moment
    monkeypatch.undo()
    assert train_without_pictures(Run.open(killed))
    check_resumed(killed, alone)
    spent = json.loads((alone / "summary.json").read_text())["seconds"]
    assert set(spent) == {"physics", "policy", "update", "evaluation"} and min(spent.values()) >= 0


TRAIN = """
import sys
from pathlib import Path
from assistax.training import loop, pieces

loop.CHECKPOINT_SECONDS, pieces.PIECE = 0.0, 4096
loop.train(loop.Run.open(Path(sys.argv[1])))
"""


SAC_SMALL = {"sac.num_steps": 8, "sac.updates": 2, "sac.batch_size": 16, "sac.buffer_size": 640, "sac.hidden": (8, 8)}
SAC_SMALL |= {"sac.warmup": 128, "env.episode_length": 16, "evaluations": 4, "evaluation_episodes": 3}


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ippo", "masac"])
def test_kill_9_loses_at_most_the_work_since_the_last_checkpoint(algorithm, recurrent, tmp_path, monkeypatch):
    """Killed at a random moment and resumed, a run ends with the very numbers of one left alone."""
    monkeypatch.setattr(pieces, "PIECE", 4096)
    config = recurrent
    if algorithm == "masac":
        config = configure("scratch", SAC_SMALL, algorithm=algorithm, num_envs=8, steps=64 * ITERATIONS)
    killed, alone = tmp_path / "killed", tmp_path / "alone"
    for folder in (killed, alone):
        Run.create(config, folder)
    process = subprocess.Popen([sys.executable, "-c", TRAIN, killed], stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 200
    while not journal.read(killed, "metrics"):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.01)
    time.sleep(random.random() * 0.1)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    done = journal.read(killed, "metrics")[-1]["steps"]
    saved = int(Run.open(killed).newest_checkpoint().stem.split("_")[1])
    assert saved <= done < 64 * ITERATIONS
    for folder in (killed, alone):
        assert train(Run.open(folder))
    if algorithm == "ippo":
        check_resumed(killed, alone)
        return
    lists = [read_metadata(Run.open(folder).newest_checkpoint())["pieces"] for folder in (killed, alone)]
    assert lists[0] == lists[1] and lists[0]  # by the hashes of their content
