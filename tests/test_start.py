"""Trainings that begin with what another run has learned."""

import shutil
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from stored import small, stored_run, train_without_pictures

from assistax.errors import UsageError
from assistax.teamwork.gather import gather, taught
from assistax.teamwork.strangers import knows
from assistax.training import loop
from assistax.training.configuration import configure
from assistax.training.run import Run

LIMITED = {"ppo.cost_limit": 2.0, "evaluations": 1, "evaluation_episodes": 4}


@pytest.fixture(scope="module")
def there(tmp_path_factory) -> Path:
    """A run that has learned for two iterations."""
    settings = LIMITED | {"ppo.teachers": ("robot=expert", "human=offers_second_way"), "ppo.initial_log_std": -1.0}
    settings |= {"ppo.final_log_std": -3.0, "ppo.exploration_steps": 256}
    run = Run.create(small("scratch-v3", settings, steps=128), tmp_path_factory.mktemp("start") / "there")
    train_without_pictures(run)
    return run.folder


def like(there: Path, folder: Path, task="scratch-v3", **settings) -> Run:
    return Run.create(small(task, LIMITED | settings, steps=64, start=str(there)), folder)


def fresh(run: Run):
    return jax.jit(run.init)(jax.random.key(0))


def learned(run: Run):
    """What a run's newest checkpoint holds."""
    training = loop._Training(run, loop.Stop(np.inf))
    return training._start()[0][0]


def equal(one, other) -> bool:
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return all(np.array_equal(a, b) for a, b in pairs)


def test_a_run_begins_with_all_that_another_has_learned(there, tmp_path):
    then = learned(Run.open(there))
    moved = shutil.copytree(there, tmp_path / "copy")
    run = like(moved, tmp_path / "run")
    shutil.rmtree(moved)  # the run has its own copy
    now = fresh(Run.open(run.folder))
    assert equal((now.params, now.normalizer), (then.params, then.normalizer))
    assert now.iteration == 0 and jax.tree.leaves(now.opt_state)[0] == 0
    assert now.constraint.excess == then.constraint.excess == -1.0  # a cost of nothing
    assert now.constraint.so_far.shape == (8,) and not now.constraint.so_far.any()
    assert not equal(now.params, run.trainer.init(jax.random.key(0)).params)


def test_who_begins_with_a_run_is_not_taught_and_explores_no_more_than_it_did(there, tmp_path):
    run = like(there, tmp_path / "run")
    assert run.config.method.teachers == ()
    assert run.config.method.initial_log_std == pytest.approx(-2.0)  # 128 of the 256 steps from -1 to -3
    assert like(there, tmp_path / "other", **{"ppo.initial_log_std": -1.5}).config.method.initial_log_std == -1.5
    assert taught(run) == "offers_second_way"


def test_who_begins_with_a_run_that_was_stopped_explores_as_it_did(there, tmp_path):
    stopped = Run.create(Run.open(there).config, tmp_path / "stopped")
    assert loop.train(stopped, seconds=1e-3) is None  # after an iteration
    run = like(stopped.folder, tmp_path / "run")
    assert run.config.method.initial_log_std == pytest.approx(-1.5)  # 64 of the 256 steps from -1 to -3


def test_costs_are_in_the_unit_that_the_critic_of_the_run_before_knows(there, tmp_path):
    run = like(there, tmp_path / "run")
    state, batch = jax.jit(run.trainer.collect)(fresh(run))
    batch["cost"] = jnp.ones_like(batch["cost"])
    improve = jax.jit(run.trainer.improve)

    def after(per_step):
        begun = replace(state, constraint=replace(state.constraint, per_step=jnp.float32(per_step)))
        return improve(begun, batch)[0].constraint.per_step

    assert after(0.25) == 0.25 and after(0.0) == 1.0  # that of the first iteration, where nothing was known


def test_the_first_iteration_learns_with_the_numbers_that_it_was_played_with(there, tmp_path):
    run = like(there, tmp_path / "run", **{"ppo.learning_rate": 1e-9})
    state, batch = jax.jit(run.trainer.collect)(fresh(run))
    _, losses = jax.jit(run.trainer.improve)(state, batch)
    for agent in run.trainer.learners:
        assert abs(losses[agent]["approx_kl"]) < 1e-5


def test_a_robot_alone_may_begin_with_that_of_a_team(there, tmp_path):
    config = small("scratch-v3", LIMITED, steps=64, start=str(there), partners=("human=still",))
    run = Run.create(config, tmp_path / "run")
    state = fresh(run)
    assert equal(state.params["robot"], learned(Run.open(there)).params["robot"]) and set(state.params) == {"robot"}


def test_whom_a_run_began_with_it_has_met(there, tmp_path):
    people = gather([Run.open(there)])

    def robot(name, start=""):
        config = small("scratch-v3", LIMITED, steps=64, start=str(start), partners=("human=still",))
        run = Run.create(config, tmp_path / name)
        train_without_pictures(run)
        return run

    then = robot("then", there)
    assert [knows(run, people) for run in (then, robot("later", then.folder))] == [[True], [True]]
    assert knows(robot("stranger"), people) == [False]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"task": "feeding-v3"}, r"is of the task scratch-v3, not feeding-v3"),
        ({"ppo.hidden": (8, 4)}, r"does not fit this configuration: \.params.* is \(1, .*\), not \(1, .*\)"),
    ],
)
def test_what_cannot_be_begun_with_is_refused_and_nothing_is_written(there, tmp_path, settings, said):
    with pytest.raises(UsageError, match=said):
        like(there, tmp_path / "run", **settings)
    assert not (tmp_path / "run").exists()


def test_runs_of_several_seeds_or_none_are_refused(there, tmp_path):
    two = stored_run(tmp_path / "two", small("scratch-v3", num_seeds=2)).folder
    empty = Run.create(small("scratch-v3"), tmp_path / "empty").folder
    for start, said in (
        (two, "is of 2 seeds; begin with a run of one"),
        (Run.create(configure("scratch-v3", {}, algorithm="masac"), tmp_path / "sac").folder, "masac, not ippo"),
        (empty, "has no checkpoint to begin with"),
        (tmp_path / "nowhere", "nowhere is not a run folder"),
    ):
        with pytest.raises(UsageError, match=said):
            like(start, tmp_path / "run")


def test_a_started_run_continues_where_it_stopped(there, tmp_path):
    whole = like(there, tmp_path / "whole")
    train_without_pictures(whole)
    shutil.rmtree(whole.folder / "start")  # its own checkpoints have all of it
    with pytest.raises(UsageError, match="whole has lost its folder start"):
        taught(whole)
    prolonged = Run.open(whole.folder, steps=128)
    train_without_pictures(prolonged)
    assert jnp.isfinite(learned(prolonged).params["robot"]["actor"]["log_std"]).all()
