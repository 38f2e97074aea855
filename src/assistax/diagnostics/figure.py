"""Speeds over numbers of environments."""

from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from assistax.results.figures import COLOURS, STYLE

KINDS: dict[str | None, dict[str, Any]] = {  # by preset of the training
    None: {"ls": "-", "marker": "o", "label": "open loop"},
    "default": {"ls": "--", "marker": "s", "label": "training, default"},
    "paper": {"ls": ":", "marker": "^", "label": "training, paper"},
}


def speeds(report: dict[str, Any]) -> Figure:
    """Of a file of measurements: a colour for each task, steps/s on logarithmic axes."""
    engines = list(dict.fromkeys(row["engine"] for row in report["rows"]))
    lines: dict[tuple[str, str | None], list[tuple[int, int]]] = {}
    for row in report["rows"]:
        preset = row["of"]["preset"]
        rate = row["training_steps_per_s" if preset else "env_steps_per_s"]
        task = row["task"] if len(engines) == 1 else f"{row['task']}, {row['engine']}"
        lines.setdefault((task, preset), []).append((row["num_envs"] * row.get("num_seeds", 1), rate))
    tasks = list(dict.fromkeys(task for task, _ in lines))
    with rc_context(STYLE):
        figure = Figure(figsize=(6.0, 3.6), layout="constrained")
        axes = figure.subplots()
        for (task, preset), points in lines.items():
            colour = COLOURS[tasks.index(task) % len(COLOURS)]
            axes.plot(*zip(*sorted(points), strict=True), color=colour, ms=3, **KINDS[preset])
        axes.set(xscale="log", yscale="log", xlabel="environments", ylabel="environment steps/s")
        sizes = sorted({x for points in lines.values() for x, _ in points})
        axes.set_xticks(sizes, [f"{size:,}" for size in sizes])
        axes.minorticks_off()
        axes.set_yticks([10**k for k in range(3, 8)], [f"{10**k:,}" for k in range(3, 8)])
        rates = [rate for points in lines.values() for _, rate in points]
        axes.set_ylim(0.7 * min(rates), 1.5 * max(rates))
        axes.set_title(f"{report['hardware']}, {' and '.join(engines)} engine")
        handles = [Line2D([], [], color=COLOURS[i % len(COLOURS)], label=task) for i, task in enumerate(tasks)]
        measured = {preset for _, preset in lines}
        handles += [Line2D([], [], color="#555555", ms=3, **KINDS[preset]) for preset in KINDS if preset in measured]
        figure.legend(handles=handles, loc="outside right center")
    return figure
