"""A population from the runs that trained its members."""

from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from assistax.errors import UsageError
from assistax.files import read_json
from assistax.formats import SUMMARY
from assistax.policies.habits import ALSO, HABITS
from assistax.training import journal
from assistax.training.configuration import TrainConfig
from assistax.training.population import Population, self_of
from assistax.training.run import Run

FRACTIONS = (1 / 3, 2 / 3)


def gather(runs: Iterable[Run]) -> Population:
    """The finished runs' teams, a member for every seed, and earlier ones that the runs have kept.

    Each run was trained with one person of its own.

    Raises UsageError for a run that is not finished, or is being prolonged, whose person or robot did not learn, or
    that was trained with people drawn afresh.
    """
    teams = []
    for run in runs:
        person, summary = one_person(run.config, run.folder), _summary(run)
        for seed, team, report in zip(run.seeds.seeds, run.teams(), summary["evaluation"], strict=True):
            row: dict[str, Any] = {"task": run.config.task, "algorithm": run.config.algorithm}
            row |= {"seed": seed, "steps": summary["steps"], "person": person, "robot": True}
            row |= {"taught": habit} if (habit := taught(run)) else {}
            final = row | {k: report[k] for k in ("mean_return", "success_rate", "safe_success_rate") if k in report}
            teams.append((final, team))
            teams += _earlier(run, row, final)
    return Population.of_teams(teams)


def _earlier(run: Run, row: dict[str, Any], final: dict[str, Any]) -> list[tuple[dict[str, Any], Any]]:
    """Of the snapshots that a run has kept, those nearest to FRACTIONS of its final success, then of its return.

    Success often comes at once: the return then tells what is a third of the way. As in fictitious co-play (Strouse et
    al. 2021): partners who are not yet good belong to those one may meet.
    """
    index = list(run.seeds.seeds).index(row["seed"])
    found: list[dict[str, Any]] = []
    for one in journal.read(run.folder, "evaluations"):
        if one["seed"] != row["seed"] or one["steps"] >= final["steps"]:
            continue
        means = {
            k: float(np.mean(one["episodes"][k])) for k in ("return", "success", "safe_success") if k in one["episodes"]
        }
        reached = {f"{k}_rate": x for k, x in means.items() if k != "return"}
        found.append({"steps": one["steps"], "mean_return": means["return"]} | reached)

    def off(one, fraction):
        return [abs(one[by] - fraction * final[by]) for by in ("success_rate", "mean_return")]

    teams, taken = [], set()
    for fraction in FRACTIONS:
        kept = [one for one in found if one["steps"] not in taken]
        for one in sorted(kept, key=partial(off, fraction=fraction)):
            if earlier := run.earlier_teams(one["steps"]):
                taken.add(one["steps"])
                teams.append((row | one | {"fraction": round(fraction, 3)}, earlier[index]))
                break
    return teams


def one_person(config: TrainConfig, place: Path | str) -> dict[str, str]:
    """Whom a run, in `place`, was trained with, in words."""
    human = config.env.human
    if human.people != "none" and len(human.listed) == 1:
        return {"disability": human.listed[0].disability, "preference": human.listed[0].preference}
    if human.people != "none" or human.disability == "standard" or human.preference == "sweep":
        raise UsageError(f"{place} was trained with people drawn afresh, not with one person.")
    return {"disability": human.disability, "preference": human.preference}


def selves_of(config: TrainConfig) -> set:
    """What a training's people, a seed each, have in common with all their selves in populations, see `self_of`.

    None where many people were drawn, or they did not learn.
    """
    with suppress(UsageError):
        row: dict[str, Any] = {"person": one_person(config, ""), "algorithm": config.algorithm}
        own = _taught(config)
        # What the run that it began with was taught, a stored configuration does not say: it may have been anything.
        may = ("", *HABITS, *ALSO) if config.start and not own else (own,)
        each = [row | ({"taught": habit} if habit else {}) for habit in may]
        learned = not any(text.startswith("human=") for text in config.partners)
        return {self_of(one | {"seed": seed}) for one in each for seed in config.seeds} if learned else set()
    return set()


def taught(run: Run) -> str:
    """The script that a run's person was taught at first, in this run or in that which it began with; "" for none."""
    habit = _taught(run.config)
    return habit if habit or run.start is None else taught(Run.open(run.start))


def _taught(config: TrainConfig) -> str:
    teachers = getattr(config.method, "teachers", ())
    return next((name for agent, _, name in (one.partition("=") for one in teachers) if agent == "human"), "")


def _summary(run: Run) -> dict[str, Any]:
    path = run.folder / "summary.json"
    if not path.exists():
        raise UsageError(f"{run.folder} is not finished: it has no summary.json.")
    if frozen := {"robot", "human"} - set(run.trainer.learners):
        raise UsageError(f"The {min(frozen)} of {run.folder} did not learn; a member is a team that learned together.")
    if run.measured(run.seeds.seeds[0]) is None:
        raise UsageError(f"{run.folder} is being prolonged; let it finish: assistax train --resume {run.folder}")
    return read_json(path, SUMMARY)
