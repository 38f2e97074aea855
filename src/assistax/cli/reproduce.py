"""`assistax reproduce`."""

import re
from pathlib import Path

from assistax.cli.common import Count, Name
from assistax.errors import UsageError


def reproduce(*, budget: Name = None, only: Name = None, seeds: Count = 1) -> None:
    """List the experiments behind the results and how far they are; with a budget, continue them.

    What is finished goes to results/; unfinished runs wait in runs/reproduce/ for the next time.

    For example:
      assistax reproduce
      assistax reproduce --only scratch-ippo
      assistax reproduce --budget 9m --only "scratch-*-paper-40M-?"

    Args:
      budget: how long to work: 90s, 9m or 1.5h. What is missing is done in the order of the list.
      only: experiments whose name contains this; * and ? stand for anything.
      seeds: seeds of each training (the paper has 16).
    """
    from assistax.experiments import advance, choose_experiments, status
    from assistax.files import writing

    results, work = Path("results"), Path("runs/reproduce")
    if seeds < 1:
        raise UsageError(f"seeds must be 1 or more, not {seeds}.")
    seconds = None if budget is None else duration(budget)
    chosen = choose_experiments(only, seeds)
    if seconds is None:
        for experiment, fraction in status(chosen, results, work):
            state = "done" if fraction == 1.0 else f"{fraction:.0%}" if fraction else "missing"
            print(f"{experiment.name:56} {experiment.shows:16} {state}")
        return
    with writing(results):
        finished = advance(chosen, results, work, seconds)
    left = sum(fraction < 1.0 for _, fraction in status(chosen, results, work))
    print(f"finished {len(finished)}, {left} left")


def duration(text: str) -> float:
    """Seconds of "90s", "9m" or "1.5h"."""
    match = re.fullmatch(r"(\d+(?:\.\d+)?)([smh])", text)
    if not match or not float(match[1]):
        raise UsageError(f"A budget is a time like 90s, 9m or 1.5h, not {text!r}.")
    return float(match[1]) * {"s": 1, "m": 60, "h": 3600}[match[2]]
