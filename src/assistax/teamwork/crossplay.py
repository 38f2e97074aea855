"""Cross-play (the paper's appendix "Crossplay"): everybody's robot beside everybody's person.

Who trains together agrees on ways that nobody else knows of. What is left of the return when the robot of one team
meets the person of another shows how much of it was agreement.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from assistax.env import Env
from assistax.errors import UsageError
from assistax.evaluation.playing import EVALUATION_SEED, Evaluator, summarize
from assistax.policies import Team
from assistax.results.figures import STYLE
from assistax.results.stored import flat
from assistax.training.clock import progress_bar

_OF_THE_MACHINE = ("num_threads", "contacts_per_env", "constraints_per_env")


@dataclass(frozen=True)
class Entrant:
    """A team, and the environment it knows."""

    name: str
    env: Env
    team: Team
    players: dict[str, str] = field(default_factory=dict)  # names by agent, where they are not the team's own
    person: int | None = None  # the row of the environment's list of people who it always is; None: drawn

    def player(self, agent: str) -> str:
        """The player's name: of entrants whose players have one name, it is the same player."""
        return self.players.get(agent, self.name)


def cross_play(
    entrants: Sequence[Entrant],
    episodes: int = 64,
    seed: int = EVALUATION_SEED,
    people: Sequence[Entrant] | None = None,
) -> dict[str, Any]:
    """Let every robot play with every person.

    The person brings body and preferences along: a pair plays in the environment of the person's team, all pairs
    with the same draws. A player that several teams have, as the still person of "still" and "expert", counts once.

    Args:
      entrants: two teams or more of one task.
      episodes: per pair.
      seed: of the draws.
      people: whose person plays, in place of the entrants'; one entrant is enough then, and no pair is a team.

    Returns:
      ready for JSON: "task", "episodes", "robots" and "persons" (names); "return", "success" and "force_in_contact"
      (N), means over episodes [robots, people]; "self_play" and "cross_play", the same averaged over the pairs that
      are a team and over the others (None if there are no others).

    Raises:
      UsageError: fewer than two teams, a team twice, or teams whose task, settings or observations differ.
    """
    _check(entrants, people)
    robots = {entrant.player("robot"): entrant for entrant in reversed(entrants)}
    persons = {
        (entrant.player("human"), str(_settings(entrant.env))): entrant for entrant in reversed(people or entrants)
    }
    robots, persons = dict(reversed(robots.items())), dict(reversed(persons.items()))
    own = () if people else entrants
    teams = {(e.player("robot"), (e.player("human"), str(_settings(e.env)))) for e in own}
    evaluators: dict[str, Evaluator] = {}
    shape = len(robots), len(persons)
    matrices = {name: np.zeros(shape) for name in ("return", "success", "force_in_contact")}
    together = np.array([[(robot, person) in teams for person in persons] for robot in robots])
    steps = episodes * entrants[0].env.episode_length
    with progress_bar(steps * together.size, 0) as bar:
        for i, robot in enumerate(robots.values()):
            for j, ((_, settings), human) in enumerate(persons.items()):
                evaluator = evaluators.setdefault(settings, Evaluator(human.env, episodes))  # compiled once
                rows = None if human.person is None else np.full(episodes, human.person)
                team = {"robot": robot.team["robot"], "human": human.team["human"]}
                played = summarize(evaluator(team, seed, rows))
                matrices["return"][i, j] = played["mean_return"]
                matrices["success"][i, j] = played["success_rate"]
                matrices["force_in_contact"][i, j] = played["force"]["mean_in_contact"]
                bar.update(steps)
    about: dict[str, Any] = {"task": entrants[0].env.name, "episodes": episodes}
    about |= {"robots": list(robots), "persons": [name for name, _ in persons]}
    about |= {name: matrix.tolist() for name, matrix in matrices.items()}
    for name, pairs in {"self_play": together, "cross_play": ~together}.items():
        means = {metric: float(matrix[pairs].mean()) for metric, matrix in matrices.items()} if pairs.any() else None
        about[name] = means
    return about


def _names(report: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Of rows and columns; older reports have a row and a column for every team."""
    return report.get("robots") or report["teams"], report.get("persons") or report["teams"]


def _check(entrants: Sequence[Entrant], people: Sequence[Entrant] | None) -> None:
    if len(entrants) < 2 and not people:
        raise UsageError("Cross-play takes two teams or more.")
    names = [entrant.name for entrant in entrants]
    if twice := [name for name in names if names.count(name) > 1]:
        raise UsageError(f"{twice[0]} is there twice; name every team once.")
    check_alike([(entrant.name, entrant.env) for entrant in entrants])
    for human in people or entrants:
        sizes = human.env.observation_sizes
        for robot in entrants:
            size = robot.env.observation_sizes["robot"]
            if size != sizes["robot"] and jax.tree.leaves(robot.team["robot"].params):  # scripted ones read none of it
                raise UsageError(
                    f"The robot of {robot.name} observes {size} numbers and would get {sizes['robot']} beside the "
                    f"person of {human.name}: one of them was trained with preferences to be seen, the other without."
                )


def check_alike(envs: Sequence[tuple[Any, Env]], free: Sequence[str] = ()) -> None:
    """Raise UsageError unless these environments, each with a name, differ in nothing but who the person is and in
    the settings that are `free` to differ."""
    for place, env in envs[1:]:
        ours, theirs = _settings(envs[0][1]), _settings(env)
        for name, value in ours.items():
            if not name.startswith("env.human.") and name not in free and theirs.get(name, value) != value:
                raise UsageError(
                    f"{name} is {value} in {envs[0][0]} and {theirs[name]} in {place}; "
                    "only what was measured in one task with the same settings can be compared."
                )


def _settings(env: Env) -> dict[str, Any]:
    """All that makes an environment what it is, by full name; the task first."""
    config = {name: value for name, value in dataclasses.asdict(env.config).items() if name not in _OF_THE_MACHINE}
    return {"task": env.name} | dict(
        flat({"env": config, "task_config": dataclasses.asdict(env.task.config), "engine": env.engine.name})
    )


def table(report: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Head and cells of a report: return and success by pair, then with their own person and with the others'."""
    robots, persons = _names(report)
    own_numbers = robots == persons
    head = ["robot of / person of", *(str(j + 1) if own_numbers else name for j, name in enumerate(persons))]
    cells = []
    for i, (name, *row) in enumerate(zip(robots, report["return"], report["success"], strict=True)):
        cells.append([f"{i + 1} {name}" if own_numbers else name, *map(_cell, *row)])
    for kind in ("self_play", "cross_play"):
        if mean := report[kind]:
            words = _cell(mean["return"], mean["success"])
            cells.append([f"{kind.replace('_', '-')}, mean", words, *[""] * (len(persons) - 1)])
    return head, cells


def _cell(value: float, success: float) -> str:
    return f"{value:.0f} ({success:.0%})"


def picture(report: dict[str, Any], metric: str = "return") -> Figure:
    """The matrix of a report as the paper draws it: a row per robot, a column per person."""
    matrix, (robots, persons) = np.array(report[metric]), _names(report)
    few = max(matrix.shape) <= 8
    inches = max(2.0, (0.6 if few else 0.25) * max(matrix.shape))
    with rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(inches + 2.5, inches + 1.2), layout="constrained")
        axes = figure.subplots()
        low, high = min(0.0, matrix.min()), matrix.max()
        shown = axes.imshow(matrix, vmin=low, vmax=high)
        for (i, j), value in np.ndenumerate(matrix) if few else ():
            colour = "white" if value < (low + high) / 2 else "black"
            words = f"{value:.0f}" if matrix.max() > 10 else f"{value:.2f}"
            axes.text(j, i, words, ha="center", va="center", size=8, color=colour)
        axes.set_xticks(range(len(persons)), persons, rotation=45, ha="right")
        axes.set_yticks(range(len(robots)), robots)
        axes.set(xlabel="person of", ylabel="robot of", title=report["task"])
        figure.colorbar(shown, label=metric.replace("_", " "))
    return figure
