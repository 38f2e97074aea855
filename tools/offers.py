"""Postures in which a person offers the robot what it is to work on, by inverse kinematics over both bodies.

python tools/offers.py            # writes src/assistax/policies/offers.json, an hour
python tools/offers.py --others   # only the other ways, half of it

A posture counts if the person can hold it, if nothing is in the way there or on the way there from rest while the robot
waits at its start, and if the tool then touches the skin with nothing else in the way. It says, too, what share of the
arm's skin the robot can reach beside a person at rest, and beside one who moves.

What can be touched can still not be scratched or washed well. So the scripted robot plays beside people who hold the
most promising postures, with an itch in every place and dirt on every side, and each gets the posture that serves best.
Where none of these serves well, more are played, in bed bath all of them.
Other people turn the arm in other ways, which are dealt postures in turn, none near one of another way.
"""

import dataclasses
import json
import sys
from itertools import product

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from assistax import make, scenes
from assistax.policies.people import OFFERS, Offer
from assistax.policies.scripted import scripted_policy
from assistax.scenes import geometry
from assistax.tasks.rewards import exposed
from assistax.tasks.scratch import SEGMENTS

CELLS = (12, 16)  # along a segment, around it
GRID = 8  # angles per joint of the person
STEP = 24  # poses on the way from rest
CLEAR = 0.04  # m, between robot and person on the way
DEEP, PRESSED = 0.005, 0.008  # m that bodies may be inside each other, and the tool inside the skin
STRENGTH = 0.9  # of the person's torque, to hold a posture
AROUND_PAD = 0.045  # m, from the pad's centre, what it washes
LEAN = {"scratch": 1.0, "bed_bath": 0.0}  # how far the tool leans away from the robot, as the scripted robot holds it
TIP = {"scratch": 0.008, "bed_bath": 0.004}  # m, from tool point to skin when touching
MORE = {"scratch": 4, "bed_bath": 8}  # postures of the usual way, beside rest
OTHERS = 5  # ... and of any other
DEALT = 30  # postures, at most, of which those are chosen
SIDES = np.linspace(-np.pi, np.pi, 48, endpoint=False)  # rad, around the arm, on which it may be dirty
TOUCHED, BEST = 8, 3  # postures, by side: which are played by what is touched, and again by what was washed
PLAYED = 14  # postures, at most, in which the robot scratches
MISSED, SERVED = 4, {"scratch": 0.5, "bed_bath": 0.75}  # postures more for places that none of the usual serves so well
PLAY_STEPS = {"scratch": 800, "bed_bath": 1000}
ENOUGH = 4.0  # s of scratching; more is not better
WAYS = {"scratch": 4, "bed_bath": 3}  # of offering; in one more of bed bath the pair succeeds in 53 %
APART = 0.35  # rad, in some joint: postures of different ways
REST = {"scratch": 0.15, "bed_bath": 0.05}  # by so much worse it may be not to move


class Reach:
    """Where the tool can touch the right arm in a posture of the person."""

    def __init__(self, task: str):
        env = make(task, engine="mujoco")
        self.task, self.env, self.model, scene = task, env, env.model, env.spec.scene
        self.data = mujoco.MjData(self.model)
        self.rest = self.model.key("start").qpos.copy()
        self.person = scenes.qpos_ids(self.model, scene.human_driven)
        self.robot = scenes.qpos_ids(self.model, env.robot.joints)
        self.strength = STRENGTH * scenes.HUMAN_TORQUE * scene.human_strength
        self.base = np.array([*scene.robot_pos[:2], 0.0])
        tree = self.model.body_rootid[self.model.geom_bodyid]
        self.of_robot, self.of_person = (
            tree == self.model.body_rootid[self.model.jnt_bodyid[self.model.joint(joint).id]]
            for joint in (env.robot.joints[0], "right_elbow")
        )
        self.skin = [self.model.geom(f"right_{segment}").id for segment in SEGMENTS]
        self.segment, self.points, self.normals = self._cells()
        self._solve = self._inverse_kinematics()
        self._rng = np.random.default_rng(0)

    def _cells(self):
        """Middles of equal patches of skin in the segments' frames: the segment of each, its place and normal."""
        rows, columns = CELLS
        heights = (np.arange(rows) + 0.5) / rows * 2 - 1
        angles = ((np.arange(columns) + 0.5) / columns * 2 - 1) * np.pi
        cells = []
        for i, segment in enumerate(SEGMENTS):
            body = f"right_{segment}"
            limb = geometry.capsule(self.model, body)
            out = geometry.outward(self.model, body, limb)
            side = np.cross(limb.axis, out)
            for height, angle in product(heights, angles):
                normal = np.cos(angle) * out + np.sin(angle) * side
                cells.append((i, limb.centre + height * limb.half_length * limb.axis + limb.radius * normal, normal))
        return (np.array(xs) for xs in zip(*cells, strict=True))

    def _inverse_kinematics(self):
        """Damped least squares: robot poses that put the tool point at places [n, 3], its axis along others [n, 3]."""
        chain = geometry.Chain(self.model, "tool_tip", self.env.robot.joints)
        low, high = jnp.asarray(self.model.jnt_range[[self.model.joint(j).id for j in self.env.robot.joints]].T)
        ids, weight = self.robot, 0.2  # m per rad

        def solve(qpos, place, along):
            def improve(_, qpos):
                pos, rot, jacobian = chain(qpos)
                error = jnp.concatenate([place - pos, weight * jnp.cross(rot[:, 2], along)])
                jacobian = jnp.concatenate([jacobian[:3], weight * jacobian[3:]])
                step = jacobian.T @ jnp.linalg.solve(jacobian @ jacobian.T + 1e-4 * jnp.eye(6), error)
                return qpos.at[ids].set(jnp.clip(qpos[ids] + jnp.clip(step, -0.2, 0.2), low, high))

            qpos = jax.lax.fori_loop(0, 50, improve, qpos)
            pos, rot, _ = chain(qpos)
            near = (jnp.linalg.norm(place - pos) < 3e-3) & (jnp.linalg.norm(jnp.cross(rot[:, 2], along)) < 0.25)
            return qpos, near

        return jax.jit(jax.vmap(solve))

    def contacts(self, qpos, margin=0.0):
        self.model.geom_margin[self.of_robot] = margin
        self.data.qpos[:] = qpos
        mujoco.mj_fwdPosition(self.model, self.data)
        self.model.geom_margin[self.of_robot] = 0.0
        return [(set(map(int, c.geom)), c.dist) for c in self.data.contact]

    def possible(self, posture):
        """Whether the person can get there from rest, with the robot at its start, and hold it."""
        for share in np.linspace(0.0, 1.0, STEP):
            qpos = self.rest.copy()
            qpos[self.person] += share * (posture - self.rest[self.person])
            for geoms, distance in self.contacts(qpos, CLEAR):
                between = any(self.of_robot[g] for g in geoms) and any(self.of_person[g] for g in geoms)
                if distance < (CLEAR if between else -2 * DEEP):
                    return False
        self.data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, self.data)
        needed = np.abs(self.data.qfrc_bias - self.data.qfrc_passive)[self.person]
        return bool((needed <= self.strength).all())

    def touched(self, posture):
        """Which cells [n] the tool touches with the person in a posture, and how far each faces the robot, 0 to 1."""
        qpos = self.rest.copy()
        qpos[self.person] = posture
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        bodies = self.data.xmat[self.model.geom_bodyid[self.skin]].reshape(-1, 3, 3)[self.segment]
        origins = self.data.xpos[self.model.geom_bodyid[self.skin]][self.segment]
        places = origins + np.einsum("nij,nj->ni", bodies, self.points)
        normals = np.einsum("nij,nj->ni", bodies, self.normals)
        away = (places - self.base) * [1, 1, 0]
        along = LEAN[self.task] * away / np.linalg.norm(away, axis=1, keepdims=True) - normals
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        found = np.zeros(len(places), bool)
        for spread in (0.0, 0.5, 0.9):
            start = np.repeat(qpos[None], len(places), 0)
            start[:, self.robot] += self._rng.uniform(-spread, spread, (len(places), len(self.robot)))
            poses, near = self._solve(
                jnp.asarray(start), jnp.asarray(places + TIP[self.task] * normals), jnp.asarray(along)
            )
            for i in np.flatnonzero(~found & np.asarray(near)):
                found[i] = self._touches(np.asarray(poses[i], float), self.skin[self.segment[i]])
        return found, np.asarray(exposed(normals, places, self.base))

    def _touches(self, qpos, skin):
        touching = False
        for geoms, distance in self.contacts(qpos):
            if skin in geoms and any(self.of_robot[g] for g in geoms):
                touching |= distance < 0
                if distance < -PRESSED:
                    return False
            elif distance < -DEEP:
                return False
        return touching


def neighbourhood(touched):
    """Share of a cell's nine neighbours that are touched [postures, cells]: a place in the middle is a safe one."""
    grid = touched.reshape(len(touched), len(SEGMENTS), *CELLS).astype(float)
    rows = [np.clip(np.arange(CELLS[0]) + d, 0, CELLS[0] - 1) for d in (-1, 0, 1)]
    return np.mean([np.roll(grid[:, :, row], d, 3) for row in rows for d in (-1, 0, 1)], 0).reshape(len(touched), -1)


class Holds(Offer):
    """A person who moves into the posture in the carry and holds it."""

    def initial_carry(self):
        return super().initial_carry() | {"held": self.rest}

    def posture(self, carry, state, way):
        return carry["held"], carry


def played(env, postures, tasks, play_steps):
    """The task's states, stacked as `tasks` [n] are, after the scripted robot has worked beside a person who holds each
    of the postures: a list."""
    robot, person = scripted_policy("expert", env, "robot"), Holds(env)
    count = len(jax.tree.leaves(tasks)[0])

    @jax.jit
    def play(posture):
        _, start = jax.vmap(env.reset)(jax.random.split(jax.random.key(0), count))
        carries = {"robot": robot.initial_carry(), "human": {"aim": person.rest, "held": posture}}
        carries = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *jnp.shape(x))), carries)

        def step(state, carries):
            acts = {}
            for agent, policy in (("robot", robot), ("human", person)):
                acts[agent], carries[agent] = policy.act({}, carries[agent], state, False, None)
            return env.step_env(jax.random.key(0), state, acts)[1], carries

        def steps(_, now):
            return jax.vmap(step)(*now)

        end, _ = jax.lax.fori_loop(0, play_steps, steps, (dataclasses.replace(start, task=tasks), carries))
        return end.task

    return [play(jnp.asarray(posture, jnp.float32)) for posture in postures]


def scratched(reach: Reach, postures, cells=slice(None)) -> np.ndarray:
    """For how much of ENOUGH the robot scratches these cells beside a person in each posture [postures, cells]."""
    segment, points = jnp.asarray(reach.segment[cells]), jnp.asarray(reach.points[cells], jnp.float32)
    fresh = jax.vmap(reach.env.task.reset)(jax.random.split(jax.random.key(0), len(points)))
    start = dataclasses.replace(fresh, segment=segment, itch=points)
    ends = played(reach.env, postures, start, PLAY_STEPS["scratch"])
    return np.array([np.minimum(end.scratch_seconds / ENOUGH, 1.0) for end in ends])


def dirt(bath, sides) -> np.ndarray:
    """Which points are dirty if these sides [n] rad are [n, points]."""
    return np.cos(np.asarray(bath._angle) - sides[:, None]) >= np.cos(bath.config.dirty)


def washed(reach: Reach, postures, sides) -> np.ndarray:
    """How well the robot washes each side beside a person in each posture [postures, sides], from 0 to 1.

    That is the share of the dirt that it washes, and whether this is enough, one as good as the other.
    """
    dirty = jnp.asarray(dirt(reach.env.task, sides))
    fresh = jax.vmap(reach.env.task.reset)(jax.random.split(jax.random.key(0), len(sides)))
    start = dataclasses.replace(fresh, dirty=dirty, visited=~dirty)
    ends = played(reach.env, postures, start, PLAY_STEPS["bed_bath"])
    share = np.array([(end.visited & dirty).sum(1) / dirty.sum(1) for end in ends])
    return (share + (share >= reach.env.task.config.success_fraction)) / 2.0


def middles(bath) -> np.ndarray:
    """Where the middle of the dirt is, in rad, that looks to be on each side: three for each [3, sides].

    It looks to be on the side that is the mean of its points, which is up to 10° beside the middle.
    """
    turns = np.linspace(-np.pi, np.pi, 15 * len(SIDES), endpoint=False)
    ups, acrosses = np.asarray(dirt(bath, turns) @ bath._around).T
    off = np.angle(np.exp(1j * (np.arctan2(acrosses, ups) - SIDES[:, None])))  # [sides, turns]
    looks = np.abs(off).argmin(0)
    away = [np.angle(np.exp(1j * (turns[looks == i] - side))) for i, side in enumerate(SIDES)]
    return np.array([side + np.quantile(some, (0.1, 0.5, 0.9)) for side, some in zip(SIDES, away, strict=True)]).T


def washed_around(reach: Reach, postures, which=slice(None)) -> np.ndarray:
    """`washed` on average of the dirt that looks to be on these of SIDES [postures, sides]."""
    return np.mean([washed(reach, postures, row[which]) for row in middles(reach.env.task)], 0)


def with_missed(reach: Reach, usual, worth, possible, promising):
    """These postures and what each is worth [postures, places], and up to MISSED more, which serve places that none of
    them does; they are played on those places alone, and worth nothing elsewhere."""
    missed = worth.max(0) < SERVED[reach.task]
    if not missed.any():
        return usual, worth
    if reach.task == "scratch":
        promising = promising * missed * (np.arange(len(possible)) > 0)[:, None]  # rest is among the usual ones
        more = possible[choose(promising, 2 * PLAYED)[1:]]
        served = scratched(reach, more, missed)
    else:  # what is best to touch is no guide to where they are washed, so that all are played
        more = possible[most(washed(reach, possible, SIDES[missed]), BEST)]
        served = washed_around(reach, more, missed)
    theirs = np.zeros((len(more), len(missed)))
    theirs[:, missed] = served
    gained = np.maximum(theirs - worth.max(0), 0.0)
    picked = [i - 1 for i in choose(np.concatenate([np.zeros((1, len(missed))), gained]), MISSED) if i]
    print(
        f"  {missed.mean():.1%} served badly; {gained[picked].max(0).mean():.1%} more with {np.round(more[picked], 2)}"
    )
    return np.concatenate([usual, more[picked]]), np.concatenate([worth, theirs[picked]])


def most(worth, count):
    """Rest, which is the first, and the `count` postures that are worth most [postures, places], of each place."""
    return sorted({0, *np.argsort(-worth, axis=0)[:count].ravel()})


def choose(worth, count):
    """Rest, which is the first, and `count` postures that together are worth most, one after the other."""
    chosen = [0]
    for _ in range(count):
        chosen.append(int(np.maximum(worth, worth[chosen].max(0)).sum(1).argmax()))
    return chosen


def way(task: str, postures, worth) -> dict:
    """Which of these postures, of which the first is rest, serves each place, by what each is worth there."""
    best = (worth + REST[task] * (np.arange(len(postures)) == 0)[:, None]).argmax(0)
    kept, best = np.unique(np.append(best, 0), return_inverse=True)  # rest is always among them
    postures, best = postures[kept], best[:-1]
    if len(kept) > 10:
        sys.exit(f"{task} has {len(kept)} postures, and a digit for ten.")
    if task == "scratch":
        rows = best.reshape(len(SEGMENTS), *CELLS)
        told = {part: ["".join(map(str, row)) for row in of] for part, of in zip(SEGMENTS, rows, strict=True)}
    else:
        told = {"sides": "".join(map(str, best))}
    return {"postures": np.round(postures, 3).tolist(), **told}


def fresh(first, postures, promising):
    """Rest and DEALT more postures, none near one that the usual way has: those that together are most promising, and
    when one more of these adds nothing, those of the rest."""
    apart = np.abs(postures[:, None] - first[1:]).max(-1).min(1) > APART
    left, chosen = promising * apart[:, None], [0]
    while len(chosen) <= DEALT and (more := [i for i in dict.fromkeys(choose(left, DEALT + 1 - len(chosen))) if i]):
        chosen += more
        left[more] = 0.0
    return postures[chosen]


def deal(count, postures, worth):
    """Rest and OTHERS of these postures for each of `count` ways [count, 1 + OTHERS], in turn that which adds most to
    its own, none near one of another way."""
    ways = [[0] for _ in range(count)]
    for mine in ways * OTHERS:
        theirs = [i for way in ways if way is not mine for i in way[1:]]
        apart = (np.abs(postures[:, None] - postures[theirs]).max(-1) > APART).all(1)
        mine.append(int((np.maximum(worth, worth[mine].max(0)).sum(1) * apart).argmax()))
    return ways


def offers(task: str, usual: dict | None = None) -> list[dict]:
    """The ways of offering, the usual first, which may be known."""
    reach = Reach(task)
    limits = reach.model.jnt_range[[reach.model.joint(j).id for j in reach.env.spec.scene.human_driven]]
    grid = product(*(np.linspace(low + 0.1, high - 0.1, GRID) for low, high in limits))
    possible = np.array([reach.rest[reach.person]] + [p for p in map(np.array, grid) if reach.possible(p)])
    touched, facing = (np.array(xs) for xs in zip(*map(reach.touched, possible), strict=True))
    rest, some = touched[0].mean(), touched.any(0).mean()
    print(f"{task}: {len(possible)} postures; {rest:.0%} of the skin touched at rest, {some:.0%} in some")
    promising = neighbourhood(touched * facing**2)
    if task == "bed_bath":
        points = np.concatenate([np.asarray(xs) for xs in reach.env.task.points])
        apart = np.linalg.norm(points[:, None] - reach.points, axis=-1)
        near = (apart < AROUND_PAD) & (reach.env.task.segment[:, None] == reach.segment)
        dirty = dirt(reach.env.task, SIDES)
        reached = ((touched.astype(int) @ near.T >= 2)[:, None] & dirty).sum(2) / dirty.sum(1)
        promising = np.mean([np.roll(reached, d, 1) for d in (-2, -1, 0, 1, 2)], 0)

    def worth(postures):
        if task == "scratch":
            return neighbourhood(scratched(reach, postures))
        return washed_around(reach, postures)

    if usual is None:
        if task == "scratch":
            postures = possible[choose(promising, PLAYED)]
        else:
            postures = possible[most(promising, TOUCHED)]
            postures = postures[most(washed(reach, postures, SIDES), BEST)]
        worths = worth(postures)
        chosen = choose(worths, MORE[task])
        tell(postures, worths, chosen)
        best = postures[chosen], worths[chosen]
        usual = way(task, *with_missed(reach, *best, possible, promising))
    postures = fresh(np.array(usual["postures"]), possible, promising)
    worths = worth(postures)
    dealt = deal(WAYS[task] - 1, postures, worths)
    for chosen in dealt:
        tell(postures, worths, chosen)
    return [usual, *(way(task, postures[chosen], worths[chosen]) for chosen in dealt)]


def tell(postures, worth, chosen):
    """How well the places are served by the first of the chosen postures, by the first two, and so on."""
    for some in (chosen[:n] for n in range(1, len(chosen) + 1)):
        print(f"  {np.round(postures[some[-1]], 2)}: {worth[some].max(0).mean():.1%}", flush=True)


if __name__ == "__main__":
    if sys.argv[1:] not in ([], ["--others"]):
        sys.exit("python tools/offers.py takes --others or nothing.")
    stored = json.loads(OFFERS.read_text())
    known = {task: ways[0] for task, ways in stored.items()} if sys.argv[1:] == ["--others"] else {}
    for task in stored:
        stored[task] = offers(task, known.get(task))
        OFFERS.write_text(json.dumps(stored, indent=1) + "\n")
