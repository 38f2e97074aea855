"""Commands in this process."""

import contextlib
import io
import sys
from types import SimpleNamespace

import pytest

from assistax import cli


def assistax(*args):
    """What a command prints, without a process of its own, whose imports take longer than most commands."""
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(printed):
        patch.setattr(sys, "argv", ["assistax", *map(str, args)])
        cli.main()
    return SimpleNamespace(stdout=printed.getvalue())
