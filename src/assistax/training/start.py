"""Beginning with what another run has learned: its networks, critics among them, and what it knows of observations.

start/ in a run's folder is that run as it was then: config.json, its newest checkpoint, its partners and its own
start. So it can be told whom a robot has met, however long ago.
"""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import jax

from assistax.errors import UsageError
from assistax.files import writing
from assistax.learning.trainer import Trainer
from assistax.training.checkpoint import load_checkpoint, newest_checkpoint
from assistax.training.configuration import TrainConfig, read_config
from assistax.training.run_folder import check_checkpoint
from assistax.training.seeds import Seeds


def keep_start(start: Path, folder: Path) -> None:
    """Copy the run that another begins with into its folder."""
    newest = newest_checkpoint(start)
    assert newest is not None
    to = folder / "start"
    with writing(to):
        (to / "checkpoints").mkdir(parents=True)
        for path in (start / "config.json", newest):
            shutil.copyfile(path, to / path.relative_to(start))
        for name in ("partners", "start"):
            if (start / name).is_dir():
                shutil.copytree(start / name, to / name)


def begin(config: TrainConfig, trainer: Trainer, start: Path, state: Any) -> Any:
    """A fresh state of one seed with what the run in `start` has learned, and with its multiplier of the cost.

    `config` and `trainer` are those of the run that begins.

    Raises:
      UsageError: `start` is of another task or algorithm, its networks are others, or it has learned nothing yet.
    """
    then = read_config(start)
    path = newest_checkpoint(start)
    if path is None:
        raise UsageError(f"{start} has no checkpoint to begin with.")
    if then.num_seeds > 1:
        raise UsageError(f"{start} is of {then.num_seeds} seeds; begin with a run of one.")
    check_checkpoint(path, config)
    like = Seeds([0]).like(trainer.init)

    def learned(part: str, like: Any) -> Any:
        return jax.tree.map(lambda x: x[0], load_checkpoint(path, like, part))

    known = {name: learned(f".{name}", getattr(like, name)) for name in ("params", "normalizer")}
    if all(getattr(one.method, "constrained", False) for one in (then, config)):
        constraint = learned(".constraint", dataclasses.replace(like.constraint, so_far=()))
        known["constraint"] = dataclasses.replace(constraint, so_far=state.constraint.so_far)
    return dataclasses.replace(state, **known)
