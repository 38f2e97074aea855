"""`assistax population`."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from assistax.cli.common import File, Number
from assistax.errors import UsageError


def population(
    action: Annotated[Literal["make", "list", "verify", "split", "merge"], tyro.conf.Positional],
    folder: Annotated[Path, tyro.conf.Positional],
    parts: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="RUN|POP ...")] = (),
    *,
    habits: bool = False,
    kind: str = "random",
    out: File = None,
    seed: Number = None,
) -> None:
    """Gather trained teams into a population of partners, a folder of data, and look at it.

    For example:
      assistax train scratch --set env.human.disability=tremor --out runs/tremor
      assistax train scratch --set env.human.disability=weakness --out runs/weak
      assistax population make populations/two runs/tremor runs/weak
      assistax population list populations/two
      assistax population verify populations/two
      assistax population split populations/two --kind disability
      assistax population merge populations/all populations/two populations/more

    Args:
      action: make, of finished runs; merge populations; list its members; verify that all of them are as they were
        saved; or split them into people to train with, to develop with and to test with.
      folder: of the population.
      parts: run folders, each trained with one person, of which every seed becomes a member; with merge, populations.
      habits: with make, add the scripted people, see docs/populations.md; they have the first run's person's body and
        preferences.
      kind: of the split: random (6 : 2 : 2), extreme (the paper's: train with the five who weigh speed most),
        interpolate or extrapolate (by how hard moving is), disability, preference or algorithm (whole groups are left
        out of training).
      out: where the split goes, a .json (default: into the population, for --partner human=POP:KIND/train).
      seed: of the split (default 0).
    """
    from assistax.teamwork.gather import gather
    from assistax.training import splits
    from assistax.training.population import Population
    from assistax.training.run import Run

    if parts and action not in ("make", "merge"):
        raise UsageError(f"Runs are for `population make`; leave out {parts[0]}.")
    if action in ("make", "merge"):
        if not parts:
            raise UsageError("Name the runs (or populations to merge) whose members it is to have, after its folder.")
        if action == "make":
            made = gather(Run.open(run) for run in parts)
        else:
            made = Population.merge([Population.load(part) for part in parts])
        if habits:
            made = Population.merge([made, Population.scripted(made.task, made.people[0])])
        made.save(folder)
        print(f"{len(made)} members of {made.task} in {folder}")
        return
    found = Population.load(folder)
    if action == "list":
        for row in found.rows:
            who, how = row["person"], f"{row['algorithm']}, seed {row['seed']}, {row['steps'] / 1e6:.1f} M steps"
            if "habit" in row:
                how = row["habit"]
            reached = (
                f"return {row['mean_return']:.0f}, success {row['success_rate']:.0%}" if "mean_return" in row else ""
            )
            if "safe_success_rate" in row:
                reached += f", safely {row['safe_success_rate']:.0%}"
            print(f"{row['id'][:12]}  {who['disability']:24} {who['preference']:10} {how:32} {reached}")
    elif action == "verify":
        print(f"{len(found)} members of {found.task}, all as they were saved")
    else:
        parts_of_it = splits.split(found, kind, seed or 0)
        path = out or splits.path_of(folder, kind)
        splits.save(path, parts_of_it)
        print(", ".join(f"{len(ids)} to {name}" for name, ids in parts_of_it.items()) + f", in {path}")
