"""One writer at a time for a folder."""

import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from assistax.errors import UsageError

try:
    import fcntl
except ImportError:  # not on this system: then nobody is kept out
    fcntl = None


@contextmanager
def locked(folder: Path) -> Generator[None, None, None]:
    """Keep others out of a folder; raises UsageError if another process has locked it. Locks end with their process."""
    if fcntl is None:
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise UsageError(f"Another process is writing to {folder}; wait until it is done, or stop it.") from None
        yield
    finally:
        os.close(handle)
