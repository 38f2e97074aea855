"""docs/strangers.md: robots with the people they learned with and with strangers, from results/teamwork."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from assistax.files import read_json
from assistax.formats import TEAMWORK
from assistax.human.variety import PREFERENCES
from assistax.results.comparison import markdown
from assistax.teamwork.report import picture

PAGE = """# Robots that meet strangers

Robots that learned with some people of a [population](partners.md), with these and with others of it, whom they had
never met. [Ad-hoc teamwork](teamwork.md) says how they learned and what is measured. Intervals are 95 %, for new seeds
and new partners; of one robot, as of references, for new partners only. "Their own" is the robot that each person
learned with, who knows them; still, random and expert know nobody, the last one being told all that the simulator
knows. Written from `results/teamwork/` by `python tools/pages.py strangers`.

{each}
"""
ONE = """## {task}, split `{split}`

{train} people to train with and {test} strangers, {episodes} episodes with each, {steps}.

{methods}

Safe success with strangers by who they are:

{kinds}

![Safe success with people of training and strangers](images/strangers_{task}_{split}.png)"""


def page(results: Path, pictures: Path) -> str:
    """The page; its pictures go to the folder `pictures`."""
    paths = [path for path in sorted(results.glob("*/*.json")) if "people" in (one := _any(path)) and "gap" in one]
    return PAGE.format(each="\n\n".join(_one(read_json(path, TEAMWORK), path.stem, pictures) for path in paths))


def _any(path: Path) -> Mapping[str, Any]:
    """A file that may be of another kind, as people's cross-play is."""
    found = json.loads(path.read_text())
    return found if isinstance(found, dict) else {}


def _one(found: Mapping[str, Any], split: str, pictures: Path) -> str:
    picture(found, pictures / f"strangers_{found['task']}_{split}.png")
    steps = sorted({f"{run['steps'] / 1e6:g} M" for runs in found["runs"].values() for run in runs if "steps" in run})
    return ONE.format(
        task=found["task"],
        split=split,
        train=len(found["partners"]["train"]),
        test=len(found["partners"]["test"]),
        episodes=found["episodes"],
        steps=" or ".join(steps) + " steps a robot" if steps else "robots made elsewhere",
        methods=_table(found),
        kinds=_by_kind(found["people"]["test"], found["test"]),
    )


def _table(found: Mapping[str, Any]) -> str:
    """References, then methods, the best with strangers first."""
    scored = any(found["test"]["scored"])
    head = ["robot", "seeds", "safe, of training", "safe, strangers", "gap", "worst tenth"]
    head += ["score"] * scored + ["return", "clamped", "hit", "peak force, N"]
    rows = []
    for group in ("references", "methods"):
        known, strange = found["train"][group], found["test"][group]
        for name in sorted(strange, key=lambda one: -strange[one]["safe_success"]["mean"]):
            one = strange[name]
            row = ["their own" if name == "own" else name]
            row.append(str(len(one["return"]["by_seed"])) if group == "methods" else "")
            row.append(_rate(known[name]["safe_success"]) if name in known else "")
            row.append(_rate(one["safe_success"]))
            row.append(_rate(found["gap"][name]["safe_success"]) if name in found["gap"] else "")
            row.append(f"{one['safe_success']['worst']:.0%}")
            row += [_number(one["score"], ".2f") if "score" in one else ""] * scored
            row += [_number(one["return"], ".0f"), *(f"{one[hurt]['mean']:.0%}" for hurt in ("clamping", "impact"))]
            rows.append([*row, f"{one['peak_force']['mean']:.0f}"])
    return markdown(head, rows)


def _by_kind(people: Sequence[Mapping[str, str]], part: Mapping[str, Any]) -> str:
    """Means over strangers of one body, of one preference, of one way that was taught or habit, where they differ."""
    columns: dict[str, list[bool]] = {}
    preferences = {words: name for name, words in PREFERENCES.items()}
    for name in ("disability", "preference", "taught", "habit"):
        there = list(dict.fromkeys(one[name] for one in people if name in one))
        if len(there) > 1:
            for value in there:
                label = "healthy" if (name, value) == ("disability", "none") else preferences.get(value, value)
                label = f"habit {label}" if name == "habit" else label
                columns[label.replace("_", " ")] = [one.get(name) == value for one in people]
    rows = []
    for group in ("references", "methods"):
        for name, one in part[group].items():
            safe = np.array(one["safe_success"]["by_partner"], float)  # None, who has no robot of their own, is NaN
            cells = [safe[np.array(mine) & ~np.isnan(safe)] for mine in columns.values()]
            rows.append(["their own" if name == "own" else name, *(f"{x.mean():.0%}" if len(x) else "" for x in cells)])
    return markdown(["robot", *columns], rows)


def _rate(one: Mapping[str, Any]) -> str:
    return _number(one, ".0%")


def _number(one: Mapping[str, Any], form: str) -> str:
    interval = f" [{one['ci'][0]:{form}}, {one['ci'][1]:{form}}]" if one["ci"] else ""
    return f"{one['mean']:{form}}{interval}"
