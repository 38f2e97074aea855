"""What a camera sees: the skin that a point is on, what hides what, and from where the help is seen best."""

import mujoco
import numpy as np

from assistax.evaluation.filmed import Filmed
from assistax.evaluation.stage import lying_on
from assistax.scenes import TOUCHED
from assistax.tasks.base import TO_DO

SHOWN = np.array([1, 1, 1, 0, 0, 0], np.uint8)  # the groups of geoms that are in a picture
ON_SKIN = 0.002  # m
CLOTHES = 0.05  # m, above the skin, at most
NEAR = 0.03  # m, before a point: what is there does not hide it
AZIMUTHS, ELEVATIONS = np.radians(np.arange(0, 360, 15)), np.radians([12, 25, 40])
LOOKS = 10  # moments of an episode at which it is asked what can be seen
TOOL = 0.04  # m, around the tool's tip: this end of the tool does the help
SPACING = 0.0075  # m, between the rays that look for it
WORK = 1.0  # what seeing the tool's end is worth
ENOUGH = 0.5  # of the most that is seen of it from any place: more is worth no more
USUAL = 0.4  # what nearness to the scene's own view "close" is worth, where seeing the target is worth 1
CLOSEST = 0.8  # m
CAPTION = 0.05  # of the distance: so much lower looks the camera than at what it shows


def out_of_skin(model: mujoco.MjModel, data: mujoco.MjData, point: np.ndarray) -> np.ndarray | None:
    """Unit vector [3] out of the person's skin at a point [3] m on it, the mouth included; None elsewhere."""
    mouth = data.site("mouth")
    if np.linalg.norm(point - mouth.xpos) < ON_SKIN:
        return mouth.xmat[[0, 3, 6]]
    found, best = None, ON_SKIN
    for name in TOUCHED:  # at the elbow there are two surfaces
        geom = data.geom(name)
        radius, half = model.geom(name).size[:2]
        axis = geom.xmat[[2, 5, 8]]
        along = np.clip((point - geom.xpos) @ axis, -half, half)
        away = point - geom.xpos - along * axis
        distance = float(np.linalg.norm(away))
        if (gap := abs(distance - radius)) < best:
            found, best = away / distance, gap
    return found


def hidden(model: mujoco.MjModel, data: mujoco.MjData, eye: np.ndarray, points: np.ndarray, near=NEAR) -> np.ndarray:
    """Which body [n] stands between the eye [3] and each of the points [n, 3]; -1 where none does.

    What is nearer to a point than near, m or [n] m, does not hide it.
    """
    bodies, hits = _first(model, data, eye, points)
    return np.where((hits >= 0) & (hits < np.linalg.norm(points - eye, axis=1) - near), bodies, -1)


def tool_seen(model: mujoco.MjModel, data: mujoco.MjData, eye: np.ndarray) -> float:
    """How large the tool's end is in a picture from the eye [3], in cm² at the tool's distance."""
    tip = data.site("tool_tip").xpos
    steps = np.arange(-TOOL, TOOL, SPACING)
    across = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    points = tip + across @ lying_on((tip - eye) / np.linalg.norm(tip - eye))[:, :2].T
    bodies, hits = _first(model, data, eye, points)
    ways = points - eye
    places = eye + ways * (hits / np.linalg.norm(ways, axis=1))[:, None]
    tools = [model.body(name).id for name in ("tool", "tool_mount")]
    near = np.linalg.norm(places - tip, axis=1) < TOOL
    return 1e4 * SPACING**2 * float((near & np.isin(bodies, tools)).sum())


def _first(model, data, eye, points):
    """The bodies [n] that are seen from the eye towards the points, and how far [n] m they are; -1 for none."""
    ways = points - eye
    rays = (ways / np.linalg.norm(ways, axis=1)[:, None]).ravel()
    hits, geoms = np.empty(len(points)), np.empty(len(points), np.int32)
    mujoco.mj_multiRay(model, data, eye, rays, SHOWN, True, -1, geoms, hits, None, len(points), 10.0)
    return np.where(hits >= 0, model.geom_bodyid[geoms], -1), hits


class Spots:
    """The spots of an episode, as they lie on the skin, or on the sleeve above it."""

    def __init__(self, camera, filmed: Filmed):
        places = [place for places in filmed.spots.values() for place in places]
        self._bodies = np.zeros(len(places), int)
        self._places, self._normals = np.zeros((len(places), 3)), np.zeros((len(places), 3))
        if not places:
            return
        camera.pose(filmed.qpos[0], filmed.marker[0])
        model, data = camera.model, camera.data
        self._bodies[:] = [model.body(body).id for body, places in filmed.spots.items() for _ in places]
        for i, (body, place) in enumerate(zip(self._bodies, places, strict=True)):
            origin, rotation = data.xpos[body], data.xmat[body].reshape(3, 3)
            point = origin + rotation @ place
            normal = out_of_skin(model, data, point)
            if normal is not None:
                self._normals[i] = rotation.T @ normal
                point = _on_top(model, data, body, point, normal)
            self._places[i] = rotation.T @ (point - origin)

    def at(self, data: mujoco.MjData) -> tuple[np.ndarray, np.ndarray]:
        """Where they are now [n, 3] in m, and what points out of the skin there [n, 3]."""
        turns = data.xmat[self._bodies].reshape(-1, 3, 3)
        places = data.xpos[self._bodies] + np.einsum("nij,nj->ni", turns, self._places)
        return places, np.einsum("nij,nj->ni", turns, self._normals)


def _on_top(model, data, body, point, normal):
    """Where a point of the body's skin is seen: on the sleeve, if there is one."""
    geom = np.zeros(1, np.int32)
    gap = mujoco.mj_ray(model, data, point + CLOTHES * normal, -normal, SHOWN, True, -1, geom)
    covered = 0 <= gap < CLOTHES and model.geom_bodyid[geom[0]] == body
    return point + (CLOTHES - gap) * normal if covered else point


def viewpoint(camera, filmed: Filmed, spots: Spots) -> mujoco.MjvCamera:
    """A place that stays for the whole film, from which target, the tool's end and spots are seen most of the time.

    Among places from which as much is seen it is one near the view "close" of the scene.
    """
    model, data = camera.model, camera.data
    looks, tools = [], []
    for i in np.linspace(0, len(filmed.qpos) - 1, LOOKS).round().astype(int):
        camera.pose(filmed.qpos[i], filmed.marker[i])
        places, normals = spots.at(data)
        todo = filmed.spot_states[0] == TO_DO if filmed.spots else np.zeros(0, bool)
        sites = [data.site(name).xpos for name in camera.targets]
        points = np.array([filmed.marker[i], *sites, *places[todo]])
        normal = out_of_skin(model, data, points[0])
        outward = np.zeros_like(points)
        outward[0] = 0.0 if normal is None else normal
        outward[1 + len(sites) :] = normals[todo]
        weights = np.array([1.0] + [0.5] * len(sites) + [3.0 / max(todo.sum(), 1)] * todo.sum())
        looks.append((filmed.qpos[i], filmed.marker[i], points, outward, weights / LOOKS))
        tools.append(data.site("tool_tip").xpos.copy())
    # A target around a limb is seen where its middle is not.
    near = np.full(len(points), NEAR)
    near[1 : 1 + len(sites)] = [max(NEAR, model.site(name).size[0]) for name in camera.targets]
    # What is worked on is in the picture all the time, and of the tool's way the end.
    worked_on = np.concatenate([points for _, _, points, _, _ in looks])
    centre = 0.75 * worked_on.mean(0) + 0.25 * np.mean(tools, 0)
    distance = CLOSEST + np.linalg.norm(worked_on - centre, axis=1).max()
    azimuths, elevations = (x.ravel() for x in np.meshgrid(AZIMUTHS, ELEVATIONS))
    level = np.cos(elevations)
    back = np.stack([level * np.cos(azimuths), level * np.sin(azimuths), np.sin(elevations)], 1)  # towards the eye
    eyes = centre + distance * back
    usual = model.camera("close").pos - centre
    score = USUAL * back @ (usual / np.linalg.norm(usual))
    for qpos, marker, points, outward, weights in looks:
        camera.pose(qpos, marker)
        facing = np.where(outward.any(1), 0.5 + 0.5 * back @ outward.T, 1.0)
        for k, eye in enumerate(eyes):
            score[k] += (weights * facing[k])[hidden(model, data, eye, points, near) < 0].sum()
        tool = np.array([tool_seen(model, data, eye) for eye in eyes])
        score += WORK / LOOKS * np.minimum(tool / max(ENOUGH * tool.max(), 1.0), 1.0)
    best = int(score.argmax())
    view = mujoco.MjvCamera()
    view.lookat[:], view.distance = centre - [0.0, 0.0, CAPTION * distance], distance
    view.azimuth, view.elevation = np.degrees(azimuths[best]) + 180.0, -np.degrees(elevations[best])
    return view
