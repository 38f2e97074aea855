"""`assistax reproduce`."""

import math
import sys
from pathlib import Path

from assistax.cli.common import ExecutorSet, Name, Number, duration, find_executor
from assistax.errors import UsageError


def reproduce(
    *,
    budget: Name = None,
    only: Name = None,
    seeds: Number = None,
    processes: Number = None,
    executor: Name = None,
    executor_set: ExecutorSet = (),
) -> None:
    """List the experiments behind the results and how far they are; with a budget, continue them.

    What is finished goes to results/; unfinished runs wait in runs/reproduce/ for the next time.

    For example:
      assistax reproduce
      assistax reproduce --only scratch-ippo
      assistax reproduce --budget 9m --only "version1/*-ippo-default-[26]M-?"

    Args:
      budget: how long to work: 90s, 9m or 1.5h. What is missing is done in the order of the list; what does not get
        finished is continued by the next call.
      only: experiments whose name contains this; * and ? stand for anything.
      seeds: of each training, instead of the one to five that the list has of it (the paper has 16).
      processes: do all that is missing, in so many processes side by side; instead of a budget. Choose trainings with
        --only: timings want a machine for themselves.
      executor: local, slurm or ray, as in `assistax population train`.
      executor_set: its settings.
    """
    from assistax.executors.drive import drive
    from assistax.experiments import WORKERS, advance, choose_experiments, jobs, status
    from assistax.files import writing
    from assistax.training.clock import progress_bar

    results, work = Path("results"), Path("runs/reproduce")
    if seeds is not None and seeds < 1:
        raise UsageError(f"seeds must be 1 or more, not {seeds}.")
    seconds = None if budget is None else duration(budget)
    chosen = choose_experiments(only, seeds)
    using = find_executor(processes, executor, executor_set, here=True)
    if using is None and processes is not None and seconds is None:  # this process does all that is missing
        seconds = math.inf
    if using is not None:
        if seconds is not None:
            raise UsageError("An executor does all that is missing; leave out --budget.")
        command = [sys.executable, "-m", "assistax", "reproduce", "--budget", "100000h"]
        command += [] if seeds is None else ["--seeds", str(seeds)]
        command += ["--only", only] if only else []
        missing = [job for job in jobs(chosen, results, work) if not job.finished]
        with writing(results):
            through = drive(
                work / WORKERS,
                missing,
                using,
                command,
                processes,
                lambda total, done: progress_bar(total, done, unit="%"),
            )
        finished = [job for job in missing if job.finished]
    elif seconds is not None:
        with writing(results):
            finished = advance(chosen, results, work, seconds)
    else:
        for experiment, fraction in status(chosen, results, work):
            state = "done" if fraction == 1.0 else f"{fraction:.0%}" if fraction else "missing"
            print(f"{experiment.name:56} {experiment.shows:16} {state}")
        return
    left = [(one, fraction) for one, fraction in status(chosen, results, work) if fraction < 1.0]
    begun = next((f"{one.name} is {fraction:.1%} done" for one, fraction in left if (work / one.name).exists()), "")
    goes_on = f": {begun}, and the same command continues it" if begun and not finished else ""
    print(f"finished {len(finished)}, {len(left)} left{goes_on}")
    if using is not None and not through:
        sys.exit(130)
