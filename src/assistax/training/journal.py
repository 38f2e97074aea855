"""metrics.jsonl and evaluations.jsonl: what a training writes down as it goes, and what of it is there.

metrics.jsonl         one line per iteration and seed
evaluations.jsonl     one line per evaluation and seed: the result of each of its episodes
"""

import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from assistax.files import read_rows, write_atomically, writing
from assistax.formats import ROWS


class Journal:
    """One of the two files, open for appending."""

    def __init__(self, folder: Path, name: str):
        self._path = folder / f"{name}.jsonl"
        with writing(self._path):
            self._file = open(self._path, "a")  # noqa: SIM115, closed in __exit__

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_) -> None:
        self._file.close()

    def write(self, rows: Iterable[dict[str, Any]]) -> None:
        """Append rows, a line each."""
        with writing(self._path):
            self._file.write("".join(json.dumps(row) + "\n" for row in rows))
            self._file.flush()

    def sync(self) -> None:
        """Come back when all is on the disk: what a checkpoint knows of must not be lost after it."""
        with writing(self._path):
            os.fsync(self._file.fileno())


def read(folder: Path, name: str) -> list[dict[str, Any]]:
    """The rows of "metrics" or "evaluations" that are whole."""
    return read_rows(folder / f"{name}.jsonl", ROWS[name])


def keep(folder: Path, name: str, steps: int) -> None:
    """Drop what is after `steps`, and a last line that a crash has cut short."""
    kept = [row for row in read(folder, name) if row["steps"] <= steps]
    write_atomically(folder / f"{name}.jsonl", "".join(json.dumps(row) + "\n" for row in kept).encode())


def missing(folder: Path, name: str, steps: Iterable[int], seeds: Sequence[int]) -> int:
    """How many of the rows that there should be, one of each seed at each of these steps, are not there."""
    there = {(row["steps"], row["seed"]) for row in read(folder, name)}
    return len({(step, seed) for step in steps for seed in seeds} - there)
