"""Where a training's time goes, and when it has to stop."""

import math
import signal
import time


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
