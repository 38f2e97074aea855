"""MuJoCo's own window, on a machine with a display."""

import time

import mujoco
import mujoco.viewer
import numpy as np

from assistax.env import Env
from assistax.errors import UsageError
from assistax.evaluation import overlay
from assistax.evaluation.stage import Stage
from assistax.policies import Team
from assistax.viewer.live import Live
from assistax.viewer.push import held_by

FRAMES = 30  # per second
REST = 1.5  # s after the end of an episode
NO_PANELS = {"show_left_ui": False, "show_right_ui": False}
WIDTH = 0.012  # m, of the arrow


def show(env: Env, team: Team, seed: int) -> None:
    """Play episodes in a window until it is closed; space pauses, and bodies can be pushed as MuJoCo has it."""
    live, stage, playing = Live(env, team, seed), Stage(env.name), [True]
    stage.pose(live.moment.qpos[0], live.moment.marker[0])

    def pressed(key):
        playing[0] ^= key == ord(" ")

    try:
        window = mujoco.viewer.launch_passive(stage.model, stage.data, key_callback=pressed, **NO_PANELS)
    except (RuntimeError, mujoco.FatalError) as error:  # no OpenGL, or on macOS a process that is not mjpython
        raise UsageError(f"Cannot open a window here ({error}); leave out --native to watch in a browser.") from None
    with window:
        _look(window.cam, *stage.aim("close"))
        due, then, ended = 0.0, time.perf_counter(), 0.0
        while window.is_running():
            now = time.perf_counter()
            due, then = due + min(now - then, 0.1) / env.dt * playing[0], now
            live.advance(int(due), _push(stage, env.model))
            due %= 1.0
            ended = (ended or now) if live.over else 0.0
            if ended and now - ended > REST:
                live.begin(live.seed + 1)
            moment = live.moment
            with window.lock():
                stage.pose(moment.qpos[0], moment.marker[0])
                mujoco.mjv_applyPerturbForce(stage.model, stage.data, window.perturb)
                _arrow(window.user_scn, moment.force[0], stage.data.site("tool_tip").xpos)
            words = ["   ".join(text for text, _ in line) for line in overlay.lines(moment, 0)]
            window.set_texts((None, mujoco.mjtGridPos.mjGRID_BOTTOMLEFT, "\n".join(words), ""))
            window.sync()
            time.sleep(max(0.0, now + 1 / FRAMES - time.perf_counter()))


def _look(camera, eye: np.ndarray, centre: np.ndarray) -> None:
    way = centre - eye
    camera.lookat[:], camera.distance = centre, np.linalg.norm(way)
    camera.azimuth = np.degrees(np.arctan2(way[1], way[0]))
    camera.elevation = np.degrees(np.arcsin(way[2] / camera.distance))


def _push(stage: Stage, model: mujoco.MjModel) -> np.ndarray:
    """What the window applies to the bodies that are seen, as the physics' bodies take it: [nbody, 6]."""
    push = np.zeros((model.nbody, 6), np.float32)
    data = stage.data
    for body in np.flatnonzero(np.abs(data.xfrc_applied).sum(1)):
        carrier = held_by(stage.model, body, model)
        if carrier is not None:
            force, torque = data.xfrc_applied[body, :3], data.xfrc_applied[body, 3:]
            own = stage.model.body(model.body(carrier).name).id
            push[carrier] += [*force, *(torque + np.cross(data.xipos[body] - data.xipos[own], force))]
    data.xfrc_applied[:] = 0.0
    return push


def _arrow(scene, force: np.ndarray, tip: np.ndarray) -> None:
    scene.ngeom = 0
    if np.linalg.norm(force) > overlay.FELT:
        tail, colour = overlay.arrow(force, tip)
        rgba = np.array([*colour, 255], np.float32) / 255
        kind, none = mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3)
        mujoco.mjv_initGeom(scene.geoms[0], kind, none, none, np.eye(3).ravel(), rgba)
        mujoco.mjv_connector(scene.geoms[0], kind, WIDTH, tail, tip)
        scene.ngeom = 1
