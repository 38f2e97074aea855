"""One labelled picture for each task's page: the expert at work beside a person who offers the target."""

from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from assistax.env import make
from assistax.evaluation import play
from assistax.evaluation.film import Camera
from assistax.evaluation.overlay import FONT, ITCH, SPOTS
from assistax.evaluation.sight import Spots, hidden, out_of_skin, viewpoint
from assistax.policies import scripted_team
from assistax.tasks.base import DONE, TO_DO

HEIGHT = 560  # pixels
WHOLE, DETAIL = 620, 420  # pixels, width of the picture of the scene and of the one from nearby
FINER = 2  # times as fine as the picture is what is drawn over it
LETTERS = 17  # pixels
INK, PAPER = (255, 255, 255, 255), (15, 18, 24, 205)

Label = tuple[str, str | tuple[str, str], tuple[float, float]]
"""Words, what they point at, and where they stand: fractions of the panel's width and height, of their middle."""


@dataclass(frozen=True)
class Picture:
    """What a task's picture shows."""

    progress: str  # the metric that says how far the help is
    whole: tuple[Label, ...]
    detail: tuple[Label, ...]
    distance: float = 0.8  # m, from which the detail is seen
    share: float = 0.5  # shown when so much of what the progress reaches is exceeded ...
    before: int = 0  # ... or so many steps before
    seed: int = 0  # of the episode


def draw(task: str, picture: Picture) -> bytes:
    """A PNG file of 256 colours."""
    env = make(task, engine="mujoco")
    filmed = play(env, scripted_team("offer", env), 1, picture.seed)["filmed"]
    reached = filmed.metrics[picture.progress]
    moment = int(np.argmax(reached > picture.share * reached[-1])) - picture.before
    out = Image.new("RGB", (WHOLE + DETAIL, HEIGHT))
    for left, width, labels in ((0, WHOLE, picture.whole), (WHOLE, DETAIL, picture.detail)):
        with Camera(env.name, width, HEIGHT) as camera:
            spots = Spots(camera, filmed)
            if left:
                camera.view = look = viewpoint(camera, filmed, spots)
                look.lookat[:], look.distance = filmed.marker[moment], picture.distance
            out.paste(_panel(camera, filmed, spots, moment, labels), (left, 0))
    file = BytesIO()
    out.quantize(256, dither=Image.Dither.NONE).save(file, "png", optimize=True)
    return file.getvalue()


def _panel(camera: Camera, filmed: Any, spots: Spots, i: int, labels: tuple[Label, ...]) -> Image.Image:
    camera.pose(filmed.qpos[i], filmed.marker[i])
    states = filmed.spot_states[i] if filmed.spots else ()
    discs = [(*spot, *SPOTS[int(state)]) for *spot, state in zip(*spots.at(camera.data), states, strict=True)]
    normal = out_of_skin(camera.model, camera.data, filmed.marker[i])
    if normal is not None and not discs and not camera.at_mouth:
        discs = [(filmed.marker[i], normal, *ITCH)]
    pixels = Image.fromarray(camera.render(discs)).convert("RGBA")
    over = Image.new("RGBA", (FINER * camera.width, FINER * camera.height))
    pen, font = ImageDraw.Draw(over), ImageFont.truetype(FONT, FINER * LETTERS)
    seen = {TO_DO: [], DONE: []}
    for (place, _, _, _), state in zip(discs, states, strict=False):
        seen.setdefault(int(state), []).append(place)
    for words, at, (x, y) in labels:
        to = FINER * camera.pixel(_place(camera, filmed.marker[i], seen, at))
        _label(pen, font, words, np.array([x, y]) * over.size, to)
    over = over.resize(pixels.size, Image.Resampling.BOX)
    return Image.alpha_composite(pixels, over).convert("RGB")


def _place(camera, marker, seen, at) -> np.ndarray:
    """Where [3] in m a label points: "target", ("body", NAME), ("site", NAME), ("spot", "washed" or "dirty")."""
    if at == "target":
        return marker
    kind, name = at
    if kind == "spot":
        places = np.array(seen[DONE if name == "washed" else TO_DO])
        places = places[hidden(camera.model, camera.data, camera.eye, places) < 0]
        return places[np.argsort(np.linalg.norm(places - marker, axis=1))[len(places) // 2]]
    return camera.data.site(name).xpos if kind == "site" else camera.data.body(name).xipos


def _label(pen, font, words, at, to) -> None:
    box = np.array(pen.multiline_textbbox(at, words, font=font, anchor="mm", align="center"))
    box += FINER * np.array([-6, -4, 6, 4])
    edge = np.clip(to, box[:2], box[2:])
    pen.line([tuple(edge), tuple(to)], fill=INK, width=FINER * 2)
    r = FINER * 4
    pen.ellipse((*(to - r), *(to + r)), fill=INK, outline=PAPER, width=FINER)
    pen.rounded_rectangle(tuple(box), FINER * 5, fill=PAPER)
    pen.multiline_text(tuple(at), words, font=font, anchor="mm", align="center", fill=INK)
