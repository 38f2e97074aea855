"""Frozen partners: who may play where, and that a run keeps the one that it was begun with."""

import json
import shutil

import jax
import numpy as np
import pytest
from stored import small, store_checkpoint, stored_run, stored_team

import assistax
from assistax.adapters.partner import Batch
from assistax.errors import UsageError
from assistax.learning.ppo import PPO, PPOConfig
from assistax.policies import Player, Still
from assistax.training.checkpoint import load_checkpoint, save_checkpoint
from assistax.training.configuration import to_json, trained_env
from assistax.training.partners import find_partner
from assistax.training.run import Run
from assistax.training.search import SEARCH
from assistax.training.sweep import Sweep
from assistax.training.team_file import load_team, params_like


def same(one, other) -> bool:
    one, other = (getattr(x, "player", x) for x in (one, other))
    pairs = zip(jax.tree.leaves(one.params), jax.tree.leaves(other.params), strict=True)
    return one.policy == other.policy and one.members == other.members and all((a == b).all() for a, b in pairs)


def make_run(folder):
    return stored_run(folder, small(num_seeds=2)).folder


def make_team(folder):
    return stored_team(folder.with_suffix(".safetensors"), small())


@pytest.mark.parametrize("make", [make_run, make_team])
def test_a_run_keeps_its_partner(tmp_path, make):
    there = make(tmp_path / "there")
    config = small(partners=(f"human={there}",))
    run = Run.create(config, tmp_path / "run")
    partner = run.partners["human"].player
    assert partner.members == (2 if there.is_dir() else 1) and partner.policy.deterministic != there.is_dir()
    if there.is_dir():  # prolonged
        store_checkpoint(Run.open(there), 128, seed=1)
    else:
        stored_team(there, small(), seed=1)
    assert not same(partner, find_partner(str(there), run.env, "human").player)
    assert same(partner, Run.open(run.folder).partners["human"].player)
    there.rename(tmp_path / "moved")
    again = Run.open(run.folder)
    assert same(partner, again.partners["human"].player)
    stored = json.loads((run.folder / "config.json").read_text())
    assert stored["partner_copies"] == list(again.config.partner_copies)
    assert len(stored["partner_copies"][0]) == len("human=") + 64


def test_two_partners_for_one_agent_are_refused(tmp_path):
    with pytest.raises(UsageError, match="The human has two partners; name one"):
        Run.create(small(partners=("human=still", "human=offer")), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_who_did_not_learn_in_a_run_is_no_partner_from_it(tmp_path):
    run = stored_run(tmp_path / "run", small(partners=("human=still",)))
    with pytest.raises(UsageError, match=r"The human of .* did not learn; name who played it: human=still"):
        find_partner(str(run.folder), run.env, "human")
    assert find_partner(str(run.folder), run.env, "robot").player.members == 1


def test_another_partner_in_its_place_is_refused(tmp_path):
    there = make_team(tmp_path / "there")
    one, two = (Run.create(small(partners=(f"human={there}",)), tmp_path / name) for name in ("one", "two"))
    assert one.config.partner_copies == two.config.partner_copies
    stored_team(there, small(), seed=1)
    other = Run.create(small(partners=(f"human={there}",)), tmp_path / "other")
    assert other.config.partner_copies != one.config.partner_copies
    copy = one.folder / "partners" / "human.safetensors"
    shutil.copy(other.folder / "partners" / "human.safetensors", copy)
    with pytest.raises(UsageError, match=r"human\.safetensors is not the partner that this run was begun with"):
        Run.open(one.folder)
    content = bytearray((two.folder / "partners" / "human.safetensors").read_bytes())
    content[-1] ^= 1
    copy.write_bytes(content)
    with pytest.raises(UsageError, match=r"human\.safetensors is damaged"):
        Run.open(one.folder)
    copy.unlink()
    with pytest.raises(UsageError, match=r"Cannot read .*human\.safetensors"):
        Run.open(one.folder)


def test_a_run_of_an_earlier_version_reads_its_partner_where_it_was(tmp_path):
    there = make_team(tmp_path / "there")
    run = Run.create(small(partners=(f"human={there}",)), tmp_path / "run")
    shutil.rmtree(run.folder / "partners")
    path = run.folder / "config.json"
    stored = json.loads(path.read_text())
    del stored["partner_copies"]
    path.write_text(json.dumps(stored))
    assert same(run.partners["human"], Run.open(run.folder).partners["human"].player)


def test_a_sweep_keeps_its_partner(tmp_path):
    there = make_team(tmp_path / "there")
    search = {"ppo.learning_rate": SEARCH["ppo"]["ppo.learning_rate"]}
    sweep = Sweep.create(small(partners=(f"human={there}",)), tmp_path / "sweep", 1, search)
    there.unlink()
    partners = [next(iter(one._runs.values())).partners["human"] for one in (sweep, Sweep.open(sweep.folder))]
    assert same(*partners)


@pytest.mark.parametrize("make", [make_run, make_team])
def test_a_partner_of_another_task_is_refused(tmp_path, make):
    """The person of scratch observes and does as much as that of bed bath."""
    there = make(tmp_path / "there")
    for task in ("bed_bath-v1", "feeding-v3", "scratch-v1"):
        said = f"is of scratch-v3 and cannot play the human in {task}; name the task scratch-v3"
        with pytest.raises(UsageError, match=said) as error:
            Run.create(small(task, partners=(f"human={there}",)), tmp_path / "run")
        assert "\n" not in str(error.value) and not (tmp_path / "run").exists()


@pytest.mark.parametrize("make", [make_run, make_team])
def test_a_partner_that_observes_something_else_is_refused(tmp_path, make):
    there = make(tmp_path / "there")
    config = small(settings={"env.human.preference": "sweep"}, partners=(f"human={there}",))
    with pytest.raises(UsageError, match=r"human of .* observes \d+ numbers, but the human here \d+"):
        Run.create(config, tmp_path / "run")


def test_weights_that_are_not_numbers_are_named(tmp_path):
    path, config = make_team(tmp_path / "team"), small()
    params = load_checkpoint(path, params_like(trained_env(config)[1]))
    weights = np.array(params["robot"]["actor"]["layers"][0]["w"])
    weights[0, 0] = np.nan
    params["robot"]["actor"]["layers"][0]["w"] = weights
    save_checkpoint(path, params, {"team": to_json(config)})
    for use in (lambda: load_team(path), lambda: Run.create(small(partners=(f"robot={path}",)), tmp_path / "run")):
        with pytest.raises(UsageError, match=r"team\.safetensors is damaged: \['robot'\].* not finite"):
            use()


def test_ones_own_player_trains_and_resumes_where_it_is_given(tmp_path):
    env_size = 3
    mine = {"human": Player(Still(env_size))}
    run = Run.create(small(), tmp_path / "run", mine)
    assert run.trainer.learners == ("robot",) and run.config.partners == ("human=given",)
    store_checkpoint(run, 64)
    with pytest.raises(UsageError, match="a player that Python code has made"):
        Run.open(run.folder)
    again = Run.open(run.folder, players=mine)
    assert again.teams()[0]["human"] is mine["human"] and again.teams()[0]["robot"].members == 1


def test_a_memory_is_kept_for_as_long_as_the_partner_stays():
    env = assistax.make("scratch-v3", episode_length=3, human={"redraw_every": 2})
    settings = PPOConfig(num_steps=12, num_minibatches=1, update_epochs=1, hidden=(4,), recurrent=True, stagger=False)
    still = Player(Still(env.action_sizes["human"]), jax.numpy.zeros((5, 1)), 5)
    ppo = PPO(env, settings, 4, 2, {"human": still})
    _, batch = jax.jit(lambda key: ppo.collect(ppo.init(key)))(jax.random.key(0))
    np.testing.assert_array_equal(batch["done"][:, 0], np.arange(12) % 3 == 2)
    np.testing.assert_array_equal(batch["reset"][:, 0], np.arange(12) % 6 == 0)


def test_a_partner_stays_in_the_adapters_too():
    env = assistax.make("scratch-v3", episode_length=2, human={"redraw_every": 3})
    batch, size = Batch(env), env.action_sizes["human"]
    people = {"human": Player(Still(size), jax.numpy.zeros((50, 1)), 50)}
    _, state = batch.reset(people, jax.random.split(jax.random.key(0), 4))
    who = []
    for _ in range(12):
        who.append(np.asarray(state.partners["human"]["index"]))
        state, _ = batch.step("same_step", people, state, {"robot": jax.numpy.zeros((4, 7))})
    meetings = np.stack(who).reshape(2, 6, 4)  # three episodes of two steps
    assert (meetings == meetings[:, :1]).all() and (meetings[0, 0] != meetings[1, 0]).any()
