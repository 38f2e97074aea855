"""What stands beside the scene in the browser: what is told, and what one can choose."""

from collections.abc import Callable
from dataclasses import dataclass

import viser

from assistax.evaluation import overlay
from assistax.evaluation.filmed import Filmed
from assistax.human.disability import DISABILITIES

AS_GIVEN = "as given"
DISABILITY = (AS_GIVEN, "none", *DISABILITIES, "standard")
PREFERENCE = (AS_GIVEN, "none", "default", "sweep")
SPEEDS = ("1/8", "1/4", "1/2", "1", "2", "4")
TABLE = '<table style="width:100%;font-size:0.8em;margin:0.4em 0">'
CELL = "<td style='text-align:right;font-variant-numeric:tabular-nums'>"
HEAD = [("", "this step", "so far")]
SMALL = "margin:0 1em;font-size:0.8em"
BAND = "background:#12151c;border-radius:4px;padding:0.4em 0.6em;margin:0 1em;font-size:0.85em;line-height:1.5"


@dataclass(frozen=True)
class Choice:
    """Who plays: names of a team, of a disability and of a preference."""

    team: str
    disability: str = AS_GIVEN
    preference: str = AS_GIVEN

    def settings(self) -> tuple[str, ...]:
        """As `--set` takes them."""
        chosen = {"env.human.disability": self.disability, "env.human.preference": self.preference}
        return tuple(f"{name}={value}" for name, value in chosen.items() if value != AS_GIVEN)


class Panel:
    """The controls.

    Args:
      server: on which.
      teams: the names that can be chosen, the first one first.
      wish: called, in any thread, with a function of the viewer's method name and arguments that somebody asked for.
    """

    def __init__(self, server: viser.ViserServer, teams: list[str], wish: Callable[..., None]):
        gui = server.gui
        gui.configure_theme(control_width="medium", show_logo=False, show_share_button=False)
        gui.set_panel_label("Assistax")
        self._told = gui.add_html("")
        self._pause = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        self._pause.on_click(lambda _: wish("pause"))
        moves = gui.add_button_group("Move on", ("step", "again", "next episode"), hint="A step is 8 ms, and pauses.")
        moves.on_click(lambda _: wish({"step": "step", "again": "again", "next episode": "next"}[moves.value]))
        speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1", hint="1 is real time.")
        speed.on_update(lambda _: wish("set_speed", _number(speed.value)))
        views = gui.add_button_group("Camera", ("close", "main"), hint="Back to where it began, or the whole scene.")
        views.on_click(lambda event: wish("look", views.value, event.client_id))
        with gui.add_folder("Who plays"):
            self._team = gui.add_dropdown("Team", teams, initial_value=teams[0])
            self._disability = gui.add_dropdown("Disability", DISABILITY, initial_value=AS_GIVEN)
            self._preference = gui.add_dropdown("Preference", PREFERENCE, initial_value=AS_GIVEN)
            for choice in (self._team, self._disability, self._preference):
                choice.on_update(lambda event: wish("cast", self.choice) if event.client_id is not None else None)
        with gui.add_folder("Reward"):
            self._terms = gui.add_html("")
        gui.add_markdown("**Push:** hold Ctrl (⌘) and drag the person or the robot with the mouse.")
        self._rates = gui.add_html("")

    @property
    def choice(self) -> Choice:
        return Choice(self._team.value, self._disability.value, self._preference.value)

    @choice.setter
    def choice(self, choice: Choice) -> None:
        self._team.value, self._disability.value = choice.team, choice.disability
        self._preference.value = choice.preference

    def tell(self, filmed: Filmed, terms: dict[str, tuple[float, float]], over: bool, frames: float, rate: float):
        """Say how it stands.

        Args:
          filmed: its last moment is told.
          terms: by name of the reward: in the last step, and over the episode.
          over: whether the episode is.
          frames: per second. rate: of the simulated time, 1 for real time.
        """
        self._told.content = f'<div style="{BAND}">{told(filmed, len(filmed.qpos) - 1)}</div>'
        total = [sum(column) for column in zip(*terms.values(), strict=True)]
        rows = [(name.replace("_", " "), *values) for name, values in terms.items()] + [("all", *total)]
        rows = [(name, f"{now:.3f}", f"{so_far:.1f}") for name, now, so_far in rows]
        cells = [f"<tr><td>{name}</td>{CELL}{now}</td>{CELL}{so_far}</td></tr>" for name, now, so_far in HEAD + rows]
        self._terms.content = f"{TABLE}{''.join(cells)}</table>"
        ended = "the episode is over; " if over else ""
        self._rates.content = f'<p style="{SMALL}">{ended}{frames:.0f} frames/s, {rate:.2f} × real time</p>'

    def paused(self, paused: bool) -> None:
        """What the button says."""
        self._pause.label = "Play" if paused else "Pause"
        self._pause.icon = viser.Icon.PLAYER_PLAY if paused else viser.Icon.PLAYER_PAUSE


def told(filmed: Filmed, i: int) -> str:
    """A film's caption at control step i, as HTML."""
    rows = []
    for line in overlay.lines(filmed, i):
        words = (f'<span style="color:rgb{colour};white-space:nowrap">{text}</span>' for text, colour in line)
        rows.append(" &nbsp; ".join(words))
    return "<br>".join(rows)


def _number(fraction: str) -> float:
    over, _, under = fraction.partition("/")
    return float(over) / float(under or 1)
