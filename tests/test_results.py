"""Finished runs: read, pooled, compared, tabulated and drawn; from folders made up here."""

import copy
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

from assistax import cli
from assistax.errors import UsageError
from assistax.evaluation.statistics import student_t
from assistax.results import comparison, figures
from assistax.results.stored import StoredRun, _short, best_source, curve, differences, experiments, find_runs

STAMP = {"versions": {"assistax": "0.1.0", "mujoco": "3.17.0", "jax": "0.10.2"}, "commit": "abc", "hardware": "2 cores"}
CONFIG = {
    "task": "scratch",
    "algorithm": "ippo",
    "preset": "default",
    "engine": "auto",
    "steps": 4000,
    "env": {
        "episode_length": 1000,
        "substeps": 4,
        "human": {"disability": "none", "preference": "none", "people": "none"},
    },
    "task_config": {"near": 0.1, "height": [-0.8, 0.8]},
    "ppo": {"gamma": 0.99, "recurrent": False, "share_parameters": False},
    "stamp": STAMP,
}


def write_run(folder, returns, seed=0, finished=True, trained=None, commit="abc", **settings):
    """A run whose seeds are evaluated at 1000, 2000, ... steps with these mean returns [seeds, points]."""
    returns = np.atleast_2d(returns)
    config = copy.deepcopy(CONFIG) | {"seed": seed, "num_seeds": len(returns)}
    config["stamp"]["commit"] = commit
    for name, value in settings.items():
        *groups, name = name.split("__")
        place = config
        for group in groups:
            place = place[group]
        place[name] = value
    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps(config))
    evaluations, metrics = [], []
    for point in range(returns.shape[1]):
        for i, value in enumerate(returns[:, point]):
            about = {"steps": 1000 * (point + 1), "seed": seed + i}
            episodes = {
                "return": [float(value) - 5, float(value) + 5],
                "success": [0.0, 1.0],
                "peak_force": [9.0, 11.0],
            }
            if config["env"]["human"]["preference"] != "none":
                episodes |= {"task_return": [float(value) - 50] * 2, "preference_return": [50.0, 50.0]}
            evaluations.append(about | {"deterministic": True, "episodes": episodes, "terms": {}})
            episode = {name: float(np.mean(x)) - 100 for name, x in episodes.items()}
            metrics.append(about | {"episodes": int(point > 0), "episode": episode, "reward": {"reach": 0.1}})
    for name, rows in (("evaluations", evaluations), ("metrics", metrics)):
        (folder / f"{name}.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    if finished:
        last = [row["episodes"] for row in evaluations[-len(returns) :]]
        each = [
            {
                "episodes": 2,
                "mean_return": float(np.mean(episodes["return"])),
                "success_rate": 0.5,
                "force": {"mean_in_contact": 3.0 + i},
                "outcomes": {"peak_force": {"mean": 10.0}},
                **{
                    name: {"mean": float(np.mean(episodes[name]))}
                    for name in set(episodes) & {"task_return", "preference_return"}
                },
            }
            for i, episodes in enumerate(last)
        ]
        about = {"evaluation": each, "steps": trained or config["steps"], "engine": "mujoco"}
        (folder / "summary.json").write_text(json.dumps(about | config["stamp"]))
    return folder


def pooled(*folders):
    return experiments([StoredRun.read(folder) for folder in folders])


HUMAN = {"disability": "none", "preference": "none", "people": "none"}
RECORDS = [
    {"task": task, "policy": policy, "human": HUMAN, "mean_return": value, "success_rate": 0.0}
    for task, values in {"scratch": (100.0, 80.0, 1180.0), "feeding": (160.0, 340.0, 3790.0)}.items()
    for policy, value in zip(("still", "random", "expert"), values, strict=True)
]


# -- reading and pooling -----------------------------------------------------------------------


def test_runs_that_differ_only_in_seeds_are_one_experiment(tmp_path):
    a = write_run(tmp_path / "a", [[1, 2], [3, 4]])
    b = write_run(tmp_path / "b", [5, 6], seed=2, engine="mujoco", commit="def")
    (found,) = pooled(a, b)
    assert found.seeds == [0, 1, 2]
    np.testing.assert_allclose(found.final("mean_return"), [2, 4, 6])
    np.testing.assert_allclose(found.final("force", "mean_in_contact"), [3, 4, 3])
    assert "commit: abc (1 run), def (1 run)" in differences([found])[0]


def test_what_differs_behind_the_fortieth_letter_is_told_apart():
    one, other = (f"/home/somebody/projects/assistax/runs/scratch-{end}" for end in ("weak", "strong"))
    assert len(_short(one)) == 40 and _short(one) != _short(other) and _short("short") == "short"


@pytest.mark.parametrize(
    ("settings", "tell"),
    [
        ({"ppo__gamma": 0.9}, lambda e: e.method.note == "ppo.gamma=0.9"),
        ({"steps": 8000}, lambda e: e.method.steps == 8000),
        ({"preset": "paper"}, lambda e: e.method.preset == "paper"),
        ({"algorithm": "mappo"}, lambda e: e.method.algorithm == "mappo"),
        ({"ppo__recurrent": True}, lambda e: e.method.algorithm == "ippo-rnn"),
        ({"partners": ["human=still"]}, lambda e: e.method.algorithm == "ippo with human=still"),
        ({"env__human__preference": "sweep"}, lambda e: e.person == "preference=sweep" and e.preferring),
        ({"env__human__people": "paper630"}, lambda e: e.person == "people=paper630" and e.preferring),
        ({"env__human__disability": "tremor"}, lambda e: e.person == "disability=tremor" and not e.preferring),
        ({"task": "feeding"}, lambda e: e.task == "feeding-v0"),
    ],
)
def test_other_differences_are_told_apart(settings, tell, tmp_path):
    found = pooled(write_run(tmp_path / "a", [1, 2]), write_run(tmp_path / "b", [1, 2], seed=1, **settings))
    assert len(found) == 2 and [tell(e) for e in found].count(True) == 1


def test_experiments_are_sorted_by_task_person_and_method(tmp_path):
    order = [{}, {"steps": 15_000}, {"algorithm": "mappo"}, {"env__human__preference": "sweep"}, {"task": "feeding"}]
    folders = [write_run(tmp_path / str(i), [1, 2], **settings) for i, settings in enumerate(order)]
    found = [e.runs[0].folder.name for e in pooled(*reversed(folders))]
    assert found == [str(i) for i in range(len(order))]


def test_what_an_older_version_does_not_know_is_no_difference(tmp_path):
    a, b = write_run(tmp_path / "a", [1, 2]), write_run(tmp_path / "b", [1, 2], seed=1)
    config = json.loads((a / "config.json").read_text())
    del config["env"]["human"], config["ppo"]["recurrent"]
    (a / "config.json").write_text(json.dumps(config))
    assert len(pooled(a, b)) == 1


def test_a_torn_last_line_is_left_out(tmp_path):
    run = write_run(tmp_path / "a", [1, 2, 3])
    with open(run / "evaluations.jsonl", "a") as file:
        file.write('{"steps": 4000, "se')
    assert len(StoredRun.read(run).rows("evaluations")) == 3
    steps, _ = curve(pooled(run)[0], "return", "evaluation")
    assert list(steps) == [1000, 2000, 3000]


def test_bad_input_is_one_clear_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    a = write_run(tmp_path / "a", [1, 2])
    b = write_run(tmp_path / "b", [1, 2])
    young = write_run(tmp_path / "young", [1, 2], seed=1, finished=False)
    torn = write_run(tmp_path / "torn", [1, 2, 3], seed=1)
    lines = (torn / "evaluations.jsonl").read_text().splitlines()
    (torn / "evaluations.jsonl").write_text("\n".join([lines[0], lines[1][:20], lines[2]]))
    (tmp_path / "odd").mkdir()
    (tmp_path / "odd/config.json").write_text("{")
    (tmp_path / "empty").mkdir()
    harder = write_run(tmp_path / "harder", [1, 2], seed=1, task_config__near=0.2)
    shorter = write_run(tmp_path / "shorter", [1, 2], seed=1, env__episode_length=500)
    prolonged = write_run(tmp_path / "prolonged", [1, 2], seed=1, trained=8000)
    foreign = write_run(tmp_path / "foreign", [1, 2])
    (foreign / "evaluations.jsonl").write_text('{"steps": 1000, "seed": 7, "episodes": {"return": [1.0]}}')
    cases = [
        (lambda: pooled(a, prolonged), "trained for 4000 steps and"),
        (lambda: curve(pooled(foreign)[0], "return", "evaluation"), "row that does not fit: 7"),
        (lambda: find_runs(), "no finished run in results and runs"),
        (lambda: find_runs([tmp_path / "empty"]), "not a run folder and holds none"),
        (lambda: find_runs([tmp_path / "nowhere"]), "not a run folder"),
        (lambda: find_runs([tmp_path / "odd"]), "odd/config.json: it is not JSON"),
        (lambda: pooled(a, b), "both seed 0"),
        (lambda: cli.table((young,)), "no summary.json"),
        (lambda: cli.table((a,), json=True, markdown=True), "--json and --markdown"),
        (lambda: curve(pooled(torn)[0], "return", "evaluation"), "Cannot read line 2 of 3 in"),
        (lambda: curve(pooled(a)[0], "retrun", "evaluation"), "/a 'retrun'. Did you mean 'return'"),
        (lambda: cli.plot((a, harder)), "task_config.near is 0.1 and 0.2"),
        (lambda: cli.plot((a, shorter)), "env.episode_length is 1000 and 500"),
        (lambda: cli.table((a, shorter), compare=True), "env.episode_length is 1000 and 500"),
        (lambda: cli.plot((a,), out=tmp_path / "x.gif"), "Can write .png, .svg, .pdf"),
        (lambda: cli.plot((a,), out=tmp_path / "no/x.png"), "does not exist"),
        (lambda: cli.plot((a, shorter), scale="bound", out=tmp_path / "x.png"), "cannot be compared"),
        (lambda: cli.plot((shorter,), scale="bound", out=tmp_path / "x.png"), "nothing to scale by bound"),
    ]
    for call, words in cases:
        with pytest.raises(UsageError) as error:
            call()
        assert words in str(error.value) and "\n" not in str(error.value)
    assert not list(tmp_path.glob("*.png"))


def test_without_arguments_all_finished_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_run(tmp_path / "results/a", [1, 2])
    write_run(tmp_path / "runs/b", [1, 2], seed=1)
    write_run(tmp_path / "runs/c", [1, 2], seed=2, finished=False)
    (tmp_path / "results/bench").mkdir()
    assert sorted(run.folder.name for run in find_runs()) == ["a", "b"]
    assert [run.folder.name for run in find_runs([tmp_path / "runs/c"])] == ["c"]
    assert [run.folder.name for run in find_runs([tmp_path / "runs", tmp_path / "runs/b"])] == ["b"]
    shutil.copytree(tmp_path / "results/a", tmp_path / "runs/copy")
    assert sorted(run.folder.name for run in find_runs()) == ["a", "b"]


def test_runs_lie_at_any_depth_but_what_was_tried_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for seed, name in enumerate(("a", "version1/b", "version1/trials/c", "version1/trials/more/d", "ablations/e")):
        write_run(tmp_path / "results" / name, [1, 2], seed=seed)
    write_run(tmp_path / "results/a/partners/f", [1, 2], seed=9)  # of a run, and none of the results

    def found(*folders):
        return [run.folder.name for run in find_runs([tmp_path / "results" / folder for folder in folders])]

    assert [run.folder.name for run in find_runs()] == ["a", "b"]
    assert found("") == ["a", "b"] and found("version1") == ["b"]
    assert found("version1/trials") == ["c", "d"] and found("version1/trials/c", "ablations") == ["c", "e"]


# -- scales and tables -------------------------------------------------------------------------


def test_scales_are_those_of_the_task_the_person_and_the_reward(tmp_path):
    plain, liked, weak, other = pooled(
        write_run(tmp_path / "a", [1, 2]),
        write_run(tmp_path / "b", [1, 2], env__human__preference="sweep"),
        write_run(tmp_path / "c", [1, 2], env__human__disability="weakness"),
        write_run(tmp_path / "d", [1, 2], task="feeding", task_config={"near": 7.0}),
    )
    if liked.person != "preference=sweep":
        liked, weak = weak, liked
    assert comparison.scale(plain, "bound", RECORDS) == (0, 1000)
    assert comparison.scale(plain, "expert", RECORDS) == (0, 1180)
    assert comparison.scale(plain, "minmax", RECORDS) == (80, 1180)
    experts = [{**RECORDS[2], "policy": name, "mean_return": x} for name, x in (("expert", 1180.0), ("offer", 1200.0))]
    assert comparison.scale(plain, "minmax", experts) is None  # nobody there is bad
    assert comparison.scale(liked, "bound", RECORDS) == (0, 2000)  # the paper's combined maximum
    assert comparison.scale(weak, "bound", RECORDS) == (0, 1000)
    assert comparison.scale(liked, "expert", RECORDS) is comparison.scale(weak, "minmax", RECORDS) is None
    changed = json.loads(json.dumps(other.runs[0].settings)) | {"env.episode_length": 500}
    object.__setattr__(other.runs[0], "settings", changed)
    assert comparison.scale(other, "bound", RECORDS) is None


def test_the_table_is_what_can_be_worked_out_by_hand(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "results").mkdir()
    (tmp_path / "results/experts.json").write_text(json.dumps(RECORDS))
    returns = {"scratch": [900.0, 1000.0, 1100.0], "feeding": [1000.0, 2000.0, 3000.0]}
    for task, last in returns.items():
        write_run(tmp_path / f"runs/{task}", np.stack([np.zeros(3), last], 1), task=task)
        write_run(
            tmp_path / f"runs/{task}-m", np.stack([np.zeros(3), np.array(last) - 150], 1), task=task, algorithm="mappo"
        )
    cli.table(compare=True, json=True)
    said = json.loads(capsys.readouterr().out)
    row = next(r for r in said["experiments"] if (r["task"], r["algorithm"]) == ("scratch-v0", "ippo"))
    half = student_t(2.0) * 100 / np.sqrt(3)
    assert row["return"]["mean"] == 1000 and row["of_bound"] == 1.0
    assert row["of_expert"] == pytest.approx(1000 / 1180)
    np.testing.assert_allclose(row["return"]["mean_ci"], [1000 - half, 1000 + half], rtol=0.06)
    assert (
        row["force_in_contact"]["mean"] == 4.0 and row["success"]["mean"] == 0.5 and row["success"]["mean_ci"] is None
    )
    assert row["commit"] == ["abc"] and row["seeds"] == [0, 1, 2] and row["versions"][0]["mujoco"] == "3.17.0"
    whole = next(r for r in said["aggregates"] if r["algorithm"] == "ippo")
    scores = sorted([0.9, 1.0, 1.1, 1000 / 4700, 2000 / 4700, 3000 / 4700])
    assert whole["bound"]["iqm"] == pytest.approx((0.5 * scores[1] + scores[2] + scores[3] + 0.5 * scores[4]) / 3)
    assert whole["expert"]["mean"] == pytest.approx((1000 / 1180 + 2000 / 3790) / 2)
    assert whole["minmax"]["mean"] == pytest.approx(((1000 - 80) / 1100 + (2000 - 160) / 3630) / 2)
    (versus,) = said["comparisons"]
    assert versus["first"]["algorithm"] == "ippo"
    # Against 750, 850 and 950 nine pairs give 8 wins; against 850, 1850, 2850 6.
    assert versus["probability_of_improvement"] == pytest.approx((8 / 9 + 6 / 9) / 2)
    assert versus["version"] == whole["version"] == 0
    cli.table(markdown=True)
    text = capsys.readouterr().out
    assert "| scratch-v0 | ippo | default | none | 0.004 | 3 | 1000 [7" in text and "†" in text
    cli.table((tmp_path / "runs/scratch",))
    assert "100%" in capsys.readouterr().out


def test_a_run_that_another_commit_finished_counts_as_of_both(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runs = [write_run(tmp_path / f"runs/{i}", [1, 2], seed=i) for i in range(2)]
    summary = json.loads((runs[1] / "summary.json").read_text())
    summary |= {"commit": "def", "versions": summary["versions"] | {"jax": "0.11.0"}}
    (runs[1] / "summary.json").write_text(json.dumps(summary))
    cli.table(json=True)
    (row,) = json.loads(capsys.readouterr().out)["experiments"]
    assert row["commit"] == ["abc", "abc, then def"] and row["hardware"] == ["2 cores"] * 2
    cli.table()
    remarks = capsys.readouterr().out
    assert "The runs differ in commit: abc (1 run), abc, then def (1 run)." in remarks
    assert "The runs differ in jax: 0.10.2 (1 run), 0.10.2, then 0.11.0 (1 run)." in remarks


def harmed(run, safe, cost):
    """To a run, what version 1 measures: at every evaluation and in the end, by seed [seeds]."""
    rows = [json.loads(line) for line in (run / "evaluations.jsonl").read_text().splitlines()]
    for row in rows:
        row["episodes"]["safe_success"] = [safe[row["seed"]]] * 2
    (run / "evaluations.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    summary = json.loads((run / "summary.json").read_text())
    for i, one in enumerate(summary["evaluation"]):
        one |= {"safe_success_rate": safe[i], "outcomes": one["outcomes"] | {"cost": {"mean": cost[i]}}}
    (run / "summary.json").write_text(json.dumps(summary))
    return run


@pytest.mark.parametrize("asked", ["success", "safe_success"])
def test_what_is_safe_what_it_costs_and_when_it_was_learned(asked, tmp_path, capsys):
    """By hand: of two seeds of 4000 steps and 8 minutes together, one has 90 % at 3000, after 3 minutes of its 4."""
    run = write_run(tmp_path / "a", [[1, 2, 3, 4], [1, 2, 3, 4]])
    if asked == "safe_success":  # success, which everybody has from the beginning, does not count then
        harmed(run, [0.25, 0.75], [1.0, 2.0])
    rows = [json.loads(line) for line in (run / "evaluations.jsonl").read_text().splitlines()]
    for row in rows:
        row["episodes"]["success"] = [1.0] * 10
        row["episodes"][asked] = [1.0] * 8 + [float(row["seed"] == 0 and row["steps"] >= 3000), 0.0]
    (run / "evaluations.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    summary = json.loads((run / "summary.json").read_text())
    summary["seconds"] = {"physics": 300.0, "update": 180.0, "evaluation": 999.0}
    (run / "summary.json").write_text(json.dumps(summary))
    row = comparison.describe(pooled(run)[0], RECORDS)
    assert row["learned"] == [{"steps": 3000, "minutes": pytest.approx(3.0)}]
    cli.table((run,), markdown=True)
    text = capsys.readouterr().out
    assert "| 0.0 (1 of 2) | 3.0 (1 of 2) |" in text
    if asked == "success":
        assert "safe_success" not in row and "cost" not in row
    else:
        assert row["safe_success"]["mean"] == 0.5 and row["cost"]["mean"] == 1.5
        assert "| success | safe success | cost |" in text
    assert comparison.describe(pooled(write_run(tmp_path / "b", [1, 2]))[0], RECORDS)["learned"] == []


def test_success_and_harm_over_the_tasks_are_those_of_methods_that_were_measured_on_all(tmp_path, capsys):
    """By hand: means over two tasks of 0.5 and 0.25, and of a cost of 2 and 5, each of two seeds."""
    both = {"task": "scratch"}, {"task": "feeding"}
    means = ([0.25, 0.75], [1.0, 3.0]), ([0.0, 0.5], [4.0, 6.0])
    ours = [
        harmed(write_run(tmp_path / f"a{i}", [[1, 2], [1, 2]], **task), *mean)
        for i, (task, mean) in enumerate(zip(both, means, strict=True))
    ]
    theirs = [write_run(tmp_path / f"b{i}", [[1, 2], [1, 2]], algorithm="mappo", **task) for i, task in enumerate(both)]
    harmed(theirs[0], *means[0])  # and not on the other
    ippo, mappo = comparison.aggregates(pooled(*ours, *theirs), RECORDS)
    assert ippo["safe_success"]["mean"] == 0.375 and ippo["cost"]["mean"] == 3.5
    low, high = ippo["cost"]["mean_ci"]
    assert 0.0 <= low < 3.5 < high
    assert ippo["safe_success"]["mean_ci"][0] >= 0.0 and ippo["safe_success"]["mean_ci"][1] <= 1.0
    assert mappo["success"]["mean"] == 0.5 and "safe_success" not in mappo and "cost" not in mappo
    cli.table((tmp_path,), markdown=True)
    text = capsys.readouterr().out
    assert "success, mean [95 %] | safe success, mean [95 %] | cost, mean [95 %] |" in text
    assert "| 50% | 38% [" in text and "| 50% |  |  |\n" in text


def test_intervals_stay_where_the_quantity_can_be(tmp_path):
    """Two seeds with 3 and 4 N: 3.5 N, give or take 12.7 standard errors of 0.5 N, but not below zero."""
    row = comparison.describe(pooled(write_run(tmp_path / "a", [[1000.0], [1100.0]]))[0], RECORDS)
    assert row["force_in_contact"]["mean_ci"] == pytest.approx((0.0, 3.5 + 12.7 * 0.5), abs=0.3)
    row = comparison.estimate([np.array([0.0, 1.0])], least=0.0, most=1.0)
    assert row["mean_ci"] == row["iqm_ci"] == (0.0, 1.0)


def test_one_seed_has_no_interval_and_says_so(tmp_path, capsys):
    cli.table((write_run(tmp_path / "a", [1, 700]),))
    text = capsys.readouterr().out
    assert "1 seed: no interval" in text and "700 [" not in text and "†" not in text


# -- figures -----------------------------------------------------------------------------------


def test_a_curve_is_the_mean_of_episodes_where_all_seeds_are(tmp_path):
    a = write_run(tmp_path / "a", [[1, 2, 3], [3, 4, 5]])
    b = write_run(tmp_path / "b", [7, 8], seed=2, finished=False)
    (found,) = pooled(a, b)
    steps, values = curve(found, "return", "evaluation")
    assert list(steps) == [1000, 2000]
    np.testing.assert_allclose(values, [[1, 2], [3, 4], [7, 8]])
    steps, values = curve(found, "return", "training")  # nothing ended in the first iteration
    assert list(steps) == [2000]
    np.testing.assert_allclose(values, [[-98], [-96], [-92]])
    assert best_source(found) == "evaluation"
    (b / "evaluations.jsonl").unlink()
    assert best_source(*pooled(a, b)) == "training"


def test_long_training_curves_are_averaged_in_windows(tmp_path):
    run = write_run(tmp_path / "a", np.arange(251.0))
    steps, values = curve(pooled(run)[0], "return", "training")
    assert len(steps) == 100 and steps[0] == np.mean([2000, 3000, 4000])
    np.testing.assert_allclose(values[0], steps / 1000 - 101)


def drawn(axes):
    """Curves (not reference lines), bands and words of a panel."""
    lines = [line for line in axes.lines if len(line.get_xdata()) > 2]
    return lines, axes.collections, [text.get_text() for text in axes.texts]


def test_panels_show_the_means_bands_and_references(tmp_path):
    folders = []
    for task, level in {"scratch": 1000.0, "feeding": 4000.0}.items():
        for algorithm, share in {"ippo": 0.5, "mappo": 0.25}.items():
            curves = level * share * (np.arange(1, 5) / 4 + np.array([[0.0], [0.1], [0.2]]))
            folders.append(write_run(tmp_path / f"{task}-{algorithm}", curves, task=task, algorithm=algorithm))
    found = pooled(*folders)
    figure = figures.learning_curves(found, RECORDS)
    scratch, feeding, whole = [axes for axes in figure.axes if axes.axison]
    assert [axes.get_title() for axes in (scratch, feeding, whole)] == ["scratch-v0", "feeding-v0", "all 2 tasks"]
    assert scratch.get_ylabel() == "return, evaluation episodes"
    lines, bands, words = drawn(scratch)
    assert len(lines) == len(bands) == 2 and words == ["paper's bound", "expert"]
    np.testing.assert_allclose(lines[0].get_ydata(), 500 * (np.arange(1, 5) / 4 + 0.1))
    np.testing.assert_allclose(lines[0].get_xdata(), [0.001, 0.002, 0.003, 0.004])
    half = student_t(2.0) * 50 / np.sqrt(3)
    edges = bands[0].get_paths()[0].get_extents()
    np.testing.assert_allclose([edges.ymin, edges.ymax], [175 - half, 550 + half], rtol=0.05)
    lines, _, _ = drawn(whole)
    scores = [((500 * (1 + s) - 80) / 1100, (2000 * (1 + s) - 160) / 3630) for s in (0.0, 0.1, 0.2)]
    scores = np.sort(np.ravel(scores))
    assert lines[0].get_ydata()[-1] == pytest.approx((0.5 * scores[1] + scores[2] + scores[3] + 0.5 * scores[4]) / 3)
    by_algorithm = [axes for axes in figures.learning_curves(found, RECORDS, by="algorithm").axes if axes.axison]
    assert [axes.get_title() for axes in by_algorithm] == ["ippo", "mappo"]
    np.testing.assert_allclose(drawn(by_algorithm[0])[0][0].get_ydata()[-1], (550 - 80) / 1100)


def test_the_bands_of_few_seeds_do_not_set_the_scale(tmp_path):
    """Two seeds at 1900 and 2100 have a band of 729 to 3271."""
    found = pooled(write_run(tmp_path / "run", np.array([[1900.0] * 3, [2100.0] * 3])))
    axes = next(axes for axes in figures.learning_curves(found, {}).axes if axes.axison)
    assert axes.collections[0].get_paths()[0].get_extents().ymax > 3200
    assert axes.get_ylim() == pytest.approx((0.0, 2200.0))


def test_versions_of_the_tasks_are_not_put_together(tmp_path):
    """Of version 0 two tasks, of version 1 the same two, which everybody solves."""
    for task in ("scratch-v0", "feeding-v0", "scratch-v1", "feeding-v1"):
        for algorithm in ("ippo", "mappo"):
            run = write_run(tmp_path / f"{task}-{algorithm}", [1, 2, 3], task=task, algorithm=algorithm)
            rows = (run / "evaluations.jsonl").read_text()
            if task.endswith("v1"):
                (run / "evaluations.jsonl").write_text(rows.replace('"success": [0.0, 1.0]', '"success": [1.0, 1.0]'))
    found = pooled(*tmp_path.iterdir())
    for rows, count in ((comparison.aggregates(found, RECORDS), 4), (comparison.comparisons(found), 2)):
        assert len(rows) == count
        assert all(row["tasks"] == [f"scratch-v{row['version']}", f"feeding-v{row['version']}"] for row in rows)
    heads = [head for head, _ in comparison.tables(comparison.report(found, RECORDS, compare=True))]
    assert "version" not in heads[0] and "version" in heads[1] and "version" in heads[2]

    def panels(by):
        figure = figures.learning_curves(found, RECORDS, by=by, metric="success")
        return {axes.get_title(): drawn(axes)[0] for axes in figure.axes if axes.axison}

    old, new = ["scratch-v0", "feeding-v0"], ["scratch-v1", "feeding-v1"]
    by_task = panels("task")
    assert list(by_task) == [*old, "all 2 tasks, version 0", *new, "all 2 tasks, version 1"]
    for version, height in enumerate((0.5, 1.0)):
        assert [list(line.get_ydata()) for line in by_task[f"all 2 tasks, version {version}"]] == [[height] * 3] * 2
    assert list(panels("algorithm")) == [f"{name}, version {n}" for n in (0, 1) for name in ("ippo", "mappo")]


def test_safe_success_of_all_tasks_has_a_panel(tmp_path):
    runs = [write_run(tmp_path / task, [1, 2, 3], task=task) for task in ("scratch", "feeding")]
    found = pooled(*(harmed(run, [share], [0.0]) for run, share in zip(runs, (0.25, 0.75), strict=True)))
    whole = figures.learning_curves(found, RECORDS, metric="safe_success").axes[-1]
    assert whole.get_title() == "all 2 tasks" and whole.get_ylabel() == "safe success, evaluation episodes, IQM"
    assert list(drawn(whole)[0][0].get_ydata()) == [0.5] * 3


def test_one_seed_is_drawn_without_a_band_and_preferences_in_a_row_of_their_own(tmp_path):
    plain = write_run(tmp_path / "a", [100, 200, 300])
    liked = write_run(tmp_path / "b", [500, 600, 700], env__human__preference="sweep")
    figure = figures.learning_curves(pooled(plain, liked), RECORDS)
    above, below = figure.axes
    assert (
        above.get_title().startswith("scratch-v0\nno preference")
        and below.get_title() == "scratch-v0\npreference=sweep"
    )
    assert above.get_subplotspec().rowspan.start == 0 and below.get_subplotspec().rowspan.start == 1
    assert drawn(above)[2] == ["paper's bound", "expert"] and drawn(below)[2] == ["paper's bound"]
    assert not any(np.isfinite(path.vertices).all() and len(path.vertices) for path in above.collections[0].get_paths())
    fed = write_run(tmp_path / "c", [1, 2, 3], task="feeding")
    liked = write_run(tmp_path / "d", [1, 2, 3], task="feeding", env__human__preference="sweep")
    folded = [axes for axes in figures.learning_curves(pooled(plain, fed, liked), RECORDS).axes if axes.axison]
    assert [axes.get_title().split("\n")[0] for axes in folded] == [
        "scratch-v0",
        "feeding-v0",
        "all 2 tasks",
        "feeding-v0",
    ]
    assert [axes.get_subplotspec().colspan.start for axes in folded] == [0, 1, 2, 0]  # no hole before the last


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_plot_writes_what_the_suffix_says(suffix, tmp_path, capsys):
    run = write_run(tmp_path / "a", [[100, 200], [150, 300]])
    out = tmp_path / f"curves.{suffix}"
    cli.plot((run,), source="training", out=out)
    start = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[suffix]
    assert out.read_bytes().startswith(start)
    if suffix == "svg":
        assert "return, training episodes" in out.read_text() and "ippo (2 seeds)" in out.read_text()
    assert "wrote" in capsys.readouterr().out


def test_the_curve_of_one_run(tmp_path):
    run = write_run(tmp_path / "a", [[101, 102, 103], [103, 104, 105]], env__human__preference="sweep")
    figure = figures.learning_curve(StoredRun.read(run).rows("metrics"), "title", tmp_path / "curve.png")
    lines = {line.get_label(): list(line.get_ydata()) for line in figure.axes[0].lines}
    assert lines["seed 0"] == [2, 3] and lines["seed 1"] == [4, 5]  # nothing ended in the first iteration
    assert lines["seed 0, task"] == [-48, -47] and lines["seed 0, preference"] == [-50, -50]
    assert (tmp_path / "curve.png").stat().st_size > 5000


WITHOUT_JAX = """
from pathlib import Path
import assistax.results.comparison, assistax.results.figures
from assistax import cli

cli.table((Path("a"),))
cli.plot((Path("a"),))
cli.main()
"""


def test_tables_and_figures_need_no_device_and_an_error_is_one_line(tmp_path):
    """In a process for which JAX has no device, so that starting its backend, which may take a GPU's memory, fails."""
    write_run(tmp_path / "a", [1, 2])
    command = [sys.executable, "-c", WITHOUT_JAX, "plot", "nowhere"]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, check=False, env=os.environ | {"JAX_PLATFORMS": "none"}
    )
    assert done.returncode == 2 and done.stderr.startswith("assistax: nowhere is not a run folder")
    assert len(done.stderr.splitlines()) == 1
    assert "scratch-v0" in done.stdout and list(tmp_path.glob("*.png"))
