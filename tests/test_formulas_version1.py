"""Version 1 of every task against NumPy in float64 on MuJoCo's own MjData, at every step of whole rollouts.

What a step makes of the state before it: observations of the task, reward terms, what is booked as help. Where an
episode starts is tested elsewhere, so that all of it follows step by step.
"""

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from test_env import mujoco_says
from test_tasks import Truth
from test_version1 import velocity

import assistax
from assistax import scenes
from assistax.learning.partners import act_as_members
from assistax.policies.scripted import scripted_team
from assistax.training.team_file import load_team, trained_file

DT, EPISODES = 0.008, 2
UP = np.array([0.0, 0.0, 1.0])
PARTS = {"upper_arm": "right_upper_arm", "forearm": "right_forearm", "head": "head"}


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


def scratch(env, seen, before):
    part = ("upper_arm", "forearm")[int(before.segment)]
    itch, normal, way = seen.spot(part, np.asarray(before.itch, float))
    vector = itch - seen.tool
    d, v, f = np.linalg.norm(vector), np.linalg.norm(seen.tool_velocity(part)), seen.tool_force(part)
    terms = {
        "reach": np.exp(-(way**2) / 0.1),
        "scratch": 16 * (d < 0.04 and f > 1e-3) * bump(v / 0.1) * bump(f / 3.0),
    }
    scratching = d < 0.04 and 1.0 <= f <= 6.0 and 0.03 <= v <= 0.3
    after = {"scratch_seconds": before.scratch_seconds + DT * scratching}
    return {"target_vector": vector, "target_distance": [d], "target_normal": normal}, terms, after


def bed_bath(env, seen, before):
    parts = ["upper_arm"] * 29 + ["forearm"] * 23
    points = np.concatenate([np.asarray(x, float) for x in env.task.points])
    places, normals, ways = map(np.array, zip(*map(seen.spot, parts, points), strict=True))
    dirty, visited, seconds = (np.asarray(x) for x in (before.dirty, before.visited, before.seconds))
    force, speed = ({part: of(part) for part in PARTS if part != "head"} for of in (
        seen.tool_force, lambda part: np.linalg.norm(seen.tool_velocity(part))
    ))  # fmt: skip
    rubbed = np.array([0.5 < force[part] <= 15.0 and 0.02 <= speed[part] <= 0.4 for part in parts])
    rubbed &= np.linalg.norm(places - seen.tool, axis=1) < 0.05
    seconds = seconds + DT * rubbed
    newly = rubbed & (seconds > 0.08 - DT / 2) & ~visited
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
    return blocks, terms, {"visited": visited, "seconds": seconds}


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
    return blocks, terms, {"seconds_at_waist": before.seconds_at_waist + DT * settled, "thrown": thrown}


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
    tipped = before.tipped_seconds + DT * (d > 0.1 and tilt > np.pi / 4)
    spilled = bool(before.spilled) or ((tipped > 0.1 or tilt > np.pi / 2) and before.mouth_seconds < 0.5)
    to_bowl = np.linalg.norm(vector - tip * np.clip(vector @ tip, 0, 0.036))
    angles = cosine(seen.tool - mouth - 0.036 * tip, ahead), -tip @ ahead, up[2]
    at_mouth = to_bowl < 0.03 and min(angles) >= 0.5
    eating = at_mouth and not spilled and speed <= 0.1
    towards = (1 - p) * UP + p * unit(vector)
    lean = min(np.arccos(np.clip(cosine(towards, UP), -1, 1)), np.pi / 12)
    wanted = np.cos(lean) * UP + np.sin(lean) * unit(towards * [1, 1, 0])
    terms = {
        "reach": 2 * np.exp(-3 * d),
        "orientation": wanted @ up - (0.3 + 0.7 * p) * (tip @ ahead),
        "approach": np.exp(-((speed - 0.2 * (1 - p)) ** 2) / 0.01),
        "contact": eating * bump(seen.f),
    }
    after = {"spilled": spilled, "tipped_seconds": tipped, "mouth_seconds": before.mouth_seconds + DT * eating}
    return {"target_vector": vector, "mouth_pos": mouth}, terms, after | {"acceleration": acceleration}


def tooth_brushing(env, seen, before):
    mouth, face = seen.site("mouth")
    vector = mouth - seen.tool
    d, towards, moves = np.linalg.norm(vector), unit(vector), seen.tool_velocity("head")
    across, f = np.linalg.norm(np.cross(moves, towards)), seen.tool_force("head")
    bristle, handle = -seen.frame[:, 0], -seen.frame[:, 2]
    there = d < 0.05 and -bristle @ face[:, 0] >= 0.5
    brushing = there and 0.3 <= f <= 3.0 and 0.03 <= across <= 0.3
    terms = {
        "reach": 2 * np.exp(-3 * d),
        "align": 0.5 * (1 - bristle @ face[:, 0] - abs(handle[2])) * np.exp(-3 * d),
        "brush": 4 * there * bump(across / 0.1) * bump(f),
    }
    return {"target_vector": vector, "mouth_pos": mouth}, terms, {"brush_seconds": before.brush_seconds + DT * brushing}


TASKS = {f.__name__: f for f in (scratch, bed_bath, arm_assist, feeding, tooth_brushing)}


def played(env, who, steps):
    """(state, actions, observations, state after, info) of episodes [steps, EPISODES], by "random" or a scripted or
    packaged team."""
    if who == "trained":
        team = load_team(trained_file(env.name))[1]
    elif who != "random":
        team = scripted_team(who, env)

    def acts(obs, state, carry, first, key):
        if who == "random":
            return {a: jax.random.uniform(key, (EPISODES, n), minval=-1) for a, n in env.action_sizes.items()}, carry
        out, after = {}, {}
        for agent, player in team.items():
            seen = carry[agent], obs[agent], state, first, jax.random.split(key, EPISODES)
            out[agent], after[agent] = act_as_members(player, jnp.zeros(EPISODES, jnp.int32), *seen)
        return {agent: jnp.clip(x, -1, 1) for agent, x in out.items()}, after

    def step(carried, key):
        obs, state, carry, first = carried
        actions, carry = acts(obs, state, carry, first, key)
        seen, after, *_, info = jax.vmap(env.step_env, (None, 0, 0))(key, state, actions)
        return (seen, after, carry, jnp.zeros(EPISODES, bool)), (state, actions, seen, after, info)

    @jax.jit
    def play():
        obs, state = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), EPISODES))
        carry = {} if who == "random" else {a: p.initial_carry() for a, p in team.items()}
        carry = jax.tree.map(lambda x: jnp.broadcast_to(x, (EPISODES, *jnp.shape(x))), carry)
        keys = jax.random.split(jax.random.key(1), steps)
        return jax.lax.scan(step, (obs, state, carry, jnp.ones(EPISODES, bool)), keys)[1]

    return jax.tree.map(np.asarray, play())


@pytest.mark.parametrize("who", ["random", "offer", "trained"])
@pytest.mark.parametrize(
    ("name", "engine", "steps"),
    [
        *((name, "mujoco", 400) for name in TASKS),
        *(pytest.param(name, "warp", 250, marks=pytest.mark.slow) for name in TASKS),
    ],
)
def test_every_step_of_a_rollout_is_what_the_formulas_say(name, engine, steps, who):
    env = assistax.make(name, engine=engine)
    layout, rows = env.obs_layout("robot"), played(env, who, steps)
    near = dict(atol=2e-3, rtol=1e-3) if engine == "mujoco" else dict(atol=2e-2, rtol=5e-2)
    outcome = {"bed_bath": "seconds"}.get(name) or next(iter(env.task.outcomes(env.task.reset(jax.random.key(0)))))
    helped, off = 0, []
    for episode in range(EPISODES):
        for t in range(steps):
            state, actions, obs, after, info = jax.tree.map(lambda x: x[t, episode], rows)  # noqa: B023
            seen = Seen(env, mujoco_says(env, state.physics, actions))
            seen.steps_left = env.config.episode_length - 1 - t
            blocks, terms, booked = TASKS[name](env, seen, state.task)
            assert set(terms) == set(info["reward_terms"])
            found = {block: obs["robot"][layout[block]] for block in blocks} | info["reward_terms"]
            found |= {field: getattr(after.task, field) for field in booked}
            for what, value in (blocks | terms | booked).items():
                if not np.allclose(found[what], value, **near):
                    off.append(f"episode {episode}, step {t}: {what} is {found[what]}, not {value}")
        helped += np.sum(getattr(after.task, outcome)) > 0
    # Pressed for 8 ms in single precision, a contact has another force, or is none, in a few steps of a hundred.
    assert len(off) <= (0 if engine == "mujoco" else 0.1 * EPISODES * steps), off[:10]
    assert engine != "mujoco" or (helped > 0) == (who != "random")  # the others play too few steps to help
