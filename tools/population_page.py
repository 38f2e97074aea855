"""docs/partners.md: the populations that come with the project, from their manifests and their cross-play."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from assistax.files import read_json
from assistax.formats import SPLIT, VALIDITY
from assistax.results.comparison import markdown
from assistax.teamwork.portrait import by_person, short, taste
from assistax.teamwork.validity import matrix_picture, number
from assistax.training.population import MANIFEST, Population

PAID = "gated_preference_return"
PAGE = """# The people who come with the project

[Populations](populations.md) of people who learned with a robot of their own. Written from `populations/` and
`results/teamwork/*/validity.json` by `python tools/pages.py populations`; [ad-hoc teamwork](teamwork.md) has what
robots reach that meet them.

{each}
"""
ONE = """## {name}

`populations/{name}` has {members} people with their robots{others}, by {algorithms}, {steps}.
What each reaches with its own robot, safe success and, in brackets, the return; columns are preferences, or the
[script](populations.md#conventions) that the person imitated at first:

{self_play}
{splits}
{crossplay}"""
CROSSPLAY = """
### Who can work with whom

{pairs} of the episodes succeed with one's own robot, {crossed} with the others' ({number} robots by {number} people,
{episodes} episodes of each pair). The best single robot, {who}, has {single} with all of them, the scripted
one, which is told everything, {expert}.{liked} {verdict}

![Who works with whom](images/{picture})
{ways}"""
LIKED = """ What preferences pay in episodes that succeed is {pairs} on average with one's own robot, {crossed} with the
others', and {single} with {who}."""
WAYS = """
{measure} by what the people {are}; on the diagonal, too, robot and person have not learned together:

{table}

What robot and person have in common:

{kinds}
"""


def page(folder: Path, results: Path, pictures: Path) -> str:
    """The page; pictures of cross-play go to the folder `pictures`."""
    each = [_one(path.parent, results, pictures) for path in sorted(folder.glob(f"*/{MANIFEST}"))]
    return PAGE.format(each="\n\n".join(text.strip() for text in each))


def _one(folder: Path, results: Path, pictures: Path) -> str:
    population = Population.load(folder)
    rows = [row for row in population.rows if "fraction" not in row]
    earlier, habits = len(population) - len(rows), sum("habit" in row for row in rows)
    bodies, tastes, cells = by_person(population)
    table = []
    for body, safe, returns in zip(bodies, cells["safe_success_rate"], cells["mean_return"], strict=True):
        table.append([body, *("" if np.isnan(x) else f"{x:.0%} ({r:.0f})" for x, r in zip(safe, returns, strict=True))])
    steps = sorted({row["steps"] / 1e6 for row in rows if "habit" not in row})
    splits = [f"`{path.stem}` ({_sizes(path)})" for path in sorted((folder / "splits").glob("*.json"))]
    found = results / folder.name / "validity.json"
    return ONE.format(
        name=folder.name,
        members=len(rows) - habits,
        others=f", {earlier} earlier selves of them" * (earlier > 0) + f", {habits} people with habits" * (habits > 0),
        algorithms=", ".join(sorted({row["algorithm"] for row in rows if "habit" not in row})).upper(),
        steps=" or ".join(f"{x:.1f}" for x in steps) + " M steps each",
        self_play=markdown(["body", *(re.sub(r"\s+", " ", taste) for taste in tastes)], table),
        splits=f"\nSplits, with how many are to train, to develop and to test with: {', '.join(splits)}.\n"
        * bool(splits),
        crossplay=_crossplay(population, read_json(found, VALIDITY), pictures / f"crossplay_{folder.name}.png")
        if found.exists()
        else "",
    )


def _sizes(path: Path) -> str:
    parts = read_json(path, SPLIT)
    return ", ".join(str(len(parts[name])) for name in ("train", "val", "test"))


def _crossplay(population: Population, found: Mapping[str, Any], picture: Path) -> str:
    matrix_picture(found, picture)
    rows = {row["id"]: row for row in population.rows}
    expert, best = found["others"]["expert"]["success"], found["best_single"]["success"]
    liked = ""
    if PAID in found["self_play"]:
        numbers = {
            name: f"{found[where][PAID]:.0f}" for name, where in (("pairs", "self_play"), ("crossed", "cross_play"))
        }
        single = found["best_single"][PAID]
        liked = LIKED.format(
            **numbers, single=f"{single['mean']:.0f}", who=_who(single["robot"], "the best single robot")
        )
    return CROSSPLAY.format(
        picture=picture.name,
        pairs=f"{found['self_play']['success']:.0%}",
        crossed=f"{found['cross_play']['success']:.0%}",
        number=len(found["ids"]),
        episodes=found["episodes"],
        single=f"{best['mean']:.0%}",
        who=_who(best["robot"], "one of these"),
        expert=f"{sum(expert) / len(expert):.0%}",
        liked=liked,
        verdict=_verdict(found),
        ways=_by_taste([rows[one] for one in found["ids"]], found["matrix"]),
    )


def _who(robot: str, member: str) -> str:
    return member if robot.startswith("member") else f"`{robot}`"


def _verdict(found: Mapping[str, Any]) -> str:
    """Whether partners matter, and by which numbers; see `validity.judge`."""
    if not found["valid"]:
        return f"Partners do not matter: {found['why']}."
    said = []
    for name in found.get("matters_in", ("success",)):
        zero = 0.0 if name == "success" else np.mean(found["others"]["still"][name])
        best, knowing = (found[who][name]["mean"] - zero for who in ("best_single", "best_knowing"))
        robot = found["best_knowing"][name]["robot"]
        who = "everybody's own robot" if robot == "their own" else f"the robot `{robot}`"
        more = f"{knowing / best - 1:.0%} more" if best > 0 else "some"
        above = " (above a still robot's)" if zero else ""
        said.append(
            f"in {name.replace('_', ' ')}{above} cross-play loses {found['lost'][name]:.0%}, and {who} has {more} than "
            f"the best single robot"
        )
    return f"Partners matter: {'; '.join(said)}."


def _by_taste(rows: list[Mapping[str, Any]], matrix: Mapping[str, Any]) -> str:
    """Tables of the means over pairs, the first without those who learned together; "" if all like the same and were
    taught the same."""
    tastes = list(map(taste, rows))
    kinds = list(dict.fromkeys(tastes))
    if len(kinds) < 2:
        return ""
    measure = PAID if PAID in matrix else "success"
    apart = np.where(np.eye(len(rows), dtype=bool), np.nan, np.array(matrix[measure]))
    of = {kind: np.array([one == kind for one in tastes]) for kind in kinds}
    table = []
    for mine in kinds:
        pairs = [apart[np.ix_(of[mine], of[theirs])] for theirs in kinds]
        table.append([_words(mine), *("" if np.isnan(x).all() else number(measure, np.nanmean(x)) for x in pairs)])
    return WAYS.format(
        measure="What preferences pay in episodes that succeed," if measure == PAID else "Success",
        are="like" if _liking(rows) else "were taught",
        table=markdown(["robot of / person of", *map(_words, kinds)], table),
        kinds=_by_kind(rows, matrix),
    )


def _by_kind(rows: list[Mapping[str, Any]], matrix: Mapping[str, Any]) -> str:
    """A table of who learned together, and of the others by whether body and taste are the same."""
    bodies, tastes = [row["person"]["disability"] for row in rows], list(map(taste, rows))
    measures = [name for name in ("safe_success", PAID) if name in matrix]
    shared = (
        ("who like the same", "who like something else")
        if _liking(rows)
        else ("taught the same way", "taught another way")
    )
    together = np.eye(len(rows), dtype=bool)
    body, way = (np.equal.outer(np.array(x), np.array(x)) for x in (bodies, tastes))
    kinds = {"learned together": together}
    for same_body, words in ((True, "the same body"), (False, "another body")):
        for same_way, taught in zip((True, False), shared, strict=True):
            kinds[f"learned apart, {words}, {taught}"] = ~together & (body == same_body) & (way == same_way)
    cells = [
        [name, str(there.sum()), *(number(one, np.array(matrix[one])[there].mean()) for one in measures)]
        for name, there in kinds.items()
        if there.any()
    ]
    return markdown(["robot and person", "pairs", *(name.replace("_", " ") for name in measures)], cells)


def _liking(rows: list[Mapping[str, Any]]) -> bool:
    return any(row["person"]["preference"] != "none" for row in rows)


def _words(kind: str) -> str:
    return " ".join(short(kind).split())
