"""--log: what TensorBoard and wandb are told is what stands in metrics.jsonl and evaluations.jsonl."""

import sys
from collections import defaultdict

import numpy as np
import pytest

from assistax.errors import UsageError
from assistax.training.loggers import LOGGERS, Loggers, check_loggers

ROW = {"steps": 64, "seconds": 1.5, "seed": 3, "episodes": 2, "episode": {"return": 5.0, "success": 0.5},
       "losses": {"robot": {"policy": -0.25}}}  # fmt: skip
EVALUATION = {"steps": 64, "seed": 3, "deterministic": True, "episodes": {"return": [1.0, 2.0], "success": [0.0, 1.0]},
              "terms": {"reach": [0.5, 1.5]}}  # fmt: skip


def told(folder):
    """By name {step: value} of what TensorBoard's own reader finds."""
    from tensorboardX.proto import event_pb2

    found = defaultdict(dict)
    for path in sorted(folder.glob("events.*")):
        data = path.read_bytes()
        while data:  # TFRecord: length, its checksum, the event, its checksum
            size = int(np.frombuffer(data[:8], np.uint64)[0])
            event = event_pb2.Event.FromString(data[12 : 12 + size])
            for value in event.summary.value:
                found[value.tag][event.step] = value.simple_value
            data = data[16 + size :]
    return found


def test_tensorboard_has_the_numbers_of_the_rows(tmp_path):
    with Loggers(["tensorboard"], tmp_path, [3], 0, {}) as log:
        log.rows([ROW, EVALUATION])
    found = told(tmp_path / "tensorboard" / "seed-3")
    assert found == {
        "seconds": {64: 1.5}, "episodes": {64: 2.0}, "episode/return": {64: 5.0}, "episode/success": {64: 0.5},
        "losses/robot/policy": {64: -0.25}, "evaluation/return": {64: 1.5}, "evaluation/success": {64: 0.5},
        "evaluation/reach": {64: 1.0},
    }  # fmt: skip


def test_wandb_is_told_offline_and_goes_on_with_the_same_run(tmp_path, monkeypatch):
    monkeypatch.setenv("WANDB_MODE", "offline")
    monkeypatch.setenv("WANDB_SILENT", "true")
    for steps in (0, 64):
        with Loggers(["wandb"], tmp_path, [3], steps, {"ppo.gamma": 0.99}) as log:
            log.rows([ROW])
    # Not the folders' names: wandb numbers them where two begin within a second.
    parts = [path.name for path in (tmp_path / "wandb").glob("offline-run-*/run-*.wandb")]
    assert parts == ["run-" + (tmp_path / "wandb-id.txt").read_text() + "-3.wandb"] * 2


def test_the_film_goes_to_all_loggers_of_the_seed_that_it_is_of(tmp_path, monkeypatch):
    shown = []

    class Recorder:
        def __init__(self, folder, seed, steps, config):
            self.film = lambda steps, path: shown.append((seed, steps, path))
            self.close = lambda: None

    monkeypatch.setitem(LOGGERS, "wandb", Recorder)
    with Loggers(["tensorboard", "wandb"], tmp_path, [3, 4], 0, {}) as log:
        log.film(64, tmp_path / "rollout.mp4")
    assert shown == [(3, 64, tmp_path / "rollout.mp4")]


def test_a_logger_that_is_not_there_is_one_line(monkeypatch):
    with pytest.raises(UsageError, match=r"Unknown logger 'tensorbord'. Did you mean 'tensorboard'"):
        check_loggers(["tensorbord"])
    monkeypatch.setitem(sys.modules, "wandb", None)
    with pytest.raises(UsageError, match=r"needs the package wandb: pip install 'assistax\[wandb\]'"):
        check_loggers(["wandb"])
