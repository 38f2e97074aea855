"""One episode as a page of the web that plays it without a server."""

from pathlib import Path

import numpy as np

from assistax.env import Env
from assistax.evaluation import overlay
from assistax.evaluation.playing import play
from assistax.evaluation.sight import viewpoint
from assistax.files import write_atomically
from assistax.policies import Team
from assistax.viewer.scene import Scene, serving

FRAMES = 25  # per second


def page(env: Env, team: Team, seed: int, path: Path) -> None:
    """Play the episode of this seed and write the page; 2 or 3 MB."""
    filmed = play(env, team, 1, seed)["filmed"]
    with serving("127.0.0.1", 0) as server:
        scene = Scene(server, filmed)
        view = viewpoint(scene.stage, filmed, scene.spots)
        scene.look(server.initial_camera, view)
        # Words as part of the scene, as a page has no panel: above the person, out of the way of the help.
        above = view.lookat + np.array([0.0, 0.0, 0.33 * view.distance])
        caption = server.scene.add_label("/caption", "", position=above, anchor="top-center", font_screen_scale=1.1)
        steps, recording = len(filmed.qpos), server.get_scene_serializer()
        for frame in range(max(1, int(steps * filmed.dt * FRAMES))):
            i = min(round(frame / FRAMES / filmed.dt), steps - 1)
            scene.show(filmed, i)
            words = ["   ".join(text for text, _ in line) for line in overlay.lines(filmed, i)]
            if caption.text != (text := "\n".join(words)):
                caption.text = text
            recording.insert_sleep(1 / FRAMES)
        recording.insert_sleep(1.0)
        write_atomically(path, recording.as_html().encode())
