"""Learning curves: of one run, and of experiments beside each other."""

import io
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from assistax.errors import UsageError, choose
from assistax.evaluation.statistics import FEW_SEEDS, iqm, mean, seed_ci
from assistax.files import check_folder, write_atomically
from assistax.results.comparison import SCALES, bound_of, expert_of, scale, scales
from assistax.results.stored import POINTS, Experiment, Method, best_source, by_method, check_comparable, curve
from assistax.tasks import task_spec

FORMATS = (".png", ".svg", ".pdf")
# Okabe and Ito's, which colour-blind readers can tell apart; without yellow, too light for a line.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
DASHES = ("-", "--", ":", "-.")  # the next one once the colours are used up
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "grid.color": "#e8e8e8",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.4,
    "savefig.dpi": 150,
    "svg.fonttype": "none",
}


@dataclass(frozen=True)
class Curve:
    """Steps [points] and, per task, values [seeds, points]."""

    steps: np.ndarray
    tasks: Sequence[np.ndarray]


@dataclass(frozen=True)
class Panel:
    """What one pair of axes shows."""

    title: str
    label: str  # of the vertical axis
    curves: dict[str, Curve]
    statistic: Callable = mean
    lines: dict[str, float] = field(default_factory=dict)  # to compare with


def check_format(path: Path) -> None:
    """Raise UsageError unless a figure can be written there."""
    if path.suffix not in FORMATS:
        raise UsageError(f"Can write {', '.join(FORMATS)}, not {path.name!r}.")
    check_folder(path)


def save(figure: Figure, path: Path, **settings: Any) -> None:
    """Write a figure, whole or not at all, in the format that the path's suffix names."""
    content = io.BytesIO()
    figure.savefig(content, format=path.suffix[1:], **settings)
    write_atomically(path, content.getvalue())


# -- of experiments ----------------------------------------------------------------------------


def learning_curves(
    found: Sequence[Experiment],
    records: Sequence[dict[str, Any]] = (),
    by: str = "task",
    metric: str = "return",
    source: str | None = None,
    kind: str | None = None,
) -> Figure:
    """Means over seeds against steps, with 95 % intervals over seeds as bands, none for one seed.

    Args:
      found: experiments; their returns must be comparable.
      records: what scripted policies reach, see `comparison.read_references`.
      by: "task": a panel per task, and with several tasks one with the interquartile mean over them, of methods that
        have them all; for each version of the tasks and kind of person. "algorithm": a panel per method, with a curve
        per task; for each of those, too.
      metric: of `Env.metrics`.
      source: "evaluation" or "training" episodes; None: for each experiment evaluation, if all its runs have it.
      kind: of comparison.SCALES, to put returns of several tasks together; None: minmax where all have it, else bound.
    """
    choose("grouping", by, ["task", "algorithm"])
    check_comparable(found)
    sources = {e: source or best_source(e) for e in found}
    source = " or ".join(sorted(set(sources.values())))
    label = f"{metric.replace('_', ' ')}, {source} episodes"
    curves = {e: Curve(steps, [values]) for e in found for steps, values in [curve(e, metric, sources[e])]}
    names = _names(found)
    groups = sorted(dict.fromkeys((e.version, e.person) for e in found), key=lambda group: group[0])
    versions, persons = map(set, zip(*groups, strict=True))

    def title(words, person, version=None):
        """With the version of several tasks: of one, its name says it."""
        who = "no preference, no disability" if person == "none" else person
        words += f", version {version}" * (version is not None and len(versions) > 1)
        return f"{words}\n{who}" if len(persons) > 1 else words

    if by == "algorithm":
        shown, scaled = _normalised(curves, records, metric, kind)
        panels = [
            Panel(title(names[method], person, version), scaled or label, {e.task: (shown or curves)[e] for e in each})
            for (version, person, method), each in by_method(found).items()
        ]
        return _draw(_fold(panels), source, same_scale=True)
    rows = []
    for version, person in groups:
        mine = {e: curves[e] for e in found if (e.version, e.person) == (version, person)}
        row, tasks = [], list(dict.fromkeys(e.task for e in mine))
        for task in tasks:
            here = [e for e in mine if e.task == task]
            lines = _lines(here[0], records) if metric == "return" else {}
            row.append(Panel(title(task, person), label, {names[e.method]: curves[e] for e in here}, lines=lines))
        shown, scaled = _normalised(mine, records, metric, kind)
        whole = {names[m]: each for (*_, m), each in by_method(list(mine)).items() if len(each) == len(tasks)}
        if shown and len(tasks) > 1 and whole:
            together = {name: _together([shown[e] for e in each]) for name, each in whole.items()}
            words = title(f"all {len(tasks)} tasks", person, version)
            row.append(Panel(words, f"{scaled or label}, IQM", together, iqm))
        rows.append(row)
    # A row for each version and person and a column for each task, if that leaves no holes.
    places = {(e.version, e.person, task_spec(e.task).name) for e in found}
    aligned = len(rows) > 1 and len(places) == len(rows) * len({task for *_, task in places})
    return _draw(rows if aligned else _fold([panel for row in rows for panel in row]), source)


def _fold(row: Sequence[Panel]) -> list[Sequence[Panel]]:
    return [row[i : i + 3] for i in range(0, len(row), 3)]


def _normalised(curves: dict[Experiment, Curve], records, metric: str, kind: str | None):
    """(Curves on a scale on which tasks can be put together, words for it), (None, "") if there is no such scale."""
    if metric in ("success", "safe_success"):
        return curves, ""
    if metric != "return":
        return None, ""
    for choice in [kind] if kind else ["minmax", "bound"]:
        if ends := scales(curves, choice, records):
            return {e: _between(of, *ends[e]) for e, of in curves.items()}, SCALES[choice]
    if kind:
        e = next(e for e in curves if scale(e, kind, records) is None)
        raise UsageError(f"{e.name}, person {e.person}: nothing to scale by {kind} with this reward and person.")
    return None, ""


def _between(of: Curve, low: float, high: float) -> Curve:
    return Curve(of.steps, [(values - low) / (high - low) for values in of.tasks])


def _together(curves: Sequence[Curve]) -> Curve:
    """Of several tasks: at the steps of the one with fewest points, as far as all go, the others interpolated."""
    first, last = max(c.steps[0] for c in curves), min(c.steps[-1] for c in curves)
    at = min((c.steps for c in curves), key=len)
    at = at[(at >= first) & (at <= last)]
    return Curve(at, [np.stack([np.interp(at, c.steps, seed) for seed in c.tasks[0]]) for c in curves])


def _names(found: Sequence[Experiment]) -> dict[Method, str]:
    """By method a name that says no more than it takes to tell them apart."""
    methods = list(dict.fromkeys(e.method for e in found))
    several = {name: len({getattr(m, name) for m in methods}) > 1 for name in ("preset", "steps")}
    names = {}
    for m in methods:
        parts = [m.algorithm, m.preset * several["preset"], f"{m.steps / 1e6:g} M steps" * several["steps"], m.note]
        names[m] = ", ".join(filter(None, parts))
    return names


def _lines(experiment: Experiment, records) -> dict[str, float]:
    lines, expert = {"paper's bound": bound_of(experiment)}, expert_of(experiment, records)
    lines |= {"expert": expert["mean_return"] if expert else None}
    return {name: value for name, value in lines.items() if value is not None}


def _draw(rows: Sequence[Sequence[Panel]], source: str, same_scale: bool = False) -> Figure:
    """Panels in rows, with one legend for all."""
    width = max(map(len, rows))
    panels = [panel for row in rows for panel in row]
    names = list(dict.fromkeys(name for panel in panels for name in panel.curves))
    looks: dict[str, dict[str, Any]] = {
        name: {"color": COLOURS[i % len(COLOURS)], "ls": DASHES[i // len(COLOURS) % 4]} for i, name in enumerate(names)
    }
    handles = []
    for name, look in looks.items():
        seeds = {values.shape[0] for p in panels if name in p.curves for values in p.curves[name].tasks}
        number = "–".join(map(str, sorted({min(seeds), max(seeds)})))
        handles.append(Line2D([], [], label=f"{name} ({number} seed{'s' * (max(seeds) > 1)})", **look))
    inches = max(4.5, 3.2 * width)
    columns = int(inches / (0.6 + 0.075 * max(len(str(handle.get_label())) for handle in handles)))
    columns = min(max(columns, 1), len(handles))
    with rc_context(STYLE):
        height = 0.5 + 2.4 * len(rows) + 0.2 * -(-len(handles) // columns)
        figure = Figure(figsize=(inches, height), layout="constrained")
        grid = figure.subplots(len(rows), width, squeeze=False, sharey=same_scale)
        for axes in grid.flat:
            axes.set_axis_off()
        for row, places in zip(rows, grid, strict=True):
            before = None
            for panel, axes in zip(row, places, strict=False):
                _fill(axes, panel, looks)
                axes.set(title=panel.title, ylabel=panel.label if panel.label != before else "")
                before = panel.label
        for column in grid.T:
            [axes for axes in column if axes.axison][-1].set_xlabel("million environment steps")
        figure.legend(handles=handles, loc="outside upper center", ncols=columns)
        figure.supxlabel(textwrap.fill(_caption(source, panels), int(18 * inches)), fontsize=7.5, color="#555555")
    return figure


def _fill(axes: Axes, panel: Panel, looks: dict[str, dict[str, Any]]) -> None:
    axes.set_axis_on()
    seen = [0.0, *panel.lines.values()]
    for name, shown in panel.curves.items():
        x, look = shown.steps / 1e6, looks[name]
        seeds_last = [values.T for values in shown.tasks]
        marker = "o" if len(x) <= 20 else None
        line = np.asarray(panel.statistic(seeds_last))
        seen.extend(line[np.isfinite(line)].tolist())
        axes.plot(x, line, marker=marker, ms=2.5, **look)
        bands = [
            seed_ci([scores[i] for scores in seeds_last], panel.statistic) or (np.nan, np.nan) for i in range(len(x))
        ]
        axes.fill_between(x, *np.transpose(bands), color=look["color"], alpha=0.2, lw=0)
    highest = max(panel.lines.values(), default=0.0)
    for name, y in panel.lines.items():
        axes.axhline(y, color="#777777", lw=0.8, ls=(0, (4, 3)))
        place = "bottom" if y == highest else "top"
        axes.annotate(name, (0.01, y), xycoords=("axes fraction", "data"), va=place, size=7, color="#555555")
    axes.margins(x=0.02)
    # Of lines only: the band of two seeds may be ten times as high as all there is to see.
    axes.set_ylim(min(seen), max(seen) + 0.1 * ((max(seen) - min(seen)) or 1.0))


def _caption(source: str, panels: Sequence[Panel]) -> str:
    """What lines and bands are."""
    words = [
        f"Mean over seeds of {source} episodes; band: 95 % interval over seeds (none for 1 seed or without spread)."
    ]
    numbers = [len(values) for panel in panels for curve in panel.curves.values() for values in curve.tasks]
    if any(1 < number < FEW_SEEDS for number in numbers):
        words.append(f"With fewer than {FEW_SEEDS} seeds it trusts that they are spread like a normal distribution.")
    if any(panel.statistic is iqm for panel in panels):
        words.append("IQM: interquartile mean over tasks and seeds.")
    if any(panel.label.startswith(SCALES["minmax"]) for panel in panels):
        words.append("Min-max: 0 the worst, 1 the best scripted policy.")
    if " or " in source:
        words.append("Training episodes where a run has no evaluations.")
    if "training" in source:
        words.append(f"Training samples actions; of more than {POINTS} iterations means over windows.")
    return " ".join(words)


# -- of one run --------------------------------------------------------------------------------


def learning_curve(rows: list[dict], title: str, path: Path) -> Figure:
    """Write return, reward terms, success rate and cost of a run against its steps, from its metrics.jsonl.

    With preferences also the two returns that add up to it, dashed the task's, dotted the preference's.
    """
    with rc_context(STYLE):
        panels = ["return per episode", "reward per 1000 steps, by term", "success rate"]
        panels += ["cost per episode"] * ("cost" in rows[0]["episode"])
        figure = Figure(figsize=(4.3 * len(panels), 3.6), layout="constrained")
        axes = figure.subplots(1, len(panels), sharex=True)
        terms = sorted(rows[0]["reward"])
        for i, seed in enumerate(sorted({row["seed"] for row in rows})):
            mine = [row for row in rows if row["seed"] == seed]
            ended = [row for row in mine if row["episodes"]]
            steps = [row["steps"] / 1e6 for row in ended]
            for axis, name, words, style in _OUTCOMES:
                if name in rows[0]["episode"]:
                    y, colour = [row["episode"][name] for row in ended], COLOURS[i % len(COLOURS)]
                    axes[axis].plot(steps, y, style, color=colour, label=f"seed {seed}{words}", lw=1.2)
            for j, term in enumerate(terms):
                x, y = [r["steps"] / 1e6 for r in mine], [1000 * r["reward"][term] for r in mine]
                label = term if seed == rows[0]["seed"] else None
                axes[1].plot(x, y, color=COLOURS[j % len(COLOURS)], label=label, lw=1.2)
        for axis, name in zip(axes, panels, strict=True):
            axis.set(xlabel="million environment steps", title=name)
            axis.legend(fontsize=8)
        figure.suptitle(f"{title}; training episodes, with sampled actions", fontsize=10)
        save(figure, path, dpi=110)
    return figure


_OUTCOMES = (  # of an episode: axis, name, words and line
    (0, "return", "", "-"),
    (0, "task_return", ", task", "--"),
    (0, "preference_return", ", preference", ":"),
    (2, "success", "", "-"),
    (2, "safe_success", ", safe", "--"),
    (3, "cost", "", "-"),
)
