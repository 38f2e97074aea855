"""`assistax population`."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from assistax.cli.common import Number
from assistax.errors import UsageError


def population(
    action: Annotated[Literal["make", "list", "verify", "split"], tyro.conf.Positional],
    folder: Annotated[Path, tyro.conf.Positional],
    runs: Annotated[tuple[Path, ...], tyro.conf.Positional] = (),
    *,
    out: Path | None = None,
    seed: Number = None,
) -> None:
    """Gather trained teams into a population of partners, a folder of data, and look at it.

    For example:
      assistax train scratch --set env.human.disability=tremor --out runs/tremor
      assistax train scratch --set env.human.disability=weakness --out runs/weak
      assistax population make populations/two runs/tremor runs/weak
      assistax population list populations/two
      assistax population verify populations/two
      assistax population split populations/two --out split.json

    Args:
      action: make, of finished runs; list its members; verify that all of them are as they were saved; or split them at
        random into people to train with, to develop with and to test with (6 : 2 : 2).
      folder: of the population.
      runs: run folders, each trained with one person; every seed is a member.
      out: where the split goes, a .json.
      seed: of the split (default 0).
    """
    from assistax.teamwork.population import Population, save_split, split
    from assistax.training.run import Run

    if runs and action != "make":
        raise UsageError(f"Runs are for `population make`; leave out {runs[0]}.")
    if action == "make":
        if not runs:
            raise UsageError("Name the runs whose teams are to be members, after the population's folder.")
        made = Population.of_runs(Run.open(run) for run in runs)
        made.save(folder)
        print(f"{len(made)} members of {made.task} in {folder}")
        return
    found = Population.load(folder)
    if action == "list":
        for row in found.rows:
            who, how = row["person"], f"{row['algorithm']}, seed {row['seed']}, {row['steps'] / 1e6:.1f} M steps"
            reached = f"return {row['mean_return']:.0f}, success {row['success_rate']:.0%}"
            if "safe_success_rate" in row:
                reached += f", safely {row['safe_success_rate']:.0%}"
            print(f"{row['id'][:12]}  {who['disability']:24} {who['preference']:10} {how:32} {reached}")
    elif action == "verify":
        print(f"{len(found)} members of {found.task}, all as they were saved")
    else:
        if out is None:
            raise UsageError("Say where the split goes: --out split.json.")
        parts = split(found, seed=seed or 0)
        save_split(out, parts)
        print(", ".join(f"{len(ids)} to {name}" for name, ids in parts.items()) + f", in {out}")
