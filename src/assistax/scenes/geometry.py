"""Rotations, and the capsules that a person's limbs are made of."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np


def rotate(quat: jax.Array, vector: jax.Array) -> jax.Array:
    """Rotate vector [..., 3] by the unit quaternion quat [..., 4] (w, x, y, z)."""
    w, u = quat[..., :1], quat[..., 1:]
    uv = jnp.cross(u, vector)
    return vector + 2.0 * (w * uv + jnp.cross(u, uv))


def matrix(quat: jax.Array) -> jax.Array:
    """Rotation matrix [..., 3, 3] of the unit quaternion quat [..., 4]; its columns are the frame's axes."""
    return jnp.stack([rotate(quat, jnp.broadcast_to(axis, (*quat.shape[:-1], 3))) for axis in jnp.eye(3)], -1)


def unit(vector: jax.Array) -> jax.Array:
    """vector [..., 3] with length 1; the zero vector stays zero."""
    return vector / jnp.maximum(jnp.linalg.norm(vector, axis=-1, keepdims=True), 1e-6)


def arc(to_skin: jax.Array, normal: jax.Array, axis: jax.Array, radius: jax.Array) -> jax.Array:
    """Length [...] in m of the way around a limb, from the side that a tool is on to a point of the skin.

    Args:
      to_skin: [..., 3] m, from the tool to the point. normal, axis: [..., 3] unit, out of the skin there, and along
        the limb. radius: [...] m, of the limb.
    """
    off = radius[..., None] * normal - to_skin  # from the limb's axis, level with the point, to the tool
    side = off - axis * jnp.sum(off * axis, -1, keepdims=True)
    return radius * jnp.arctan2(norm(jnp.cross(side, normal)), jnp.sum(side * normal, -1))


def norm(x: jax.Array) -> jax.Array:
    """Euclidean norm of the last axis, with a gradient of zero (not NaN) at zero."""
    square = jnp.sum(jnp.square(x), -1)
    safe = jnp.where(square > 0, square, 1.0)
    return jnp.where(square > 0, jnp.sqrt(safe), 0.0)


class Chain:
    """The hinges from the world to a site: where the site is, and how it moves with them."""

    def __init__(self, model: mujoco.MjModel, site: str, joints: tuple[str, ...]):
        """`joints` are the columns of the Jacobian, in their order."""
        self._site = model.site(site).pos.copy(), model.site(site).quat.copy()
        self._bodies = []
        body = int(model.site(site).bodyid[0])
        while body:
            first, count = model.body_jntadr[body], model.body_jntnum[body]
            hinges = [
                (int(model.jnt_qposadr[j]), model.jnt_axis[j].copy(), model.jnt_pos[j].copy())
                for j in range(first, first + count)
            ]
            self._bodies.insert(0, (model.body_pos[body].copy(), model.body_quat[body].copy(), hinges))
            body = int(model.body_parentid[body])
        self._columns = [int(model.joint(joint).qposadr[0]) for joint in joints]

    def __call__(self, qpos: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Position [3] and rotation [3, 3] of the site, and its Jacobian [6, joints]: velocity above spin."""
        pos, rot, hinges = jnp.zeros(3), jnp.eye(3), {}
        for offset, quat, joints in self._bodies:
            pos, rot = pos + rot @ offset, rot @ matrix(quat)
            for address, axis, anchor in joints:
                pivot = pos + rot @ anchor
                hinges[address] = rot @ axis, pivot
                half = qpos[address] / 2
                rot = rot @ matrix(jnp.concatenate([jnp.cos(half)[None], jnp.sin(half) * axis]))
                pos = pivot - rot @ anchor
        pos, rot = pos + rot @ self._site[0], rot @ matrix(self._site[1])
        spin, pivot = (jnp.stack([hinges[column][i] for column in self._columns]) for i in (0, 1))
        return pos, rot, jnp.concatenate([jnp.cross(spin, pos - pivot), spin], -1).T


class Capsule(NamedTuple):
    """A capsule in the frame of its body; lengths in m."""

    centre: np.ndarray  # [3]
    axis: np.ndarray  # [3] unit
    half_length: float
    radius: float


def capsule(model: mujoco.MjModel, body: str) -> Capsule:
    """The longest capsule of `body`: the skin of an arm segment."""
    bid = model.body(body).id
    ids = [
        g
        for g in range(model.ngeom)
        if model.geom_bodyid[g] == bid and model.geom_type[g] == mujoco.mjtGeom.mjGEOM_CAPSULE
    ]
    geom = max(ids, key=lambda g: model.geom_size[g, 1])
    axis = np.zeros(9)
    mujoco.mju_quat2Mat(axis, model.geom_quat[geom])
    return Capsule(
        model.geom_pos[geom].copy(),
        axis.reshape(3, 3)[:, 2],
        model.geom_size[geom, 1],
        model.geom_size[geom, 0],
    )


def outward(model: mujoco.MjModel, body: str, limb: Capsule) -> np.ndarray:
    """Unit vector [3] in the body's frame, square to the limb, that points outward and up at rest."""
    data = _at_rest(model)
    away = data.body(body).xpos + data.body(body).xmat.reshape(3, 3) @ limb.centre - data.body("torso").xpos
    away[2] = np.linalg.norm(away[:2])  # half outward, half upward
    return _square_to(limb, data.body(body).xmat.reshape(3, 3).T @ away)


def upward(model: mujoco.MjModel, body: str, limb: Capsule) -> np.ndarray:
    """Unit vector [3] in the body's frame, square to the limb, that points up as far as it can at rest."""
    return _square_to(limb, _at_rest(model).body(body).xmat.reshape(3, 3)[2])


def _at_rest(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_kinematics(model, data)
    return data


def _square_to(limb: Capsule, vector: np.ndarray) -> np.ndarray:
    vector = vector - limb.axis * (limb.axis @ vector)
    return vector / np.linalg.norm(vector)
