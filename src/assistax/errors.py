"""Errors that a user can act on: one line that says what was wrong and what would be right."""

import difflib
from collections.abc import Iterable


class AssistaxError(Exception):
    """Base of every error this package raises on purpose; the command line prints it and exits with 2."""


class UsageError(AssistaxError, ValueError):
    """A name, size, file or setting that cannot be used."""


class SimulationError(AssistaxError, RuntimeError):
    """The physics lost contacts or became non-finite; results after that point mean nothing."""


def choose(what: str, name: str, known: Iterable[str]) -> str:
    """Return `name` if it is one of `known`, else raise a UsageError that lists them and guesses."""
    known = list(known)
    if name in known:
        return name
    guess = difflib.get_close_matches(name, known, n=1)
    hint = f" Did you mean {guess[0]!r}?" if guess else ""
    raise UsageError(f"Unknown {what} {name!r}.{hint} Known: {', '.join(known) or 'none'}.")
