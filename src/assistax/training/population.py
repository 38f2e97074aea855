"""Populations of trained partners as folders of data.

manifest.jsonl                   one row a member, see formats.MEMBER: who they are, how they were trained, what they
                                 reach with the robot that was trained with them
population.json                  how many rows that are, and their hash in whatever order; older populations have none
weights-ARCHITECTURE.safetensors the weights of all members of one architecture, stacked, by agent; networks in half
                                 precision, normalisers in single

A member is a whole team: a person, and the robot that learned with them. Its id is a hash of its weights and of who it
is, so that the order of the rows means nothing and nobody changes unnoticed.
"""

import dataclasses
import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax.env import Env
from assistax.errors import UsageError, choose
from assistax.files import read_json, read_rows, write_atomically, write_json, writing
from assistax.formats import MEMBER, SEAL
from assistax.human import Person
from assistax.learning.actors import Actor, SquashedActor
from assistax.learning.normalizer import RunningStats
from assistax.policies import Mixed, Player, habits
from assistax.policies.habits import HABITS
from assistax.settings import check_seed
from assistax.training.checkpoint import EVERYTHING, load_checkpoint, read_metadata, save_checkpoint
from assistax.training.hub_client import snapshot

POLICIES = {"ppo": Actor, "sac": SquashedActor}
SCRIPTED = "scripted"  # the architecture of people with habits, who have no weights
MANIFEST = "manifest.jsonl"
ABOUT = "population.json"
SHARED = (MANIFEST, ABOUT, "weights-*.safetensors", "splits/*.json")  # with others; runs and plans stay at home


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
        """Of the members, in their order."""
        return tuple(row["id"] for row in self.rows)

    @property
    def hash(self) -> str:
        """Of everybody in it, in their order."""
        return hashlib.sha256(" ".join(self.ids).encode()).hexdigest()

    @property
    def task(self) -> str:
        """The id of the task that all members are of."""
        return self.rows[0]["task"]

    @property
    def people(self) -> tuple[Person, ...]:
        """Who the members are, in their order: what env.human.people takes."""
        return tuple(Person(**row["person"]) for row in self.rows)

    # -- from files and back -------------------------------------------------------------------

    @classmethod
    def load(cls, folder: Path | str) -> "Population":
        """A population, see `find`; raises UsageError, naming the file, if it is none or not what was saved."""
        folder = find(folder)
        if not (folder / MANIFEST).is_file():
            raise UsageError(f"{folder} is not a population: it has no {MANIFEST}.")
        rows = read_rows(folder / MANIFEST, MEMBER)
        _check_rows(rows, folder / MANIFEST)
        if is_sealed(folder) and read_json(folder / ABOUT, SEAL) != _seal(rows):
            raise UsageError(
                f"{folder / MANIFEST} is not what was saved, as {ABOUT} tells: a row was changed, lost or added."
            )
        policies, weights = {}, {}
        for name in dict.fromkeys(row["architecture"] for row in rows):
            if name == SCRIPTED:
                continue
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
    def of_teams(cls, teams: Sequence[tuple[dict[str, Any], Mapping[str, Player]]]) -> "Population":
        """A population of these teams, each with its row of the manifest, but for id, architecture and row."""
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
            rows.append({"id": ""} | row | {"id": _hash(params, row)})
        if len({row["id"] for row in rows}) < len(rows):
            raise UsageError("A population holds nobody twice; one of these teams is given more than once.")
        weights = {name: jax.tree.map(lambda *xs: np.stack(xs), *some) for name, some in members.items()}
        return cls(tuple(rows), policies, weights)

    @classmethod
    def scripted(cls, task: str, people: Iterable[Person], names: Iterable[str] = tuple(HABITS)) -> "Population":
        """Each of some people with each of the habits of these names; they have no robot."""
        rows = []
        for person, name in product(people, names):
            row: dict[str, Any] = {"task": task, "algorithm": SCRIPTED, "seed": 0, "steps": 0, "robot": False, "row": 0}
            row |= {"person": dataclasses.asdict(person), "architecture": SCRIPTED}
            row["habit"] = choose("habit", name, HABITS)
            rows.append({"id": _hash({}, row)} | row)
        if len({row["id"] for row in rows}) < len(rows):
            raise UsageError("A population holds nobody twice; a habit or a person is given more than once.")
        return cls(tuple(rows), {}, {})

    @classmethod
    def merge(cls, populations: Sequence["Population"]) -> "Population":
        """Everybody of several populations of one task; who is in two of them is in it once."""
        _check_rows([row for one in populations for row in one.rows[:1]], "these populations", twice=True)
        rows, weights, policies = {}, {}, {}
        for one in populations:
            policies |= one.policies
            for row in one.rows:
                if row["id"] in rows:
                    continue
                if row["architecture"] != SCRIPTED:
                    mine = weights.setdefault(row["architecture"], [])
                    mine.append(one.member(row))
                    row = row | {"row": len(mine) - 1}
                rows[row["id"]] = row
        stacked = {name: jax.tree.map(lambda *xs: np.stack(xs), *some) for name, some in weights.items()}
        return cls(tuple(rows.values()), policies, stacked)

    def save(self, folder: Path | str, beside: Sequence[str] = ()) -> None:
        """Write the population into a folder of its own, the manifest last; `beside` may be there already."""
        folder = Path(folder)
        written = (ABOUT, *(f"weights-{name}.safetensors" for name in self.weights))
        ours = {*beside, *written} if beside else set()
        with writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            there = {path.name for path in folder.iterdir() if path.suffix != ".part"}  # of a writer that was killed
        if there - ours:
            raise UsageError(f"{folder} is not empty; a population is written into a folder of its own.")
        for name, weights in self.weights.items():
            kind, policy = _describe(self.policies[name])
            like = {k: [list(x.shape), str(x.dtype)] for k, x in _flat(weights).items()}
            about = {"population": {"kind": kind, "policy": policy, "like": like}}
            save_checkpoint(folder / f"weights-{name}.safetensors", _flat(weights), about)
        write_json(folder / ABOUT, _seal(self.rows))
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
            if row["architecture"] == SCRIPTED:
                rows.append(row)
                continue
            mine = order.setdefault(row["architecture"], [])
            rows.append(row | {"row": len(mine)})
            mine.append(row["row"])
        weights = {
            name: jax.tree.map(lambda x, take=take: x[np.array(take)], self.weights[name])
            for name, take in order.items()
        }
        return Population(tuple(rows), {name: self.policies[name] for name in order}, weights)

    def sample(self, number: int, seed: int = 0) -> "Population":
        """So many members, drawn, each at most once; who they are does not depend on the order of the rows."""
        if not 1 <= number <= len(self):
            raise UsageError(f"From {len(self)} members 1 to {len(self)} can be drawn, not {number}.")
        check_seed("seed", seed)
        return self.select(np.random.default_rng(seed).choice(sorted(self.ids), number, replace=False).tolist())

    def member(self, row: dict[str, Any]) -> dict[str, Any]:
        """By agent the parameters of one member, as they are stored; nothing for people with habits."""
        if row["architecture"] == SCRIPTED:
            return {}
        return jax.tree.map(lambda x: x[row["row"]], self.weights[row["architecture"]])

    def partner(
        self, agent: str = "human", deterministic: bool = False, by_person: bool = True, env: Env | None = None
    ) -> Player:
        """A frozen partner with all members, in their order.

        Args:
          agent: whom they play.
          deterministic: whether they act without the noise with kind they were trained.
          by_person: whether they belong to the people of `Population.people`: one draw for both.
          env: where; people with habits need it.

        Raises:
          UsageError: somebody cannot play this agent.
        """
        players, kind, place = [], np.zeros(len(self), np.int32), np.zeros(len(self), np.int32)
        for name in dict.fromkeys(row["architecture"] for row in self.rows):
            mine = [i for i, row in enumerate(self.rows) if row["architecture"] == name]
            kind[mine], place[mine] = len(players), np.arange(len(mine))
            players.append(self._player(name, [self.rows[i] for i in mine], agent, deterministic, env))
        if len(players) == 1:
            return dataclasses.replace(players[0], by_person=by_person)
        return Mixed.of_players(players, kind, place, by_person)

    def observes(self, agent: str) -> set[int]:
        """How many numbers the members' policies of this agent observe; nothing of people with habits."""
        return {one[agent]["normalizer"]["mean"].shape[-1] for one in self.weights.values() if agent in one}

    def check_observations(self, agent: str, env: Env, place: Path | str) -> None:
        """Raise UsageError, naming `place`, if a member's policy of this agent observes something else in `env`."""
        for name, policies in self.weights.items():
            theirs = policies[agent]["normalizer"]["mean"].shape[-1] if agent in policies else 0
            if theirs != env.observation_sizes[agent]:
                raise UsageError(
                    f"The {agent}s of {place}, architecture {name}, observe {theirs} numbers, but the {agent} here "
                    f"{env.observation_sizes[agent]}: its settings (preferences, for example) were others."
                )

    def _player(self, name: str, rows: list[dict[str, Any]], agent: str, deterministic: bool, env: Env | None):
        """These members of one architecture, in this order."""
        if name == SCRIPTED:
            if agent != "human" or env is None:
                raise UsageError("People with habits play the human only, in an environment that `partner` is given.")
            return habits.person(env, tuple(row["habit"] for row in rows))
        if agent not in self.weights[name]:
            raise UsageError(f"This population has nobody for the {agent}.")
        order = np.array([row["row"] for row in rows])
        params = jax.tree.map(lambda x: jnp.asarray(x[order], jnp.float32), self.weights[name][agent])
        params |= {"normalizer": RunningStats(**params["normalizer"])}
        return Player(dataclasses.replace(self.policies[name], deterministic=deterministic), params, len(rows))


def find(name: Path | str) -> Path:
    """The folder of a population; of OWNER/NAME, where there is no folder OWNER, that of a dataset on the Hub.

    Such a dataset is fetched into the Hub client's cache. Raises UsageError if it is not there.
    """
    here = Path(name)
    if here.parent.exists() or not re.fullmatch(r"\w[\w.-]*/\w[\w.-]*", str(name)):
        return here
    try:
        return snapshot(str(name), SHARED)
    except UsageError as error:
        raise UsageError(f"{name} is no folder here. {error}") from None


def is_population(name: str | Path) -> bool:
    """Whether "POP" or "POP:KIND/PART" names a folder that has a manifest."""
    folder, colon, _ = str(name).rpartition(":")
    return (Path(name) / MANIFEST).is_file() or (bool(colon) and (Path(folder) / MANIFEST).is_file())


def self_of(row: Mapping[str, Any]) -> tuple | str:
    """What all earlier selves of a member have in common with it, and with nobody else."""
    if "habit" in row:
        return row["id"]
    return (*row["person"].values(), row["algorithm"], row["seed"], row.get("taught"))


def is_sealed(folder: Path) -> bool:
    """Whether a population's folder tells what its manifest was; older ones do not."""
    return (folder / ABOUT).exists()


# -- parts -------------------------------------------------------------------------------------


def _check_rows(rows: list[dict[str, Any]], path: Path | str, twice: bool = False) -> None:
    if not rows:
        raise UsageError(f"{path} has no members.")
    if not twice and len({row["id"] for row in rows}) < len(rows):
        raise UsageError(f"{path} has a member twice.")
    if len({row["task"] for row in rows}) > 1:
        raise UsageError(f"{path} mixes tasks: {', '.join(sorted({row['task'] for row in rows}))}.")


def _seal(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What population.json says of these rows, whatever their order."""
    lines = sorted(json.dumps(row, sort_keys=True) for row in rows)
    return {"members": len(rows), "sha256": hashlib.sha256("\n".join(lines).encode()).hexdigest()}


def _rounded(params: Any) -> Any:
    """As they are stored: networks in half precision, the normaliser by the names of its fields."""
    networks, stats = {k: x for k, x in params.items() if k != "normalizer"}, params["normalizer"]
    halves = jax.tree.map(lambda x: np.asarray(x, np.float16), networks)
    fields = {field.name: np.asarray(getattr(stats, field.name)) for field in dataclasses.fields(stats)}
    return halves | {"normalizer": fields}


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
    who = [row["task"], row["person"], row["seed"], row["steps"]]
    if row["architecture"] == SCRIPTED:
        habit = vars(HABITS[choose("habit", row["habit"], HABITS)])
        who.append({k: v for k, v in habit.items() if k not in ("way", "shows") or v})  # ids are older than these
    found = hashlib.sha256(json.dumps(who).encode())
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
