"""Who does what: a claim is a file that one process has and nobody else gets, until it lets go of it or is lost.

The claims of a job are numbered, NAME.0001 and so on; the newest counts. It is linked into place whole and locked, so
that of all who want it one gets it, on shared file systems, too. Its owner is lost when the lock is free, which the
system sees to on the same machine; or, on another machine, when the owner has not touched the file for `LOST` seconds.
Nothing is ever taken away: the next owner writes the next number, and an owner that wakes up after that ends at once.
"""

import json
import os
import re
import socket
import sys
import threading
import time
import uuid
from contextlib import suppress
from pathlib import Path
from typing import Any

from assistax.files import write_atomically, writing

try:
    import fcntl
except ImportError:  # not on this system: then only time tells
    fcntl = None

BEAT = 15.0  # s between touches
LOST = 300.0  # s without one
_NUMBERED = re.compile(r"(.+)\.(\d{4,})")


def machine() -> str:
    """This machine and its space of processes, the only ones whose locks are certain to be seen."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {os.readlink('/proc/self/ns/pid')}"
    except OSError:
        return socket.gethostname()


class Claim:
    """A claim of this process; it lasts until `release`, or as long as the process."""

    def __init__(self, path: Path, handle: int):
        self.path, self._handle, self._ended = path, handle, threading.Event()
        self._touching = threading.Thread(target=self._touch, daemon=True)
        self._touching.start()

    def release(self, failed: str | None = None) -> None:
        """Let go of the job, whether it is finished or not; `failed` says in a line why it cannot be done."""
        self._ended.set()
        self._touching.join()
        with suppress(OSError, ValueError):  # UsageError, too: it is then as if this owner were lost
            content = json.loads(self.path.read_bytes()) | {"released": True}
            write_atomically(self.path, json.dumps(content | ({"failed": failed} if failed else {})).encode())
        os.close(self._handle)

    def _touch(self) -> None:
        name, _, number = self.path.name.rpartition(".")
        newer = self.path.with_name(f"{name}.{int(number) + 1:04d}")
        while not self._ended.wait(BEAT):
            if newer.exists():
                print(f"{name} was given to another process, for this one was silent too long.", file=sys.stderr)
                os._exit(1)
            with suppress(OSError):
                os.utime(self.path)


def claims(folder: Path) -> dict[str, list[Path]]:
    """By job, all its claims, oldest first."""
    found: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("*.*")) if folder.is_dir() else []:
        if match := _NUMBERED.fullmatch(path.name):
            found.setdefault(match[1], []).append(path)
    return found


def take(folder: Path, name: str, earlier: list[Path], at: int) -> Claim | None:
    """Claim a job of which `earlier` claims are known; `at` is how far it is. None if somebody else has it."""
    if earlier and is_held(earlier[-1]):
        return None
    number = int(earlier[-1].name.rpartition(".")[2]) + 1 if earlier else 1
    path, new = folder / f"{name}.{number:04d}", folder / f"new-{uuid.uuid4().hex}"
    who = {"machine": machine(), "host": socket.gethostname(), "pid": os.getpid(), "at": at, "since": time.time()}
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        try:
            new.write_text(json.dumps(who))
            handle = os.open(new, os.O_RDWR)
            with suppress(OSError):  # a file system without locks
                if fcntl is not None:
                    fcntl.flock(handle, fcntl.LOCK_EX)
            try:
                os.link(new, path)
            except OSError as error:
                os.close(handle)
                if isinstance(error, FileExistsError):
                    return None
                raise
        finally:
            new.unlink(missing_ok=True)
    return Claim(path, handle)


def is_held(path: Path) -> bool:
    """Whether the owner of a claim still has it."""
    about = read(path)
    if about.get("released"):
        return False
    if fcntl is not None and about.get("machine") == machine():
        try:
            handle = os.open(path, os.O_RDWR)
        except OSError:
            return False
        try:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)  # shared: those who ask do not see each other
            return False
        except BlockingIOError:
            return True
        except OSError:  # no locks here
            pass
        finally:
            os.close(handle)
    with suppress(OSError):
        return time.time() - path.stat().st_mtime < LOST
    return False


def read(path: Path) -> dict[str, Any]:
    """What a claim says: machine, host, pid, at, since; "released", and "failed" with a reason; {} if unreadable."""
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
