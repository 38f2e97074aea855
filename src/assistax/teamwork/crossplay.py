"""Cross-play (the paper's appendix "Crossplay"): everybody's robot beside everybody's person.

Who trains together agrees on ways that nobody else knows of. What is left of the return when the robot of one team
meets the person of another tells how much of it was agreement.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from assistax.env import Env
from assistax.errors import UsageError
from assistax.evaluation.playing import EVALUATION_SEED, Player, summarize
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


def cross_play(entrants: Sequence[Entrant], episodes: int = 64, seed: int = EVALUATION_SEED) -> dict[str, Any]:
    """Let every robot play with every person.

    The person brings body and preferences along: a pair plays in the environment of the person's team, all pairs
    with the same draws.

    Args:
      entrants: two teams or more of one task.
      episodes: per pair.
      seed: of the draws.

    Returns:
      ready for JSON: "task", "episodes", "teams" (names); "return", "success" and "force_in_contact" (N), means over
      episodes by [robot][person]; "self_play" and "cross_play", the same averaged over the pairs that belong together
      and over the others.

    Raises:
      UsageError: fewer than two teams, or teams whose task, settings or observations differ.
    """
    _check(entrants)
    players: dict[Any, Player] = {}
    matrices = {name: np.zeros((len(entrants),) * 2) for name in ("return", "success", "force_in_contact")}
    steps = episodes * entrants[0].env.episode_length
    with progress_bar(steps * len(entrants) ** 2, 0) as bar:
        for i, robot in enumerate(entrants):
            for j, human in enumerate(entrants):
                env = next(e.env for e in entrants if _settings(e.env) == _settings(human.env))  # compiled once
                team = {"robot": robot.team["robot"], "human": human.team["human"]}
                policies = {agent: policy for agent, (policy, _) in team.items()}
                player = players.setdefault((id(env), *policies.values()), Player(env, policies, episodes))
                said = summarize(player({agent: params for agent, (_, params) in team.items()}, seed))
                matrices["return"][i, j] = said["mean_return"]
                matrices["success"][i, j] = said["success_rate"]
                matrices["force_in_contact"][i, j] = said["force"]["mean_in_contact"]
                bar.update(steps)
    together = np.eye(len(entrants), dtype=bool)
    about: dict[str, Any] = {
        "task": entrants[0].env.name,
        "episodes": episodes,
        "teams": [entrant.name for entrant in entrants],
    }
    about |= {name: matrix.tolist() for name, matrix in matrices.items()}
    for name, pairs in {"self_play": together, "cross_play": ~together}.items():
        about[name] = {metric: float(matrix[pairs].mean()) for metric, matrix in matrices.items()}
    return about


def _check(entrants: Sequence[Entrant]) -> None:
    if len(entrants) < 2:
        raise UsageError("Cross-play takes two teams or more.")
    first = entrants[0]
    for other in entrants[1:]:
        ours, theirs = _settings(first.env), _settings(other.env)
        for name, value in ours.items():
            if not name.startswith("env.human.") and theirs.get(name, value) != value:
                raise UsageError(
                    f"{name} is {value} in {first.name} and {theirs[name]} in {other.name}; "
                    "cross-play is of one task with the same settings."
                )
    for human in entrants:
        sizes = human.env.observation_sizes
        for robot in entrants:
            size = robot.env.observation_sizes["robot"]
            if size != sizes["robot"] and jax.tree.leaves(robot.team["robot"][1]):  # scripted ones read none of it
                raise UsageError(
                    f"The robot of {robot.name} observes {size} numbers and would get {sizes['robot']} beside the "
                    f"person of {human.name}: one of them was trained with preferences to be seen, the other without."
                )


def _settings(env: Env) -> dict[str, Any]:
    """All that makes an environment what it is, by full name; the task first."""
    config = {name: value for name, value in dataclasses.asdict(env.config).items() if name not in _OF_THE_MACHINE}
    return {"task": env.name} | dict(
        flat({"env": config, "task_config": dataclasses.asdict(env.task.config), "engine": env.engine.name})
    )


def table(report: dict[str, Any]) -> tuple[list[str], list[list[str]]]:
    """Head and cells of a report: return and success by pair, then with their own person and with the others'."""
    names = report["teams"]
    head = ["robot of / person of", *(str(j + 1) for j in range(len(names)))]
    cells = []
    for i, (name, *row) in enumerate(zip(names, report["return"], report["success"], strict=True)):
        cells.append([f"{i + 1} {name}", *map(_cell, *row)])
    for kind in ("self_play", "cross_play"):
        said = _cell(report[kind]["return"], report[kind]["success"])
        cells.append([f"{kind.replace('_', '-')}, mean", said, *[""] * (len(names) - 1)])
    return head, cells


def _cell(value: float, success: float) -> str:
    return f"{value:.0f} ({success:.0%})"


def picture(report: dict[str, Any], metric: str = "return") -> Figure:
    """The matrix of a report as the paper draws it: a row per robot, a column per person."""
    matrix, names = np.array(report[metric]), report["teams"]
    few = len(names) <= 8
    inches = max(2.0, (0.6 if few else 0.25) * len(names))
    with rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(inches + 2.5, inches + 1.2), layout="constrained")
        axes = figure.subplots()
        low, high = min(0.0, matrix.min()), matrix.max()
        shown = axes.imshow(matrix, vmin=low, vmax=high)
        for (i, j), value in np.ndenumerate(matrix) if few else ():
            colour = "white" if value < (low + high) / 2 else "black"
            words = f"{value:.0f}" if matrix.max() > 10 else f"{value:.2f}"
            axes.text(j, i, words, ha="center", va="center", size=8, color=colour)
        axes.set_xticks(range(len(names)), names, rotation=45, ha="right")
        axes.set_yticks(range(len(names)), names)
        axes.set(xlabel="person of", ylabel="robot of", title=report["task"])
        figure.colorbar(shown, label=metric.replace("_", " "))
    return figure
