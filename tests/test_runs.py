"""Runs from Python: what is asked for is what is trained, and a run survives what happens to it."""

import json
import os
import random
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from safetensors.numpy import load_file

from assistax.errors import UsageError
from assistax.runs import Run, configure

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
    done = Run.open(folders[0]).metrics()[-1]["steps"]
    saved = max((folders[0] / "checkpoints").glob("*.safetensors"))
    assert 0 < int(saved.stem.split("_")[1]) <= done < 64 * 200
    for folder in folders:
        subprocess.run([sys.executable, "-c", TRAIN, folder], check=True, capture_output=True)
    killed, alone = (load_file(max((f / "checkpoints").glob("*.safetensors"))) for f in folders)
    assert killed.keys() == alone.keys() and any("gru" in name for name in alone)
    for name in alone:
        np.testing.assert_array_equal(killed[name], alone[name], err_msg=name)
    rows = [[r["episode"]["return"] for r in Run.open(f).metrics()] for f in folders]
    assert len(rows[0]) == 200 and rows[0] == rows[1]
    spent = json.loads((folders[1] / "summary.json").read_text())["seconds"]
    assert set(spent) == {"physics", "policy", "update"} and min(spent.values()) >= 0
