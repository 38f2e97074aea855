"""A picture of a population: who there is, and what they reach with the robots that they learned with."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from assistax.errors import UsageError
from assistax.human.variety import PREFERENCES
from assistax.results.figures import STYLE, save
from assistax.training.population import Population

MANY = 12  # columns, up to which cells are labelled


def portrait(population: Population, path: Path) -> None:
    """Safe success and return in self-play, a row for each body, a column for each preference, or way that was taught.

    A cell is the mean over the algorithms and seeds of this person; nobody is there where it is empty.
    """
    bodies, tastes, cells = by_person(population)
    number = len(_measured(population))
    with rc_context(STYLE):
        figure = Figure(figsize=(3.4 + 1.6 * min(len(tastes), MANY), 1.6 + 0.36 * len(bodies)), layout="constrained")
        titles = {"safe_success_rate": "safe success", "mean_return": "return"}
        for axes, (name, values) in zip(figure.subplots(1, 2, sharey=True), cells.items(), strict=True):
            top = 1.0 if name == "safe_success_rate" else None
            axes.imshow(values, aspect="auto", vmin=0.0, vmax=top, cmap="viridis")
            middle = np.nanmax(values) / 2
            for (i, j), value in np.ndenumerate(values if len(tastes) <= MANY else values[:0]):
                text = "" if np.isnan(value) else f"{value:.0%}" if top else f"{value:.0f}"
                axes.text(
                    j, i, text, ha="center", va="center", color="white" if value < middle else "black", fontsize=8
                )
            if len(tastes) <= MANY:
                axes.set_xticks(range(len(tastes)), tastes, fontsize=7)
            else:
                axes.set_xlabel(f"{len(tastes)} preferences")
            axes.set_yticks(range(len(bodies)), bodies)
            axes.set_title(titles[name])
            axes.grid(visible=False)
        figure.suptitle(f"{population.task}: {number} members with their own robots", fontsize=10)
        save(figure, path, dpi=150)


def by_person(population: Population) -> tuple[list[str], list[str], dict[str, np.ndarray]]:
    """Bodies, preferences (what was taught where nobody has one), and safe success and return in self-play [bodies,
    preferences].

    NaN where nobody is. Raises UsageError if nobody says what it reaches.
    """
    rows = _measured(population)
    if not rows:
        raise UsageError("No member of this population says what it reaches; there is nothing to draw.")
    bodies = list(dict.fromkeys(row["person"]["disability"] for row in rows))
    tastes = list(dict.fromkeys(map(taste, rows)))
    cells: dict[str, np.ndarray] = {}
    for name in ("safe_success_rate", "mean_return"):
        cells[name] = np.full((len(bodies), len(tastes)), np.nan)
        for i, body in enumerate(bodies):
            for j, one in enumerate(tastes):
                mine = [r[name] for r in rows if (r["person"]["disability"], taste(r)) == (body, one) and name in r]
                if mine:
                    cells[name][i, j] = np.mean(mine)
    return bodies, list(map(short, tastes)), cells


def taste(row: Mapping[str, Any]) -> str:
    """The preference of a manifest's row, or what was taught where there is none."""
    preference = row["person"]["preference"]
    return row.get("taught", "none") if preference == "none" else preference


def _measured(population: Population) -> list[dict[str, Any]]:
    """The members, without their earlier selves, who say what they reach."""
    return [row for row in population.rows if "fraction" not in row and "mean_return" in row]


def short(taste: str) -> str:
    """The name of a preference that has one, else words below each other."""
    named = {words: name for name, words in PREFERENCES.items()}.get(taste, taste.replace(" ", "\n"))
    return named.replace("_", " ").replace(" way", "\nway")
