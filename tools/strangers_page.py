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
from assistax.teamwork.report import by_partner, picture
from assistax.teamwork.scores import FEWEST

PAGE = """# Robots that meet strangers

Robots that learned with some people of a [population](partners.md), with these and with others of it, whom they had
never met. [Ad-hoc teamwork](teamwork.md) says how they learned and what is measured. Intervals are 95 %, for new seeds
and new partners; of one robot, as of references, for new partners only. The gap is the mean with people of training
less that with strangers: above 0 strangers are served worse. The regret is what a robot is short of each person's own;
its gap, too, is training less strangers, so that below 0 strangers are served worse. It leaves out that some people are
easier to help than others. The column "beside" compares robots that met the same strangers. "Their own" is the robot
that each person learned with, who knows them; still, random and expert know nobody, the last one being told all that
the simulator knows. Written from `results/teamwork/` by `python tools/pages.py strangers`.

{each}
"""
ONE = """## {population}, {title}

{train} people to train with and {test} strangers, {episodes} episodes with each. {scored}

{methods}

Safe success with strangers by who they are:

{kinds}{liked}

![Safe success with people of training and strangers](images/{picture})"""
LIKED = """

What preferences pay in episodes that succeed, with everybody, those of training and strangers, by who they are:

"""
PAID = "gated_preference_return"


def page(results: Path, pictures: Path) -> str:
    """The page; its pictures go to the folder `pictures`."""
    paths = [
        path
        for path in sorted(results.glob("*/*.json"), key=lambda path: path.with_suffix(""))
        if "people" in (one := _any(path)) and "gap" in one
    ]
    return PAGE.format(each="\n\n".join(_one(read_json(path, TEAMWORK), path.stem, pictures) for path in paths))


def _any(path: Path) -> Mapping[str, Any]:
    """A file that may be of another kind, as people's cross-play is."""
    found = json.loads(path.read_text())
    return found if isinstance(found, dict) else {}


def _one(found: Mapping[str, Any], name: str, pictures: Path) -> str:
    population = found.get("population", found["task"])
    place = pictures / f"strangers_{population}_{name}.png"
    picture(found, place)
    split, _, about = name.partition("-")
    return ONE.format(
        population=population,
        picture=place.name,
        title=f"split `{split}`" + (f": {about}" if about else ""),
        train=len(found["partners"]["train"]),
        test=len(found["partners"]["test"]),
        episodes=found["episodes"],
        scored=_scored(found["test"]["scored"]["score"]),
        methods=_table(found),
        kinds=_by_kind(found["people"]["test"], found["test"]),
        liked=_liked(found),
    )


def _scored(partners: Sequence[bool]) -> str:
    count = f"{sum(partners)} of {len(partners)}"
    if sum(partners) < FEWEST:
        return f"There is no score: with {count} strangers somebody who knows them is better than who knows nobody."
    return f"Scores are over the {count} strangers with whom somebody who knows them is better than who knows nobody."


def _table(found: Mapping[str, Any]) -> str:
    """References, then methods, the best with strangers first."""
    part = found["test"]
    first = next(iter(part["methods"]))
    scores = [name for name, partners in part["scored"].items() if sum(partners) >= FEWEST]
    head = ["robot", "seeds", "safe, of training", "safe, strangers", "gap", "gap of regret", f"beside {first}"]
    liked = [PAID] if PAID in next(iter(part["methods"].values())) else []
    head += ["worst tenth", *(name.replace("_", " ") for name in (*scores, *liked)), "return"]
    head += ["clamped", "hit", "peak force, N"]
    rows = []
    for group in ("references", "methods"):
        known, strange = found["train"][group], part[group]
        for name in sorted(strange, key=lambda one: -strange[one]["safe_success"]["mean"]):
            one, gaps = strange[name], found["gap"].get(name, {})
            row = ["their own" if name == "own" else name, _seeds(found["runs"].get(name, ()))]
            row.append(_rate(known[name]["safe_success"]) if name in known else "")
            row.append(_rate(one["safe_success"]))
            row += [_rate(gaps[gap]) if gap in gaps else "" for gap in ("safe_success", "safe_regret")]
            less = part["differences"].get(name)
            row.append(_number(less["safe_success"], "+.0%") if less and group == "methods" else "")
            row.append(f"{one['safe_success']['worst']:.0%}")
            row += [_number(one[score], ".2f") if score in one else "" for score in scores]
            row += [_number(one[name], ".0f") for name in (*liked, "return")]
            row += [f"{one[hurt]['mean']:.0%}" for hurt in ("clamping", "impact")]
            rows.append([*row, f"{one['peak_force']['mean']:.0f}"])
    return markdown(head, rows)


def _seeds(runs: Sequence[Mapping[str, Any]]) -> str:
    """How many of a method's robots have learned for how many steps."""
    counts: dict[str, int] = {}
    for run in runs:
        steps = f"{run['steps'] / 1e6:g} M" if "steps" in run else "elsewhere"
        counts[steps] = counts.get(steps, 0) + len(run.get("seeds", (0,)))
    return ", ".join(f"{count} × {steps}" for steps, count in counts.items())


def _liked(found: Mapping[str, Any]) -> str:
    """What preferences pay by kind, of both parts together; nothing where people like nothing in particular."""
    parts = [found[part] for part in ("train", "test")]
    if PAID not in next(iter(parts[0]["methods"].values())):
        return ""
    both = {
        group: {
            name: {
                PAID: {"by_pair": np.hstack([np.array(part[group][name][PAID]["by_pair"], float) for part in parts])}
            }
            for name in parts[0][group]
        }
        for group in ("references", "methods")
    }
    return LIKED + _by_kind([one for part in ("train", "test") for one in found["people"][part]], both, PAID, ".0f")


def _by_kind(
    people: Sequence[Mapping[str, str]], part: Mapping[str, Any], measure: str = "safe_success", form: str = ".0%"
) -> str:
    """Means over people of one body, of one preference, of one way that was taught or habit, where they differ."""
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
            mean = by_partner(one[measure])
            cells = [mean[np.array(mine) & ~np.isnan(mean)] for mine in columns.values()]
            label = "their own" if name == "own" else name
            rows.append([label, *(f"{x.mean():{form}}" if len(x) else "" for x in cells)])
    return markdown(["robot", *columns], rows)


def _rate(one: Mapping[str, Any]) -> str:
    return _number(one, ".0%")


def _number(one: Mapping[str, Any], form: str) -> str:
    interval = f" [{one['ci'][0]:{form}}, {one['ci'][1]:{form}}]" if one["ci"] else ""
    return f"{one['mean']:{form}}{interval}"
