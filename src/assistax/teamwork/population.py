"""Populations of trained partners as folders of data.

manifest.jsonl                   one row a member, see formats.MEMBER: who they are, how they were trained, what they
                                 reach with the robot that was trained with them
weights-ARCHITECTURE.safetensors the weights of all members of one architecture, stacked, by agent; actors in half
                                 precision, normalisers in single

A member is a whole team: a person, and the robot that learned with them. Its id is a hash of its weights and of who it
is, so that the order of the rows means nothing and nobody changes unnoticed.
"""

import dataclasses
import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax.errors import UsageError
from assistax.files import read_json, read_rows, write_atomically, write_json
from assistax.formats import MEMBER, SPLIT, SUMMARY
from assistax.human import Person
from assistax.learning.actors import Actor, SquashedActor
from assistax.learning.normalizer import RunningStats
from assistax.policies import Player
from assistax.training.checkpoint import EVERYTHING, load_checkpoint, read_metadata, save_checkpoint
from assistax.training.run import Run

POLICIES = {"ppo": Actor, "sac": SquashedActor}
MANIFEST = "manifest.jsonl"


@dataclasses.dataclass(frozen=True)
class Population:
    """Members by row: what the manifest says of each, and their parameters by architecture and agent."""

    rows: tuple[dict[str, Any], ...]
    policies: dict[str, Any]  # by architecture
    weights: dict[str, dict[str, Any]]  # by architecture and agent, [members, ...] in the order of "row"

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, index: int) -> dict[str, Any]:
        return self.rows[index]

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(row["id"] for row in self.rows)

    @property
    def task(self) -> str:
        return self.rows[0]["task"]

    @property
    def people(self) -> tuple[Person, ...]:
        """Who the members are, in their order: what env.human.people takes."""
        return tuple(Person(**row["person"]) for row in self.rows)

    # -- from files and back -------------------------------------------------------------------

    @classmethod
    def load(cls, folder: Path | str) -> "Population":
        """A population; raises UsageError, naming the file, if it is none or not what was saved."""
        folder = Path(folder)
        if not (folder / MANIFEST).is_file():
            raise UsageError(f"{folder} is not a population: it has no {MANIFEST}.")
        rows = read_rows(folder / MANIFEST, MEMBER)
        _check_rows(rows, folder / MANIFEST)
        policies, weights = {}, {}
        for name in dict.fromkeys(row["architecture"] for row in rows):
            path = folder / f"weights-{name}.safetensors"
            about = read_metadata(path, {"population": {"kind": str, "policy": {str: object}, "like": {str: object}}})
            policies[name], weights[name] = _read_weights(path, about["population"])
        found = cls(tuple(rows), policies, weights)
        for row in rows:
            if _hash(found.member(row), row) != row["id"]:
                raise UsageError(
                    f"{folder}: member {row['id'][:12]} is not what was saved; its weights, its person or its place in "
                    f"{MANIFEST} were changed."
                )
        return found

    @classmethod
    def of_runs(cls, runs: Iterable[Run]) -> "Population":
        """The finished runs' teams, a member for every seed; each was trained with one person of its own."""
        teams = []
        for run in runs:
            human, summary = run.config.env.human, _summary(run)
            person = {"disability": human.disability, "preference": human.preference}
            if human.people != "none" or not _one_person(person):
                raise UsageError(f"{run.folder} was trained with people drawn afresh, not with one person.")
            for seed, team, report in zip(run.seeds.seeds, run.teams(), summary["evaluation"], strict=True):
                row: dict[str, Any] = {"task": run.config.task, "algorithm": run.config.algorithm}
                row |= {"seed": seed, "steps": summary["steps"], "person": person, "robot": True}
                row |= {k: report[k] for k in ("mean_return", "success_rate", "safe_success_rate") if k in report}
                teams.append((row, team))
        return cls._of_teams(teams)

    @classmethod
    def _of_teams(cls, teams: Sequence[tuple[dict[str, Any], dict[str, Player]]]) -> "Population":
        if not teams:
            raise UsageError("A population needs one member or more.")
        if len({row["task"] for row, _ in teams}) > 1:
            raise UsageError(f"A population is of one task, not of {', '.join(sorted({r['task'] for r, _ in teams}))}.")
        rows, policies, members = [], {}, {}
        for row, team in teams:
            policy = next(iter(team.values())).policy
            params = {agent: _rounded(player.member(0)) for agent, player in team.items()}
            shapes = [str(x.shape) for x in jax.tree.leaves(params)]
            name = hashlib.sha256(repr((_describe(policy), shapes)).encode()).hexdigest()[:8]
            name = f"{row['algorithm']}-{name}"
            policies[name] = policy
            members.setdefault(name, []).append(params)
            row = row | {"architecture": name, "row": len(members[name]) - 1}
            rows.append({"id": _hash(params, row)} | row)
        if len({row["id"] for row in rows}) < len(rows):
            raise UsageError("A population holds nobody twice; one of these teams is given more than once.")
        weights = {name: jax.tree.map(lambda *xs: np.stack(xs), *some) for name, some in members.items()}
        return cls(tuple(rows), policies, weights)

    def save(self, folder: Path | str) -> None:
        """Write the population into a folder of its own, the manifest last."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise UsageError(f"{folder} is not empty; a population is written into a folder of its own.")
        for name, weights in self.weights.items():
            kind, policy = _describe(self.policies[name])
            like = {k: [list(x.shape), str(x.dtype)] for k, x in _flat(weights).items()}
            about = {"population": {"kind": kind, "policy": policy, "like": like}}
            save_checkpoint(folder / f"weights-{name}.safetensors", _flat(weights), about)
        lines = "".join(json.dumps(row) + "\n" for row in self.rows)
        write_atomically(folder / MANIFEST, lines.encode())

    # -- choosing and playing ------------------------------------------------------------------

    def select(self, ids: Iterable[str]) -> "Population":
        """These members, in this order; raises UsageError for ids that are not there, or twice."""
        ids = list(ids)
        known = {row["id"]: row for row in self.rows}
        if unknown := [one for one in ids if one not in known]:
            raise UsageError(f"There is no member {unknown[0][:12]} in this population of {len(self)}.")
        if not ids or len(set(ids)) < len(ids):
            raise UsageError("Select one member or more, and each once.")
        rows, order = [], {}
        for row in (known[one] for one in ids):
            mine = order.setdefault(row["architecture"], [])
            rows.append(row | {"row": len(mine)})
            mine.append(row["row"])
        weights = {
            name: jax.tree.map(lambda x, take=take: x[np.array(take)], self.weights[name])
            for name, take in order.items()
        }
        return Population(tuple(rows), {name: self.policies[name] for name in order}, weights)

    def member(self, row: dict[str, Any]) -> dict[str, Any]:
        """By agent the parameters of one member, as they are stored."""
        return jax.tree.map(lambda x: x[row["row"]], self.weights[row["architecture"]])

    def partner(self, agent: str = "human", deterministic: bool = False) -> Player:
        """A frozen partner with all members, who belong to the people of `Population.people`: one draw for both.

        They act with the noise with which they were trained, unless `deterministic`.
        """
        if len(self.policies) > 1:
            raise UsageError(
                f"These members have {len(self.policies)} architectures ({', '.join(self.policies)}), and one player "
                "has one; select those of one."
            )
        ((name, policy),) = self.policies.items()
        if agent not in self.weights[name]:
            raise UsageError(f"This population has nobody for the {agent}.")
        order = np.array([row["row"] for row in self.rows])
        params = jax.tree.map(lambda x: jnp.asarray(x[order], jnp.float32), self.weights[name][agent])
        params |= {"normalizer": RunningStats(**params["normalizer"])}
        return Player(dataclasses.replace(policy, deterministic=deterministic), params, len(self), by_person=True)


def split(population: Population, shares: tuple[float, float] = (0.6, 0.2), seed: int = 0) -> dict[str, list[str]]:
    """Ids by "train", "val" and "test", at random: these shares for the first two, the rest for the test."""
    ids = sorted(population.ids)
    np.random.default_rng(seed).shuffle(ids)
    first, second = (round(x * len(ids)) for x in (shares[0], shares[0] + shares[1]))
    parts = {"train": ids[:first], "val": ids[first:second], "test": ids[second:]}
    return check_split(population, parts)


def check_split(population: Population, parts: dict[str, list[str]]) -> dict[str, list[str]]:
    """The split; raises UsageError if somebody is unknown or in two of its parts, or nobody is left for the test."""
    everybody = [one for ids in parts.values() for one in ids]
    if unknown := set(everybody) - set(population.ids):
        raise UsageError(f"The split names {min(unknown)[:12]}, who is not in this population.")
    if len(set(everybody)) < len(everybody):
        twice = next(one for one in everybody if everybody.count(one) > 1)
        raise UsageError(f"The split has {twice[:12]} in two of its parts.")
    if not parts["test"] or not parts["train"]:
        raise UsageError("A split needs members to train with and others to test with.")
    return parts


def save_split(path: Path, parts: dict[str, list[str]]) -> None:
    write_json(path, parts)


def load_split(path: Path, population: Population) -> dict[str, list[str]]:
    return check_split(population, read_json(path, SPLIT))


# -- parts -------------------------------------------------------------------------------------


def _check_rows(rows: list[dict[str, Any]], path: Path) -> None:
    if not rows:
        raise UsageError(f"{path} has no members.")
    if len({row["id"] for row in rows}) < len(rows):
        raise UsageError(f"{path} has a member twice.")
    if len({row["task"] for row in rows}) > 1:
        raise UsageError(f"{path} mixes tasks: {', '.join(sorted({row['task'] for row in rows}))}.")


def _one_person(person: dict[str, str]) -> bool:
    return person["disability"] != "standard" and person["preference"] != "sweep"


def _summary(run: Run) -> dict[str, Any]:
    path = run.folder / "summary.json"
    if not path.exists():
        raise UsageError(f"{run.folder} is not finished: it has no summary.json.")
    return read_json(path, SUMMARY)


def _rounded(params: Any) -> Any:
    """As they are stored: what is called "actor" in half precision, the normaliser by the names of its fields."""
    halves = jax.tree.map(lambda x: np.asarray(x, np.float16), params["actor"])
    stats = params["normalizer"]
    fields = {field.name: np.asarray(getattr(stats, field.name)) for field in dataclasses.fields(stats)}
    return {"actor": halves, "normalizer": fields}


def _describe(policy: Any) -> tuple[str, dict[str, Any]]:
    """The kind of a policy, of POLICIES, and its settings."""
    for kind, made in POLICIES.items():
        if isinstance(policy, made):
            return kind, dataclasses.asdict(policy)
    raise UsageError("A population holds trained policies, of PPO or SAC; this one is another.")


def _flat(tree: Any) -> dict[str, np.ndarray]:
    return {jax.tree_util.keystr(path): np.asarray(x) for path, x in jax.tree_util.tree_leaves_with_path(tree)}


def _hash(params: dict[str, Any], row: dict[str, Any]) -> str:
    """Of one member's weights and of who it is."""
    found = hashlib.sha256(json.dumps([row["task"], row["person"], row["seed"], row["steps"]]).encode())
    for name, array in sorted(_flat(params).items()):
        found.update(f"{name} {array.dtype} {array.shape} ".encode())
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def _read_weights(path: Path, about: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """The policy and the weights, by agent, of one architecture."""
    try:
        policy = POLICIES[about["kind"]](**about["policy"])
        like = {name: jax.ShapeDtypeStruct(shape, dtype) for name, (shape, dtype) in about["like"].items()}
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{path} describes a policy that this version does not know ({error}).") from None
    tree: dict[Any, Any] = {}
    for name, array in load_checkpoint(path, like, finite=EVERYTHING).items():
        *way, last = [part or int(number) for part, number in re.findall(r"\['([^']+)'\]|\[(\d+)\]", name)]
        place = tree
        for part in way:
            place = place.setdefault(part, {})
        place[last] = np.asarray(array)
    return policy, _lists(tree)


def _lists(tree: Any) -> Any:
    """Where all keys are numbers, a list."""
    if not isinstance(tree, dict):
        return tree
    inside = {key: _lists(value) for key, value in tree.items()}
    return [inside[i] for i in range(len(inside))] if all(isinstance(key, int) for key in inside) else inside
