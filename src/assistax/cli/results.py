"""`assistax table` and `plot`."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from assistax.cli.common import Json, aligned, print_json
from assistax.errors import UsageError

Runs = Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN ...")]


def table(runs: Runs = (), *, compare: bool = False, markdown: bool = False, json: Json = False) -> None:
    """Tabulate what finished runs have come to, with 95 % intervals over their seeds.

    Runs that differ in nothing but seeds are one row. Below it, for each algorithm with several tasks, the
    interquartile mean of normalised returns: by the paper's bound, by the expert's return, and between the worst and
    the best scripted policy (results/experts.json).

    For example:
      assistax table
      assistax table runs/scratch-ippo-0 runs/scratch-mappo-0 --compare
      assistax table results --json > results/table.json

    Args:
      runs: run folders, or folders of finished ones (default: results and runs).
      compare: also how probable it is that one algorithm beats another.
      markdown: print Markdown.
      json: print JSON, with seeds, commits, versions and hardware.
    """
    from assistax.results.comparison import markdown as as_markdown
    from assistax.results.comparison import read_references, report, tables
    from assistax.results.stored import experiments, find_runs

    if json and markdown:
        raise UsageError("Choose one of --json and --markdown.")
    said = report(experiments(find_runs(runs)), read_references(), compare)
    if json:
        print_json(said)
        return
    print("\n\n".join((as_markdown if markdown else aligned)(*each) for each in tables(said)))
    for remark in said["remarks"]:
        print(f"\n{remark}")


def plot(
    runs: Runs = (),
    *,
    by: Literal["task", "algorithm"] = "task",
    metric: str = "return",
    source: Literal["evaluation", "training"] | None = None,
    scale: Literal["bound", "expert", "minmax"] | None = None,
    out: Path = Path("learning_curves.png"),
) -> None:
    """Plot learning curves: means over seeds, with 95 % intervals over them.

    By task: a panel per task with a curve per algorithm, and one for all tasks together (interquartile mean of
    normalised returns); for each kind of person, as with and without preferences. By algorithm: a
    panel per algorithm with a curve per task.

    For example:
      assistax plot runs/scratch-ippo-0 runs/scratch-mappo-0
      assistax plot results --by algorithm --out curves.svg
      assistax plot runs/scratch-ippo-0 --metric success

    Args:
      runs: run folders, or folders of finished ones (default: results and runs).
      by: what a panel is for: task or algorithm.
      metric: return, success, peak_force, task_return, preference_return or another that all runs have.
      source: evaluation or training episodes (default: evaluation where all runs have it).
      scale: how returns of several tasks are put together: bound, expert or minmax (default: minmax where all have
        it, else bound).
      out: a .png, .svg or .pdf.
    """
    from assistax.results.comparison import read_references
    from assistax.results.figures import check_format, learning_curves
    from assistax.results.stored import differences, experiments, find_runs

    check_format(out)
    found = experiments(find_runs(runs))
    figure = learning_curves(found, read_references(), by=by, metric=metric, source=source, kind=scale)
    figure.savefig(out)
    print(f"wrote {out}")
    for remark in differences(found):
        print(remark, file=sys.stderr)
