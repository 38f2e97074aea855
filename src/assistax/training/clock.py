"""Where a training's time goes, how far it is, and when it has to stop."""

import math
import signal
import sys
import time

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


def progress_bar(total: int, done: int) -> tqdm:
    """Of environment steps, on stderr; in a file, where nobody watches it move, a word every half minute."""
    interval = 0.1 if sys.stderr.isatty() else 30.0
    return tqdm(total=total, initial=done, unit=" steps", unit_scale=True, mininterval=interval, maxinterval=interval)


class Stop:
    """Asks to stop after this iteration: at the first Ctrl-C (the second one interrupts), or after `seconds`."""

    def __init__(self, seconds: float = math.inf):
        self._deadline = time.monotonic() + seconds

    @property
    def asked(self) -> bool:
        return time.monotonic() > self._deadline

    def __enter__(self):
        def ask(*_):
            self._deadline = -math.inf
            signal.signal(signal.SIGINT, self._before)

        try:
            self._before = signal.signal(signal.SIGINT, ask)
        except ValueError:  # not the main thread: then nobody sends us Ctrl-C
            self._before = None
        return self

    def __exit__(self, *_):
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)
