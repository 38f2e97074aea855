"""Plans of populations: interrupted, shared or in one go, the same population comes of them."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from commands import assistax as assistax_command
from stored import SMALL

from assistax.errors import UsageError
from assistax.evaluation.playing import Evaluator, summarize
from assistax.human import Person
from assistax.teamwork import gather as gathering
from assistax.teamwork.plan import Plan, training
from assistax.teamwork.plan import train as train_plan
from assistax.training import journal, loop, splits
from assistax.training.population import Population
from assistax.training.run import Run


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    people = Person("none", "default"), Person("tremor", "default")
    settings = SMALL | {"evaluations": 4, "evaluation_episodes": 3}
    return Plan("scratch", people, steps=256, num_envs=8, settings=settings, taught=("offers", "offers_second_way"))


@pytest.fixture(scope="module")
def in_one_go(plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plans") / "one"
    plan.save(folder)
    return folder, train_plan(folder)


def test_a_plan_in_shards_with_interruptions_is_the_plan_in_one_go(plan, in_one_go, tmp_path, monkeypatch):
    _, whole = in_one_go
    assert len(set(whole.ids)) == 6 and [row.get("fraction") for row in whole.rows[:3]] == [None, 0.333, 0.667]
    folder = tmp_path / "pop"
    plan.save(folder)
    assert train_plan(folder, (2, 2)) is None  # the other shard has not begun
    number = iter(range(100))
    wait = loop._Training._rows

    def interrupted(self, *args):
        if next(number) == 0:
            self.stop._first = 0.0  # as a signal does
        return wait(self, *args)

    monkeypatch.setattr(loop._Training, "_rows", interrupted)
    made, tries = None, 0
    while made is None:
        made, tries = train_plan(folder, (1, 2)), tries + 1
    assert tries > 1 and made.ids == whole.ids and made.hash == whole.hash
    for mine, row in zip(made.rows, whole.rows, strict=True):
        assert mine == row
    assert Population.load(folder).ids == whole.ids
    monkeypatch.setattr(loop, "train", None)  # nobody is trained again
    assert train_plan(folder).ids == whole.ids


def test_a_member_plays_as_in_its_run(in_one_go):
    folder, population = in_one_go
    run = Run.open(folder / "runs/0001-ippo-0")
    assert population[3]["person"]["disability"] == "tremor"
    assert (population[0]["taught"], population[3]["taught"]) == ("offers", "offers_second_way")
    one = population.select([population.ids[3]])
    team = {agent: one.partner(agent, deterministic=True) for agent in ("robot", "human")}
    report = summarize(Evaluator(run.env, 3)(team))
    assert report["mean_return"] == pytest.approx(population[3]["mean_return"], rel=0.01)


def test_earlier_selves_are_as_good_as_they_were_and_go_with_their_members(in_one_go):
    folder, population = in_one_go
    run = Run.open(folder / "runs/0000-ippo-0")
    rows = [row for row in journal.read(run.folder, "evaluations")]
    for row in population.rows[1:3]:
        assert 0 < row["steps"] < 256 and row["person"]["disability"] == "none"
        then = next(one for one in rows if one["steps"] == row["steps"])
        assert row["mean_return"] == pytest.approx(np.mean(then["episodes"]["return"]))
        one = population.select([row["id"]])
        team = {agent: one.partner(agent, deterministic=True) for agent in ("robot", "human")}
        assert summarize(Evaluator(run.env, 3)(team))["mean_return"] == pytest.approx(row["mean_return"], rel=0.01)
    parts = splits.split(population, "disability")
    assert sorted(len(ids) for ids in parts.values()) == [0, 1, 1]
    splits.save(splits.path_of(folder, "disability"), parts)
    _, fcp = splits.named(f"{folder}:disability/train+earlier")
    assert len(fcp) == 3 and len({row["person"]["disability"] for row in fcp.rows}) == 1


def test_earlier_selves_are_those_a_third_and_two_thirds_of_the_way(monkeypatch):
    """Success comes at once here: of the steps without it, the one with a third of the return."""
    curve = {100: (0, 0.0), 200: (300, 0.0), 300: (450, 0.0), 400: (900, 1.0), 500: (700, 1.0)}
    rows = [{"seed": 7, "steps": n, "episodes": {"return": [r], "success": [s]}} for n, (r, s) in curve.items()]
    monkeypatch.setattr(gathering.journal, "read", lambda *_: rows)
    run = SimpleNamespace(folder=None, seeds=SimpleNamespace(seeds=[7]), earlier_teams=lambda steps: [f"team {steps}"])
    final = {"steps": 600, "mean_return": 1000.0, "success_rate": 1.0}
    found = gathering._earlier(run, {"seed": 7}, final)
    assert [(row["fraction"], team) for row, team in found] == [(0.333, "team 200"), (0.667, "team 500")]


def test_every_habit_is_taught_as_often_and_another_with_another_seed():
    people = tuple(Person(name) for name in ("none", "tremor", "weakness", "limited_range"))
    plan = Plan("scratch", people, seeds=2, taught=("offers", "shy"))
    taught = {name: config.method.teachers for name, config in plan.jobs()}
    assert taught["0000-ippo-0"] == ("robot=expert", "human=offers") == taught["0001-ippo-1"]
    assert taught["0000-ippo-1"] == ("robot=expert", "human=shy") == taught["0003-ippo-0"]
    assert sorted(x[1] for x in taught.values()) == ["human=offers"] * 4 + ["human=shy"] * 4
    ((_, liking),) = Plan("scratch", (Person("none", "default"),), taught=("offers",)).jobs()
    assert liking.method.teachers == ("robot=considerate", "human=offers")
    with pytest.raises(UsageError, match="Unknown habit 'offer'"):
        Plan("scratch", people, taught=("offer",))
    with pytest.raises(UsageError, match="Only PPO can be taught habits: leave out --taught or masac"):
        Plan("scratch", people, ("ippo", "masac"), taught=("offers",))


def test_a_plan_with_a_list_is_the_same_when_it_is_named_again(tmp_path):
    plan = Plan("scratch", (Person("none"),), settings={"ppo.hidden": [64, 64]})
    plan.save(tmp_path / "plan")
    plan.save(tmp_path / "plan")
    assert Plan.load(tmp_path / "plan") == plan


def test_a_folder_that_a_killed_worker_had_begun_is_begun_anew(plan, tmp_path, monkeypatch):
    name, config = next(iter(plan.jobs()))
    (tmp_path / name / "checkpoints").mkdir(parents=True)
    monkeypatch.setattr(loop, "train", lambda run, **_: run.folder)
    assert training(tmp_path / name, config).do() and (tmp_path / name / "config.json").exists()


def test_another_plan_is_refused(plan, in_one_go, tmp_path):
    folder, _ = in_one_go
    plan.save(folder)
    for other in (dataclasses.replace(plan, seeds=2), dataclasses.replace(plan, people=plan.people[:1])):
        with pytest.raises(UsageError, match="by another plan"):
            other.save(folder)
    with pytest.raises(UsageError, match="Who the members are says --people"):
        dataclasses.replace(plan, settings={"env.human.disability": "tremor"})
    with pytest.raises(UsageError, match=r"has no plan\.json"):
        train_plan(tmp_path)
    for words in (
        ("train", "scratch"),  # no --out
        ("train", "--resume", folder, "--shard", "3/2"),
        ("train",),
        ("train", "--resume", folder, "--processes", "1000"),
    ):
        with pytest.raises(SystemExit):
            assistax_command("population", *words)
