"""Splits of a population: who is there to train with, to develop with and to test with.

A split is a JSON file of member ids, splits/KIND.json in the population's folder or anywhere else.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from assistax.errors import UsageError, choose
from assistax.files import read_json, write_json, writing
from assistax.formats import SPLIT
from assistax.human import disability, preference
from assistax.settings import check_seed
from assistax.training.population import Population, find, self_of

Split = dict[str, list[str]]
"""Ids by "train", "val" and "test"."""

EARLIER = "+earlier"  # behind a part's name: with earlier selves

EXTREME = 5  # members of the paper's split: those with the highest weight on speed


def random(population: Population, rng: np.random.Generator) -> Split:
    """At random, 6 : 2 : 2."""
    ids = sorted(population.ids)
    rng.shuffle(ids)
    return _shares(ids)


def extreme(population: Population, rng: np.random.Generator) -> Split:
    """The paper's: those with the highest weight on speed are there to train with (section "AHT pipeline").

    Of the rest, a fifth to develop with.
    """
    weight = {row["id"]: _preference(row).weights[0] for row in population.rows}
    ids = sorted(population.ids, key=lambda one: (-float(weight[one]), one))
    number = min(EXTREME, max(1, len(ids) // 2))
    train, rest = ids[:number], ids[number:]
    rng.shuffle(rest)
    return {"train": train, "val": rest[: len(rest) // 5], "test": rest[len(rest) // 5 :]}


def interpolate(population: Population, rng: np.random.Generator) -> Split:
    """Train with the strongest and the weakest bodies, test with those between them."""
    bodies = _by_hardship(population)
    outer = len(bodies) // 3
    last = len(bodies) - outer
    return _held_out([*bodies[:outer], *bodies[last:]], bodies[outer:last], rng)


def extrapolate(population: Population, rng: np.random.Generator) -> Split:
    """Train with the stronger bodies, test with the weakest third."""
    bodies = _by_hardship(population)
    return _held_out(bodies[: 2 * len(bodies) // 3], bodies[2 * len(bodies) // 3 :], rng)


def by_disability(population: Population, rng: np.random.Generator) -> Split:
    """Whole disabilities are left out of training."""
    return _groups(population, rng, lambda row: row["person"]["disability"], "disability")


def by_preference(population: Population, rng: np.random.Generator) -> Split:
    """Whole preferences are left out of training."""
    return _groups(population, rng, lambda row: row["person"]["preference"], "preference")


def by_algorithm(population: Population, rng: np.random.Generator) -> Split:
    """Whole algorithms are left out of training; people with habits are one of them."""
    return _groups(population, rng, lambda row: row["algorithm"], "algorithm")


def by_teaching(population: Population, rng: np.random.Generator) -> Split:
    """People who were taught one way of helping are left out of training, all of them."""
    return _groups(population, rng, lambda row: row.get("taught", ""), "taught")


def by_habit(population: Population, rng: np.random.Generator) -> Split:
    """Whole habits are left out of training; who has none is one of them."""
    return _groups(population, rng, lambda row: row.get("habit", ""), "habit")


KINDS: dict[str, Callable[[Population, np.random.Generator], Split]] = {
    "random": random,
    "extreme": extreme,
    "interpolate": interpolate,
    "extrapolate": extrapolate,
    "disability": by_disability,
    "preference": by_preference,
    "algorithm": by_algorithm,
    "taught": by_teaching,
    "habit": by_habit,
}


def by_convention(population: Population, rng: np.random.Generator, crossplay: Mapping[str, Any]) -> Split:
    """Whole conventions are left out of training: people whom the same robots serve well.

    `crossplay` is what `teamwork validity` wrote: "ids", and "matrix" by measure, robots by people, both in that order.
    """
    from scipy.cluster.hierarchy import fcluster, linkage

    if any("habit" in row for row in population.rows):
        raise UsageError(
            "People with habits have no robots, and so no place in a cross-play; split a population of teams."
        )
    if set(crossplay["ids"]) != set(population.ids):
        raise UsageError("The cross-play is of other members; make it anew with `assistax teamwork validity`.")
    returns = np.array(crossplay["matrix"]["return"])
    profiles = (returns - returns.mean(1, keepdims=True)) / (returns.std(1, keepdims=True) + 1e-9)
    number = max(2, round(len(profiles) ** 0.5))
    conventions = fcluster(linkage(profiles.T, "ward"), number, "maxclust")
    of = dict(zip(crossplay["ids"], conventions.tolist(), strict=True))
    return _groups(population, rng, lambda row: of[row["id"]], "convention")


CONVENTION = "convention"


def split(
    population: Population, kind: str = "random", seed: int = 0, crossplay: Mapping[str, Any] | None = None
) -> Split:
    """A split of a kind in KINDS, or by `crossplay` of the CONVENTION.

    The same whatever the order of the members. Earlier selves are in no part.
    """
    choose("kind", kind, [*KINDS, CONVENTION])
    if (kind == CONVENTION) != (crossplay is not None):
        raise UsageError(f"The split by {CONVENTION}, and no other, needs a cross-play (--crossplay).")
    final = population.select([row["id"] for row in population.rows if "fraction" not in row])
    check_seed("seed", seed)
    rng = np.random.default_rng(seed)
    parts = KINDS[kind](final, rng) if crossplay is None else by_convention(final, rng, crossplay)
    return check(population, _selves_together(final, parts))


def check(population: Population, parts: Split) -> Split:
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


def path_of(folder: Path, kind: str) -> Path:
    """Where a population keeps its split of this kind."""
    return folder / "splits" / f"{kind}.json"


def save(path: Path, parts: Split) -> None:
    """Write a split as JSON."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, parts)


def load(path: Path, population: Population) -> Split:
    """Read a split; raises UsageError unless it is one of this population."""
    return check(population, read_json(path, SPLIT))


def named(text: str) -> tuple[Path, Population]:
    """The folder and the members that "POP" or "POP:KIND/PART" names, for example "populations/scratch:random/test".

    POP may be on the Hub, see `population.find`.

    "POP:random/train+earlier" names the earlier selves of the part's members, too.

    Raises UsageError where there is no such population, split or part.
    """
    folder, colon, part = text.rpartition(":") if ":" in text else (text, "", "")
    place = find(folder)
    population = Population.load(place)
    if not colon:
        return place, population
    kind, slash, part = part.partition("/")
    path = path_of(place, kind)
    if not slash or not path.is_file():
        there = sorted(found.stem for found in path.parent.glob("*.json"))
        raise UsageError(
            f"Name a split and a part of it, for example {folder}:random/train, not {text!r}; {folder} has "
            f"{'the splits ' + ', '.join(there) if there else 'no splits; make one with `assistax population split`'}."
        )
    parts = load(path, population)
    part, more, _ = part.partition(EARLIER)
    ids = parts[choose("part", part, parts)]
    if not ids:
        raise UsageError(f"The part {part} of {path} is empty.")
    chosen = population.select(ids)
    return place, with_earlier(population, chosen) if more else chosen


def with_earlier(population: Population, chosen: Population) -> Population:
    """`chosen`, and the earlier selves that its members have in `population`: the partners of fictitious co-play."""
    mine = {self_of(row) for row in chosen.rows}
    earlier = [row["id"] for row in population.rows if "fraction" in row and self_of(row) in mine]
    return population.select([*chosen.ids, *earlier])


def _selves_together(population: Population, parts: Split) -> Split:
    """With those who pass for selves of each other in one part: the same person, algorithm, seed and way twice.

    As from two populations that were merged. Who has met one of them counts as having met the other.
    """
    of = {one: part for part, ids in parts.items() for one in ids}
    selves = {one: self_of(_row(population, one)) for one in of}
    chosen = {selves[one]: of[one] for one in sorted(of, reverse=True)}  # the part of the first by id
    return {part: [one for one in of if chosen[selves[one]] == part] for part in parts}


def _shares(ids: list[str]) -> Split:
    first, second = round(0.6 * len(ids)), round(0.8 * len(ids))
    return {"train": ids[:first], "val": ids[first:second], "test": ids[second:]}


def _preference(row) -> preference.Preference:
    words = row["person"]["preference"]
    if words == "none":
        raise UsageError("These people have no preferences to split them by.")
    return preference.parse(words)


def _by_hardship(population: Population) -> list[list[str]]:
    """The ids of each body, from the strongest to the weakest: by strength and motion that is left, then by tremor."""

    def hardship(words):
        body = disability.parse(words)
        return float(body.tremor) - float(body.strength) - float(body.motion), words

    of = {row["id"]: row["person"]["disability"] for row in population.rows}
    return [sorted(one for one in of if of[one] == words) for words in sorted(set(of.values()), key=hardship)]


def _held_out(train: list[list[str]], rest: list[list[str]], rng: np.random.Generator) -> Split:
    """Everybody of some bodies to train with; of the others' a quarter to develop with."""
    ids = [one for body in rest for one in body]
    rng.shuffle(ids)
    number = len(ids) // 4
    return {"train": [one for body in train for one in body], "val": ids[:number], "test": ids[number:]}


def _row(population: Population, one: str):
    return next(row for row in population.rows if row["id"] == one)


def _groups(population: Population, rng: np.random.Generator, of: Callable, what: str) -> Split:
    """Whole groups to train with, 6 : 2 : 2 by their number, at least one to train and one to test with."""
    groups = sorted({of(row) for row in population.rows})
    if len(groups) < 2:
        raise UsageError(f"All members have the same {what}; there is nothing to split them by.")
    rng.shuffle(groups)
    first = min(max(1, round(0.6 * len(groups))), len(groups) - 1)
    second = min(max(first, round(0.8 * len(groups))), len(groups) - 1)
    names = {"train": groups[:first], "val": groups[first:second], "test": groups[second:]}
    return {part: sorted(row["id"] for row in population.rows if of(row) in some) for part, some in names.items()}
