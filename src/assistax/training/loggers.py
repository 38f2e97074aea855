"""Loggers that people already use: the rows of metrics.jsonl and evaluations.jsonl go to TensorBoard or wandb, too.

Each seed is a run of its own there, its steps are environment steps. A row's numbers keep their names, with slashes:
`episode/return`, `losses/robot/policy`; an evaluation's are means over its episodes, under `evaluation/`.
"""

from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol
from uuid import uuid4

import numpy as np

from assistax.errors import UsageError, choose
from assistax.files import write_atomically

_ABOUT = ("steps", "seed", "deterministic")  # what a row says of itself


class Logger(Protocol):
    """Where one seed's numbers go."""

    def numbers(self, steps: int, values: Mapping[str, float]) -> None:
        """Numbers by name, after so many environment steps."""
        ...

    def film(self, steps: int, path: Path) -> None:
        """The film at `path`, of the team after so many steps."""
        ...

    def close(self) -> None:
        """Write what is left."""
        ...


class TensorBoard:
    """Event files in RUN/tensorboard/seed-N."""

    def __init__(self, folder: Path, seed: int, steps: int, config: dict[str, Any]):
        writer = _package("tensorboardX", "tensorboard").SummaryWriter
        # What came after the checkpoint that a run continues from is logged anew.
        self._writer = writer(str(folder / "tensorboard" / f"seed-{seed}"), purge_step=steps + 1 if steps else None)

    def numbers(self, steps, values):
        for name, value in values.items():
            self._writer.add_scalar(name, value, steps)

    def film(self, steps, path):
        """Not shown: TensorBoard has no place for an .mp4."""

    def close(self):
        self._writer.close()


class Wandb:
    """A run per seed in the project "assistax", all of a folder in one group; WANDB_MODE=offline keeps it here.

    The folder remembers its name there, so that a training that is continued has the same run there.
    """

    def __init__(self, folder: Path, seed: int, steps: int, config: dict[str, Any]):
        self._wandb = _package("wandb", "wandb")
        known = folder / "wandb-id.txt"
        if not known.exists():
            write_atomically(known, uuid4().hex.encode())
        self._run = self._wandb.init(
            project="assistax",
            group=folder.name,
            name=f"{folder.name}-{seed}",
            id=f"{known.read_text()}-{seed}",
            resume="allow",
            reinit="create_new",
            dir=str(folder),
            config=config,
        )
        self._run.define_metric("steps")
        self._run.define_metric("*", step_metric="steps")

    def numbers(self, steps, values):
        self._run.log({"steps": steps, **values})

    def film(self, steps, path):
        self._run.log({"steps": steps, "film": self._wandb.Video(str(path))})

    def close(self):
        self._run.finish()


LOGGERS = {"tensorboard": TensorBoard, "wandb": Wandb}


def check_loggers(names: Iterable[str]) -> None:
    """Raise UsageError for a logger that does not exist or whose package is not installed."""
    for name in names:
        choose("logger", name, LOGGERS)
        _package({"tensorboard": "tensorboardX"}.get(name, name), name)


class Loggers:
    """All loggers of a training, of all of its seeds; a context, which closes them."""

    def __init__(self, names: Iterable[str], folder: Path, seeds: Iterable[int], steps: int, config: dict[str, Any]):
        self._by_seed = {seed: [LOGGERS[name](folder, seed, steps, config) for name in names] for seed in seeds}

    def __enter__(self) -> "Loggers":
        return self

    def __exit__(self, *_) -> None:
        for logger in self._all():
            logger.close()

    def rows(self, rows: Iterable[dict[str, Any]]) -> None:
        """Of metrics.jsonl or evaluations.jsonl."""
        for row in rows:
            for logger in self._by_seed[row["seed"]]:
                logger.numbers(row["steps"], dict(_numbers(row)))

    def film(self, steps: int, path: Path) -> None:
        """Of the first seed's trained team, to its loggers."""
        for logger in next(iter(self._by_seed.values())):
            logger.film(steps, path)

    def _all(self) -> list[Logger]:
        return [logger for loggers in self._by_seed.values() for logger in loggers]


def _numbers(row: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, float]]:
    """A row's numbers by name; of an evaluation the means over its episodes."""
    for name, value in row.items():
        if not prefix and name in _ABOUT:
            continue
        if isinstance(value, Mapping):
            inside = "evaluation" if not prefix and isinstance(next(iter(value.values()), 0), list) else name
            yield from _numbers(value, f"{prefix}{inside}/")
        elif isinstance(value, list):
            yield prefix + name, float(np.mean(value))
        elif value is not None:
            yield prefix + name, float(value)


def _package(module: str, extra: str) -> Any:
    try:
        return import_module(module)
    except ImportError as error:
        raise UsageError(f"--log {extra} needs the package {module}: pip install 'assistax[{extra}]'.") from error
