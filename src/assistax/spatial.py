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
    """Unit vector [3] in the body's frame, square to the limb, that points away from the torso and up at rest."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_kinematics(model, data)
    rot = data.body(body).xmat.reshape(3, 3)
    centre = data.body(body).xpos + rot @ limb.centre
    away = centre - data.body("torso").xpos
    away[2] = np.linalg.norm(away[:2])  # half outward, half upward
    away = rot.T @ away
    away -= limb.axis * (limb.axis @ away)
    return away / np.linalg.norm(away)
