"""Whether partners matter in a task; where they do not, a score of ad-hoc teamwork says nothing.

Every member's robot meets every member's person. In a task that needs no agreement the robots are as good with
strangers as with whom they learned with.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from assistax.env import Env, EnvConfig
from assistax.errors import UsageError
from assistax.evaluation.playing import EVALUATION_SEED
from assistax.results.figures import STYLE
from assistax.settings import with_settings
from assistax.stamp import stamp
from assistax.teamwork.adhoc import Meeting
from assistax.training.clock import progress_bar
from assistax.training.population import Population

MEASURES = ("return", "success", "safe_success")
LOST = 0.2  # of self-play's return above a still robot's, or of its success: what cross-play must lose at least


def validity_of(
    population: Population, episodes: int, sample: int | None = None, seed: int = EVALUATION_SEED
) -> dict[str, Any]:
    """Cross-play of a population.

    Args:
      population: two members or more who have robots; their earlier selves do not count.
      episodes: of each pair.
      sample: so many members, at random; None: all.
      seed: of the draws.

    Returns:
      ready for JSON: "ids"; by measure "matrix", a row for each robot and a column for each person, "self_play" and
      "cross_play" means, and what is "lost" from one to the other, as a fraction (of the return above a still robot's);
      "valid", and "why" not.
    """
    population = with_robots(population, sample, seed)
    number = len(population)
    env = Env(population.task, "auto", with_settings(EnvConfig(), {"human.people": population.people}))
    meeting, found = Meeting(env, population, episodes), []
    with progress_bar(number * number * episodes * env.episode_length, 0) as bar:
        for one in population.ids:
            robot = population.select([one]).partner("robot", deterministic=True, by_person=False)
            found.append(meeting(robot, seed))
            bar.update(number * episodes * env.episode_length)
    still = meeting.scripted("still", seed)["return"].mean(1)
    matrix = {name: np.stack([one[name].mean(1) for one in found]) for name in MEASURES if name in found[0]}
    own = np.eye(number, dtype=bool)
    self_play = {name: float(x[own].mean()) for name, x in matrix.items()}
    cross_play = {name: float(x[~own].mean()) for name, x in matrix.items()}
    lost = {name: _lost(self_play[name], cross_play[name]) for name in matrix}
    lost["return"] = _lost(self_play["return"] - still.mean(), cross_play["return"] - still.mean())
    valid = max(lost["return"], lost["success"]) >= LOST
    why = (
        ""
        if valid
        else f"cross-play loses {lost['return']:.0%} of the return and {lost['success']:.0%} of the success, "
        f"less than {LOST:.0%} of both: robots serve strangers as well as whom they know."
    )
    return {
        "task": population.task,
        "episodes": episodes,
        "seed": seed,
        "ids": list(population.ids),
        "people": [row["person"] for row in population.rows],
        "matrix": {name: np.round(x, 4).tolist() for name, x in matrix.items()},
        "self_play": self_play,
        "cross_play": cross_play,
        "lost": lost,
        "valid": bool(valid),
        "why": why,
    } | stamp()


def with_robots(population: Population, sample: int | None = None, seed: int = EVALUATION_SEED) -> Population:
    """The members who have robots, without their earlier selves; or so many of them, at random."""
    ids = [row["id"] for row in population.rows if row["robot"] and "fraction" not in row]
    if sample is not None and sample < len(ids):
        ids = sorted(np.random.default_rng(seed).permutation(ids)[:sample].tolist())
    if len(ids) < 2:
        raise UsageError("Cross-play needs two members with robots, or more.")
    return population.select(ids)


def matrix_picture(found: Mapping[str, Any], path: Path) -> None:
    """Return and success of every robot (rows) with every person (columns), alike members side by side."""
    order = _by_convention(np.array(found["matrix"]["return"]))
    with rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(9.6, 4.2), layout="constrained")
        for axes, name in zip(figure.subplots(1, 2), ("return", "success"), strict=True):
            matrix = np.array(found["matrix"][name])[np.ix_(order, order)]
            shown = axes.imshow(matrix, aspect="equal", vmin=0 if name == "success" else None)
            axes.set_title(f"{found['task']}: {name}")
            axes.set_xlabel("person of member")
            axes.set_ylabel("robot of member")
            figure.colorbar(shown, ax=axes, shrink=0.8)
        figure.savefig(path, dpi=150)


def _lost(own: float, cross: float) -> float:
    return (own - cross) / own if own > 1e-9 else 0.0


def _by_convention(matrix: np.ndarray) -> list[int]:
    """An order in which neighbours are good partners: hierarchical clustering of mutual returns."""
    from scipy.cluster.hierarchy import leaves_list, linkage
    from scipy.spatial.distance import squareform

    if len(matrix) < 3:
        return list(range(len(matrix)))
    mutual = (matrix + matrix.T) / 2
    distance = mutual.max() - mutual
    np.fill_diagonal(distance, 0.0)
    return leaves_list(linkage(squareform(distance, checks=False), "average", optimal_ordering=True)).tolist()
