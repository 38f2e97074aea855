"""docs/partners.md: the populations that come with the project, from their manifests and their cross-play."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from assistax.files import read_json
from assistax.formats import SPLIT, VALIDITY
from assistax.results.comparison import markdown
from assistax.teamwork.portrait import by_person
from assistax.teamwork.validity import matrix_picture
from assistax.training.population import MANIFEST, Population

PAGE = """# The people who come with the project

[Populations](populations.md) of people who learned with a robot of their own. Written from `populations/` and
`results/teamwork/*/validity.json` by `python tools/pages.py populations`; [ad-hoc teamwork](teamwork.md) has what
robots reach that meet them.

{each}
"""
ONE = """## {task}

`populations/{task}` has {members} people with their robots{others}, by {algorithms}, {steps}.
What each reaches with its own robot, safe success and, in brackets, the return; columns are preferences, and the
[script](populations.md#conventions) that the person imitated at first, if any:

{self_play}
{splits}
{crossplay}"""
CROSSPLAY = """
### Who can work with whom

{pairs} of the episodes succeed with one's own robot, {crossed} with the others' ({number} robots by {number} people,
{episodes} episodes of each pair). The best single robot, {who}, has {single} with all of them, the scripted
one, which is told everything, {expert}. {verdict}

![Who works with whom](images/crossplay_{task}.png)
{ways}"""
WAYS = """
Success by what the people were taught; on the diagonal, too, robot and person have not learned together:

{table}

Safe success by what robot and person have in common:

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
    found = results / population.task / "validity.json"
    return ONE.format(
        task=population.task,
        members=len(rows) - habits,
        others=f", {earlier} earlier selves of them" * (earlier > 0) + f", {habits} people with habits" * (habits > 0),
        algorithms=", ".join(sorted({row["algorithm"] for row in rows if "habit" not in row})).upper(),
        steps=" or ".join(f"{x:.1f}" for x in steps) + " M steps each",
        self_play=markdown(["body", *(re.sub(r"\s+", " ", taste) for taste in tastes)], table),
        splits=f"\nSplits, with how many are to train, to develop and to test with: {', '.join(splits)}.\n"
        * bool(splits),
        crossplay=_crossplay(population, read_json(found, VALIDITY), pictures) if found.exists() else "",
    )


def _sizes(path: Path) -> str:
    parts = read_json(path, SPLIT)
    return ", ".join(str(len(parts[name])) for name in ("train", "val", "test"))


def _crossplay(population: Population, found: Mapping[str, Any], pictures: Path) -> str:
    matrix_picture(found, pictures / f"crossplay_{population.task}.png")
    rows = {row["id"]: row for row in population.rows}
    expert, best = found["others"]["expert"]["success"], found["best_single"]["success"]["robot"]
    return CROSSPLAY.format(
        task=population.task,
        pairs=f"{found['self_play']['success']:.0%}",
        crossed=f"{found['cross_play']['success']:.0%}",
        number=len(found["ids"]),
        episodes=found["episodes"],
        single=f"{found['best_single']['success']['mean']:.0%}",
        who="one of these" if best.startswith("member") else f"`{best}`",
        expert=f"{sum(expert) / len(expert):.0%}",
        verdict=_verdict(found),
        ways=_by_way([rows[one] for one in found["ids"]], found["matrix"]),
    )


def _verdict(found: Mapping[str, Any]) -> str:
    """Whether partners matter, and by which numbers; see `validity.judge`."""
    if not found["valid"]:
        return f"Partners do not matter: {found['why']}."
    lost = max(("return", "success"), key=lambda name: found["lost"][name])
    still = np.mean(found["others"]["still"]["return"])
    gains = {}
    for name, zero in (("return", still), ("success", 0.0)):
        best, knowing = (found[who][name]["mean"] - zero for who in ("best_single", "best_knowing"))
        gains[name] = knowing / best - 1 if best > 0 else np.inf
    gained = max(gains, key=lambda name: gains[name])
    knowing = found["best_knowing"][gained]["robot"]
    who = "everybody's own robot" if knowing == "their own" else f"the robot `{knowing}`"
    above = {"return": " (above a still robot's)", "success": ""}
    more = f"{gains[gained]:.0%} more" if np.isfinite(gains[gained]) else "some"
    return (
        f"Partners matter in this task: cross-play loses {found['lost'][lost]:.0%} of {lost}{above[lost]}, and\n"
        f"{who} has {more} {gained}{above[gained]} than the best single robot."
    )


def _by_way(rows: list[Mapping[str, Any]], matrix: Mapping[str, Any]) -> str:
    """Tables of the means over pairs, the first without those who learned together; "" if nobody was taught."""
    taught, success = [row.get("taught", "") for row in rows], np.array(matrix["success"])
    ways = [way for way in dict.fromkeys(taught) if way]
    if len(ways) < 2:
        return ""
    apart = np.where(np.eye(len(success), dtype=bool), np.nan, success)
    of = {way: np.array([one == way for one in taught]) for way in ways}
    table = []
    for mine in ways:
        pairs = [apart[np.ix_(of[mine], of[theirs])] for theirs in ways]
        table.append([mine, *("" if np.isnan(x).all() else f"{np.nanmean(x):.0%}" for x in pairs)])
    return WAYS.format(table=markdown(["robot of / person of", *ways], table), kinds=_by_kind(rows, matrix))


def _by_kind(rows: list[Mapping[str, Any]], matrix: Mapping[str, Any]) -> str:
    """A table of who learned together, and of the others by whether body and way are the same."""
    bodies, ways = [row["person"]["disability"] for row in rows], [row.get("taught", "") for row in rows]
    together = np.eye(len(rows), dtype=bool)
    body, way = (np.equal.outer(np.array(x), np.array(x)) for x in (bodies, ways))
    kinds = {"learned together": together}
    for same_body, words in ((True, "the same body"), (False, "another body")):
        for same_way, taught in ((True, "taught the same way"), (False, "taught another way")):
            kinds[f"learned apart, {words}, {taught}"] = ~together & (body == same_body) & (way == same_way)
    safe = np.array(matrix["safe_success"])
    cells = [[name, str(there.sum()), f"{safe[there].mean():.0%}"] for name, there in kinds.items() if there.any()]
    return markdown(["robot and person", "pairs", "safe success"], cells)
