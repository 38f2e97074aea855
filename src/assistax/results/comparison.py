"""Experiments beside the paper's bound, the experts and each other: scales of the return, rows and tables."""

import dataclasses
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from assistax.env import EnvConfig
from assistax.errors import choose
from assistax.evaluation.statistics import FEW_SEEDS, Interval, iqm, mean, probability_of_improvement, seed_ci
from assistax.files import read_json
from assistax.formats import EXPERTS
from assistax.results.stored import Experiment, by_method, check_comparable, differences, flat, scales_return
from assistax.tasks import stored_task, task_spec

REFERENCES = Path("results/experts.json")  # what scripted policies reach, written by `tools/pages.py`
LEARNED = 0.9  # of the episodes a success, in an evaluation while training
OUTCOMES = {  # of the last evaluations beside the return: where they stand in a summary, and the most they can be
    "success": (("success_rate",), 1.0),
    "safe_success": (("safe_success_rate",), 1.0),
    "cost": (("outcomes", "cost", "mean"), np.inf),
}
SCALES = {  # of a return
    "bound": "return / paper's bound",
    "expert": "return / expert's return",
    "minmax": "min-max normalised return",  # 0 what the worst, 1 what the best scripted policy reaches
}


# -- scales ------------------------------------------------------------------------------------


def read_references(path: Path = REFERENCES) -> list[dict[str, Any]]:
    """What scripted policies reach: per task, policy and person what `summarize` says of them; [] without a file."""
    return read_json(path, EXPERTS) if path.exists() else []


def references_of(experiment: Experiment, records: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """The records that were measured on the experiment's task, with its person and its reward."""
    if not _standard(experiment):
        return []
    settings = experiment.runs[0].settings

    def same_person(record):
        names = ("disability", "preference", "people")
        return all(record["human"].get(name, "none") == settings.get(f"env.human.{name}", "none") for name in names)

    return [r for r in records if stored_task(r["task"]) == experiment.task and same_person(r)]


def expert_of(experiment: Experiment, records: Iterable[dict[str, Any]]) -> dict[str, Any] | None:
    """The record of the expert: with a person who is still or offers, considerate or not, whichever is best."""
    found = [r for r in references_of(experiment, records) if r["policy"] in ("expert", "considerate", "offer")]
    return max(found, key=lambda r: r["mean_return"], default=None)


def bound_of(experiment: Experiment) -> float | None:
    """The paper's upper bound of the return, with preferences the combined one; None if the reward is another."""
    spec = task_spec(experiment.task)
    if spec.bound is None or not _standard(experiment):
        return None
    return spec.bound + experiment.preferring * EnvConfig.episode_length * spec.preference_budget


def scale(experiment: Experiment, kind: str, records: Iterable[dict[str, Any]]) -> Interval | None:
    """The returns that count 0 and 1 on one of SCALES; None if the experiment has none."""
    if choose("scale", kind, SCALES) == "bound":
        bound = bound_of(experiment)
        return None if bound is None else (0.0, bound)
    expert = expert_of(experiment, records)
    if expert is None:
        return None
    if kind == "expert":
        return 0.0, expert["mean_return"]
    there = references_of(experiment, records)
    if not any(r["policy"] in ("still", "random") for r in there):  # the worst would be an expert
        return None
    returns = [r["mean_return"] for r in there]
    return (min(returns), max(returns)) if len(returns) > 1 else None


def scales(found: Iterable[Experiment], kind: str, records) -> dict[Experiment, Interval] | None:
    """The `scale` of each, or None if one has none."""
    ends = {e: scale(e, kind, records) for e in found}
    known = {e: end for e, end in ends.items() if end is not None}
    return known if len(known) == len(ends) else None


def _standard(experiment: Experiment) -> bool:
    """Whether reward and length of an episode are those that bounds and references are of."""
    usual = {"task_config": dataclasses.asdict(task_spec(experiment.task).config)}
    usual["env"] = dataclasses.asdict(EnvConfig())
    usual = json.loads(json.dumps(dict(flat(usual))))  # tuples as JSON has them
    settings = experiment.runs[0].settings
    return all(settings.get(name, value) == value for name, value in usual.items() if scales_return(name))


# -- tables ------------------------------------------------------------------------------------


def estimate(tasks: Sequence[np.ndarray], least: float = -np.inf, most: float = np.inf) -> dict[str, Any]:
    """Mean and interquartile mean of scores, per task [seeds], with intervals over seeds, within [least, most]."""
    found: dict[str, Any] = {}
    for name, statistic in {"mean": mean, "iqm": iqm}.items():
        ci = seed_ci(tasks, statistic)
        found |= {name: float(statistic(tasks)), f"{name}_ci": ci and (max(ci[0], least), min(ci[1], most))}
    return found


def describe(experiment: Experiment, records: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """One row: where it comes from and the results of its last evaluations, ready for JSON."""
    runs, returns = experiment.runs, experiment.final("mean_return")
    row = {"task": experiment.task, "person": experiment.person, **dataclasses.asdict(experiment.method)}
    row |= {"seeds": experiment.seeds, "episodes": int(experiment.final("episodes").min())}
    row["return"] = estimate([returns]) | {"by_seed": returns.tolist()}
    for kind in ("bound", "expert"):
        ends = scale(experiment, kind, records)
        row[f"of_{kind}"] = None if ends is None else float(returns.mean() / ends[1])
    if experiment.preferring:
        row |= {name: estimate([experiment.final(name, "mean")]) for name in ("task_return", "preference_return")}
    row |= outcomes([experiment])
    row["learned"] = learned(experiment)
    row["force_in_contact"] = estimate([experiment.final("force", "mean_in_contact")], least=0.0)
    row["peak_force"] = estimate([experiment.final("outcomes", "peak_force", "mean")], least=0.0)
    about = {name: [run.origin(name) for run in runs] for name in ("commit", "hardware")}
    about["versions"] = [run.stamp.get("versions") for run in runs]
    return row | {"settings": runs[0].settings, "runs": [str(run.folder) for run in runs], **about}


def outcomes(tasks: Sequence[Experiment]) -> dict[str, Any]:
    """An `estimate` of each of OUTCOMES that all runs have."""
    return {
        name: estimate([e.final(*where) for e in tasks], least=0.0, most=most)
        for name, (where, most) in OUTCOMES.items()
        if all(e.has(*where) for e in tasks)
    }


def learned(experiment: Experiment) -> list[dict[str, float]]:
    """By seed that came there, when evaluations first had LEARNED of success, where harm was measured of safe success:
    "steps", and "minutes" of training, of which the seeds of a run have equal shares."""
    found, name = [], "safe_success" if experiment.has("safe_success_rate") else "success"
    for run in experiment.runs:
        seconds = sum(time for name, time in run.summary.get("seconds", {}).items() if name != "evaluation")
        trained = len(run.seeds) * run.summary.get("steps", experiment.method.steps)
        for seed in run.seeds:
            rows = [row for row in run.rows("evaluations") if row["seed"] == seed]
            steps = [row["steps"] for row in rows if np.mean(row["episodes"].get(name, 0.0)) >= LEARNED]
            if steps:
                found.append({"steps": min(steps), "minutes": seconds / 60.0 * min(steps) / trained})
    return found


def aggregates(found: Sequence[Experiment], records: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Per version, person and method with two tasks and more, over the tasks: returns on each of SCALES and each of
    OUTCOMES that all of them have."""
    rows = []
    for (version, person, method), each in by_method(found).items():
        if len(each) < 2:
            continue
        row: dict[str, Any] = {"version": version, "person": person, **dataclasses.asdict(method)}
        row |= {"tasks": [e.task for e in each], "seeds": [len(e.seeds) for e in each]}
        for kind in SCALES:
            ends = scales(each, kind, records)
            row[kind] = ends and estimate([(e.final("mean_return") - a) / (b - a) for e, (a, b) in ends.items()])
        rows.append(row | outcomes(each))
    return rows


def comparisons(found: Sequence[Experiment]) -> list[dict[str, Any]]:
    """Of every two methods with the same tasks and person: how probable it is that the first beats the second."""
    check_comparable(found)
    groups = list(by_method(found).items())
    rows = []
    for i, ((version, person, first), ours) in enumerate(groups):
        for (_, other, second), theirs in groups[i + 1 :]:
            pairs = [(a, b) for a in ours for b in theirs if a.task == b.task]
            if person != other or not pairs:
                continue
            scores = [[e.final("mean_return") for e in side] for side in zip(*pairs, strict=True)]
            probability, ci = probability_of_improvement(*scores)
            row: dict[str, Any] = {"version": version, "person": person}
            row |= {"first": dataclasses.asdict(first), "second": dataclasses.asdict(second)}
            row |= {"tasks": [a.task for a, _ in pairs], "seeds": [[x.size for x in side] for side in scores]}
            rows.append(row | {"probability_of_improvement": probability, "ci": ci})
    return rows


def report(found: Sequence[Experiment], records: Sequence[dict[str, Any]], compare: bool = False) -> dict[str, Any]:
    """All there is to say of finished experiments, ready for JSON and for `tables`."""
    results = {"experiments": [describe(e, records) for e in found], "aggregates": aggregates(found, records)}
    if compare:
        results["comparisons"] = comparisons(found)
    results["remarks"] = [*differences(found), *_remarks(results, bool(records))]
    return results


def _remarks(results: dict[str, Any], referenced: bool) -> list[str]:
    """What the cells mean, in sentences."""
    rows, words = results["experiments"], []
    numbers = [len(row["seeds"]) for row in rows]
    if 1 in numbers:
        words.append("1 seed: no interval, for it says nothing about the next.")
    if any(1 < number < FEW_SEEDS for number in numbers):
        words.append(
            f"† fewer than {FEW_SEEDS} seeds: the interval (Student's t) is right if seeds are spread like a normal "
            "distribution, and too narrow if a few of many fail."
        )
    if not referenced:
        words.append(f"There is no {REFERENCES} here, so that no expert is compared with.")
    if any(row[name] is None for row in rows for name in ("of_bound", "of_expert")):
        words.append(
            "–: the task has no bound or no record of an expert, or reward, episode length or person are not those of "
            "the reference."
        )
    return words


Table = tuple[list[str], list[list[str]]]


def tables(results: dict[str, Any]) -> list[Table]:
    """Head and cells of each table of a `report`."""
    found = []
    rows = results["experiments"]
    head = ["task", *_METHOD, "seeds", "return [95 %]", "of the bound", "of the expert"]
    apart = [name for name in ("task_return", "preference_return") if any(name in row for row in rows)]
    shown = _shown(rows)
    head += [name.replace("_", " ") for name in (*apart, *shown)] + ["force in contact, N", "peak force, N"]
    head += [f"{LEARNED:.0%} at, M steps", "minutes to it"]
    cells = []
    for row in rows:
        n = len(row["seeds"])
        fractions = [_percent(row[f"of_{kind}"]) or "–" for kind in ("bound", "expert")]
        cell = [row["task"], *_method(row), str(n), _estimate(row["return"], n), *fractions]
        cell += [_estimate(row.get(name), n) for name in apart] + _outcomes(row, shown, n)
        cell += [_estimate(row[name], n, "{:.1f}".format) for name in ("force_in_contact", "peak_force")]
        cells.append([*cell, _median(row["learned"], "steps", 1e-6, n), _median(row["learned"], "minutes", 1.0, n)])
    found.append((head, cells))
    if rows := results["aggregates"]:
        shown = _shown(rows)
        head = [
            "version",
            "tasks",
            *_METHOD,
            "seeds",
            *(f"{kind}, IQM [95 %]" for kind in ("of the bound", "of the expert", "min-max")),
            *(f"{name.replace('_', ' ')}, mean [95 %]" for name in shown),
        ]
        cells = []
        for row in rows:
            few = min(row["seeds"])
            scores = [_estimate(row[kind], few, _percent, "iqm") or "–" for kind in SCALES]
            cell = [str(row["version"]), str(len(row["tasks"])), *_method(row), _seeds(row["seeds"]), *scores]
            cells.append(cell + _outcomes(row, shown, few))
        found.append((head, cells))
    if rows := results.get("comparisons"):
        cells = []
        for row in rows:
            value = {"mean": row["probability_of_improvement"], "mean_ci": row["ci"]}
            names = [_name(row[who]) for who in ("first", "second")]
            numbers = [_seeds(seeds) for seeds in row["seeds"]]
            few = min(map(min, row["seeds"]))
            cell = [*names, row["person"], str(row["version"]), str(len(row["tasks"])), " / ".join(numbers)]
            cells.append([*cell, _estimate(value, few, _percent)])
        found.append((["this", "beats that", "person", "version", "tasks", "seeds", "with probability [95 %]"], cells))
    return found


def markdown(head: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    return "\n".join("| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows))


_METHOD = ("algorithm", "preset", "person", "M steps")


def _method(row: dict[str, Any]) -> list[str]:
    name = row["algorithm"] + f" ({row['note']})" * bool(row["note"])
    return [name, row["preset"], row["person"], f"{row['steps'] / 1e6:g}"]


def _shown(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Those of OUTCOMES that a row has."""
    return [name for name in OUTCOMES if any(name in row for row in rows)]


def _outcomes(row: dict[str, Any], shown: Sequence[str], seeds: int) -> list[str]:
    words = {name: "{:.1f}".format if name == "cost" else _percent for name in shown}
    return [_estimate(row.get(name), seeds, words[name]) for name in shown]


def _name(method: dict[str, Any]) -> str:
    name, preset, _, steps = _method(method | {"person": ""})
    return f"{name}, {preset}, {steps} M"


def _seeds(numbers: Sequence[int]) -> str:
    return "–".join(str(n) for n in sorted({min(numbers), max(numbers)}))


def _median(values: list[dict[str, float]], name: str, unit: float, seeds: int) -> str:
    """Of the seeds that came there, and how many did if not all."""
    if not values:
        return "–"
    some = f" ({len(values)} of {seeds})" if len(values) < seeds else ""
    return f"{unit * float(np.median([value[name] for value in values])):.1f}{some}"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{value:.0%}"


def _estimate(value: dict[str, Any] | None, seeds: int, words=lambda x: f"{x:.0f}", kind: str = "mean") -> str:
    if value is None:
        return ""
    ci = value[f"{kind}_ci"]
    interval = "" if ci is None else f" [{words(ci[0])}, {words(ci[1])}]" + "†" * (seeds < FEW_SEEDS)
    return words(value[kind]) + interval
