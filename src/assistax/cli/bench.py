"""`assistax bench`."""

import math
import sys
from functools import partial
from typing import Annotated

import tyro
from tyro.conf import arg

from assistax.cli.common import Count, File, Json, Name, Switch, duration, print_json, print_table
from assistax.errors import UsageError


def bench(
    task: Annotated[str | None, tyro.conf.Positional, arg(metavar="[TASK]", help_behavior_hint="")] = None,
    *,
    all: Switch = False,
    engine: str = "auto",
    num_envs: Annotated[tuple[Count, ...], arg(metavar="N ...", help_behavior_hint="")] = (),
    seconds: float | None = None,
    train: Switch = False,
    profile: Switch = False,
    preset: str = "default",
    budget: Name = None,
    out: File = None,
    json: Json = False,
) -> None:
    """Measure speed on this machine: the environment beside its bare physics engine, and training.

    For example:
      assistax bench scratch
      assistax bench scratch --num-envs 1 64 1024 --train
      assistax bench scratch --profile
      assistax bench --all --budget 8m --out results/bench/laptop.json

    Args:
      task: `assistax tasks` lists them.
      all: every task, open loop and in training, at the sizes that tell most on this machine, in order of worth.
      engine: auto, mujoco, warp or mjx.
      num_envs: environments side by side, one or more numbers. Without it 1024; with --all several, and in training
        those of the preset.
      seconds: how long to measure each, after compilation (default 10, on an accelerator 2, where a round is short).
      train: also time IPPO training.
      profile: instead of rates, the microseconds of each stage of a physics step and of each part of a control step;
        of one task, engine mujoco.
      preset: of the training, default or paper.
      budget: begin nothing new after 90s, 8m or 1h, but for the first of what is missing.
      out: a JSON file for what is measured, with a figure beside it; a later call makes what it lacks.
      json: print JSON.
    """
    from assistax.diagnostics.bench import check_seconds
    from assistax.diagnostics.measurements import check_out, default_seconds, measure, newest_tasks, plan
    from assistax.tasks import task_spec

    if (task is None) != all:
        raise UsageError("Name a task, or all of them with --all, not both.")
    seconds = default_seconds() if seconds is None else seconds
    check_seconds(seconds)
    if preset != "default" and not (train or all):
        raise UsageError("--preset is of the training; add --train.")
    limit = math.inf if budget is None else duration(budget)
    check_out(out)
    if profile:
        if task is None or train or out is not None or budget is not None or len(num_envs) > 1:
            raise UsageError("--profile is of one task at one size, without --all, --train, --budget and --out.")
        return _profile(task, engine, num_envs[0] if num_envs else 1024, seconds, json)
    tasks = newest_tasks() if task is None else [task_spec(task).id]
    wanted = plan(tasks, engine, num_envs if all or num_envs else (1024,), train or all, preset)
    say = partial(print, file=sys.stderr if json else sys.stdout, flush=True)
    several = len(wanted) > 1
    report = measure(wanted, out, seconds, limit, say if several else lambda line: None)
    if out is not None:
        from assistax.diagnostics.figure import speeds
        from assistax.results.figures import save

        save(speeds(report), out.with_suffix(".png"))
    if json:
        print_json(report)
    elif not several:
        (row,) = (row for row in report["rows"] if wanted[0].is_of(row))
        print_table(row | {name: x for name, x in report.items() if name != "rows"})


def _profile(task: str, engine: str, num_envs: int, seconds: float, json: bool) -> None:
    from assistax.diagnostics.profile import profile
    from assistax.env import make

    (print_json if json else print_table)(profile(make(task, engine), num_envs, seconds))
