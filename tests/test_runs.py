"""Runs from Python: what is asked for is what is trained, and a run survives what happens to it."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
from safetensors.numpy import load_file

from assistax.errors import UsageError
from assistax.runs import Run, configure, find_partner

SMALL = {"ppo.num_steps": 8, "ppo.num_minibatches": 2, "ppo.update_epochs": 1, "ppo.hidden": (8, 8)}
SMALL |= {"env.episode_length": 16}


def small(algorithm="ippo", **choices):
    return configure("scratch", SMALL, algorithm=algorithm, num_envs=8, **choices)


def test_algorithm_and_switches_choose_trainer_and_row():
    plain, central = configure("bed_bath", {}), configure("bed_bath", {}, algorithm="mappo", recurrent=True)
    assert not plain.ppo.central_critic and not plain.ppo.recurrent and plain.ppo.clip_eps == 0.042
    assert central.ppo.central_critic and central.ppo.recurrent and central.ppo.clip_eps == 0.068
    assert configure("bed_bath", {"ppo.recurrent": True}).ppo.clip_eps == 0.066
    assert configure("scratch", {}, share_parameters=True).ppo.share_parameters
    joint, own = (configure("scratch", {}, algorithm=a) for a in ("masac", "isac"))
    assert joint.sac.joint_critics and not own.sac.joint_critics and joint.num_envs == 256
    assert joint.sac.actor_learning_rate == 5.62e-5


@pytest.mark.parametrize(
    ("settings", "choices", "words"),
    [
        ({}, {"algorithm": "mapo"}, "Did you mean 'mappo'"),
        ({"sac.tau": 0.1}, {}, "sac.tau does not exist for ippo; its settings are ppo.*"),
        ({"ppo.gamma": 0.9}, {"algorithm": "isac"}, "ppo.gamma does not exist for isac"),
        ({"ppo.central_critic": True}, {}, "ppo.central_critic is False for ippo; change --algorithm"),
        ({"ppo.hidden": ()}, {"recurrent": True}, "ppo.hidden"),
        ({"sac.taus": 1}, {"algorithm": "masac"}, "Did you mean 'sac.tau'"),
        ({}, {"algorithm": "masac", "recurrent": True}, "--recurrent and --share-parameters exist for ippo and mappo"),
        ({}, {"algorithm": "masac", "share_parameters": True}, "exist for ippo and mappo only"),
    ],
)
def test_what_an_algorithm_does_not_have_is_refused(settings, choices, words):
    with pytest.raises(UsageError) as error:
        configure("scratch", settings, **choices)
    assert words in str(error.value) and "\n" not in str(error.value)


def test_a_checkpoint_of_something_else_is_refused_and_kept(tmp_path):
    run = Run.create(small(), tmp_path / "run")
    run._save(run.seeds.init(run.trainer.init), 0, _no_clock())
    path = run.newest_checkpoint()
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
            Run.open(run.folder).train()
        assert path.read_bytes() == before and not list(run.folder.glob("*.part"))


def test_evaluations_are_even_and_whole_and_the_last_is_the_summary(tmp_path):
    """Four over five iterations: after 1, 2, 3 and 5; cut short after 3 and gone on with, the same numbers."""
    settings = SMALL | {"evaluations": 4, "evaluation_episodes": 3}
    choices = {"num_envs": 8, "steps": 5 * 64, "num_seeds": 2}
    whole = Run.create(configure("scratch", settings, **choices), tmp_path / "whole")
    summary = whole.train()
    rows = whole.rows("evaluations")
    assert [(row["steps"], row["seed"]) for row in rows] == [(64 * i, seed) for i in (1, 2, 3, 5) for seed in (0, 1)]
    assert {len(values) for row in rows for part in ("episodes", "terms") for values in row[part].values()} == {3}
    for row, one in zip(rows[-2:], summary["evaluation"], strict=True):
        assert np.mean(row["episodes"]["return"]) == pytest.approx(one["mean_return"], abs=1e-3)
        for term, total in one["terms"].items():
            assert np.mean(row["terms"][term]) == pytest.approx(total, abs=1e-3)

    Run.create(configure("scratch", settings, **choices | {"steps": 3 * 64}), tmp_path / "part").train()
    path = tmp_path / "part" / "evaluations.jsonl"
    path.write_text(path.read_text() + '{"steps": 2')  # torn
    Run.open(tmp_path / "part", steps=5 * 64).train()
    ends = [Run.open(tmp_path / name).rows("evaluations")[-2:] for name in ("whole", "part")]
    assert ends[0] == ends[1]


def test_a_partner_is_scripted_or_comes_from_a_run(tmp_path):
    first = Run.create(small(num_seeds=2, steps=64), tmp_path / "first")
    first.train()
    partner = find_partner(str(first.folder), first.env, "human")
    assert partner.members == 2 and not partner.policy.deterministic
    run = Run.create(small(partners=(f"human={first.folder}",), steps=64), tmp_path / "second")
    assert run.train() and set(run.trainer.learners) == {"robot"}
    team = run.teams()[0]
    assert team["robot"][0].deterministic and team["human"][0].members == 2
    for mine, theirs in zip(jax.tree.leaves(team["human"][1]), jax.tree.leaves(partner.params), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    still = Run.create(small(partners=("human=still",), steps=64), tmp_path / "third")
    still.train()
    assert still.rows("evaluations")[-1]["episodes"]["work_human"] == [0.0] * 64


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("dog=still", "Did you mean|robot"),
        ("human", "AGENT=WHO"),
        ("human=expert", "or a run folder"),
        ("human=still,robot=still", "."),
    ],
)
def test_an_impossible_partner_is_refused(text, words):
    with pytest.raises(UsageError, match=words) as error:
        Run(Path("nowhere"), small(partners=tuple(text.split(","))))
    assert "\n" not in str(error.value)


class _no_clock:
    seconds: dict = {}  # noqa: RUF012


TRAIN = """
import sys
from pathlib import Path
import assistax.runs as runs
runs.CHECKPOINT_SECONDS = 0.1
runs.Run.open(Path(sys.argv[1])).train()
"""


def test_kill_9_loses_at_most_the_work_since_the_last_checkpoint(tmp_path):
    """Killed at a random moment and resumed, a recurrent run ends with the very numbers of one left alone."""
    folders = [tmp_path / name for name in ("killed", "alone")]
    for folder in folders:
        Run.create(small(recurrent=True, steps=64 * 200), folder)
    process = subprocess.Popen([sys.executable, "-c", TRAIN, folders[0]], stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 200
    while not list((folders[0] / "checkpoints").glob("*.safetensors")):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.05)
    time.sleep(random.random() * 0.2)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    done = Run.open(folders[0]).rows("metrics")[-1]["steps"]
    saved = max((folders[0] / "checkpoints").glob("*.safetensors"))
    assert 0 < int(saved.stem.split("_")[1]) <= done < 64 * 200
    for folder in folders:
        subprocess.run([sys.executable, "-c", TRAIN, folder], check=True, capture_output=True)
    killed, alone = (load_file(max((f / "checkpoints").glob("*.safetensors"))) for f in folders)
    assert killed.keys() == alone.keys() and any("gru" in name for name in alone)
    for name in alone:
        np.testing.assert_array_equal(killed[name], alone[name], err_msg=name)
    rows = [[r["episode"]["return"] for r in Run.open(f).rows("metrics")] for f in folders]
    assert len(rows[0]) == 200 and rows[0] == rows[1]
    spent = json.loads((folders[1] / "summary.json").read_text())["seconds"]
    assert set(spent) == {"physics", "policy", "update", "evaluation"} and min(spent.values()) >= 0
