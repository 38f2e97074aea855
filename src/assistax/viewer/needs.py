"""What a viewer needs of the machine, each in one line where it is missing."""

import os
import socket
import sys
from importlib.util import find_spec
from pathlib import Path

from assistax.errors import UsageError


def check_extra() -> None:
    """Raise UsageError unless the packages of the extra `view` are there."""
    if any(find_spec(name) is None for name in ("viser", "mjviser")):
        raise UsageError("The viewer needs viser and mjviser: pip install 'assistax[view]'.")


def check_port(host: str, port: int) -> None:
    """Raise UsageError unless a server can be opened there; viser itself would silently take another port."""
    if not 1 <= port <= 65535:
        raise UsageError(f"--port must be from 1 to 65535, not {port}.")
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise UsageError(
                f"Cannot serve on {host}, port {port} ({error.strerror or error}); take another one with --port."
            ) from None


def check_page(path: Path) -> None:
    """Raise UsageError unless a page can be written there."""
    if path.suffix != ".html":
        raise UsageError(f"--html writes a file named *.html, not {path.name!r}.")
    if not path.parent.is_dir():
        raise UsageError(f"The folder {path.parent} of --html does not exist.")


def check_display() -> None:
    """Raise UsageError where no window can be opened."""
    if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")):
        raise UsageError("There is no display for a window here; leave out --native to watch in a browser.")
