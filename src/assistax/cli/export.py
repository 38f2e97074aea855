"""`assistax export`."""

import dataclasses
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import tyro

from assistax.cli.common import Number
from assistax.errors import UsageError


def export(run: Annotated[Path, tyro.conf.Positional], *, out: Path, seed: Number = None) -> None:
    """Write the trained team of a run into one small file, which plays without the run folder.

    As .safetensors for `assistax play` and other commands, with what it reached at the end of training; as .npz for
    `assistax.load_team`, which needs only NumPy.

    Args:
      run: a run folder.
      out: NAME.safetensors or NAME.npz.
      seed: which of the run's seeds (default the first).
    """
    from assistax.files import write_atomically
    from assistax.training.numpy_team import as_numpy
    from assistax.training.run import Run
    from assistax.training.team_file import save_team

    found = Run.open(run)
    seeds = list(found.seeds.seeds)
    if seed is not None and seed not in seeds:
        raise UsageError(f"{run} has no seed {seed}; it has {', '.join(map(str, seeds))}.")
    seed = seeds[0] if seed is None else seed
    team = found.teams()[seeds.index(seed)]
    if out.suffix == ".npz":
        with TemporaryDirectory() as folder:
            as_numpy(team).save(part := Path(folder, out.name))
            write_atomically(out, part.read_bytes())
    else:
        save_team(out, team, dataclasses.replace(found.config, seed=seed), found.measured(seed))
    print(f"wrote {out}")
