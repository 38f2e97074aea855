"""Speeds over numbers of environments."""

import math
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from assistax.results.figures import COLOURS, STYLE

KINDS = {"open loop": "-", "training": "--"}  # by kind of measurement, the line


def speeds(report: dict[str, Any]) -> Figure:
    """Of a file of measurements: a colour for each task, steps/s on logarithmic axes."""
    lines: dict[tuple[str, str], list[tuple[int, int]]] = {}
    for row in report["rows"]:
        kind = "training" if row["of"]["preset"] else "open loop"
        rate = row["training_steps_per_s" if kind == "training" else "env_steps_per_s"]
        lines.setdefault((row["task"], kind), []).append((row["num_envs"] * row.get("num_seeds", 1), rate))
    tasks = list(dict.fromkeys(task for task, _ in lines))
    with rc_context(STYLE):
        figure = Figure(figsize=(5.0, 3.6), layout="constrained")
        axes = figure.subplots()
        for (task, kind), points in lines.items():
            colour = COLOURS[tasks.index(task) % len(COLOURS)]
            axes.plot(*zip(*sorted(points), strict=True), ls=KINDS[kind], color=colour, marker="o", ms=2.5)
        axes.set(xscale="log", yscale="log", xlabel="environments", ylabel="environment steps/s")
        sizes = sorted({x for points in lines.values() for x, _ in points})
        axes.set_xticks(sizes, [f"{size:,}" for size in sizes])
        axes.minorticks_off()
        axes.set_yticks([10**k for k in range(3, 8)], [f"{10**k:,}" for k in range(3, 8)])
        rates = [rate for points in lines.values() for _, rate in points]
        axes.set_ylim(10 ** math.floor(math.log10(min(rates))), 10 ** (math.floor(math.log10(max(rates))) + 1))
        axes.set_title(f"{report['hardware']}, {report['rows'][0]['engine']} engine")
        handles = [Line2D([], [], color=COLOURS[i % len(COLOURS)], label=task) for i, task in enumerate(tasks)]
        handles += [Line2D([], [], color="#555555", ls=ls, label=kind) for kind, ls in KINDS.items()]
        figure.legend(handles=handles, loc="outside right center")
    return figure
