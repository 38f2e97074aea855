"""Films: what they show beside bodies and target, and that it can be seen."""

import os
import subprocess
import sys

import jax
import numpy as np
import pytest
from PIL import Image

from assistax import make
from assistax.errors import UsageError
from assistax.evaluation.film import Camera, film
from assistax.evaluation.filmed import Filmed
from assistax.evaluation.overlay import Overlay, lines, outcome
from assistax.evaluation.sight import Spots, hidden, out_of_skin, viewpoint
from assistax.tasks.base import DONE, NOTHING_TO_DO, TO_DO

SIZE = {"width": 160, "height": 120}
METRICS = {"success": 0.0, "peak_force": 0.0, "seconds_over_force_limit": 0.0}

# By task a moment at which a trained team works: angles of the person's and the robot's joints in rad, target in m, and
# how many pixels of the tool's end are to be seen then.
WORK = {
    "scratch": (
        (0.63, 0.0, 0.2, 0.63, -0.36, -0.08, -0.45, 0.46, -0.5, -0.05, -0.54, 0.16, -1.76, -0.54, 2.81, 0.56),
        (0.218, -0.122, 0.94),
        18,
    ),
    "bed_bath": (
        (0.19, 0.0, 0.02, 0.31, -0.83, -1.14, -0.66, 0.76, -1.41, 0.05, -0.4, -0.21, -2.12, -0.51, 1.97, 0.61),
        (-0.002, -0.437, 0.834),
        60,
    ),
    "arm_assist": (
        (0.19, 0.0, 0.02, 0.75, -0.73, -1.41, -0.66, 0.76, -1.41, -2.9, -0.96, 2.07, -0.07, 1.06, 0.63, 1.25),
        (-0.056, -0.245, 0.705),
        120,
    ),
    "feeding": (
        (0.63, -0.52, 0.25, 0.45, -0.46, -0.5, -0.45, 0.46, -0.5, 1.15, -0.35, -1.09, -1.93, -0.66, 3.37, 0.73),
        (0.033, -0.09, 1.088),
        40,
    ),
    "tooth_brushing": (
        (0.63, 0.01, 0.26, 0.45, -0.46, -0.5, -0.45, 0.46, -0.5, 0.01, -0.1, 0.08, -1.61, -1.47, 2.68, 0.71),
        (0.0, -0.081, 1.09),
        18,
    ),
}


def camera(task, **settings):
    try:
        return Camera(task, **SIZE, **settings)
    except UsageError as error:
        if not str(error).startswith("Cannot render here"):
            raise
        pytest.skip(str(error))


def still(cam, task, marker, forces, **told) -> Filmed:
    """A person and a robot who stay as they are at the start, a step for each of the forces."""
    n = len(forces)
    metrics = {name: np.full(n, value) for name, value in METRICS.items()}
    qpos = np.tile(cam.model.key("start").qpos, (n, 1))
    return Filmed(task, 0.008, qpos, np.tile(marker, (n, 1)), np.array(forces), metrics, **told)


def mouth(cam):
    cam.pose(cam.model.key("start").qpos, np.zeros(3))
    return cam.data.site("mouth").xpos.copy()


def changed(a, b):
    """Which pixels differ; the caption apart."""
    differ = (a != b).any(-1)
    band = round(0.85 * SIZE["height"])
    return differ[:band], differ[band:]


def test_an_arrow_appears_with_force_and_a_caption_always():
    with camera("feeding") as cam:
        filmed = still(cam, "feeding-v0", mouth(cam), [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 9.0]])
        overlay = Overlay(cam, filmed, Spots(cam, filmed))
        none, again, pushed = (overlay.picture(i) for i in range(3))
        above, below = changed(none, cam.picture(filmed.qpos[0], filmed.marker[0]))
        assert not above.any() and below.mean() > 0.8
        assert not changed(none, again)[0].any()
        where = np.argwhere(changed(none, pushed)[0])
        assert len(where) > 10
        x, y = cam.pixel(cam.data.site("tool_tip").xpos)
        assert np.abs(where - [y, x]).max(1).min() < 3 and (where[:, 0] >= y - 3).all()  # from below up to the tool


def test_a_plain_film_is_the_bare_picture(tmp_path):
    with camera("feeding") as cam:
        filmed = still(cam, "feeding-v0", mouth(cam), [[0.0, 0.0, 9.0]])
        bare = cam.picture(filmed.qpos[0], filmed.marker[0])
    pictures = []
    stored = Filmed(filmed.task, filmed.dt, filmed.qpos, filmed.marker)  # bodies and target alone, as of old
    for one, plain in ((filmed, True), (stored, False), (filmed, False)):
        film(one, tmp_path / "a.png", plain, view="main", **SIZE)
        pictures.append(np.asarray(Image.open(tmp_path / "a.png")))
    np.testing.assert_array_equal(pictures[0], bare)
    np.testing.assert_array_equal(pictures[1], bare)
    assert (pictures[2] != bare).any()


def test_washed_spots_change_colour_and_clean_ones_hardly_show():
    with camera("bed_bath", view="close") as cam:
        data = cam.data
        cam.pose(cam.model.key("start").qpos, np.zeros(3))
        arm = data.geom("right_forearm")
        up = np.array([0.0, 0.0, 1.0])
        up -= arm.xmat[[2, 5, 8]] * arm.xmat[8]
        place = arm.xpos + cam.model.geom("right_forearm").size[0] * up / np.linalg.norm(up)
        body = data.body("right_forearm")
        spots = {"right_forearm": (body.xmat.reshape(3, 3).T @ (place - body.xpos))[None]}
        states = np.array([[TO_DO], [DONE], [NOTHING_TO_DO]])
        filmed = still(cam, "bed_bath-v1", [0.0, 0.0, -1.0], np.zeros((3, 3)), spots=spots, spot_states=states)
        overlay = Overlay(cam, filmed, Spots(cam, filmed))
        todo, done, clean = (overlay.picture(i) for i in range(3))
        bare = cam.picture(filmed.qpos[0], filmed.marker[0])
        x, y = cam.pixel(place).round().astype(int)
        assert todo[y, x].sum() < done[y, x].sum() < bare[y, x].sum() and done[y, x, 2] > done[y, x, 0]
        assert changed(clean, bare)[0].sum() < changed(todo, bare)[0].sum() > 4


def test_the_film_is_taken_from_where_the_itch_is_seen():
    env = make("scratch-v3", engine="mujoco")
    with camera("scratch") as cam:
        start = cam.model.key("start").qpos
        cam.pose(start, np.zeros(3))
        sensors = {
            f"{part}_{what}": np.asarray(getattr(cam.data.body(f"right_{part}"), f"x{what}"))
            for part in ("upper_arm", "forearm")
            for what in ("pos", "quat")
        }
        sensors["tool_pos"] = cam.data.site("tool_tip").xpos.copy()
        seen, from_close = [], []
        for seed in range(6):
            place, normal, _ = env.task.skin(sensors, env.task.reset(jax.random.key(seed)))
            np.testing.assert_allclose(out_of_skin(cam.model, cam.data, np.asarray(place)), normal, atol=1e-3)
            filmed = still(cam, "scratch-v3", np.asarray(place), np.zeros((1, 3)))
            for view, found in (("close", from_close), (viewpoint(cam, filmed, Spots(cam, filmed)), seen)):
                cam.view = view
                cam.picture(start, filmed.marker[0])
                found.append(hidden(cam.model, cam.data, cam.eye, filmed.marker)[0] < 0)
        assert np.mean(seen) > np.mean(from_close)
        assert np.mean(seen) >= 0.8  # the rest lies between arm and armrest, or in the armpit


@pytest.mark.parametrize("task", WORK)
def test_the_film_is_taken_from_where_the_work_is_seen(task):
    """The tool's end and the target; of a toothbrush its head, as the bristles are at the teeth."""
    qpos, marker, enough = WORK[task]
    with camera(task) as cam:
        model, data = cam.model, cam.data
        filmed = Filmed(f"{task}-v1", 0.008, np.array([qpos]), np.array([marker]))
        cam.view = viewpoint(cam, filmed, Spots(cam, filmed))
        one = cam.picture(filmed.qpos[0], filmed.marker[0])
        near = np.linalg.norm(data.geom_xpos - data.site("tool_tip").xpos, axis=1) < 0.02
        end = model.geom_bodyid == model.body("tool").id
        end |= near & (model.geom_bodyid == model.body("tool_mount").id)
        model.geom_matid[end], model.geom_rgba[end] = -1, (1.0, 0.0, 1.0, 1.0)
        above, _ = changed(one, cam.render())
        assert above.sum() >= enough
        if task != "arm_assist":  # there it is the middle of the forearm
            assert hidden(model, data, cam.eye, filmed.marker)[0] < 0


def test_shadows_have_smooth_edges():
    with camera("feeding") as cam:
        cam.pose(cam.model.key("start").qpos, np.zeros(3))
        shadows = cam.render().astype(int)
        cam.model.light_castshadow[:] = False
        darker = (cam.render() - shadows).sum(-1)[90:, 112:150]  # on the floor beside the wheel chair
        assert (darker > 0.8 * darker.max()).mean() > 0.1
        assert ((darker > 0.2 * darker.max()) & (darker < 0.8 * darker.max())).mean() > 0.02


def test_a_target_in_the_air_has_no_skin():
    with camera("scratch") as cam:
        cam.pose(cam.model.key("start").qpos, np.zeros(3))
        assert out_of_skin(cam.model, cam.data, np.array([0.0, 0.0, 3.0])) is None
        ahead = cam.data.site("mouth").xmat.reshape(3, 3)[:, 0]
        np.testing.assert_array_equal(out_of_skin(cam.model, cam.data, cam.data.site("mouth").xpos), ahead)


def test_the_words_of_the_caption():
    assert outcome("scratch_seconds", 1.23) == "scratched 1.2 s"
    assert outcome("fraction_visited", 0.449) == "washed 45 %"
    assert outcome("seconds_at_waist", 0.5) == "at waist 0.5 s"
    assert outcome("spilled", 0.0) == "" and outcome("spilled", 1.0) == "spilled"
    harmless = {"clamping": 0.0, "impact": 0.0, "seconds_above_comfort": 0.0}
    for told, words in (
        ({"success": 1.0} | harmless, ["success", "never clamped or hit"]),
        (harmless | {"impact": 1.0, "clamping": 1.0}, ["no success yet", "harm: clamped and hit"]),
        ({"seconds_over_force_limit": 2.0}, ["no success yet", "over the limit 2.0 s"]),
    ):
        metrics = {name: np.array([value]) for name, value in (METRICS | told).items()}
        filmed = Filmed("a-v1", 0.008, np.zeros((1, 1)), np.zeros((1, 3)), np.array([[0.0, 3.0, 4.0]]), metrics)
        said = [[words for words, _ in line] for line in lines(filmed, 0)]
        assert [line[-1] for line in said] == words and "force 5.0 N" in said[1][0] and "0.0 s" in said[0][0]


def test_the_targets_of_a_scene_are_in_the_view():
    """Arm assist: forearm and waist, at the first and the last moment."""
    with camera("arm_assist") as cam:
        start = cam.model.key("start").qpos
        cam.pose(start, np.zeros(3))
        filmed = still(cam, "arm_assist-v1", cam.data.site("wrist_target").xpos.copy(), np.zeros((1, 3)))
        cam.view = viewpoint(cam, filmed, Spots(cam, filmed))
        cam.picture(start, filmed.marker[0])
        for name in cam.targets:
            x, y = cam.pixel(cam.data.site(name).xpos)
            assert 0 < x < SIZE["width"] and 0 < y < 0.85 * SIZE["height"]


def test_mujoco_may_be_imported_first():
    code = """
import mujoco, assistax
from assistax.evaluation.film import Camera
with Camera("scratch-v0", 64, 48) as camera:
    print(camera.render().std() > 1)
"""
    env = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "DISPLAY")}
    found = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert found.stdout.split() == ["True"] and not found.stderr, found.stderr
