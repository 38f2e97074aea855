"""Others' tasks and algorithms, from files outside the package, with all commands and from entry points."""

import json
import sys
from importlib.metadata import EntryPoint
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest
from commands import assistax
from pages import DOCS, imported, python_blocks

from assistax.env import make
from assistax.errors import UsageError
from assistax.evaluation.film import Camera
from assistax.learning.algorithms import ALGORITHMS, Algorithm
from assistax.registry import Registry
from assistax.tasks import TASKS, TaskSpec, register_task
from assistax.training.configuration import configure
from assistax.training.sweep import Sweep

SMALL = ["--num-envs", "4", "--set", "evolution.num_steps=8", "env.episode_length=16"]


@pytest.fixture(scope="module")
def package(registries, tmp_path_factory):
    """Somebody's package: the task and the algorithm of the docs."""
    folder = tmp_path_factory.mktemp("package")
    blocks = {name: python_blocks(DOCS / f"your_{name}.md")[0] for name in ("task", "algorithm")}
    return {name: imported(folder / f"{name}.py", code) for name, code in blocks.items()}


@pytest.fixture(scope="module")
def run(package, tmp_path_factory):
    """A finished run of another's algorithm on another's task."""
    folder = tmp_path_factory.mktemp("runs") / "toy"
    more = ["evaluations=1", "evaluation_episodes=2"]
    assistax("train", "showing", "--algorithm", "evolution", "--steps", 64, "--out", folder, *SMALL, *more)
    return folder


def test_they_train_and_evaluate(run):
    summary = json.loads((run / "summary.json").read_text())
    assert (summary["task"], summary["algorithm"], summary["steps"]) == ("showing-v0", "evolution", 64)
    assert summary["evaluation"][0]["outcomes"]["seconds_shown"]["mean"] >= 0
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert len(rows) == 2 and rows[-1]["losses"]["human"]["change"] > 0 and rows[-1]["reward"]["reach"] > 0
    report = json.loads(assistax("evaluate", run, "--episodes", 2, "--json").stdout)
    assert report["mean_return"] == pytest.approx(summary["mean_return"], rel=1e-5)


def test_they_are_filmed(run, tmp_path):
    try:
        Camera("showing", 16, 16).close()
    except UsageError as error:
        if not str(error).startswith("Cannot render here"):
            raise
        pytest.skip(str(error))
    assert (run / "rollout.mp4").stat().st_size
    film = tmp_path / "last.png"
    assistax("render", run, "--out", film)
    assert film.read_bytes().startswith(b"\x89PNG")


def test_a_team_of_theirs_fits_into_a_file(run, tmp_path):
    path = tmp_path / "team.safetensors"
    assistax("export", run, "--out", path)
    there, here = (json.loads(assistax("evaluate", what, "--episodes", 2, "--json").stdout) for what in (path, run))
    assert there["mean_return"] == pytest.approx(here["mean_return"], rel=1e-2)


def test_their_hyperparameters_are_searched(package, tmp_path):
    folder = tmp_path / "sweep"
    search = ["--search", "evolution.noise=0.01:0.3", "--configs", 2, "--seeds", 1, "--steps", 32]
    here = ["--processes", 1]  # other processes do not know what is registered in this one alone
    assistax("sweep", "showing", "--algorithm", "evolution", *search, *here, "--out", folder, *SMALL)
    ranking = json.loads((folder / "ranking.json").read_text())
    assert len(ranking) == 2 and ranking[0]["auc"] >= ranking[1]["auc"] > 0 and (folder / "sweep.png").exists()


def test_a_search_without_tuned_settings_compiles_every_configuration(package, tmp_path):
    algorithm = package["algorithm"]

    class Fixed(algorithm.Evolution):
        def init(self, key, tuned=None):
            return {"params": super().init(key).params, "normalizer": {}}

    ALGORITHMS.register(Algorithm("fixed", Fixed, algorithm.EvolutionConfig, group="fixed"))
    drawn = [{"evolution.noise": 0.1}, {"evolution.noise": 0.2}]
    for name, programs in {"evolution": [[0, 1]], "fixed": [[0], [1]]}.items():
        mine = [{key.replace("evolution", name): value for key, value in one.items()} for one in drawn]
        config = configure("showing", {}, algorithm=name, num_envs=4)
        sweep = Sweep(tmp_path, config, {f"{name}.noise": "0.05:0.3"}, mine)
        assert sweep._programs == programs
    assert [sweep._runs[i].trainer.config.noise for i in (0, 1)] == [0.1, 0.2]


def test_a_search_needs_a_name_where_there_is_no_list(package, capsys):
    with pytest.raises(SystemExit):
        assistax("sweep", "showing", "--algorithm", "evolution", *SMALL)
    assert "Name one with --search" in capsys.readouterr().err


def test_tables_show_what_is_missing(run):
    (row,) = json.loads(assistax("table", run, "--json").stdout)["experiments"]
    assert row["task"] == "showing-v0" and row["of_bound"] is None and row["of_expert"] is None
    printed = assistax("table", run, "--markdown").stdout
    head, _, cells = (line.strip("| ").split(" | ") for line in printed.splitlines()[:3])
    cell = dict(zip(head, cells, strict=True))
    assert cell["of the bound"] == cell["of the expert"] == "–"
    assert "–: " in printed


def test_presets_fall_back_to_the_default_row(package):
    ours, theirs = configure("scratch-v0", {}), configure("showing", {})
    assert theirs.method == ours.method and theirs.num_envs == ours.num_envs and theirs.task == "showing-v0"
    assert configure("showing", {}, algorithm="evolution").method == package["algorithm"].EvolutionConfig()
    for choices in ({}, {"algorithm": "evolution"}):
        with pytest.raises(UsageError, match="The preset 'paper' has no settings for"):
            configure("showing", {}, preset="paper", **choices)


def test_their_people_can_have_preferences(package):
    preferring = {"preference": "sweep"}
    env = make("showing", human=preferring)
    _, state = env.reset(jax.random.key(0))
    *_, info = env.step(jax.random.key(1), state, {agent: jnp.zeros(n) for agent, n in env.action_sizes.items()})
    assert sum(name.startswith("prefer") for name in info["reward_terms"]) == 4
    lacking = type("Lacking", (package["task"].Showing,), {"tool_speed": property()})  # there is none
    register_task(TaskSpec("lacking", 0, lacking, package["task"].SPEC.scene))
    assert make("lacking").name == "lacking-v0"
    with pytest.raises(UsageError, match="need tool_speed of a task, which lacking-v0 does not have"):
        make("lacking", human=preferring)


def test_what_they_lack_is_refused_in_one_line(package, capsys):
    for args, words in {
        ("evaluate", "showing", "--policy", "expert"): "There is no scripted robot for showing-v0",
        ("evaluate", "showing", "--policy", "trained"): "No trained team comes with showing",
        ("train", "showing", "--algorithm", "evolution", "--recurrent"): "--recurrent does not exist for evolution",
        ("train", "scratch", "--algorithm", "evolution", "--set", "ppo.gamma=1"): "ppo.gamma does not exist for evol",
    }.items():
        with pytest.raises(SystemExit):
            assistax(*args)
        assert words in capsys.readouterr().err


def test_names_that_are_taken_are_refused(package):
    task = package["task"]
    with pytest.raises(UsageError, match="The task 'showing-v0' is registered already"):
        task.assistax.register_task(TaskSpec("showing", 0, task.Showing, task.SPEC.scene))
    newer = task.assistax.register_task(TaskSpec("showing", 1, task.Showing, task.SPEC.scene))
    assert configure("showing", {}).task == newer.id
    del TASKS._things[newer.id]
    with pytest.raises(UsageError, match="The algorithm 'ippo' is registered already"):
        ALGORITHMS.register(Algorithm("ippo", object, object, "ppo"))


def entry_points(monkeypatch, **points):
    """Pretend that packages are installed with these entry points of the group "toys"."""
    found = {"toys": [EntryPoint(name, value, "toys") for name, value in points.items()]}
    monkeypatch.setattr("assistax.registry.metadata.entry_points", lambda group: found.get(group, []))


def test_installed_packages_register_by_entry_points(monkeypatch):
    toys = SimpleNamespace(BEAR="bear")
    monkeypatch.setitem(sys.modules, "toy_package", toys)
    entry_points(monkeypatch, bear="toy_package:BEAR")
    registry: Registry[str] = Registry("toy", str, "toys")
    registry.register("duck")
    assert list(registry) == ["duck", "bear"] and "bear" in registry and registry["bear"] == "bear"


def test_a_package_that_cannot_be_loaded_is_named_every_time(monkeypatch):
    entry_points(monkeypatch, bear="no_such_package:BEAR")
    registry: Registry[str] = Registry("toy", str, "toys")
    for look in (lambda: list(registry), lambda: registry["bear"], lambda: "duck" in registry):
        with pytest.raises(UsageError, match=r"toy 'bear' .* cannot be loaded from no_such_package:BEAR: ModuleNotF"):
            look()
