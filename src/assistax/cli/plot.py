"""`assistax plot`."""

import sys
from pathlib import Path
from typing import Literal

from assistax.cli.common import Runs


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
    normalised returns, or of success or safe success); for each version of the tasks and each kind of person, as with
    and without preferences. By algorithm: a panel per algorithm with a curve per task.

    For example:
      assistax plot runs/scratch-ippo-0 runs/scratch-mappo-0
      assistax plot results --by algorithm --out curves.svg
      assistax plot runs/scratch-ippo-0 --metric success

    Args:
      runs: run folders, or folders of finished ones, at any depth (default: results and runs). Sub-folders trials
        and ablations hold what was tried on the way and count only if they are named.
      by: what a panel is for: task or algorithm.
      metric: return, success, safe_success, peak_force, task_return, preference_return or another that all runs have.
      source: evaluation or training episodes (default: evaluation where there is any).
      scale: how returns of several tasks are put together: bound, expert or minmax (default: minmax where all have
        it, else bound).
      out: a .png, .svg or .pdf.
    """
    from assistax.results.comparison import read_references
    from assistax.results.figures import check_format, learning_curves, save
    from assistax.results.stored import differences, experiments, find_runs

    check_format(out)
    found = experiments(find_runs(runs))
    figure = learning_curves(found, read_references(), by=by, metric=metric, source=source, kind=scale)
    save(figure, out)
    print(f"wrote {out}")
    for remark in differences(found):
        print(remark, file=sys.stderr)
