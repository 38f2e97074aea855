"""Populations are pushed to a hub and pulled from it, and what comes is what was there."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from commands import assistax
from hub_stub import Hub

from assistax.errors import UsageError
from assistax.learning.actors import Actor
from assistax.learning.normalizer import init_stats
from assistax.policies import Player
from assistax.training import hub, splits
from assistax.training.population import Population

NAME = "somebody/people"


@pytest.fixture
def server(monkeypatch, tmp_path_factory):
    """A hub, which the client takes for the hub."""
    import huggingface_hub.constants as constants

    with Hub() as made:
        cache = str(tmp_path_factory.mktemp("cache"))
        for name, value in {"ENDPOINT": made.address, "HF_HUB_DISABLE_XET": True, "HF_HUB_CACHE": cache}.items():
            monkeypatch.setattr(constants, name, value)
        monkeypatch.setattr(
            constants, "HUGGINGFACE_CO_URL_TEMPLATE", made.address + "/{repo_id}/resolve/{revision}/{filename}"
        )
        monkeypatch.setenv("HF_TOKEN", "hf_anything")
        yield made
        made.shutdown()


@pytest.fixture
def folder(tmp_path):
    """Of three people with weights, a split, and runs that nobody else needs."""
    teams = []
    for seed, words in enumerate(("none", "tremor", "weakness")):
        weights = {"layers": [{"w": np.full((3, 2), seed + 0.5, np.float32)}]}
        params = {"actor": weights, "normalizer": init_stats(3)}
        row = {"task": "feeding-v3", "algorithm": "ippo", "seed": seed, "steps": 64, "robot": True}
        row |= {"person": {"disability": words, "preference": "none"}, "mean_return": 1.0, "safe_success_rate": 0.5}
        teams.append((row, {"human": Player.of(Actor("tanh", True, True), params)}))
    population = Population.of_teams(teams)
    population.save(tmp_path / "people")
    splits.save(splits.path_of(tmp_path / "people", "random"), splits.split(population, "random"))
    (tmp_path / "people" / "runs").mkdir()
    (tmp_path / "people" / "runs" / "large").write_text("a checkpoint")
    return tmp_path / "people"


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_is_pulled_is_what_was_pushed(server, folder, tmp_path):
    commit = hub.push(folder, NAME)
    assert sorted(server.at(NAME, "main")[1]) == sorted(
        {".gitattributes", "README.md", *contents(folder)} - {"runs/large"}
    )
    assert server.at(NAME, commit)[1]["README.md"].startswith(b"---\npretty_name: People for feeding-v3")
    assert b"| tremor | 1 |" in server.at(NAME, commit)[1]["README.md"]
    pulled = hub.pull(NAME, tmp_path / "pulled")
    assert pulled.ids == Population.load(folder).ids
    assert contents(tmp_path / "pulled") == {k: v for k, v in contents(folder).items() if k != "runs/large"}


def test_a_population_is_loaded_by_its_name_there(server, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hub.push(folder, NAME)
    assert Population.load(NAME).rows == Population.load(folder).rows
    assert splits.named(f"{NAME}:random/test")[1].ids == splits.named(f"{folder}:random/test")[1].ids
    assert assistax("population", "verify", NAME).stdout == "3 members of feeding-v3, all as they were saved\n"
    hub.push(Path(NAME), "somebody/copy")
    assert server.at("somebody/copy", "main")[1].keys() == server.at(NAME, "main")[1].keys()
    with pytest.raises(UsageError, match=r"^else/people is no folder here\. There is no else/people on the Hub"):
        Population.load("else/people")
    (tmp_path / "somebody").mkdir()  # a folder here is meant, whatever is there
    with pytest.raises(UsageError, match=r"^somebody/people is not a population"):
        Population.load(NAME)


def test_a_revision_is_what_it_was(server, folder, tmp_path):
    commit = hub.push(folder, NAME)
    two = Population.load(folder)
    two.select(two.ids[:2]).save(tmp_path / "two")
    now = hub.push(tmp_path / "two", NAME)
    assert "splits/random.json" in server.at(NAME, commit)[1] and "splits/random.json" not in server.at(NAME, now)[1]
    assert len(hub.pull(NAME, tmp_path / "now")) == 2
    assert len(hub.pull(NAME, tmp_path / "then", commit)) == 3


def test_what_arrives_damaged_is_not_there(server, folder, tmp_path):
    hub.push(folder, NAME)
    (weights,) = folder.glob("weights-*")
    bytes_ = bytearray(weights.read_bytes())
    bytes_[-1] ^= 1
    server.add(NAME, {weights.name: bytes(bytes_)})
    with pytest.raises(UsageError, match=r"is not what was saved"):
        hub.pull(NAME, tmp_path / "pulled")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["people"]


def test_what_cannot_be_is_one_line(server, folder, tmp_path):
    new = tmp_path / "pulled"
    with pytest.raises(UsageError, match=r"There is no somebody/people on the Hub"):
        hub.pull(NAME, new)
    with pytest.raises(UsageError, match=r"called OWNER/NAME, not 'a b'"):
        hub.pull("a b", new)
    with pytest.raises(UsageError, match=r"is there already; name another --out"):
        hub.pull(NAME, folder)
    with pytest.raises(UsageError, match=r"is not a population"):
        hub.push(tmp_path, NAME)
    hub.push(folder, NAME)
    with pytest.raises(UsageError, match=r"has no revision 'v7'"):
        hub.pull(NAME, new, "v7")
    server.add("somebody/else", {"README.md": b"poems"})
    with pytest.raises(UsageError, match=r"somebody/else on the Hub is not a population"):
        hub.pull("somebody/else", new)
    server.shutdown()
    server.server_close()
    with pytest.raises(UsageError, match=rf"The Hub at {server.address} (cannot be reached|did not do it)"):
        hub.pull(NAME, new)
    assert not new.exists()


def test_without_the_client_a_line_says_what_to_install():
    code = "import sys; sys.modules['huggingface_hub'] = None\nfrom assistax.training import hub\n"
    code += "for use in (hub.Population.load, lambda name: hub.pull(name, __import__('pathlib').Path('x'))):\n"
    code += "    try: use('a/b')\n    except Exception as error: print(error)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    line = 'Sharing needs the Hugging Face Hub\'s client: pip install "assistax[hub]".\n'
    assert said == f"a/b is no folder here. {line}{line}"
