"""What a training does when it is stopped, prolonged, moved on to another version, or found with parts missing."""

import json
import os
import shutil
import signal
import time
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stored import randomly, small, store_checkpoint, stored_run, train_without_pictures

from assistax.errors import UsageError
from assistax.training import journal, loop
from assistax.training.checkpoint import read_metadata, save_checkpoint
from assistax.training.clock import Clock, Stop
from assistax.training.configuration import configure
from assistax.training.lock import locked
from assistax.training.loop import train
from assistax.training.run import Run


def files(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_fewer_steps_than_are_done_are_refused(tmp_path):
    run = stored_run(tmp_path / "run", small(steps=640))
    store_checkpoint(run, 320)
    before = files(run.folder)
    with pytest.raises(UsageError, match="trained for 320 steps, which is more than --steps 128"):
        train(Run.open(run.folder, steps=128))
    assert files(run.folder) == before


def test_results_without_a_checkpoint_are_not_overwritten(tmp_path):
    run = stored_run(tmp_path / "run", small())
    run.newest_checkpoint().unlink()
    (run.folder / "metrics.jsonl").write_text(
        json.dumps({"steps": 64, "seed": 0, "episodes": 0, "episode": {}, "reward": {}}) + "\n"
    )
    before = files(run.folder)
    with pytest.raises(UsageError, match="no checkpoint to continue from"):
        train(Run.open(run.folder))
    assert files(run.folder) == before


def test_settings_that_were_changed_since_the_checkpoint_are_refused(tmp_path):
    run = stored_run(tmp_path / "run", small(steps=640))
    path = run.newest_checkpoint()
    metadata = {"task": "scratch-v3", "algorithm": "ippo", "steps": 64, "seconds": {}}
    save_checkpoint(path, {}, metadata | {"settings": loop._settings(run)})
    stored = json.loads((run.folder / "config.json").read_text())
    for change in ({"num_steps": 16}, {"learning_rate": 0.5}):
        (run.folder / "config.json").write_text(json.dumps(stored | {"ppo": stored["ppo"] | change}))
        (name,) = change
        with pytest.raises(UsageError, match=f"config.json was changed: ppo.{name} is"):
            train(Run.open(run.folder))
    save_checkpoint(path, {}, metadata)  # of an earlier version
    (run.folder / "config.json").write_text(json.dumps(stored | {"ppo": stored["ppo"] | {"num_steps": 20}}))
    with pytest.raises(UsageError, match="at step 64, which no iteration of 160 steps ends at"):
        train(Run.open(run.folder))


def test_two_processes_cannot_write_to_one_run(tmp_path):
    run = stored_run(tmp_path / "run", small())
    with locked(run.folder), pytest.raises(UsageError, match="Another process is writing to"):
        train(run)
    with locked(run.folder):
        pass


def test_another_version_is_said_and_written_down(tmp_path, capsys):
    run = Run.create(small(), tmp_path / "run")
    stored = json.loads((run.folder / "config.json").read_text())
    began = stored["stamp"] | {"versions": stored["stamp"]["versions"] | {"mujoco": "3.0.0"}}
    (run.folder / "config.json").write_text(json.dumps(stored | {"stamp": began}))
    for _ in range(2):  # once for every change
        Run.open(run.folder).write_config(640)
    said = capsys.readouterr().err
    assert said.count("was trained with mujoco 3.0.0, now") == 1
    after = json.loads((run.folder / "config.json").read_text())
    assert after["stamp"] == began and after["resumed"] == [{"steps": 640, "stamp": stored["stamp"]}]


def test_rows_that_are_missing_are_said_and_written_down(tmp_path, capsys):
    run = Run.create(small(steps=3 * 64, settings={"evaluations": 1, "evaluation_episodes": 2}), tmp_path / "run")
    assert "missing_rows" not in train_without_pictures(run)
    metrics = run.folder / "metrics.jsonl"
    lines = metrics.read_text().splitlines(keepends=True)
    metrics.write_text("".join(lines[:1] + lines[2:]))
    summary = train_without_pictures(Run.open(run.folder))
    assert summary["missing_rows"] == {"metrics": 1} and "metrics.jsonl lacks 1 rows" in capsys.readouterr().err
    shutil.copytree(run.folder, tmp_path / "copy")
    (tmp_path / "copy/metrics.jsonl").unlink()
    assert journal.missing(tmp_path / "copy", "metrics", [64, 128, 192], [0]) == 3


def test_a_run_that_is_prolonged_lacks_no_evaluation_of_its_new_schedule(tmp_path, capsys):
    folder = tmp_path / "run"
    settings = {"evaluations": 2, "evaluation_episodes": 2}
    train_without_pictures(Run.create(small(steps=4 * 64, settings=settings), folder))
    summary = train_without_pictures(Run.open(folder, steps=6 * 64))
    assert "missing_rows" not in summary and "lacks" not in capsys.readouterr().err
    rows = [row["steps"] for row in journal.read(folder, "evaluations")]
    assert rows == [2 * 64, 4 * 64, 6 * 64]  # half and all of 4; all of 6, as its half was past
    lines = (folder / "evaluations.jsonl").read_text().splitlines(keepends=True)
    (folder / "evaluations.jsonl").write_text("".join(lines[1:]))
    assert train_without_pictures(Run.open(folder, steps=7 * 64))["missing_rows"] == {"evaluations": 1}


def test_a_replay_is_written_once_and_not_with_every_checkpoint(tmp_path):
    settings = {"sac.buffer_size": 8192, "sac.hidden": (8,), "sac.num_steps": 8}
    run = Run.create(configure("scratch", settings, algorithm="masac", num_envs=8, num_seeds=2), tmp_path / "run")

    def is_key(x):
        return jnp.issubdtype(x.dtype, jax.dtypes.prng_key)

    leaves, tree = jax.tree.flatten(jax.eval_shape(run.trainer.init, jax.random.key(0)))

    def random_state(seed):
        return tree.unflatten(
            jax.random.split(jax.random.key(seed), x.shape) if is_key(x) else jnp.asarray(randomly(x, 1000 * seed + i))
            for i, x in enumerate(leaves)
        )

    states = [random_state(seed) for seed in run.config.seeds]
    training = loop._Training(run, Stop(), ())
    training.clock = Clock({})
    with journal.Journal(run.folder, "metrics") as metrics, journal.Journal(run.folder, "evaluations") as evaluations:
        training.metrics, training.evaluations = metrics, evaluations
        for done in (1, 2, 3):
            training._save(states, done)
    checkpoints = sorted((run.folder / "checkpoints").glob("*.safetensors"))
    assert [path.stem for path in checkpoints] == ["step_000000000128", "step_000000000192"]
    about = read_metadata(checkpoints[-1])
    (rows,) = {len(lanes) for lanes in about["pieces"].values()}
    written = sum(path.stat().st_size for path in run.folder.glob("checkpoints/pieces/*"))
    replay = sum(x.nbytes for state in states for x in jax.tree.leaves(state.replay))
    assert rows == 2 and checkpoints[-1].stat().st_size < replay / 5 and 0.8 * replay < written < replay
    found, done, _ = loop._Training(run, Stop(), ())._start()
    assert done == 3
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(states), strict=True):
        if is_key(a):
            a, b = jax.random.key_data(a), jax.random.key_data(b)
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_asks_to_stop_and_two_at_once_count_once(number, monkeypatch):
    monkeypatch.setattr(Stop, "TOGETHER", 0.05)
    before = signal.getsignal(number)
    with Stop() as stop:
        assert not stop.asked
        for _ in range(2):
            os.kill(os.getpid(), number)
        assert stop.asked
        time.sleep(0.1)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), number)
            time.sleep(0.1)
    assert signal.getsignal(number) == before


def signal_this(*_, **__):
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.01)


def test_a_signal_ends_an_evaluation_and_the_resumed_run_makes_up_for_it(tmp_path, monkeypatch):
    run = stored_run(tmp_path / "run", small(steps=640, num_seeds=3, settings={"evaluations": 2}))
    (done,) = run.evaluate_at
    monkeypatch.setattr(run, "team", lambda seed: seed)
    result = {"metrics": {"return": np.zeros(2)}, "terms": {}}

    def evaluated(signalled_at=None):
        """The seeds that are played; the state of a seed is its number here."""
        played = []
        with Stop() as stop, journal.Journal(run.folder, "evaluations") as rows:
            training = loop._Training(run, stop, ())
            training.evaluations, training.clock = rows, Clock({})
            training.told = SimpleNamespace(rows=lambda _: None)
            training.evaluator = lambda team: (played.append(team), team == signalled_at and signal_this(), result)[2]
            training._evaluate_due(done, [0, 1, 2])
            assert training._missing(done)["evaluations"] == 0  # those before
        return played

    assert evaluated(signalled_at=1) == [0, 1] and evaluated() == [2] and evaluated() == []
    rows = journal.read(run.folder, "evaluations")
    assert [(row["steps"], row["seed"]) for row in rows] == [(done * 64, seed) for seed in (0, 1, 2)]


@pytest.mark.parametrize("during", ["evaluation", "film"])
def test_a_signal_after_the_last_iteration_does_not_wait_for_the_film(during, tmp_path, monkeypatch):
    run = stored_run(tmp_path / "run", small(steps=64))
    result = {"metrics": {"return": np.zeros(2)}, "terms": {}, "filmed": None}
    monkeypatch.setattr(loop._Training, "_start", lambda self: (None, run.iterations, Clock({})))
    monkeypatch.setattr(loop, "summarize", lambda result: {"success_rate": 0.0, "mean_return": 0.0})
    monkeypatch.setattr("assistax.results.figures.learning_curve", lambda *_: None)
    monkeypatch.setattr(
        "assistax.evaluation.film.film", lambda *_: (during == "film" and signal_this(), time.sleep(10))
    )
    play = lambda team: (during == "evaluation" and signal_this(), result)[1]  # noqa: E731
    monkeypatch.setattr(loop, "Evaluator", lambda *_: play)
    began = time.monotonic()
    assert train(run) is None and time.monotonic() - began < 5
    assert (run.folder / "summary.json").exists() == (during == "film")
