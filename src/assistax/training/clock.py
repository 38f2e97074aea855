"""Where a training's time goes, how far it is, and when it has to stop."""

import math
import os
import signal
import sys
import time
from typing import Any

from tqdm import tqdm


class Clock:
    """Adds up the seconds spent in named blocks."""

    def __init__(self, seconds: dict[str, float]):
        self.seconds = dict(seconds)

    def __call__(self, name: str):
        self._name = name
        return self

    def __enter__(self):
        self._since = time.perf_counter()

    def __exit__(self, *_):
        passed = time.perf_counter() - self._since
        self.seconds[self._name] = self.seconds.get(self._name, 0.0) + passed

    def move(self, source: str, to: str, seconds: float) -> None:
        """Count seconds of `source` as of `to` instead."""
        self.seconds[source] -= seconds
        self.seconds[to] = self.seconds.get(to, 0.0) + seconds


def progress_bar(total: int, done: int, unit: str = " steps") -> tqdm:
    """Of environment steps, or another unit, on stderr; in a file, where nobody watches, a word every half minute."""
    interval = 0.1 if sys.stderr.isatty() else 30.0
    return tqdm(total=total, initial=done, unit=unit, unit_scale=True, mininterval=interval, maxinterval=interval)


class Stop:
    """Asks to stop after this iteration: at Ctrl-C, SIGTERM or SIGHUP, or after `seconds`.

    Another signal interrupts at once, but for those that come within a second: `timeout` and terminals send a program
    and its group one each. Where nothing can be lost, with `at_once`, the first does too.
    """

    SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP")
    TOGETHER = 1.0  # s

    def __init__(self, seconds: float = math.inf):
        self._deadline = time.monotonic() + seconds
        self._first: float | None = None
        self.at_once = False
        self._before: dict[int, Any] = {}

    @property
    def signalled(self) -> bool:
        """Whether somebody waits for it, who may lose patience."""
        return self._first is not None

    @property
    def asked(self) -> bool:
        """Whether it is time to save and stop."""
        return self.signalled or time.monotonic() > self._deadline

    def _ask(self, *_) -> None:
        now = time.monotonic()
        if self._first is None:
            self._first = now
            if self.at_once:
                raise KeyboardInterrupt
            os.write(2, b"\nStopping after this iteration; once more stops at once.\n")  # safe in a signal handler
        elif now - self._first > self.TOGETHER:
            raise KeyboardInterrupt

    def __enter__(self):
        for name in self.SIGNALS:
            number = getattr(signal, name, None)
            try:
                if number is not None:
                    self._before[number] = signal.signal(number, self._ask)
            except ValueError:  # not the main thread: then nobody sends us signals
                pass
        return self

    def __exit__(self, *_):
        for number, before in self._before.items():
            signal.signal(number, before)
