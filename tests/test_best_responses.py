"""Best responses in bulk: each learns with one partner, nothing runs twice, and all of them are references."""

import dataclasses
import json

import jax
import pytest
from commands import assistax as assistax_command
from stored import SMALL, store_checkpoint

import assistax
from assistax.errors import UsageError
from assistax.human import Person
from assistax.learning.ppo import PPO, PPOConfig
from assistax.policies import Player
from assistax.teamwork import best_responses as bulk
from assistax.teamwork.strangers import knows
from assistax.training import loop, splits
from assistax.training.population import Population
from assistax.training.run import Run


@pytest.fixture(scope="module")
def population(tmp_path_factory):
    """Five untrained members, with a split: its folder."""
    env = assistax.make("scratch-v3", engine="mujoco")
    trainer, made = PPO(env, PPOConfig(num_steps=4, num_minibatches=1, hidden=(8, 8)), 2, 1), []
    for seed, words in enumerate(("none", "tremor", "weakness", "limited_range", "strength=0.5")):
        params = trainer.policy_params(jax.jit(trainer.init)(jax.random.key(seed)))
        row = {"task": env.name, "algorithm": "ippo", "seed": seed, "steps": 64, "robot": True}
        row["person"] = dataclasses.asdict(Person(words, "none"))
        made.append((row, {agent: Player.of(trainer.policy(False), params[agent]) for agent in params}))
    folder = tmp_path_factory.mktemp("best") / "pop"
    Population.of_teams(made).save(folder)
    ids = Population.load(folder).ids
    splits.save(splits.path_of(folder, "random"), {"train": ids[:2], "val": ids[2:3], "test": ids[3:]})
    return folder


@pytest.fixture
def trained(monkeypatch):
    """In place of training: a checkpoint and a summary; the names of the runs that were trained."""
    names, stops = [], []

    def train(run, **_):
        names.append(run.folder.name)
        if stops and stops.pop():
            return None
        store_checkpoint(run, run.config.steps)
        (run.folder / "summary.json").write_text(json.dumps({"steps": run.config.steps}))
        return {}

    monkeypatch.setattr(loop, "train", train)
    return names, stops


def command(*words):
    """The command with these words, in this process."""
    return assistax_command("teamwork", "best-responses", *map(str, words), "--processes", "1")


def test_each_partner_gets_a_robot_of_its_own_and_nothing_runs_twice(population, trained, tmp_path):
    names, stops = trained
    stops.append(True)
    out, settings = tmp_path / "best", [f"{name}={value}" for name, value in SMALL.items()]
    said = command(population, "--out", out, "--steps", 128, "--set", *settings).stdout
    assert "Not all robots are finished" in said and len(names) == 1
    assert "2 robots in" in command("--resume", out).stdout and len(names) == 3
    command("--resume", out)
    assert len(names) == 3
    strangers = Population.load(population).select(splits.named(f"{population}:random/test")[1].ids)
    assert sorted(set(names)) == sorted(one[:12] for one in strangers.ids)
    for run in map(Run.open, bulk.runs_of(out)):
        assert run.config.steps == 128 and run.config.method.hidden == (8, 8) and run.trainer.learners == ("robot",)
        assert [one[:12] for one, met in zip(strangers.ids, knows(run, strangers), strict=True) if met] == [
            run.folder.name
        ]


def test_a_folder_of_robots_is_as_good_as_their_names(population, trained, tmp_path, monkeypatch):
    bulk.begin(tmp_path / "best", splits.named(f"{population}:random/test")[1], 128, SMALL)
    with pytest.raises(UsageError, match=r"No robot of .* is finished"):
        bulk.runs_of(tmp_path / "best")
    assert bulk.train(tmp_path / "best")
    given = {}

    def report(*_, **words):
        given.update(words)
        raise UsageError("enough is known")

    monkeypatch.setattr("assistax.teamwork.report.report", report)
    one = bulk.runs_of(tmp_path / "best")[0]
    with pytest.raises(SystemExit):
        words = ("--population", population, "--best-responses", tmp_path / "best")
        assistax_command("teamwork", "evaluate", f"br={one}", *map(str, words))
    assert sorted(given["best_responses"]) == [str(run) for run in bulk.runs_of(tmp_path / "best")]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "Name a population and --out to begin, or --resume"),
        (("POP",), "Say where the robots go"),
        (("POP", "--resume", "x"), "Name a population and --out to begin, or --resume"),
        (("POP", "--out", "full"), "is not empty; to continue what was begun there, use --resume"),
        (("--resume", "full", "--steps", "64"), "leave out --steps"),
        (("--resume", "full"), "has no best_responses.json"),
        (("POP", "--out", "new", "--part", "train"), "Unknown part 'train'"),
        (("POP", "--out", "new", "--set", "ppo.gama=1"), "gama"),
    ],
)
def test_bad_input_is_one_line(population, words, said, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "note").write_text("mine")
    with pytest.raises(SystemExit):
        command(*(population if word == "POP" else word for word in words))
    printed = capsys.readouterr().err.strip()
    assert not (tmp_path / "new").exists()
    assert printed.startswith("assistax: ") and said in printed and "\n" not in printed
    assert (tmp_path / "full" / "note").read_text() == "mine"
