"""The live viewer: a web server that plays episodes and shows them to whoever opens its page."""

import queue
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack

import numpy as np

from assistax.env import Env
from assistax.errors import AssistaxError
from assistax.policies import Team
from assistax.viewer.live import Live
from assistax.viewer.needs import check_port
from assistax.viewer.panel import Choice, Panel
from assistax.viewer.push import Hand, held_by
from assistax.viewer.scene import Scene, serving

FRAMES = 30  # per second
LATEST = 0.1  # s of wall time: what cannot be caught up with is left out, and the simulation runs slower
REST = 1.5  # s after the end of an episode

Casting = Callable[[str, tuple[str, ...]], tuple[Env, Team]]
"""Makes environment and team of a team's name and settings like "env.human.disability=tremor"; raises AssistaxError for
what does not fit."""


class Browser:
    """Serves the viewer; everything but the server itself happens in the thread that calls `tick` or `run`.

    Args:
      casting: see there.
      teams: names of the teams to choose from; it begins with the first one.
      seed: of the first episode.
      host, port: where it is served.

    Raises:
      UsageError: the port is in use, or the first choice does not fit.
    """

    def __init__(self, casting: Casting, teams: list[str], seed: int, host: str = "127.0.0.1", port: int = 8080):
        check_port(host, port)
        self._casting, self.chosen = casting, Choice(teams[0])
        self.live = Live(*casting(teams[0], ()), seed)
        self.speed, self.playing, self._due, self._rest = 1.0, True, 0.0, 0.0
        self.hand: Hand | None = None
        self._wishes: queue.SimpleQueue[tuple] = queue.SimpleQueue()
        self._shown: deque[tuple[float, int]] = deque(maxlen=FRAMES)  # when, and after how many control steps
        self._steps = 0  # control steps, of all episodes
        self._exit = ExitStack()
        self.server = self._exit.enter_context(serving(host, port))
        self.url = f"http://{'localhost' if host in ('127.0.0.1', '0.0.0.0') else host}:{self.server.get_port()}"
        self.panel = Panel(self.server, teams, self.wish)
        self._build()
        self._then = time.perf_counter()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self) -> None:
        """Stop serving."""
        self._exit.close()

    def run(self) -> None:
        """Play until interrupted."""
        while True:
            began = time.perf_counter()
            self.tick(began)
            time.sleep(max(0.0, began + 1 / FRAMES - time.perf_counter()))

    def wish(self, what: str, *args) -> None:
        """Ask, from any thread, for a method of this object before the next frame."""
        self._wishes.put((what, *args))

    def tick(self, now: float) -> None:
        """One frame: what was wished for, the steps that are due at this time of the clock in s, and the picture."""
        while not self._wishes.empty():
            what, *args = self._wishes.get()
            getattr(self, what)(*args)
        passed, self._then = min(now - self._then, LATEST), now
        if self.playing:
            self._play(passed * self.speed)
        self._show(now)

    # -- what can be wished for --------------------------------------------------------------------

    def pause(self) -> None:
        """Or play on."""
        self.playing = not self.playing
        self.panel.paused(not self.playing)

    def step(self) -> None:
        """One control step, and pause."""
        if self.playing:
            self.pause()
        if self.live.over:
            self.next()
        self._advance(1)

    def again(self) -> None:
        """The same episode from its beginning."""
        self._begin(self.live.seed)

    def next(self) -> None:
        """Another episode."""
        self._begin(self.live.seed + 1)

    def set_speed(self, speed: float) -> None:
        """1 is real time."""
        self.speed = speed

    def look(self, view: str, client: int) -> None:
        """Move somebody's camera to where the view "close" or "main" is."""
        if client in (clients := self.server.get_clients()):
            self.scene.look(clients[client].camera, view)

    def cast(self, choice: Choice) -> None:
        """Another team or person; where they do not fit, the reason is shown and all stays as it is."""
        if choice == self.chosen:
            return
        self._notify("One moment", "This team and person are being prepared.", loading=True)
        try:
            live = Live(*self._casting(choice.team, choice.settings()), self.live.seed)
        except AssistaxError as error:
            self.panel.choice = self.chosen
            self._notify("That does not fit", str(error))
            return
        self.live, self.chosen, self.hand = live, choice, None
        self._build()
        self._notify("Ready", f"{choice.team}; disability {choice.disability}, preference {choice.preference}.")
        self._then = time.perf_counter()

    def grab(self, body: int, point: np.ndarray) -> None:
        """Take hold of a body of the physics at a point [3] m."""
        self.hand = Hand(self.live.env.model, body, self.live.moment.qpos[0], point)

    def pull(self, target: np.ndarray) -> None:
        """Pull what is held towards a point [3] m."""
        if self.hand is not None:
            self.hand.target = target

    def release(self) -> None:
        """Let go of what is held."""
        self.hand = None

    # -- parts ---------------------------------------------------------------------------------

    def _begin(self, seed: int) -> None:
        self.live.begin(seed)
        self.hand, self._due, self._rest = None, 0.0, 0.0

    def _play(self, seconds: float) -> None:
        if self.live.over:
            self._rest += seconds
            if self._rest >= REST * self.speed:
                self.next()
            return
        self._due += seconds / self.live.env.dt
        self._advance(int(self._due))
        self._due %= 1.0

    def _advance(self, steps: int) -> None:
        push, before = None if self.hand is None else self.hand.push(self.live.moment.qpos[0]), self.live.steps
        try:
            self.live.advance(steps, push)
        except AssistaxError as error:
            self._notify("The episode has ended", str(error))
        self._steps += self.live.steps - before

    def _show(self, now: float) -> None:
        moment = self.live.moment
        held = None if self.hand is None else (self.hand.pull(moment.qpos[0])[0], self.hand.target)
        self.scene.show(moment, 0, held)
        self._shown.append((now, self._steps))
        (first, steps), frames = self._shown[0], len(self._shown) - 1
        seconds = max(now - first, 1e-9)
        rate = (self._steps - steps) * self.live.env.dt / seconds
        self.panel.tell(moment, self.live.terms(), self.live.over, frames / seconds, rate)

    def _build(self) -> None:
        """The scene of the task that is played now."""
        self.scene = Scene(self.server, self.live.moment)
        self.scene.look(self.server.initial_camera, "close")
        for body, handle in self.scene.handles():
            carrier = held_by(self.scene.stage.model, body, self.live.env.model)
            if carrier is not None:
                handle.on_drag("left", modifier="cmd/ctrl")(self._dragging(carrier))

    def _dragging(self, body: int):
        async def dragged(event):  # async, so that they come in order
            if event.phase == "start":
                self.wish("grab", body, np.array(event.start_position))
            if event.phase == "end":
                self.wish("release")
            else:
                self.wish("pull", np.array(event.end_position))

        return dragged

    def _notify(self, title: str, body: str, loading: bool = False) -> None:
        for client in self.server.get_clients().values():
            client.add_notification(title, body, loading=loading, auto_close_seconds=3.0 if loading else 8.0)
