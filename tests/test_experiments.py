"""What is finished is kept whole, what is not goes on where it stopped."""

from dataclasses import dataclass
from pathlib import Path

import pytest
from commands import assistax
from pages import DOCS

import assistax.experiments as all_experiments
from assistax.cli.common import duration
from assistax.errors import UsageError
from assistax.executors.local import Local
from assistax.experiments import advance, choose_experiments, experiments, status
from assistax.training import splits
from assistax.training.population import Population


@dataclass(frozen=True)
class Counting:
    """Needs `pieces` calls; leaves a folder, or a file if it is called so."""

    name: str
    pieces: int
    shows = "counting"

    def progress(self, work: Path) -> float:
        return len(list(work.glob("piece*"))) / self.pieces

    def advance(self, work: Path, seconds: float):
        work.mkdir(parents=True, exist_ok=True)
        done = len(list(work.glob("piece*"))) + 1
        (work / f"piece{done}").write_text(str(done))
        if done < self.pieces:
            return None
        last = work / f"piece{done}"
        return last if self.name.endswith(".json") else [work / "piece1", last]


def test_pieces_add_up_and_nothing_is_done_twice(tmp_path):
    results, work = tmp_path / "results", tmp_path / "work"
    chosen = [Counting("quick/one.json", 1), Counting("long", 3), Counting("later", 1)]
    assert [e.name for e in advance(chosen, results, work, 60)] == ["quick/one.json"]
    assert [fraction for _, fraction in status(chosen, results, work)] == [1.0, pytest.approx(1 / 3), 0.0]
    assert advance(chosen, results, work, 60) == []
    (results / "long.part").mkdir()  # of an earlier attempt, cut short
    (results / "long.part" / "rubbish").touch()
    assert [e.name for e in advance(chosen, results, work, 60)] == ["long", "later"]
    assert sorted(p.name for p in (results / "long").iterdir()) == ["piece1", "piece3"]
    assert (results / "quick" / "one.json").read_text() == "1"
    assert sorted(p.name for p in results.iterdir()) == ["later", "long", "quick"]
    assert advance(chosen, results, work, 60) == [] and [f for _, f in status(chosen, results, work)] == [1.0] * 3


def test_an_executor_does_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    chosen = [Counting("one", 1), Counting("quick/two.json", 3)]
    monkeypatch.setattr(all_experiments, "experiments", lambda seeds: chosen)
    started = []

    def start(self, command, logs):
        started.append(command[2:])
        advance(chosen, Path("results"), Path("runs/reproduce"), 60)
        return []

    monkeypatch.setattr(Local, "start", start)
    monkeypatch.setattr(Local, "seconds", 0.01)
    printed = assistax("reproduce", "--only", "*", "--processes", 2).stdout
    assert printed.endswith("\nfinished 2, 0 left\n") and len(started) == 3
    assert started[0] == ["assistax", "reproduce", "--budget", "100000h", "--only", "*"]
    with pytest.raises(SystemExit):
        assistax("reproduce", "--budget", "9m", "--processes", 2)


def test_a_budget_too_short_for_one_says_how_far_it_is(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refusing, short, long = Refusing("damaged", 1), Counting("short", 1), Counting("long", 8)

    def last(*chosen):
        monkeypatch.setattr(all_experiments, "experiments", lambda seeds: chosen)
        return assistax("reproduce", "--budget", "5s").stdout.splitlines()[-1]

    assert last(refusing, long) == "finished 0, 2 left: long is 12.5% done, and the same command continues it"
    assert last(refusing, short, long) == "finished 1, 2 left"
    assert last(refusing) == "finished 0, 1 left"  # nothing has begun


class Refusing(Counting):
    def advance(self, work: Path, seconds: float):
        raise UsageError(f"{self.name} cannot be.")


def test_what_refuses_leaves_the_rest_of_the_list_to_be_done(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    chosen = [Counting("one", 1), Refusing("damaged", 1), Counting("other", 1)]
    monkeypatch.setattr(all_experiments, "experiments", lambda seeds: chosen)
    printed = assistax("reproduce", "--budget", "9m").stdout
    assert printed.splitlines()[-1] == "finished 2, 1 left"
    assert capsys.readouterr().err == "damaged: damaged cannot be.\n"
    assert sorted(path.name for path in (tmp_path / "results").iterdir()) == ["one", "other"]


def test_names_are_unique_and_chosen_by_pattern():
    names = [e.name for e in experiments(seeds=3)]
    assert len(names) == len(set(names)) and "feeding-mappo-rnn-paper-40M-2" in names
    assert [e.name for e in choose_experiments("scratch-masac-paper-6M", 2)] == [
        "scratch-masac-paper-6M-0",
        "scratch-masac-paper-6M-1",
    ]

    def of_the_paper(pattern, seeds):
        return [e for e in choose_experiments(pattern, seeds) if not e.name.startswith("version")]

    assert len(of_the_paper("*-ippo-paper-40M-?", 2)) == len(of_the_paper("*-ippo-default-40M-?", 2)) == 10
    assert len(of_the_paper("*-masac-default-3M-0", 1)) == 5
    assert len(of_the_paper("*-mappo-default-10M-0", 1)) == 5
    assert len(of_the_paper("feeding-*-default-preferences-*-0", 1)) == 5  # every algorithm
    with pytest.raises(UsageError, match="No experiment is called 'scrach'"):
        choose_experiments("scrach", 1)


def test_the_list_begins_with_five_seeds_of_every_task():
    names = [e.name for e in experiments()]
    assert names[0] == "version3/scratch-ippo-default-4M-0"
    assert all(name.startswith(("version2/", "version3/")) and "-ippo-default-" in name for name in names[:25])
    assert sum("scratch" in name and "-4M-" in name for name in names[:25]) == 5
    assert sum("bed_bath" in name and "-6M-" in name for name in names[:25]) == 5
    assert sum("-2M-" in name for name in names[:25]) == 15
    assert {name[-1] for name in names[:25]} == set("01234")
    for pattern, count in {
        "-still-": 15 + 5,  # and of former versions what was measured of them
        "-keeps_still-": 2 + 1,
        "-preferences-10M-": 3 + 20,
        "-preferences-4M-": 12 + 6,
        "version3/scratch-ippo-default-preferences-4M-": 3,
        "version3/feeding-ippo-default-tremor-": 1,
        "-default-untaught-4M-": 9 + 8,
    }.items():
        assert len([name for name in names if pattern in name]) == count, pattern


@pytest.fixture
def asked(monkeypatch):
    """The configurations of trainings that are begun, and then are not."""
    configs = []
    monkeypatch.setattr("assistax.training.run.Run.create", lambda config, folder: configs.append(config))
    monkeypatch.setattr("assistax.training.run.Run.open", lambda folder: None)
    monkeypatch.setattr("assistax.training.loop.train", lambda run, seconds: None)
    return configs


def test_robots_learn_beside_the_people_of_the_split(asked, tmp_path, monkeypatch):
    monkeypatch.chdir(DOCS.parent)
    splits.save(tmp_path / "taught.json", splits.split(Population.load("populations/scratch-v1"), "taught"))
    monkeypatch.setattr(splits, "path_of", lambda folder, kind: tmp_path / f"{kind}.json")
    chosen = [e for e in experiments() if e.name.startswith("teamwork/scratch-v1/runs/taught-")]
    assert len(chosen) == 3 + 3 + 2 * 10 and len({e.name for e in chosen}) == len(chosen)
    for one in chosen:
        assert one.advance(tmp_path / "none", 1.0) is None
    by_method = dict(zip([one.method for one in chosen], asked, strict=True))
    assert [one.method for one in chosen[:3]] == ["best-response", "untaught", "asymmetric"]
    train = splits.named("populations/scratch-v1:taught/train")[1]
    assert by_method["best-response"].partners == ("human=populations/scratch-v1:taught/train",)
    assert by_method["best-response"].env.human.people == train.people and by_method["best-response"].method.teachers
    assert by_method["best-response-clock"].env.clock == 1.5 and by_method["best-response"].env.clock is None
    assert by_method["fcp"].partners == ("human=populations/scratch-v1:taught/train+earlier",)
    assert len(by_method["fcp"].env.human.people) == 3 * len(train)
    assert by_method["self-play"].partners == () and by_method["self-play"].env.human.people == train.people
    assert by_method["gru-stays"].env.human.redraw_every == 3 and by_method["gru-stays"].method.recurrent
    assert by_method["randomised"].partners == ("human=offers",)
    assert by_method["randomised"].env.human.people == train.people
    assert by_method["gru"].method.recurrent and by_method["liam"].method.partner_code == 16
    assert by_method["asymmetric"].method.critic_knows_partner
    assert by_method["oracle"].env.human.visibility == "oracle" and not by_method["untaught"].method.teachers


def test_robots_of_feeding_learn_with_and_without_the_preferences(asked, tmp_path, monkeypatch):
    monkeypatch.chdir(DOCS.parent)
    chosen = [e for e in experiments(1) if e.name.startswith("teamwork/feeding-v1/runs/")]
    for one in chosen:
        assert one.advance(tmp_path / "none", 1.0) is None
    by_name = dict(zip([f"{one.split}-{one.method}" for one in chosen], asked, strict=True))
    assert by_name["random-hidden"].env.human.visibility == "human"
    assert by_name["random-best-response"].env.human.visibility == "both"
    assert by_name["extreme-sac"].algorithm == "isac" and len(by_name["extreme-sac"].env.human.people) == 5


def test_robots_who_must_find_out_what_people_like_are_not_told(asked, tmp_path, monkeypatch):
    monkeypatch.chdir(DOCS.parent)
    chosen = [e for e in experiments(1) if e.name.startswith("teamwork/scratch-v3-tastes/runs/interpolate-")]
    for one in chosen:
        assert one.advance(tmp_path / "none", 1.0) is None
    by_method = dict(zip([one.method for one in chosen], asked, strict=True))
    train = splits.named("populations/scratch-v3-tastes:interpolate/train")[1]
    assert {config.task for config in asked} == {"scratch-v3"} == {train.task}
    assert {config.env.human.people for config in asked} == {train.people}
    told = {name for name, config in by_method.items() if config.env.human.visibility in ("both", "oracle")}
    assert told == {"best-response", "oracle"} and by_method["shown"].env.human.visibility == "shown"
    remember = {name for name, config in by_method.items() if config.method.recurrent}
    assert remember == {"gru-hidden", "gru-stays-hidden"}
    assert by_method["self-play-hidden"].partners == ()
    assert "robot=considerate" in by_method["hidden"].method.teachers


def test_a_person_who_does_nothing_is_a_frozen_partner(asked, tmp_path):
    for pattern in ("version3/feeding-ippo-default-still-2M-0", "feeding-ippo-default-tremor+weakness-10M-0"):
        (experiment,) = [e for e in experiments() if e.name == pattern]
        assert experiment.advance(tmp_path / "none", 1.0) is None
    still, trembling = asked
    assert still.task == "feeding-v3" and still.partners == ("human=still",) and still.steps == 2_000_000
    assert trembling.task == "feeding-v0" and trembling.env.human.disability == "tremor+weakness"


def test_durations():
    assert [duration(text) for text in ("90s", "9m", "1.5h")] == [90, 540, 5400]
    for text in ("9", "0m", "m", "-3m", "9 m"):
        with pytest.raises(UsageError, match="time like 90s"):
            duration(text)
