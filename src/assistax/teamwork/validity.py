"""Whether partners matter in a task; where they do not, a score of ad-hoc teamwork says nothing.

Every member's robot meets every member's person. In a task that needs no agreement the robots are as good with
strangers as with whom they learned with, and some one robot is as good with everybody as everybody's own.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from assistax.env import Env, EnvConfig
from assistax.errors import UsageError
from assistax.evaluation.playing import EVALUATION_SEED
from assistax.results.figures import STYLE, save
from assistax.settings import check_count, with_settings
from assistax.stamp import stamp
from assistax.teamwork.adhoc import CONSIDERATE, Meeting
from assistax.teamwork.report import Meetings
from assistax.teamwork.scores import gated
from assistax.teamwork.strangers import check_robots
from assistax.training.clock import progress_bar
from assistax.training.population import Population
from assistax.training.run import Run

MEASURES = ("return", "success", "safe_success", "gated_return", "gated_preference_return")
LOST = 0.2  # of self-play's return above a still robot's, or of its success: what cross-play must lose at least
GAINED = 0.1  # what everybody's own robot must have more than the best single one, of what that one has
TOLD = ("expert", CONSIDERATE)  # scripts that are told all that the simulator knows, the second what people like, too
JUDGED = ("return", "success"), ("gated_return", "success", "gated_preference_return")  # without preferences, with them


def validity_of(
    population: Population,
    episodes: int,
    sample: int | None = None,
    seed: int = EVALUATION_SEED,
    robots: Mapping[str, Sequence[Run]] | None = None,
    oracles: Mapping[str, Sequence[Run]] | None = None,
) -> dict[str, Any]:
    """Cross-play of a population.

    Args:
      population: two members or more who have robots; their earlier selves do not count.
      episodes: of each pair.
      sample: so many members, at random; None: all.
      seed: of the draws.
      robots: by name, runs of robots that may be the best single one, beside the members' own; any number of seeds.
      oracles: by name, runs of robots that are told who the person is; the best of them, or everybody's own robot, is
        what the best single one is compared with.

    Returns:
      ready for JSON: "ids"; by measure "matrix", a row for each robot and a column for each person; by name of a run's
      or a scripted robot, what it reaches with each person ("others"); and what `judge` says.
    """
    population = with_robots(population, sample, seed)
    number = len(population)
    env = Env(population.task, "auto", with_settings(EnvConfig(), {"human.people": population.people}))
    meeting, found = Meeting(env, population, episodes), []
    with progress_bar(number * number * episodes * env.episode_length, 0) as bar:
        for one in population.ids:
            robot = population.select([one]).partner("robot", deterministic=True, by_person=False)
            found.append(gated(meeting(robot, seed)))
            bar.update(number * episodes * env.episode_length)
    scripts = ("still", *(TOLD if env.config.human.preferring else TOLD[:1]))
    others = {name: gated(meeting.scripted(name, seed)) for name in scripts}
    others |= _by_seed(robots or {}, population, episodes, seed)
    told = _by_seed(oracles or {}, population, episodes, seed)
    others |= told
    measures = [name for name in MEASURES if name in found[0]]
    matrix = {name: np.stack([one[name].mean(1) for one in found]) for name in measures}
    by_person = {robot: {name: one[name].mean(1) for name in measures} for robot, one in others.items()}
    return {
        "task": population.task,
        "episodes": episodes,
        "seed": seed,
        "ids": list(population.ids),
        "people": [row["person"] for row in population.rows],
        "matrix": {name: np.round(x, 4).tolist() for name, x in matrix.items()},
        "others": {
            robot: {name: np.round(x, 4).tolist() for name, x in one.items()} for robot, one in by_person.items()
        },
        **judge(matrix, by_person, tuple(told)),
        **stamp(),
    }


def _by_seed(
    robots: Mapping[str, Sequence[Run]], population: Population, episodes: int, seed: int
) -> dict[str, dict[str, np.ndarray]]:
    """What the robots of these runs reach, see Meeting, by name and number of the seed."""
    found = {}
    for name, runs in robots.items():
        check_robots(runs, {"everybody": population})
        meetings = Meetings(runs[0].config, population, episodes)
        seeds = [gated(one) for run in runs for one in meetings(run, seed)]
        found |= {f"{name} {i}" if len(seeds) > 1 else name: one for i, one in enumerate(seeds)}
    return found


def judge(
    matrix: Mapping[str, np.ndarray], others: Mapping[str, Mapping[str, np.ndarray]], oracles: Sequence[str] = ()
) -> dict[str, Any]:
    """Whether partners matter.

    Args:
      matrix: by measure [robots, people], who belong together on the diagonal; returns and success at least, and with
        preferences those of `scores.gated`.
      others: by robot and measure [people], "still" among them; scripts of TOLD are no competitors.
      oracles: those of the others who are told who the person is.

    Returns:
      by measure the means of "self_play" and "cross_play", what is "lost" from one to the other, what one robot reaches
      on average that is the "best_single" one by this measure, and the same of the "best_knowing" one, an oracle or
      everybody's own robot; returns are above the still robot's in "lost" and in comparisons. "matters_in", the
      measures of JUDGED in which LOST and GAINED both hold; "valid" if there is one; "why" not.
    """
    own = np.eye(len(matrix["return"]), dtype=bool)
    self_play = {name: float(x[own].mean()) for name, x in matrix.items()}
    cross_play = {name: float(x[~own].mean()) for name, x in matrix.items()}
    zero = {name: 0.0 if "success" in name else float(others["still"][name].mean()) for name in matrix}
    lost = {name: _lost(self_play[name] - zero[name], cross_play[name] - zero[name]) for name in matrix}
    robots: dict[str, Mapping[str, np.ndarray]] = {
        f"member {i}": {name: x[i] for name, x in matrix.items()} for i in range(len(own))
    }
    robots |= {name: one for name, one in others.items() if name not in ("still", *TOLD, *oracles)}
    knowing = {name: others[name] for name in oracles} | {"their own": {name: x[own] for name, x in matrix.items()}}
    best, best_knowing = ({name: _best(those, name) for name in matrix} for those in (robots, knowing))
    matters, why = [], []
    for name in JUDGED["gated_return" in matrix]:
        most, single = best_knowing[name]["mean"] - zero[name], best[name]["mean"] - zero[name]
        if lost[name] >= LOST - 1e-9 and most >= (1 + GAINED) * single - 1e-9 and most > 0.0:
            matters.append(name)
        why.append(
            f"in {name.replace('_', ' ')} cross-play loses {lost[name]:.0%}, and one robot, {best[name]['robot']}, has "
            f"{number(name, best[name]['mean'])} with all, who knows the partner, {best_knowing[name]['robot']}, "
            f"{number(name, best_knowing[name]['mean'])}"
        )
    return {
        "self_play": self_play,
        "cross_play": cross_play,
        "lost": lost,
        "best_single": best,
        "best_knowing": best_knowing,
        "matters_in": matters,
        "valid": bool(matters),
        "why": "" if matters else "; ".join(why),
    }


def _best(robots: Mapping[str, Mapping[str, np.ndarray]], measure: str) -> dict[str, Any]:
    """Who has most on average over people."""
    name = max(robots, key=lambda robot: float(robots[robot][measure].mean()))
    return {"robot": name, "mean": float(robots[name][measure].mean())}


def with_robots(population: Population, sample: int | None = None, seed: int = EVALUATION_SEED) -> Population:
    """The members who have robots, without their earlier selves; or so many of them, at random."""
    if sample is not None:
        check_count("sample", sample)
    ids = [row["id"] for row in population.rows if row["robot"] and "fraction" not in row]
    if sample is not None and sample < len(ids):
        ids = sorted(np.random.default_rng(seed).permutation(ids)[:sample].tolist())
    if len(ids) < 2:
        raise UsageError("Cross-play needs two members with robots, or more.")
    return population.select(ids)


def matrix_picture(found: Mapping[str, Any], path: Path) -> None:
    """Return, success and what preferences pay: robots are rows, people columns, alike members side by side."""
    names = [name for name in ("return", "success", "gated_preference_return") if name in found["matrix"]]
    order = _by_convention(np.array(found["matrix"]["return"]))
    with rc_context(STYLE | {"axes.grid": False}):
        figure = Figure(figsize=(4.8 * len(names), 4.2), layout="constrained")
        for axes, name in zip(figure.subplots(1, len(names)), names, strict=True):
            matrix = np.array(found["matrix"][name])[np.ix_(order, order)]
            shown = axes.imshow(matrix, aspect="equal", vmin=0 if name == "success" else None)
            axes.set_title(f"{found['task']}: {name.replace('_', ' ')}")
            axes.set_xlabel("person of member")
            axes.set_ylabel("robot of member")
            figure.colorbar(shown, ax=axes, shrink=0.8)
        save(figure, path, dpi=150)


def number(measure: str, x: float) -> str:
    """A mean of a measure as a reader wants it: shares in percent."""
    return f"{x:.0%}" if "success" in measure else f"{x:.0f}"


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
