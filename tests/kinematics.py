"""Inverse kinematics in NumPy on MuJoCo's C library, independent of the package's own code."""

import mujoco
import numpy as np

from assistax import scenes


def solve(model, point, seed=0, restarts=12, tolerance=2e-3, accept=lambda data: True, facing=None):
    """Robot joint angles within limits that put `tool_tip` at point [3], the person at rest; None if none found.

    Damped least squares from the ready pose, then from random poses. `accept(data)` may turn a pose down.
    With `facing` [3] the z axis of the hand, along which the tool points, is turned there too, to 0.1 rad.
    """
    data = mujoco.MjData(model)
    ids = scenes.qpos_ids(model, scenes.PANDA.joints)
    low, high = model.jnt_range[[model.joint(j).id for j in scenes.PANDA.joints]].T
    rng = np.random.default_rng(seed)
    site = model.site("tool_tip").id
    hand = model.site_bodyid[site]  # the last body with a joint: fixed ones may be fused into it
    jac, turn = np.zeros((2, 3, model.nv))
    for attempt in range(restarts):
        mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
        if attempt:
            spread = 0.4 + 0.1 * attempt
            data.qpos[ids] = np.clip(data.qpos[ids] + rng.uniform(-spread, spread, 7), low, high)
        for _ in range(150):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            error = point - data.site_xpos[site]
            tilt = np.zeros(3) if facing is None else np.cross(data.xmat[hand].reshape(3, 3)[:, 2], facing)
            if np.linalg.norm(error) < tolerance and np.linalg.norm(tilt) < 0.1:
                mujoco.mj_forward(model, data)
                if accept(data):
                    return data.qpos.copy()
                break
            mujoco.mj_jacSite(model, data, jac, turn, site)
            j = jac[:, ids]
            if facing is not None:
                j, error = np.concatenate([j, 0.2 * turn[:, ids]]), np.concatenate([error, 0.2 * tilt])
            step = j.T @ np.linalg.solve(j @ j.T + 1e-4 * np.eye(len(j)), error)
            data.qpos[ids] = np.clip(data.qpos[ids] + np.clip(step, -0.2, 0.2), low, high)
    return None


def touching_pose(model, body="right_forearm", depth=0.004):
    """A pose [nq] in which the tool presses on the middle of an arm segment."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_kinematics(model, data)
    geom = model.geom(body).id
    centre, radius = data.geom_xpos[geom], model.geom_size[geom, 0]
    away = centre - data.body("torso").xpos
    away[2] = np.linalg.norm(away[:2])
    axis = data.geom_xmat[geom].reshape(3, 3)[:, 2]
    away -= axis * (axis @ away)
    tool = model.geom_bodyid == model.body("tool").id
    reach = model.geom_size[np.flatnonzero(tool)[0], 0]
    point = centre + away / np.linalg.norm(away) * (radius + reach - depth)
    pose = solve(model, point, tolerance=1e-4)
    assert pose is not None
    return pose


def joints_after(model, data):
    """(qpos, qvel) at the end of the physics step that data describes the start of: semi-implicit Euler."""
    qvel = data.qvel + model.opt.timestep * data.qacc
    return data.qpos + model.opt.timestep * qvel, qvel
