"""Reward and help agree: the best-paid behaviour helps, by 5 % over the best-paid one found that does not.

A search over instants: where the tool is and how turned, how hard it presses, how fast it moves, what was before.
What helps is what the task's own outcome counts. Poses in which the tool would be inside the head are left out. In bed
bath, where pay hangs on what was washed before, whole episodes are compared.
"""

import dataclasses
import json

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import assistax
from assistax import scenes
from assistax.human import preference
from assistax.policies.people import OFFERS
from assistax.scenes import geometry

HEAD = 0.09  # m, its radius
MARGIN = 1.05


def solid(name):
    """Points [n, 3] m of what is in the way of a face, in the tool's frame: bowl and handle, or bristles and handle."""
    if name == "feeding":
        tip = [
            (x, y, z)
            for x in (-0.002, 0.002)
            for y in np.linspace(-0.024, 0.024, 5)
            for z in np.linspace(-0.036, 0.036, 7)
        ]
        return jnp.array(tip + [(0, 0, -0.03 - 0.01 * k) for k in range(10)])
    tip = [(0.0, y, z) for y in (-0.006, 0.006) for z in np.linspace(-0.018, 0.018, 5)]
    return jnp.array(tip + [(0.012, 0, -0.02 - 0.01 * k) for k in range(10)])


class Instant:
    """What a task pays and counts for one control step, from numbers x [13] that a search may choose."""

    def __init__(self, name):
        self.name, self.env = name, assistax.make(name, engine="mujoco")
        self.task, model = self.env.task, self.env.model
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_forward(model, data)
        self.rest = {k: jnp.asarray(data.sensordata[at], jnp.float32) for k, at in scenes.sensor_slices(model).items()}
        self.head = jnp.asarray(data.geom("head").xpos, jnp.float32)
        self.state = self.task.reset(jax.random.key(0))

    def __call__(self, x, before, person):
        """(reward, whether it helps, whether it is possible)."""
        s, state, possible = getattr(self, f"_{self.name}")(x, before)
        after = self.task.advance(s, state)
        paid = sum(self.task.reward_terms(s, after).values())
        counted = {"scratch": "scratch_seconds", "feeding": "mouth_seconds", "tooth_brushing": "brush_seconds",
                   "arm_assist": "seconds_at_waist"}[self.name]  # fmt: skip
        helps = getattr(after, counted) > getattr(state, counted)
        if person is not None:
            speed, force = self.task.tool_speed(s, after), jnp.linalg.norm(s["tool_force"])
            terms = preference.reward_terms(
                person, speed, force, force, jnp.zeros(7), self.env.spec.preference_budget, self.task.helping(s, after)
            )
            paid += sum(terms.values())
        return paid, helps, possible

    def _pressing(self, s, parts, force, velocity, own, turned):
        """The tool presses and moves so on these body parts, which move, too: its own velocity is another."""
        push = jnp.array([0.0, 0.0, 1.0]) * force
        s |= {"tool_force": push, "robot_force": push, "tool_vel": own}
        for part in parts:
            s |= {f"tool_force_{part}": push, f"tool_vel_{part}": turned(part) @ velocity}
        return s

    def _face(self, x):
        frame = geometry.matrix(self.rest["mouth_quat"])
        pos = self.rest["mouth_pos"] + frame @ x[:3]
        angle = jnp.linalg.norm(x[3:6]) + 1e-9
        quat = jnp.concatenate([jnp.cos(angle / 2)[None], jnp.sin(angle / 2) * x[3:6] / angle])
        around = solid(self.name) @ geometry.matrix(quat).T - self.head
        for _ in range(8):  # a tool that presses is moved straight ahead until it touches the face
            depth = (HEAD - jnp.linalg.norm(pos + around, axis=1)).max()
            pos += (x[6] > 0.0) * jnp.clip(depth, -0.05, 0.05) * frame[:, 0]
        depth = (HEAD - jnp.linalg.norm(pos + around, axis=1)).max()
        force = jnp.where(depth > -0.001, jnp.clip(x[6], 0.0, 20.0), 0.0)
        s = self._pressing(dict(self.rest), ["head"], force, x[7:10], x[10:], lambda part: frame.T)
        return s | {"tool_pos": pos, "tool_quat": quat}, depth < 0.001

    def _feeding(self, x, before):
        s, possible = self._face(x)
        return s, dataclasses.replace(self.state, spilled=before), possible

    def _tooth_brushing(self, x, before):
        s, possible = self._face(x)
        return s, self.state, possible

    def _scratch(self, x, before):
        """`before` stands for the wrong segment."""
        segment = self.state.segment
        quat = jnp.where(segment == 0, self.rest["upper_arm_quat"], self.rest["forearm_quat"])
        place = jnp.where(segment == 0, self.rest["upper_arm_pos"], self.rest["forearm_pos"])
        force, nothing = jnp.clip(x[6], 0.0, 20.0), jnp.zeros(3)
        frames = {part: geometry.matrix(self.rest[f"{part}_quat"]).T for part in ("upper_arm", "forearm")}
        s = self._pressing(dict(self.rest), frames, force, x[7:10], x[10:], frames.get)
        state = dataclasses.replace(self.state, strokes=jnp.stack([x[7:10], x[10:]]))  # for long enough
        right = jnp.array([segment == 0, segment == 1]) ^ before
        for i, part in enumerate(frames):
            s[f"tool_force_{part}"] = jnp.where(right[i], s[f"tool_force_{part}"], nothing)
        return s | {"tool_pos": place + geometry.rotate(quat, state.itch) + x[:3]}, state, jnp.bool_(True)

    def _arm_assist(self, x, before):
        """`before`: the arm was thrown to where it is."""
        s = dict(self.rest) | {"wrist_target_vel": x[7:10], "tool_pos": self.rest["wrist_target_pos"] + x[3:6]}
        s |= {"wrist_target_pos": self.rest["waist_target_pos"] + x[:3]}
        s["tool_pos"] = s["wrist_target_pos"] + x[3:6] * 0.1
        return s, dataclasses.replace(self.state, thrown=before), jnp.bool_(True)


def best(instant, person, wanted, number=6000, rounds=22, fast=0.1):
    """The most that is paid per step for what helps, or for what does not; speeds begin around `fast` m/s."""
    look = jax.jit(jax.vmap(instant, (0, 0, None)))
    rng, most = np.random.default_rng(0), -np.inf

    def draw(n):
        speed = np.repeat(rng.normal(size=(n, 3)) * fast * rng.integers(0, 2, (n, 1)), 2, 0).reshape(n, 6)
        return np.concatenate(
            [rng.uniform(-0.15, 0.15, (n, 3)), rng.normal(size=(n, 3)) * 1.6, rng.uniform(-2, 6, (n, 1)), speed], 1
        )

    x, before = draw(number), rng.random(number) < 0.5
    scale = np.array([0.03] * 3 + [0.4] * 3 + [0.8] + [0.04] * 6)
    step = 0
    for _ in range(rounds):
        paid, helps, possible = (np.asarray(y) for y in look(jnp.asarray(x, jnp.float32), jnp.asarray(before), person))
        score = np.where(possible & (helps == wanted), paid, -np.inf)
        order = np.argsort(-score)[: number // 20]
        order = order[np.isfinite(score[order])]
        most = max(most, float(score[order[0]]) if len(order) else -np.inf)
        if not len(order):
            x, before = draw(number), rng.random(number) < 0.5
            continue
        step += 1
        parents = rng.choice(order, number)
        moved = scale * 0.9**step * rng.normal(size=x.shape) * (rng.random(x.shape) < 0.5)
        x, before = x[parents] + moved * (np.arange(number) >= 50)[:, None], before[parents]
    return most


@pytest.mark.parametrize("who", ["nobody's", "default"])
@pytest.mark.parametrize("name", ["scratch", "feeding", "tooth_brushing", "arm_assist"])
def test_help_is_paid_best(name, who):
    instant, person = Instant(name), None if who == "nobody's" else preference.preference()
    helps, other = (best(instant, person, wanted) for wanted in (True, False))
    assert helps > MARGIN * other > 0, (helps, other)


@pytest.mark.parametrize(
    ("speed", "force", "weights"),
    [((0.03, 0.05), (1.0, 1.5), (0.5, 0.1, -0.1)), ((0.08, 0.2), (2.0, 5.0), (0.1, 0.6, -0.01))],
    ids=["slow", "firm"],
)
def test_help_is_paid_best_at_the_ends_of_the_sweep(speed, force, weights):
    """Who wants it slow and soft and cares how fast it is, and the other way round; where what pays is closest."""
    instant, person = Instant("tooth_brushing"), preference.preference(speed, force, weights)
    helps, other = (best(instant, person, wanted, fast=0.04) for wanted in (True, False))
    assert helps > MARGIN * other > 0, (helps, other)


def best_hovering(task, rows, state, number=3000, rounds=20):
    """The most that a pad is paid per step that hovers wherever it likes beside the arm in one of these postures."""

    @jax.jit
    @jax.vmap
    def paid(x, row):
        s = jax.tree.map(lambda values: values[row], rows)
        quat = x[3:7] / jnp.linalg.norm(x[3:7])
        s |= {"tool_pos": s["forearm_pos"] + x[:3], "tool_quat": quat}
        return sum(task.reward_terms(s, state).values())

    rng, most = np.random.default_rng(0), -np.inf
    x = np.concatenate([rng.uniform(-0.3, 0.3, (number, 3)), rng.normal(size=(number, 4))], 1)
    row = rng.integers(0, len(rows["tool_pos"]), number)
    for step in range(rounds):
        score = np.asarray(paid(jnp.asarray(x, jnp.float32), jnp.asarray(row)))
        parents = rng.choice(np.argsort(-score)[: number // 20], number)
        most = max(most, float(score.max()))
        x, row = x[parents] + 0.85**step * rng.normal(size=x.shape) * ([0.05] * 3 + [0.3] * 4), row[parents]
    return most


@pytest.mark.parametrize("seed", range(3))
def test_washing_more_is_paid_more_than_stopping_and_hovering_where_it_pays_best(seed):
    """An episode that washes these shares of the dirt at once and then hovers to its end, wherever that pays best."""
    env = assistax.make("bed_bath", engine="mujoco")
    rows, driven = [], scenes.qpos_ids(env.model, env.spec.scene.human_driven)
    for posture in [None, *json.loads(OFFERS.read_text())["bed_bath"][0]["postures"]]:
        data = mujoco.MjData(env.model)
        mujoco.mj_resetDataKeyframe(env.model, data, 0)
        if posture:
            data.qpos[driven] = posture
        mujoco.mj_forward(env.model, data)
        rows.append(
            {k: jnp.asarray(data.sensordata[at], jnp.float32) for k, at in scenes.sensor_slices(env.model).items()}
        )
    rows = jax.tree.map(lambda *xs: jnp.stack(xs), *rows)
    state = env.task.reset(jax.random.key(seed))
    dirty = np.flatnonzero(state.dirty)
    washing, earned = env.task.config.wipe_scale * 52.0, []
    for share in (0.0, 0.25, 0.5, 0.74, 1.0):
        washed = dirty[: int(share * len(dirty))]
        now = dataclasses.replace(state, visited=state.visited.at[washed].set(True))
        hovers = best_hovering(env.task, rows, now) * env.config.episode_length
        earned.append(hovers + washing * len(washed) / len(dirty))
    assert earned[-1] == pytest.approx(env.spec.bound, rel=0.01)
    assert (np.array(earned[1:]) > MARGIN * np.array(earned[:-1])).all(), earned


@pytest.mark.parametrize(("speed", "force", "steps"), [(0.1, 2.5, 25), (0.0, 2.5, 0), (0.0499, 2.5, 0), (0.1, 0.1, 0)])
def test_preferences_of_a_bathed_person_are_met_only_while_dirt_goes(speed, force, steps):
    """A pad that stays on the last dirty points, once they are washed or without washing them, pleases nobody."""
    env = assistax.make("bed_bath", engine="mujoco", human={"preference": "default"})
    _, begun = env.reset(jax.random.key(0))
    state, s = begun.task, dict(env.sensors(begun.physics))
    last = int(np.flatnonzero(state.dirty)[-1])
    alone = jnp.arange(len(state.dirty)) == last
    moves = jnp.array([speed, 0.0, 0.0])
    state = dataclasses.replace(state, dirty=alone, visited=~alone, strokes=jnp.tile(moves, (3, 1)))  # as before
    s["tool_pos"] = s["tool_pos"] + env.task.to_points(s)[last]
    part = ("upper_arm", "forearm")[env.task.segment[last]]
    s |= {f"tool_force_{part}": jnp.array([0.0, 0.0, force]), f"tool_vel_{part}": moves, "tool_vel": moves}
    paid = []
    for _ in range(30):
        state = env.task.advance(s, state)
        terms = preference.reward_terms(
            preference.preference(), speed, force, force, jnp.zeros(7), 1.0, env.task.helping(s, state)
        )
        paid.append(sum(terms.values()))
    assert (np.array(paid) > 0.0).sum() == steps
    assert state.visited[last] == (steps > 0)
