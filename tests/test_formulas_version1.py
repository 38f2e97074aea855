"""The versions of every task from 1 on against NumPy in float64 on MuJoCo's own MjData, at every step of rollouts.

What a step makes of the state before it: observations of the task, reward terms, those of preferences too, what is
booked as help, force by region of the body, harm and cost. Where an episode starts is tested elsewhere, so that all of
it follows step by step.
"""

import dataclasses

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from kinematics import solve
from test_env import mujoco_says
from test_tasks import Truth
from test_version1 import velocity

import assistax
from assistax import scenes
from assistax.human import harm
from assistax.learning.partners import act_as_members
from assistax.policies.scripted import scripted_team
from assistax.tasks import task_spec
from assistax.training.team_file import load_team, trained_file

DT, EPISODES = 0.008, 2
UP = np.array([0.0, 0.0, 1.0])
PARTS = {"upper_arm": "right_upper_arm", "forearm": "right_forearm", "head": "head"}
LIMITS = {  # N: up to where it is comfortable, for clamping and for impact; the neck has the throat's
    "face": (5, 65, 90), "skull": (10, 130, 175), "neck": (10, 35, 35), "trunk": (10, 140, 210),
    "thigh": (10, 220, 440), "upper_arm": (10, 150, 190), "forearm": (10, 160, 220), "hand": (10, 135, 180),
}  # fmt: skip
GEOMS = {"throat": "neck", "chest": "trunk", "belly": "trunk", "pelvis": "trunk"}
GEOMS |= {f"{side}_{part}": part for side in ("right", "left") for part in ("thigh", "upper_arm", "forearm", "hand")}
BUDGET = {"scratch": 3.165, "bed_bath": 1.624, "arm_assist": 4.512, "feeding": 1.88, "tooth_brushing": 1.256}


def unit(x):
    return x / np.linalg.norm(x)


def bump(x):
    return x * np.exp(-x)


def cosine(x, y):
    return unit(x) @ unit(y)


class Seen(Truth):
    """And what body parts feel of the tool."""

    def part(self, name):
        """Position [3] and frame [3, 3] of a body part."""
        body = self.data.body(PARTS[name])
        return body.xpos, body.xmat.reshape(3, 3)

    def tool_velocity(self, name):
        """[3] m/s, world axes: what is left of the tool's when that of the part, moving and turning, is taken away."""
        body, tip = self.data.body(PARTS[name]), self.data.site("tool_tip")
        v_body, spin = velocity(self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, body)
        return self.velocity - v_body - np.cross(spin, tip.xpos - body.xpos)

    def tool_force(self, name):
        """N, of the tool's working surface on a body part."""
        tool, part = self.model.body("tool").id, self.model.body(PARTS[name]).id
        total, wrench = np.zeros(3), np.zeros(6)
        for i, contact in enumerate(self.data.contact[: self.data.ncon]):
            if {*self.model.geom_bodyid[contact.geom]} == {tool, part}:
                mujoco.mj_contactForce(self.model, self.data, i, wrench)
                on_second = contact.frame.reshape(3, 3).T @ wrench[:3]
                total += on_second if self.model.geom_bodyid[contact.geom[1]] == part else -on_second
        return np.linalg.norm(total)

    def robot_forces(self):
        """N [3], world axes, of the whole robot, by geom of the person."""
        forces, wrench = {}, np.zeros(6)
        for i, contact in enumerate(self.data.contact[: self.data.ncon]):
            robot = self.model.body_rootid[self.model.geom_bodyid[contact.geom]] == self.model.body("robot").id
            skin = [self.model.geom(geom).name for geom in contact.geom]
            for on, by, sign in ((0, 1, -1), (1, 0, 1)):
                if robot[by] and skin[on] in {*GEOMS, "head"}:
                    mujoco.mj_contactForce(self.model, self.data, i, wrench)
                    push = sign * contact.frame.reshape(3, 3).T @ wrench[:3]
                    forces[skin[on]] = forces.get(skin[on], 0.0) + push
        return forces

    def felt(self):
        """N of the whole robot by region, of two limbs or parts of the trunk the larger one. From where the head is
        pushed says which of its regions it is: from below within arccos 0.8, else from ahead within 60°."""
        felt = dict.fromkeys(LIMITS, 0.0)
        for geom, force in self.robot_forces().items():
            region = GEOMS.get(geom)
            if geom == "head" and force.any():
                ahead, _, above = -unit(self.site("mouth")[1].T @ force)
                region = "neck" if above < -0.8 else "face" if ahead > 0.5 else "skull"
            if region:
                felt[region] = max(felt[region], np.linalg.norm(force))
        return felt

    def least(self, parts):
        """N on that one of these regions or geoms on which it is least."""
        felt = self.felt() | {geom: np.linalg.norm(force) for geom, force in self.robot_forces().items()}
        return min(felt.get(part, 0.0) for part in parts)

    def spot(self, part, point):
        """Of a point [3] on an arm segment, in its body's axes: where it is [3] in the world, what points out of the
        skin there [3], and the way to it in m, straight and then around from the side that the tool is on."""
        limb = scenes.geometry.capsule(self.model, PARTS[part])
        origin, frame = self.part(part)
        across = np.eye(3) - np.outer(limb.axis, limb.axis)
        normal, tool = (across @ (x - limb.centre) for x in (np.asarray(point), frame.T @ (self.tool - origin)))
        place = origin + frame @ point
        way = np.linalg.norm(self.tool - place) + limb.radius * np.arccos(np.clip(cosine(normal, tool), -1, 1))
        return place, unit(frame @ normal), way


def stroked(before, now):
    """Velocities over some parts and in the room, low-pass filtered over 0.1 s, and by part the lesser speed."""
    after = before + (1 - np.exp(-DT / 0.1)) * (np.stack(now) - before)
    *over, room = np.linalg.norm(after, axis=1)
    return after, np.minimum(over, room)


def scratch(env, seen, before):
    near = {"scratch-v1": 0.04, "scratch-v2": 0.02, "scratch-v3": 0.02}[env.name]
    part = ("upper_arm", "forearm")[int(before.segment)]
    itch, normal, way = seen.spot(part, np.asarray(before.itch, float))
    vector = itch - seen.tool
    d, moves, f = np.linalg.norm(vector), seen.tool_velocity(part), seen.tool_force(part)
    strokes = np.asarray(before.strokes, float)
    v = np.linalg.norm(moves)
    if env.name == "scratch-v3":
        strokes, (v,) = stroked(strokes, [moves, seen.velocity])
    terms = {
        "reach": np.exp(-(way**2) / 0.1),
        "scratch": 16 * (d < near and f > 1e-3) * bump(v / 0.1) * bump(f / 3.0),
    }
    scratching = d < near and 1.0 <= f <= 6.0 and 0.03 <= v <= 0.3
    after = {"scratch_seconds": before.scratch_seconds + DT * scratching, "strokes": strokes}
    blocks = {"target_vector": vector, "target_distance": [d], "target_normal": normal}
    return blocks, terms, after, (d < near and f > 1e-3, v)


def bed_bath(env, seen, before):
    parts = ["upper_arm"] * 29 + ["forearm"] * 23
    points = np.concatenate([np.asarray(x, float) for x in env.task.points])
    places, normals, ways = map(np.array, zip(*map(seen.spot, parts, points), strict=True))
    dirty, visited, seconds = (np.asarray(x) for x in (before.dirty, before.visited, before.seconds))
    arm = ("upper_arm", "forearm")
    force, moves = ({part: of(part) for part in arm} for of in (seen.tool_force, seen.tool_velocity))
    strokes, least, long = np.asarray(before.strokes, float), 0.02, 0.08
    speed = {part: np.linalg.norm(moves[part]) for part in arm}
    if env.name == "bed_bath-v3":
        (strokes, speeds), least, long = stroked(strokes, [*moves.values(), seen.velocity]), 0.05, 0.2
        speed = dict(zip(arm, speeds, strict=True))
    rubbed = np.array([0.5 < force[part] <= 15.0 and least <= speed[part] <= 0.4 for part in parts])
    rubbed &= np.linalg.norm(places - seen.tool, axis=1) < 0.05
    seconds = seconds + DT * rubbed
    newly = rubbed & (seconds > long - DT / 2) & ~visited
    visited = visited | newly
    robot = np.array(env.spec.scene.robot_pos)
    level = (robot - places) * [1, 1, 0]
    shown = 0.5 + 0.5 * np.einsum("ij,ij->i", normals, level / np.linalg.norm(level, axis=1)[:, None] + UP) / 2**0.5
    flat = 0.5 - 0.5 * normals @ seen.frame[:, 2]
    paid = np.where(visited, 1.0, np.exp(-(ways**2) / 0.1) * (1 + shown + flat) / 3)
    left = ~visited if not visited.all() else np.ones(52, bool)
    best = np.argmin(np.where(left, ways + 0.6 * (1 - shown) + 0.2 * (1 - flat), np.inf))
    rest = 1 + seen.steps_left * visited.all()  # who has washed all loses nothing by the end
    terms = {"reach": paid[dirty].mean() * rest, "wipe": 12 * newly.sum() * 52 / dirty.sum()}
    blocks = {"target_vector": places[best] - seen.tool, "target_normal": normals[best]}
    nearest = parts[np.argmin(np.linalg.norm(places - seen.tool, axis=1))]
    dirt_goes = (rubbed & ~np.asarray(before.visited)).any()
    return (
        blocks,
        terms,
        {"visited": visited, "seconds": seconds, "strokes": strokes},
        (dirt_goes, speed[nearest]),
    )


def arm_assist(env, seen, before):
    (wrist, r_wrist), (waist, _) = seen.site("wrist_target"), seen.site("waist_target")
    moves, _ = velocity(env.model, seen.data, mujoco.mjtObj.mjOBJ_SITE, seen.data.site("wrist_target"))
    there, speed = np.linalg.norm(waist - wrist) < 0.1, np.linalg.norm(moves)
    thrown = (bool(before.thrown) and (there or speed > 0.1)) or speed > 0.5
    settled = there and not thrown and speed <= 0.1
    grip = wrist - 0.075 * r_wrist[:, 2] - seen.tool
    terms = {
        "reach": np.exp(-(grip @ grip) / 0.1),
        "waist": 10 * (1.0 if settled else 0.7) * (1 - np.tanh(np.linalg.norm(waist - wrist) / 0.3)),
        "rotation": 0.1 * (2 * 2**0.5 - np.linalg.norm(seen.frame - r_wrist)),
    }
    blocks = {"target_vector": wrist - seen.tool, "waist_vector": waist - wrist}
    blocks |= {"target_velocity": moves, "thrown": [thrown]}
    after = {"seconds_at_waist": before.seconds_at_waist + DT * settled, "thrown": thrown, "there": there}
    return blocks, terms, after, (there and not thrown, np.linalg.norm(seen.tool_velocity("forearm")))


def feeding(env, seen, before):
    mouth, face = seen.site("mouth")
    vector = mouth - seen.tool
    d, p = np.linalg.norm(vector), np.exp(-150 * (vector @ vector))
    up, tip, ahead = -seen.frame[:, 0], seen.frame[:, 2], face[:, 0]
    speed = np.linalg.norm(seen.tool_velocity("head"))
    # The food feels gravity and the spoon's acceleration, which is low-pass filtered over 50 ms.
    share = 1 - np.exp(-DT / 0.05)
    acceleration = np.asarray(before.acceleration, float)
    acceleration = acceleration + share * ((seen.velocity - np.asarray(before.velocity, float)) / DT - acceleration)
    tilt = np.arccos(np.clip(cosine(up, 9.81 * UP + acceleration), -1, 1))
    newest = env.name == "feeding-v3"
    tipped = before.tipped_seconds + DT * ((d > 0.1 or newest) and tilt > np.pi / 4)
    spilled = bool(before.spilled) or ((tipped > 0.1 or tilt > np.pi / 2) and before.mouth_seconds < 0.5)
    to_bowl = vector - tip * np.clip(vector @ tip, 0, 0.036)
    _, aside, above = np.abs(face.T @ to_bowl)
    at_lips = env.name == "feeding-v1" or (aside < 0.02 and above < 0.01)
    angles = cosine(seen.tool - mouth - 0.036 * tip, ahead), -tip @ ahead, up[2]
    at_mouth = np.linalg.norm(to_bowl) < 0.03 and at_lips and min(angles) >= 0.5
    at_mouth &= seen.tool_force("head") >= 0.1 or not newest
    eating = at_mouth and not spilled and speed <= 0.1
    towards = (1 - p) * UP + p * unit(vector)
    lean = min(np.arccos(np.clip(cosine(towards, UP), -1, 1)), np.pi / 12)
    wanted = np.cos(lean) * UP + np.sin(lean) * unit(towards * [1, 1, 0])
    terms = {
        "reach": 2 * np.exp(-3 * (d if env.name == "feeding-v1" else np.linalg.norm(to_bowl))),
        "orientation": wanted @ up - (0.3 + 0.7 * p) * (tip @ ahead),
        "approach": np.exp(-((speed - 0.2 * (1 - p)) ** 2) / 0.01),
        "contact": eating * bump(seen.f),
    }
    after = {"spilled": spilled, "tipped_seconds": tipped, "mouth_seconds": before.mouth_seconds + DT * eating}
    after |= {"acceleration": acceleration}
    return {"target_vector": vector, "mouth_pos": mouth}, terms, after, (at_mouth and not spilled, speed)


def tooth_brushing(env, seen, before):
    mouth, face = seen.site("mouth")
    vector = mouth - seen.tool
    d, towards, moves = np.linalg.norm(vector), unit(vector), seen.tool_velocity("head")
    across, f, newest = np.linalg.norm(np.cross(moves, towards)), seen.tool_force("head"), env.name.endswith("v2")
    bristle, handle = -seen.frame[:, 0], -seen.frame[:, 2]
    there = d < 0.05 and -bristle @ face[:, 0] >= 0.5
    likes = np.linalg.norm(moves)
    if newest:  # what the brush itself moves along the teeth
        likes = across = min(np.linalg.norm(np.cross(v, face[:, 0])) for v in (moves, seen.velocity))
        there &= abs(vector @ face[:, 1]) < 0.025 and abs(vector @ face[:, 2]) < 0.015
    brushing = there and 0.3 <= f <= 3.0 and 0.03 <= across <= 0.3
    terms = {
        "reach": 2 * np.exp(-3 * d),
        "align": 0.5 * (1 - bristle @ face[:, 0] - abs(handle[2])) * np.exp(-3 * d),
        "brush": (8 if newest else 4) * there * bump(across / 0.1) * bump(f),
    }
    after = {"brush_seconds": before.brush_seconds + DT * brushing}
    return {"target_vector": vector, "mouth_pos": mouth}, terms, after, (there, likes)


def liking(x, low, high):
    return 1.0 if low <= x <= high else np.exp(-(((2 * x - low - high) / (high - low)) ** 2) / 2)


def preferred(budget, seen, person, force_before, action, helps, speed):
    """What a person is paid who wants this speed and force of the tool, none of it to begin anew, and no effort."""
    weights = np.asarray(person.weights, float)
    share = budget * weights / (weights[0] + weights[1] + weights[3])
    return {
        "prefer_speed": helps * share[0] * liking(speed, *np.asarray(person.speed, float)),
        "prefer_force": helps * share[1] * liking(seen.f, *np.asarray(person.force, float)),
        "prefer_touch": share[2] * (force_before < 0.1 <= seen.f),
        "prefer_action": helps * share[3] * (1 - np.mean(np.clip(action, -1, 1).astype(float) ** 2)),
    }


def harmed(seen, before):
    """Force in N by region, and what is made of it in a control step: filtered over 8 ms, booked, its cost."""
    force, (comfort, clamping, impact) = np.array([*seen.felt().values()]), np.array([*LIMITS.values()]).T
    over = np.maximum(force - comfort, 0)
    filtered = before.filtered + (1 - np.exp(-1)) * (force - before.filtered)
    peak, pressing = np.maximum(before.peak, filtered), np.where(filtered > clamping, before.pressing + DT, 0)
    return {
        "force": force,
        "cost": (over / (clamping - comfort)).sum(),
        "filtered": filtered,
        "pressing": pressing,
        "clamping": bool(before.clamped) or (pressing > 0.5).any(),
        "impact": (peak > impact).any(),
        "seconds_above_comfort": before.seconds + DT * (over > 0).any(),
        "impulse_above_comfort": before.impulse + DT * over.sum(),
    } | {f"peak_force_{region}": x for region, x in zip(LIMITS, peak, strict=True)}


def said_of_harm(after, info):
    """The same as the environment has it."""
    of_state = {name: getattr(after.harm, name) for name in ("filtered", "pressing")}
    return info["metrics"] | of_state | {"force": info["regions"], "cost": info["cost"]}


TASKS = {f.__name__: f for f in (scratch, bed_bath, arm_assist, feeding, tooth_brushing)}
NEWEST = [task_spec(name).id for name in TASKS]
EARLIER = [f"{task}-v1" for task in TASKS] + ["scratch-v2", "bed_bath-v2", "feeding-v2"]


def played(env, who, steps, poses=None):
    """(state, actions, observations, state after, info) of episodes [steps, n], by "random" or a scripted or packaged
    team; of EPISODES, or one from each of the poses [n, nq]. In info are `regions`, forces by region."""
    n = EPISODES if poses is None else len(poses)
    if who == "trained":
        team = load_team(trained_file(env.name))[1]
    elif who != "random":
        team = scripted_team(who, env)

    def acts(obs, state, carry, first, key):
        if who == "random":
            return {a: jax.random.uniform(key, (n, size), minval=-1) for a, size in env.action_sizes.items()}, carry
        out, after = {}, {}
        for agent, player in team.items():
            seen = carry[agent], obs[agent], state, first, jax.random.split(key, n)
            out[agent], after[agent] = act_as_members(player, jnp.zeros(n, jnp.int32), *seen)
        return {agent: jnp.clip(x, -1, 1) for agent, x in out.items()}, after

    def step(carried, key):
        obs, state, carry, first = carried
        actions, carry = acts(obs, state, carry, first, key)
        seen, after, *_, info = jax.vmap(env.step_env, (None, 0, 0))(key, state, actions)
        info["regions"] = jax.vmap(lambda physics: harm.forces(env.sensors(physics)))(after.physics)
        return (seen, after, carry, jnp.zeros(n, bool)), (state, actions, seen, after, info)

    @jax.jit
    def play():
        obs, state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), n))
        if poses is not None:
            qpos = jnp.asarray(poses)
            state = dataclasses.replace(state, physics=jax.vmap(env.engine.init)(qpos, jnp.zeros_like(qpos)))
        carry = {} if who == "random" else {a: p.initial_carry() for a, p in team.items()}
        carry = jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *jnp.shape(x))), carry)
        keys = jax.random.split(jax.random.key(1), steps)
        return jax.lax.scan(step, (obs, state, carry, jnp.ones(n, bool)), keys)[1]

    return jax.tree.map(np.asarray, play())


def compared(found, wanted, engine, where):
    """What the environment has otherwise, in words."""
    near = dict(atol=2e-3, rtol=1e-3) if engine == "mujoco" else dict(atol=2e-2, rtol=5e-2)
    off = [what for what, value in wanted.items() if not np.allclose(found[what], value, **near)]
    return [f"{where}: {what} is {found[what]}, not {wanted[what]}" for what in off]


@pytest.mark.parametrize("who", ["random", "offer", "trained"])
@pytest.mark.parametrize(
    ("task", "engine", "steps"),
    [
        *((task, "mujoco", 400) for task in NEWEST),
        *(pytest.param(task, "mujoco", 400, marks=pytest.mark.slow) for task in EARLIER),
        *(pytest.param(task, "warp", 250, marks=pytest.mark.slow) for task in NEWEST),
    ],
)
def test_every_step_of_a_rollout_is_what_the_formulas_say(task, engine, steps, who):
    """A person who offers the target has preferences, the others have none."""
    name = task_spec(task).name
    liked = {"scratch": "weights=0.3,0.35,-0.03,0.2"}.get(name, "sweep") if who == "offer" else "none"
    env = assistax.make(task, engine=engine, human={"preference": liked})
    layout, rows = env.obs_layout("robot"), played(env, who, steps)
    outcome = {"bed_bath": "seconds"}.get(name) or next(iter(env.task.outcomes(env.task.reset(jax.random.key(0)))))
    helped, off, paid = 0, [], []
    for episode in range(EPISODES):
        force_before, sums = 0.0, {"cost": 0.0} | ({"preference_return": 0.0} if who == "offer" else {})
        for t in range(steps):
            state, actions, obs, after, info = jax.tree.map(lambda x: x[t, episode], rows)  # noqa: B023
            seen = Seen(env, mujoco_says(env, state.physics, actions))
            seen.steps_left = env.config.episode_length - 1 - t
            blocks, terms, booked, helps = TASKS[name](env, seen, state.task)
            if who == "offer":
                person = state.person.preference
                likes = preferred(BUDGET[name], seen, person, force_before, actions["robot"], *helps)
                blocks |= {"preference": np.concatenate([person.speed, person.force, person.weights[:3]])}
                terms |= likes
                paid.append([*likes.values()])
                sums["preference_return"] += sum(likes.values())
            assert set(terms) == set(info["reward_terms"])
            found = {block: obs["robot"][layout[block]] for block in blocks} | info["reward_terms"]
            found |= {field: getattr(after.task, field) for field in booked}
            off += compared(found, blocks | terms | booked, engine, f"episode {episode}, step {t}")
            harms = harmed(seen, state.harm)
            off += compared(said_of_harm(after, info), harms, engine, f"episode {episode}, step {t}")
            force_before = seen.f
            sums["cost"] += harms["cost"]
        off += compared(info["metrics"], sums, engine, f"episode {episode}")
        helped += np.sum(getattr(after.task, outcome)) > 0
    # Pressed for 8 ms in single precision, a contact has another force, or is none, in a few steps of a hundred.
    assert len(off) <= (0 if engine == "mujoco" else 0.1 * EPISODES * steps), off[:10]
    assert engine != "mujoco" or (helped > 0) == (who != "random")  # the others play too few steps to help
    if who == "offer" and engine == "mujoco":  # there are steps in which each is paid, and some in which it is not
        due = np.array([True, True, True, name == "scratch"])
        assert (np.any(paid, axis=0) == due).all() and not np.all(paid, axis=0).any()


def pressed(env, *parts):
    """A pose [nq] in which the robot presses on all these parts of the person, regions or geoms."""
    model, data = env.model, mujoco.MjData(env.model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    face, rng = data.site("mouth").xmat.reshape(3, 3), np.random.default_rng(0)
    ways = {"face": face[:, 0], "skull": UP, "neck": unit(0.5 * face[:, 0] - face[:, 2])}
    geoms = ["head" if part in ways else part for part in parts]
    middle = np.mean([data.geom(geom).xpos for geom in geoms], axis=0)

    def accept(data):
        seen = Seen(env, data)
        return seen.least(parts) > 5.0 and max(seen.felt().values()) < 300.0

    for seed in range(40):
        way = ways.get(parts[0], unit(rng.normal(size=3)))
        pose = solve(model, middle + way * model.geom(geoms[0]).size[0], seed=seed, restarts=5, accept=accept)
        if pose is not None:  # a joint exactly at its limit is on either side of it, depending on the engine's rounding
            return pose + 1e-3 * (pose - model.jnt_range[:, 0] < 1e-4)
    raise AssertionError(f"nothing presses on {parts}")


@pytest.mark.parametrize("engine", ["mujoco", pytest.param("warp", marks=pytest.mark.slow)])
def test_harm_is_what_the_contacts_say_wherever_the_robot_presses(engine):
    """On every part of the person, one after the other, and on two of one region at once."""
    env, steps = assistax.make("tooth_brushing", engine=engine), 12
    places = [("face",), ("skull",), ("neck",), *((geom,) for geom in GEOMS), ("chest", "belly")]
    rows = played(env, "random", steps, np.array([pressed(env, *parts) for parts in places]))
    off, touched = [], set()
    for i, parts in enumerate(places):
        for t in range(steps):
            state, actions, _, after, info = jax.tree.map(lambda x: x[t, i], rows)  # noqa: B023
            seen = Seen(env, mujoco_says(env, state.physics, actions))
            off += compared(said_of_harm(after, info), harmed(seen, state.harm), engine, f"{parts}, step {t}")
            if seen.least(parts) > 1.0:
                touched.add(parts)
    assert not off and touched == {*places}, off[:10]
    assert {region: limits[:3] for region, limits in harm.REGIONS.items()} == LIMITS
