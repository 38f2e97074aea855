"""Sweeps: what is drawn, that a trial is the ordinary run with its settings, and what interruptions leave behind."""

import io
import json
import math
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from commands import assistax as assistax_command
from games import Cue
from scipy import stats as scipy_stats

import assistax.training.sweep
from assistax.errors import UsageError
from assistax.executors.claims import take
from assistax.learning.algorithms import ALGORITHMS
from assistax.settings import with_settings
from assistax.training.configuration import configure
from assistax.training.presets import PRESETS
from assistax.training.run import Run
from assistax.training.search import SEARCH, choices, draw, intervals
from assistax.training.sweep import Program, Sweep, outcome, rank
from assistax.training.sweep_figures import facets, overview

ENVS, STEPS = 8, 5 * 8 * 10  # five iterations
SMALL = {
    "ppo.cost_limit": None,
    "ppo.teachers": (),
    "ppo.hidden": (8,),
    "ppo.num_steps": 10,
    "ppo.update_epochs": 2,
    "ppo.num_minibatches": 2,
}
SEARCHED = {"ppo.learning_rate": "1e-3:1e-1", "ppo.gamma": "0.5,0.9"}
SAC_SMALL = {"sac.hidden": (8,), "sac.num_steps": 10, "sac.updates": 4, "sac.batch_size": 32, "sac.warmup": 80}
SAC_SEARCHED = {"sac.actor_learning_rate": "1e-3:1e-1", "sac.tau": "1e-3:1e-1"}


@cache
def program(algorithm, count, platform):
    """Compiled once for all tests."""
    config = small(algorithm, SMALL if algorithm == "ippo" else SAC_SMALL)
    return Program(Run(Path(), config), count)


@pytest.fixture(autouse=True)
def game(monkeypatch):
    """Sweeps play a tiny game instead of physics."""
    monkeypatch.setattr(Cue, "engine", SimpleNamespace(name="mujoco"), raising=False)
    monkeypatch.setattr("assistax.training.run.Env", lambda *_: Cue())
    monkeypatch.setattr(
        "assistax.training.sweep.Program", lambda run, n: program(run.config.algorithm, n, jax.default_backend())
    )


def small(algorithm="ippo", settings=SMALL, **more):
    return configure("scratch", settings, algorithm=algorithm, num_envs=ENVS, steps=STEPS, num_seeds=2, **more)


def lines(sweep):
    return [json.loads(path.read_text()) for path in sorted(sweep.folder.glob("trials/*/trial.json"))]


def unfinished(folder):
    return list(folder.glob("trials/*/unfinished.safetensors")) + list(folder.glob("trials/*/pieces/*"))


# -- what is drawn -----------------------------------------------------------------------------


def test_numbers_are_log_uniform_and_choices_are_balanced():
    search = {"ppo.learning_rate": "1e-5:1e-2", "ppo.initial_log_std": "-2:1", **SEARCH["ppo"]}
    drawn = draw(search, 900, 0)
    rates = [one["ppo.learning_rate"] for one in drawn]
    assert scipy_stats.kstest(rates, scipy_stats.loguniform(1e-5, 1e-2).cdf).pvalue > 0.01
    assert (
        scipy_stats.kstest([one["ppo.initial_log_std"] for one in drawn], scipy_stats.uniform(-2, 3).cdf).pvalue > 0.01
    )
    assert all(float(f"{rate:.4g}") == rate for rate in rates)
    pairs = [(one["ppo.update_epochs"], one["ppo.num_minibatches"]) for one in drawn]
    assert {pairs.count(pair) for pair in set(pairs)} == {100} and len(set(pairs)) == 9
    assert draw(search, 900, 0) == drawn != draw(search, 900, 1)
    assert draw(search, 5, 0) == drawn[:5]


def test_the_papers_tables_lie_within_what_is_searched():
    for row, tasks in PRESETS["paper"].items():
        group = ALGORITHMS[row.split("_")[0]].group
        for settings in tasks.values():
            for name, interval in intervals(SEARCH[group]).items():
                assert interval.low < settings[name.split(".")[1]] < interval.high
            for name, values in choices(SEARCH[group]).items():
                assert settings[name.split(".")[1]] in values


@pytest.mark.parametrize(
    ("search", "words"),
    [
        ({}, "Nothing is left to search"),
        ({"ppo.gamma": ""}, "ppo.gamma has nothing to choose from"),
        ({"ppo.gamma": "0.9:x"}, "ppo.gamma takes LOW:HIGH"),
        ({"ppo.gamma": "0.9:0.8"}, "ppo.gamma takes LOW:HIGH"),
        ({"ppo.gama": "0.8:0.9"}, "Did you mean 'ppo.gamma'"),
        ({"ppo.num_steps": "8:16"}, "ppo.num_steps takes choices"),
        ({"ppo.gama": "0.8,0.9"}, "Did you mean 'ppo.gamma'"),
        ({"ppo.gamma": "0.9:2"}, "ppo.gamma must be in [0, 1]"),
        ({"ppo.num_minibatches": "2,3"}, "ppo.num_minibatches = 3"),
    ],
)
def test_what_cannot_be_searched_is_refused_and_no_folder_is_made(search, words, tmp_path):
    with pytest.raises(UsageError) as error:
        Sweep.create(small(), tmp_path / "sweep", 20, search)
    assert words in str(error.value) and "\n" not in str(error.value)
    assert not (tmp_path / "sweep").exists()
    with pytest.raises(UsageError, match="configs must be 1 or more"):
        Sweep.create(small(), tmp_path / "sweep", 0, SEARCHED)


def test_none_and_what_is_the_environments_can_be_searched(tmp_path):
    search = {"ppo.final_log_std": "None,-2.0", "env.torque_scale": "0.1,0.3"}
    found = Sweep.create(small(), tmp_path / "sweep", 4, search)
    assert Sweep.open(tmp_path / "sweep").drawn == found.drawn
    assert {tuple(one.values()) for one in found.drawn} == {(None, 0.1), (None, 0.3), (-2.0, 0.1), (-2.0, 0.3)}


def test_what_is_no_input_gets_a_program_of_its_own(tmp_path):
    sweep = Sweep.create(small(), tmp_path / "sweep", 12, SEARCHED | {"ppo.num_minibatches": "2,4,8"})
    assert sorted(map(len, sweep._programs)) == [4, 4, 4]
    for members in sweep._programs:
        wanted = {sweep.drawn[i]["ppo.num_minibatches"] for i in members}
        assert {sweep._runs[i].trainer.config.num_minibatches for i in members} == wanted and len(wanted) == 1
        assert len({id(sweep._runs[i]) for i in members}) == 1


# -- a trial is the ordinary run ---------------------------------------------------------------


def alone(config, seeds):
    """By seed, the return at the pace of every iteration of the ordinary run, from its rewards."""
    trainer = config.kind.trainer(Cue(), config.method, ENVS, 5)

    def iteration(state):
        state, batch = trainer.collect(state)
        if config.group == "sac":  # the newest rows of the replay
            rewards = jax.lax.dynamic_slice_in_dim(state.replay.rows["reward"]["team"], state.iteration * 80, 80)
        else:
            rewards = batch["rewards"]["robot"]
        return trainer.improve(state, batch)[0], rewards.mean()

    def returns(key):  # episodes are eight steps long
        return 8 * jax.lax.scan(lambda state, _: iteration(state), trainer.init(key), length=5)[1]

    returns = jax.jit(returns)
    return [returns(jax.random.key(seed)) for seed in seeds]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A sweep of two configurations and two seeds that nobody interrupted, and its ranking."""
    with pytest.MonkeyPatch.context() as patch:
        game.__wrapped__(patch)
        sweep = Sweep.create(small(), tmp_path_factory.mktemp("sweeps") / "whole", 2, SEARCHED)
        return sweep, sweep.run()


def check(sweep, ranking):
    """By (configuration, seed) the curves [5] of a finished sweep with two of each."""
    rows = lines(sweep)
    assert [entry["auc"] for entry in ranking] == sorted((entry["auc"] for entry in ranking), reverse=True)
    assert not unfinished(sweep.folder)
    for row in rows:
        assert row["settings"] == sweep.drawn[row["config"]] and row["steps"] == STEPS and not row["failed"]
        assert [steps for steps, _ in row["curve"]] == [80, 160, 240, 320, 400]
        assert math.isclose(row["auc"], np.mean([y for _, y in row["curve"]]), abs_tol=1e-3)
    curves = {(row["config"], row["seed"]): np.array(row["curve"])[:, 1] for row in rows}
    assert set(curves) == {(0, 0), (0, 1), (1, 0), (1, 1)}
    # Seeds and settings change far more than is tolerated below.
    assert all(np.abs(curves[a] - curves[b]).max() > 0.02 for a in curves for b in curves if a != b)
    return curves


def test_a_trial_is_the_ordinary_run_with_its_settings_and_seed(whole):
    curves = check(*whole)
    for i, settings in enumerate(whole[0].drawn):
        for seed, expected in enumerate(alone(with_settings(whole[0].config, settings), (0, 1))):
            np.testing.assert_allclose(curves[i, seed], expected, atol=2e-3)


def test_so_it_is_with_sac(tmp_path):
    sweep = Sweep.create(small("masac", SAC_SMALL), tmp_path / "sweep", 2, SAC_SEARCHED)
    curves = check(sweep, sweep.run())
    for seed, expected in enumerate(alone(with_settings(sweep.config, sweep.drawn[1]), (0, 1))):
        np.testing.assert_allclose(curves[1, seed], expected, atol=2e-3)


def test_so_it_is_side_by_side(whole, tmp_path, monkeypatch):
    """As on an accelerator: both configurations in one batch, with the first seed, then with the second."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    sweep = Sweep.create(small(), tmp_path / "sweep", 2, SEARCHED)
    curves = check(sweep, sweep.run())
    for trial, expected in check(*whole).items():
        np.testing.assert_allclose(curves[trial], expected, atol=2e-3)


# -- interruptions -----------------------------------------------------------------------------


class StopAfter:
    """A Ctrl-C that comes at the n-th time one is looked for."""

    signalled = False

    def __init__(self, n):
        self.left = n

    @property
    def asked(self):
        self.left -= 1
        return self.left < 0

    def __call__(self, seconds):
        return self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass


def test_stopped_anywhere_and_resumed_a_sweep_ends_as_one_left_alone(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(assistax.training.sweep.pieces, "PIECE", 8)
    folder, finished, result = tmp_path / "stopped", [], None
    Sweep.create(small(), folder, 2, SEARCHED)
    for times, steps in {7: 560, 2: 720, 0: 720, 6: 1200, 1000: 1600}.items():
        monkeypatch.setattr(assistax.training.sweep, "Stop", StopAfter(times))
        sweep = Sweep.open(folder)
        result = sweep.run()
        finished.append(len(lines(sweep)))
        assert sum(job.done() for job in sweep.jobs()) == steps
        assert result or len(unfinished(folder)) > 1
    assert finished == [1, 1, 1, 3, 4] and result == whole[1] and not unfinished(folder)

    def told(sweep):
        return [{name: value for name, value in row.items() if name != "seconds"} for row in lines(sweep)]

    assert told(sweep) == told(whole[0])
    before = lines(sweep)
    assert Sweep.open(folder).run() == whole[1] and lines(sweep) == before


def test_a_signal_in_the_last_iteration_of_a_trial_stops_all_the_same(tmp_path, monkeypatch):
    sweep = Sweep.create(small(), tmp_path / "sweep", 2, SEARCHED)
    late = StopAfter(1000)
    late.signalled = True
    monkeypatch.setattr(assistax.training.sweep, "Stop", late)
    assert sweep.run() is None and len(lines(sweep)) == 1


def test_machines_that_share_a_sweep_cut_it_alike(tmp_path, monkeypatch):
    """Begun on a CPU, for machines with an accelerator."""
    Sweep.create(small(), tmp_path / "sweep", 2, SEARCHED, side_by_side=2)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    (first, second) = Sweep.open(tmp_path / "sweep").jobs()
    assert (first.name, second.name) == ("0000-0", "0000-1") and first.size == 2 * STEPS
    with pytest.raises(UsageError, match="side_by_side must be 1 or more"):
        Sweep.create(small(), tmp_path / "none", 2, SEARCHED, side_by_side=0)


def test_a_checkpoint_that_goes_while_it_is_read_is_no_error(tmp_path, monkeypatch):
    """Another process has just finished the trial; what is damaged is told by whoever would continue from it."""
    sweep = Sweep.create(small(), tmp_path / "sweep", 2, SEARCHED)
    monkeypatch.setattr(assistax.training.sweep, "Stop", StopAfter(2))
    assert sweep.run() is None
    (path,) = sweep.folder.glob("trials/*/unfinished.safetensors")
    path.write_bytes(b"torn")
    assert [job.done() for job in sweep.jobs()] == [0, 0, 0, 0]
    with pytest.raises(UsageError, match=r"unfinished\.safetensors"):
        sweep.run()


def test_what_others_are_at_is_left_to_them(whole, tmp_path):
    folder = tmp_path / "shared"
    mine = Sweep.create(small(), folder, 2, SEARCHED)
    theirs = take(folder / "workers", "0001-0", [], 0)
    assert mine.run() is None and {(row["config"], row["seed"]) for row in lines(mine)} == {(0, 0), (0, 1), (1, 1)}
    theirs.release(None)
    assert mine.run() == whole[1]


def test_several_processes_find_what_one_does(tmp_path, monkeypatch):
    """Real ones, of the scratching task, with a core each."""
    monkeypatch.undo()
    words = "scratch", "--configs", 2, "--seeds", 2, "--steps", 128, "--num-envs", 4, "--search", "ppo.gamma=0.9:0.99"
    words += "--set", "ppo.num_steps=16", "ppo.hidden=(8,8)", "ppo.num_minibatches=1", "env.episode_length=30"
    words += "--executor-set", "cores=1", "--processes"
    for number in (1, 2):
        printed = assistax_command("sweep", *words, number, "--out", tmp_path / f"{number}").stdout
        assert "Best of 2" in printed
    one, two = (json.loads((tmp_path / f"{number}" / "ranking.json").read_text()) for number in (1, 2))
    assert one == two and [entry["seeds"] for entry in one] == [2, 2]


@pytest.fixture
def begun(tmp_path):
    """A sweep with the lines of two trials that have not really been trained."""
    sweep = Sweep.create(small(), tmp_path / "sweep", 2, SEARCHED)
    rows = [
        {"config": i, "seed": 0, "settings": sweep.drawn[i], "steps": STEPS} | outcome([[1.0 + i, 0, 0]], 80)
        for i in range(2)
    ]
    for row in rows:
        place = sweep.folder / "trials" / f"{row['config']:04d}-0"
        place.mkdir(parents=True)
        (place / "trial.json").write_text(json.dumps(row))
    return sweep


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda row: row["settings"].update({"ppo.gamma": 0.123}), "0001-0/trial.json is of another sweep"),
        (lambda row: row.update(steps=7), "0001-0/trial.json is of another sweep"),
        (lambda row: row.update(seed=5), "0001-0/trial.json is of another sweep"),
        (lambda row: row.update(seed=1), "0001-0/trial.json is of another sweep"),
        (lambda row: row.update(config=2), "0001-0/trial.json is of another sweep"),
        (lambda row: row.pop("auc"), "trial.json: it has no auc"),
    ],
)
def test_trials_that_do_not_belong_are_refused_and_kept(begun, change, words):
    assert [row["config"] for row in begun.trials().values()] == [0, 1]
    path = begun.folder / "trials" / "0001-0" / "trial.json"
    row = json.loads(path.read_text())
    change(row)
    path.write_text(json.dumps(row))
    with pytest.raises(UsageError, match=words):
        Sweep.open(begun.folder).run()
    assert json.loads(path.read_text()) == row


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda stored: stored["config"]["stamp"]["versions"].update(assistax="0.0.9"),
            "begun with assistax 0.0.9, now",
        ),
        (lambda stored: stored["config"]["stamp"].update(source="elsewhere"), "begun with source elsewhere, now"),
        (lambda stored: stored.pop("drawn"), "sweep.json: it has no drawn"),
        (lambda stored: stored["config"].pop("stamp"), "sweep.json: config has no stamp"),
    ],
)
def test_a_sweep_of_other_versions_or_a_damaged_one_is_refused(begun, change, words):
    path = begun.folder / "sweep.json"
    stored = json.loads(path.read_text())
    change(stored)
    path.write_text(json.dumps(stored))
    with pytest.raises(UsageError, match=words):
        Sweep.open(begun.folder)


def test_folders_that_are_not_a_sweep_or_in_use_are_refused(begun, tmp_path):
    (begun.folder / "sweep.json").write_text("{")
    with pytest.raises(UsageError, match="not JSON"):
        Sweep.open(begun.folder)
    with pytest.raises(UsageError, match="not a sweep folder"):
        Sweep.open(tmp_path)
    with pytest.raises(UsageError, match="already in use"):
        Sweep.create(small(), begun.folder, 2, SEARCHED)


# -- what trials came to -----------------------------------------------------------------------


def test_outcomes_by_hand():
    """Twenty points, so that the last tenth is two; of the eight episodes that ended there four succeeded."""
    points = [[float(k), 0, 0.0] for k in range(18)] + [[19.0, 4, 3.0], [21.0, 4, 1.0]]
    found = outcome(points, 100)
    assert found["curve"][0] == [100, 0.0] and found["curve"][-1] == [2000, 21.0]
    assert (found["auc"], found["final_return"], found["success"], found["failed"]) == (9.65, 20.0, 0.5, False)
    assert outcome(points[:18], 100)["success"] is None  # no episode has ended
    assert outcome([[1.0, 2, math.nan]], 100)["success"] is None  # a task without success
    failed = outcome([[1.0, 0, 0.0], [math.nan, 0, 0.0], [2.0, 0, 0.0]], 100)
    assert failed == {"curve": [[100, 1.0]], "auc": None, "final_return": None, "success": None, "failed": True}
    json.dumps(failed, allow_nan=False)


def row(config, seed, auc):
    more = {"final_return": auc, "success": None, "failed": auc is None}
    return {"config": config, "seed": seed, "settings": {"ppo.gamma": config}, "auc": auc} | more


def test_a_failed_seed_counts_as_the_worst_that_did_not_fail():
    ranking = rank([row(0, 0, 4.0), row(0, 1, 6.0), row(1, 0, 20.0), row(1, 1, None), row(2, 0, 2.0)])
    assert [(e["config"], e["auc"], e["seeds"], e["failed"]) for e in ranking] == [
        (1, 11.0, 2, 1),
        (0, 5.0, 2, 0),
        (2, 2.0, 1, 0),
    ]
    assert ranking[1]["interval"][0] < 5.0 < ranking[1]["interval"][1] and ranking[2]["interval"] is None
    assert rank([row(0, 0, None)])[0]["auc"] is None


def test_training_that_becomes_non_finite_has_failed_and_the_sweep_goes_on(tmp_path):
    sweep = Sweep.create(small(), tmp_path / "sweep", 2, {"ppo.learning_rate": "1e-3,1e30", "ppo.gamma": "0.9"})
    ranking = sweep.run()
    assert [entry["settings"]["ppo.learning_rate"] for entry in ranking] == [1e-3, 1e30]
    assert [entry["failed"] for entry in ranking] == [0, 2] and len(lines(sweep)) == 4
    texts = [path.read_text() for path in sweep.folder.rglob("*.json")]
    assert len(texts) == 2 + 4 and "NaN" not in "".join(texts)


def test_pictures_show_every_configuration_where_it_belongs(tmp_path):
    search = {"ppo.learning_rate": "1e-3:1e-1", "ppo.update_epochs": "4,8", "ppo.num_minibatches": "2,4"}
    drawn = draw(search, 12, 0)
    ranking = rank([row(i, 0, float(i)) | {"settings": settings} for i, settings in enumerate(drawn)])

    def dots(axis):
        return sorted(zip(*map(list, axis.lines[0].get_data()), strict=True))

    everything = sorted((one["ppo.learning_rate"], float(i)) for i, one in enumerate(drawn))
    rate, epochs, _ = overview(ranking, search, "title").axes
    assert dots(rate) == everything and rate.get_xscale() == "log"
    assert [round(x) for x, _ in dots(epochs)] == sorted(one["ppo.update_epochs"] // 4 - 1 for one in drawn)
    figure = facets(ranking, search, "ppo.learning_rate", "title")
    assert len(figure.axes) == 9 and dots(figure.axes[8]) == everything
    assert dots(figure.axes[0]) == [
        (x, y)
        for x, y in everything
        if (drawn[int(y)]["ppo.update_epochs"], drawn[int(y)]["ppo.num_minibatches"]) == (4, 2)
    ]
    for nothing in ([], rank([row(0, 0, None) | {"settings": drawn[0]}])):
        for figure in (overview(nothing, search, "title"), facets(nothing, search, "ppo.learning_rate", "title")):
            figure.savefig(io.BytesIO())
            assert not any(axis.lines for axis in figure.axes)
    alone = facets(ranking, {"ppo.learning_rate": "1e-3:1e-1"}, "ppo.learning_rate", "title")
    assert len(alone.axes) == 1 and dots(alone.axes[0]) == everything
