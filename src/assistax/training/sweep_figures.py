"""Pictures of a sweep: the area under the return curve against hyperparameters, as in the paper's appendix."""

from collections.abc import Sequence

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from assistax.results.figures import COLOURS, STYLE
from assistax.training.search import Search, choices, intervals


def overview(ranking: Sequence[dict], search: Search, title: str) -> Figure:
    """The area against every hyperparameter."""
    columns = min(len(search), 4)
    rows = -(-len(search) // columns)
    with rc_context(STYLE):
        figure, axes = _grid(rows, columns, title)
        for axis, name in zip(axes.ravel(), search, strict=False):
            _scatter(axis, ranking, ranking[:1], name, search)
            axis.set_xlabel(_label(name))
        for axis in axes.ravel()[len(search) :]:
            axis.remove()
    return figure


def facets(ranking: Sequence[dict], search: Search, name: str, title: str) -> Figure:
    """The area against one hyperparameter for every value of the last two that are choices; "all" pools them."""
    factors = list(choices(search).items())[-2:]
    values = [[*((factor, value) for value in each), None] for factor, each in factors]
    down, across = [[None]] * (2 - len(values)) + values
    with rc_context(STYLE):
        figure, axes = _grid(len(down), len(across), title)
        for (i, j), axis in np.ndenumerate(axes):
            chosen = [one for one in (down[i], across[j]) if one]
            shown = [entry for entry in ranking if all(entry["settings"][factor] == v for factor, v in chosen)]
            _scatter(axis, shown, ranking[:1], name, search)
            axis.set_title("\n".join(f"{_label(factor)} {v}" for factor, v in chosen) or "all")
        for axis in axes[-1]:
            axis.set_xlabel(_label(name))
    return figure


def _grid(rows: int, columns: int, title: str) -> tuple[Figure, np.ndarray]:
    figure = Figure((2.8 * columns + 0.4, 2.4 * rows + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False)
    for axis in axes[:, 0]:
        axis.set_ylabel("area under the curve")
    figure.suptitle(title)
    return figure, axes


def _scatter(axis: Axes, shown: Sequence[dict], best: Sequence[dict], name: str, search: Search) -> None:
    """A dot per configuration, a cross if it failed with some seed, a ring around the best."""
    interval, values = intervals(search).get(name), choices(search).get(name, ())
    if interval:
        decades = interval.log and interval.high >= 10 * interval.low
        axis.set(xscale="log" if decades else "linear", xlim=(interval.low, interval.high))
        axis.xaxis.set_minor_formatter(NullFormatter())
    else:
        axis.set_xticks(range(len(values)), list(map(str, values)))
        axis.set_xlim(-0.5, len(values) - 0.5)

    def x(entry):
        value = entry["settings"][name]
        aside = (0.618 * entry["config"]) % 1.0 - 0.5  # so that dots do not hide each other
        return value if interval else values.index(value) + 0.5 * aside

    def plot(entries, marker, **style):
        if dots := [(x(entry), entry["auc"]) for entry in entries if entry["auc"] is not None]:
            axis.plot(*zip(*dots, strict=True), marker, clip_on=False, **style)

    plot([entry for entry in shown if not entry["failed"]], "o", color=COLOURS[0], ms=4, alpha=0.7)
    plot([entry for entry in shown if entry["failed"]], "x", color=COLOURS[0], ms=4)
    plot([entry for entry in best if entry in shown], "o", color=COLOURS[1], ms=9, mfc="none")


def _label(name: str) -> str:
    return name.split(".")[-1].replace("_", " ")
