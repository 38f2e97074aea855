"""What a film tells beside the scene: caption, force, spots of the skin, and a target that is out of sight."""

from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from assistax.evaluation import sight
from assistax.evaluation.filmed import Filmed
from assistax.evaluation.sight import Spots
from assistax.evaluation.stage import Disc, Stage
from assistax.human import harm
from assistax.tasks.base import DONE, NOTHING_TO_DO, TO_DO

SPOTS = {  # by state the colour and the radius in m of a disc on the skin
    TO_DO: ((0.42, 0.22, 0.10, 1.0), 0.013),
    DONE: ((0.20, 0.65, 1.00, 1.0), 0.013),
    NOTHING_TO_DO: ((0.98, 0.80, 0.68, 0.5), 0.004),
}
ITCH = (0.95, 0.05, 0.35, 1.0), 0.018
FELT = 0.05  # N, from which on a force is shown
FORCES = ((0.0, (70, 200, 90)), (5.0, (240, 200, 50)), (15.0, (240, 130, 30)), (40.0, (225, 30, 40)))  # N, colour
LENGTH, PER_NEWTON, LONGEST = 0.05, 0.01, 0.35  # m, of the arrow
WHITE, GREY = (255, 255, 255), (190, 195, 200)
GREEN, AMBER, RED, PINK = (120, 225, 140), (245, 190, 80), (255, 110, 100), (242, 13, 89)
GENERAL = {"success", "safe_success", "return", "task_return", "preference_return", "peak_force", "cost"}
GENERAL |= {"seconds_over_force_limit", "work_robot", "work_human", "length", *harm.OUTCOMES}
IN_WORDS = {"scratch": "scratched", "visited": "washed", "mouth": "at the mouth", "brush": "brushed"}
FONT = Path(matplotlib.get_data_path()) / "fonts/ttf/DejaVuSans.ttf"
GAP = "   "
ROOM = 0.97  # of the width, for words
FINER = 2  # times as fine as the picture is what is rendered, and drawn over it, for smooth edges

Line = list[tuple[str, tuple[int, int, int]]]
"""Words with their colours."""


class Overlay:
    """Draws on the pictures that one camera takes of one episode."""

    def __init__(self, camera, filmed: Filmed, spots: Spots):
        self.camera, self.filmed, self.spots = camera, filmed, spots
        all_lines = [line for i in range(0, len(filmed.qpos), 10) for line in lines(filmed, i)]
        self.font = fitting(all_lines, FINER * camera.width, FINER * camera.height)

    def picture(self, i: int) -> np.ndarray:
        """Pixels [height, width, 3] uint8 of control step i."""
        camera, filmed, marker = self.camera, self.filmed, self.filmed.marker[i]
        model, data = camera.model, camera.data
        camera.pose(filmed.qpos[i], marker)
        normal = sight.out_of_skin(model, data, marker)
        pixels = Image.fromarray(camera.render(discs(camera, filmed, i, self.spots)))
        over = Image.new("RGBA", (FINER * camera.width, FINER * camera.height))
        draw = ImageDraw.Draw(over)
        if normal is not None and self._far(marker):
            self._ring(draw, marker)
        force = filmed.force[i]
        if np.linalg.norm(force) > FELT:
            self._arrow(draw, force, data.site("tool_tip").xpos)
        caption(draw, over.size, self.font, lines(filmed, i))
        over = over.resize(pixels.size, Image.Resampling.BOX)
        return np.asarray(Image.alpha_composite(pixels.convert("RGBA"), over).convert("RGB"))

    def _far(self, point):
        """Whether it is behind the person or the furniture."""
        model = self.camera.model
        before = sight.hidden(model, self.camera.data, self.camera.eye, point[None])[0]
        return before >= 0 and model.body_rootid[before] != model.body_rootid[model.body("robot").id]

    def _ring(self, draw, point):
        (x, y), r = FINER * self.camera.pixel(point), FINER * 0.022 * self.camera.height
        for start in range(0, 360, 40):
            draw.arc((x - r, y - r, x + r, y + r), start, start + 24, fill=PINK, width=2 * FINER)

    def _arrow(self, draw, force, tip):
        """With its head at the tool, pointing as the force on the person does."""
        tail, colour = arrow(force, tip)
        head, tail = (FINER * self.camera.pixel(point) for point in (tip, tail))
        way = head - tail
        long = max(float(np.linalg.norm(way)), 1e-6)
        along, across = way / long, np.array([-way[1], way[0]]) / long
        thick = FINER * 0.007 * self.camera.height
        barb = min(3.5 * thick, long)
        neck = head - barb * along
        shape = [tail + thick * across / 2, neck + thick * across / 2, neck + 1.5 * thick * across, head]
        shape += [neck - 1.5 * thick * across, neck - thick * across / 2, tail - thick * across / 2]
        draw.polygon([tuple(corner) for corner in shape], fill=(*colour, 255), outline=(20, 20, 25, 255), width=FINER)


def discs(stage: Stage, filmed: Filmed, i: int, spots: Spots) -> list[Disc]:
    """What is to be done to the skin, and what has been, at control step i; the stage is posed so."""
    states = filmed.spot_states[i] if filmed.spots else ()
    found = [(*spot, *SPOTS[int(state)]) for *spot, state in zip(*spots.at(stage.data), states, strict=True)]
    if found or stage.at_mouth:
        return found
    normal = sight.out_of_skin(stage.model, stage.data, filmed.marker[i])
    return [] if normal is None else [(filmed.marker[i], normal, *ITCH)]


def arrow(force: np.ndarray, tip: np.ndarray) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Where [3] m the arrow of a force [3] N begins that ends at the tool's tip, and its colour; a force above FELT."""
    newtons = float(np.linalg.norm(force))
    red, green, blue = (np.interp(newtons, [n for n, _ in FORCES], [c[k] for _, c in FORCES]) for k in range(3))
    tail = tip - force / newtons * min(LENGTH + PER_NEWTON * newtons, LONGEST)
    return tail, (round(red), round(green), round(blue))


def lines(filmed: Filmed, i: int) -> tuple[Line, Line]:
    """The caption at control step i: what has been achieved so far, and what the robot has done to the person."""
    so_far = {name: float(values[i]) for name, values in filmed.metrics.items()}
    success = so_far["success"] > 0
    done: Line = [(f"{filmed.task}  {(filmed.before + i + 1) * filmed.dt:.1f} s", WHITE)]
    outcomes = [outcome(name, value) for name, value in so_far.items() if name not in GENERAL]
    done += [(words, WHITE) for words in outcomes if words]
    done.append(("success", GREEN) if success else ("no success yet", GREY))
    force = f"force {np.linalg.norm(filmed.force[i]):.1f} N, most {so_far['peak_force']:.0f} N"
    harmed: Line = [(force, WHITE)]
    if "clamping" not in so_far:  # version 0
        over = so_far["seconds_over_force_limit"]
        return done, [*harmed, (f"over the limit {over:.1f} s", RED if over >= 0.05 else GREY)]
    over = so_far["seconds_above_comfort"]
    harmed.append((f"above comfort {over:.1f} s", AMBER if over >= 0.05 else GREY))
    hurt = [word for name, word in (("clamping", "clamped"), ("impact", "hit")) if so_far[name]]
    harmed.append((f"harm: {' and '.join(hurt)}", RED) if hurt else ("never clamped or hit", GREEN))
    return done, harmed


def outcome(name: str, value: float) -> str:
    """ "scratch_seconds" as "scratched 1.2 s", "fraction_visited" as "washed 45 %"; nothing where there is none."""
    words = name.split("_")
    unit = next((unit for unit in ("seconds", "fraction") if unit in words), None)
    text = " ".join(IN_WORDS.get(word, word) for word in words if word != unit)
    if unit is None:
        return "" if not value else text if value == 1 else f"{text} {value:g}"
    return f"{text} {value:.1f} s" if unit == "seconds" else f"{text} {100 * value:.0f} %"


def fitting(lines: list[Line], width: float, height: float) -> ImageFont.FreeTypeFont:
    """The letters in which the widest of these lines fits into a picture."""
    font = ImageFont.truetype(FONT, height / 26)
    widest = max(font.getlength(GAP.join(words for words, _ in line)) for line in lines)
    return font if widest <= ROOM * width else ImageFont.truetype(FONT, ROOM * width / widest * font.size)


def caption(draw: ImageDraw.ImageDraw, size: tuple[int, int], font, lines: tuple[Line, ...]) -> None:
    """Write lines on a dark band at the lower edge."""
    (width, height), step = size, 1.45 * font.size
    top = height - step * len(lines) - 0.3 * font.size
    draw.rectangle((0, top, width, height), fill=(15, 18, 24, 190))
    for row, line in enumerate(lines):
        x = (1 - ROOM) / 2 * width
        for words, colour in line:
            draw.text((x, top + 0.25 * font.size + step * row), words, font=font, fill=colour)
            x += font.getlength(words + GAP)
