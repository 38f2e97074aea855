"""A population from the runs that trained its members."""

from collections.abc import Iterable
from typing import Any

from assistax.errors import UsageError
from assistax.files import read_json
from assistax.formats import SUMMARY
from assistax.training.population import Population
from assistax.training.run import Run


def gather(runs: Iterable[Run]) -> Population:
    """The finished runs' teams, a member for every seed; each was trained with one person of its own.

    Raises UsageError for a run that is not finished, or was trained with people drawn afresh.
    """
    teams = []
    for run in runs:
        person, summary = one_person(run), _summary(run)
        for seed, team, report in zip(run.seeds.seeds, run.teams(), summary["evaluation"], strict=True):
            row: dict[str, Any] = {"task": run.config.task, "algorithm": run.config.algorithm}
            row |= {"seed": seed, "steps": summary["steps"], "person": person, "robot": True}
            row |= {k: report[k] for k in ("mean_return", "success_rate", "safe_success_rate") if k in report}
            teams.append((row, team))
    return Population.of_teams(teams)


def one_person(run: Run) -> dict[str, str]:
    """Whom a run was trained with, in words."""
    human = run.config.env.human
    if human.people != "none" and len(human.listed) == 1:
        return {"disability": human.listed[0].disability, "preference": human.listed[0].preference}
    if human.people != "none" or human.disability == "standard" or human.preference == "sweep":
        raise UsageError(f"{run.folder} was trained with people drawn afresh, not with one person.")
    return {"disability": human.disability, "preference": human.preference}


def _summary(run: Run) -> dict[str, Any]:
    path = run.folder / "summary.json"
    if not path.exists():
        raise UsageError(f"{run.folder} is not finished: it has no summary.json.")
    return read_json(path, SUMMARY)
