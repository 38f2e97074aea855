"""The command line as a user meets it: good runs, bad input, interruptions."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from commands import assistax
from PIL import Image
from safetensors.numpy import save_file
from stored import without_pictures

from assistax import cli

SMALL = ["--num-envs", "8", "--set", "ppo.num_steps=8", "ppo.num_minibatches=2", "ppo.update_epochs=1"]
SMALL += ["env.episode_length=16", "ppo.hidden=(8,8)", "evaluations=2", "evaluation_episodes=4"]


@pytest.fixture
def refused(monkeypatch, capsys):
    """Give the command line something bad, without a process of its own; the one line that it answers."""

    def call(*args):
        monkeypatch.setattr(sys, "argv", ["assistax", *map(str, args)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        lines = capsys.readouterr().err.strip().splitlines()
        assert end.value.code == 2 and len(lines) == 1 and lines[0].startswith("assistax: ")
        return lines[0]

    return call


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished run of 640 steps."""
    folder = tmp_path_factory.mktemp("runs") / "small"
    assistax("train", "scratch", "--steps", 640, "--out", folder, *SMALL)
    return folder


def checkpoint(folder):
    return max((folder / "checkpoints").glob("*.safetensors"))


def test_a_run_folder_holds_what_it_promises(run):
    summary = json.loads((run / "summary.json").read_text())
    wanted = {"task", "algorithm", "preset", "steps", "seeds", "success_rate", "mean_return"}
    wanted |= {"safe_success_rate"}
    assert wanted | {"env_steps_per_s", "hardware", "versions", "commit"} <= set(summary)
    assert summary["steps"] == 640 and summary["task"] == "scratch-v3"
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert [row["steps"] for row in rows] == [64 * i for i in range(1, 11)]
    for name in ("learning_curve.png", "rollout.mp4", "config.json"):
        assert (run / name).stat().st_size > 500


@pytest.mark.parametrize(("harm", "words"), [({}, "92%"), ({"safe_success_rate": 0.9}, "92%, safely 90%")])
def test_harm_stands_beside_success(harm, words, tmp_path, monkeypatch):
    found = {"success_rate": 0.92, "mean_return": 1.0, "env_steps_per_s": 1, "force": {"mean_in_contact": 1, "peak": 2}}
    monkeypatch.setattr("assistax.training.loop.train", lambda run, log: found | harm)
    last = assistax("train", "scratch", "--out", tmp_path / "run", *SMALL).stdout
    assert f"success {words} over 4 evaluation episodes" in last
    monkeypatch.setattr("assistax.evaluation.playing.play", lambda *_: {})
    monkeypatch.setattr("assistax.evaluation.playing.summarize", lambda _: found | harm)
    monkeypatch.setattr(sys.modules["assistax.cli.play"], "film_episode", lambda *_: None)
    assert f"success        {words}\n" in assistax("play", "scratch").stdout


def test_evaluate_as_json(run):
    report = json.loads(assistax("evaluate", run, "--episodes", 8, "--json").stdout)
    assert {"mean_return", "return_ci", "terms", "success_rate", "episodes", "force"} <= set(report)
    assert report["episodes"] == 8
    np.testing.assert_allclose(report["mean_return"], sum(report["terms"].values()), rtol=1e-4)
    low, high = report["return_ci"]
    assert low <= report["mean_return"] <= high


def test_crossplay_says_who_can_work_with_whom(run, tmp_path):
    picture = tmp_path / "matrix.png"
    text = assistax("crossplay", run, "still", "--episodes", 2, "--out", picture).stdout
    rows = [line.split() for line in text.splitlines()]
    assert rows[1][:2] == ["1", run.name] and rows[2][:2] == ["2", "still"] and len(rows[1]) == 6
    assert "cross-play" in text and picture.stat().st_size > 500


def test_several_seeds_are_the_runs_of_each_seed_alone(run, tmp_path):
    both = tmp_path / "both"
    with without_pictures():
        assistax("train", "scratch", "--steps", 128, "--num-seeds", 2, "--out", both, *SMALL)
    rows = [json.loads(line) for line in (both / "metrics.jsonl").read_text().splitlines()]
    alone = json.loads((run / "metrics.jsonl").read_text().splitlines()[0])
    assert [row["seed"] for row in rows] == [0, 1, 0, 1]
    np.testing.assert_allclose(rows[0]["reward"]["reach"], alone["reward"]["reach"], rtol=1e-3)
    assert rows[0]["reward"] != rows[1]["reward"]


def test_an_interrupted_run_goes_on(tmp_path):
    folder = tmp_path / "run"
    command = [sys.executable, "-m", "assistax", "train", "scratch", "--steps", "10000000", "--out", folder, *SMALL]
    running = subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    metrics = folder / "metrics.jsonl"
    deadline = time.monotonic() + 120
    while not (metrics.exists() and metrics.stat().st_size > 3000):
        assert running.poll() is None and time.monotonic() < deadline
        time.sleep(0.1)
    running.send_signal(signal.SIGINT)
    _, errors = running.communicate(timeout=60)
    assert running.returncode == 130 and f"--resume {folder}" in errors
    done = int(checkpoint(folder).stem.split("_")[1])
    with without_pictures():
        assistax("train", "--resume", folder, "--steps", done + 128)
    rows = [json.loads(line) for line in metrics.read_text().splitlines()]
    assert [row["steps"] for row in rows] == list(range(64, done + 129, 64))


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["train", "scratc"], "Did you mean 'scratch'"),
        (["train"], "Name a task"),
        (["train", "scratch", "--engine", "wrap"], "Did you mean 'warp'"),
        (["train", "scratch", "--algorithm", "ipo"], "Did you mean 'ippo'"),
        (["train", "scratch", "--preset", "papr"], "Did you mean 'paper'"),
        (["train", "scratch", "--set", "ppo.learningrate=1"], "Did you mean 'ppo.learning_rate'"),
        (["train", "scratch", "--set", "ppo.learning_rate"], "NAME=VALUE"),
        (["train", "scratch", "--set", "ppo.gamma=0.9", "--set", "ppo.lambda=1"], "--set is there twice"),
        (["train", "scratch", "--set", "ppo.gamma=2"], r"ppo.gamma must be in [0, 1]"),
        (["train", "scratch", "--num-envs", "0"], "num_envs must be 1 or more"),
        (["train", "scratch", "--num-envs", "3", "--set", "ppo.num_minibatches=7"], "do not divide"),
        (["train", "--resume", "nowhere"], "not a run folder"),
        (["train", "--resume", "x", "--seed", "3"], "leave out seed"),
        (["evaluate", "scratch"], "--policy"),
        (["evaluate", "nowhere"], "neither a run folder, nor a team file, nor a task"),
        (["evaluate", "scratch", "--policy", "stil"], "Did you mean 'still'"),
        (["render", "scratch", "--policy", "still", "--out", "no/such/a.mp4"], "does not exist"),
        (["render", "scratch", "--policy", "still", "--out", "a.bmp"], "Can write .mp4, .webp, .gif, .png"),
        (["bench", "scratch", "--num-envs", "0"], "num_envs must be 1 or more"),
        (["crossplay", "still", "expert"], "scripted teams alone"),
        (["crossplay", "scratch-v0"], "two teams or more"),
        (["crossplay", "scratch-v0", "feeding-v0"], "one task"),
        (["crossplay", "scratch-v0", "nowhere"], "neither a run folder, nor a team file, nor a task"),
        (["crossplay", "scratch", "still", "--out", "a.gif"], "Can write .png, .svg, .pdf"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing_behind(args, words, refused, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert words in refused(*args)
    assert not list(tmp_path.iterdir())


def test_a_used_folder_is_not_overwritten(run, refused):
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    assert "already in use" in refused("train", "scratch", "--out", run, *SMALL)
    assert before == {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_an_unwritable_folder_is_one_line(refused, tmp_path):
    tmp_path.chmod(0o500)
    assert "Cannot write" in refused("train", "scratch", "--out", tmp_path / "x")


@pytest.mark.parametrize("damage", ["cut", "foreign", "other shape"])
def test_a_bad_checkpoint_is_one_line(run, refused, tmp_path, damage):
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    path = checkpoint(copy)
    if damage == "cut":
        path.write_bytes(path.read_bytes()[:1000])
    elif damage == "foreign":
        save_file({"x": np.zeros(3)}, path)
    else:
        config = json.loads((copy / "config.json").read_text())
        config["ppo"]["hidden"] = [16, 16]
        (copy / "config.json").write_text(json.dumps(config))
    assert path.name in refused("evaluate", copy)


def test_tasks_doctor_and_bench_answer(tmp_path):
    listing = json.loads(assistax("tasks", "--json").stdout)
    assert listing["scratch-v0"]["observations"] == {"robot": 34, "human": 38, "global": 52}
    report = json.loads(assistax("doctor", "--json").stdout)
    assert "mujoco" in report["engine"] and report["self_test"].startswith("ok")
    report = json.loads(assistax("bench", "scratch", "--num-envs", 16, "--seconds", 1, "--json").stdout)
    assert {"versions", "hardware"} <= set(report)
    (speed,) = report["rows"]
    wanted = {
        "env_steps_per_s",
        "engine_steps_per_s",
        "simulated_seconds_per_s",
        "compile_s",
        "peak_memory_mb",
    }
    assert wanted | {"engine", "num_envs"} <= set(speed)


def children_seconds():
    """Of processor, so that a busy machine is not taken for slow code."""
    times = os.times()
    return times.children_user + times.children_system


HELP = """
import sys
from assistax.__main__ import main

try:
    main()
finally:
    print("loaded:", *{"jax", "mujoco"} & set(sys.modules))
"""


def test_help_is_instant_and_teaches():
    used = children_seconds()
    command = [sys.executable, "-c", HELP, "train", "--help"]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert children_seconds() - used < 2.0
    assert "For example" in text and "--resume" in text and text.splitlines()[-1] == "loaded:"


def test_still_picture(tmp_path):
    out = tmp_path / "still.png"
    assistax("render", "scratch", "--policy", "still", "--out", out, "--width", 160, "--height", 120)
    assert out.stat().st_size > 1000


@pytest.mark.parametrize("text", ["32", "3_2", "3.2e1"])
def test_every_count_takes_whole_numbers_in_any_spelling(text, tmp_path):
    out = tmp_path / "film.png"
    counts = "--width", text, "--height", text, "--set", "env.episode_length=3"
    assistax("render", "scratch-v0", "--policy", "still", "--plain", "--out", out, *counts)
    with Image.open(out) as picture:
        assert picture.size == (32, 32)


@pytest.mark.parametrize("command", ["train", "evaluate", "render", "sweep", "table", "bench", "crossplay"])
def test_help_has_no_noise(command, capsys):
    with pytest.raises(SystemExit):
        assistax(command, "--help")
    printed = capsys.readouterr().out
    assert "(default: )" not in printed and "(default: False)" not in printed and "STR [STR" not in printed
