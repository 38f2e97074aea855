"""The components that the paper's rewards are made of (its Table "Reward component overview")."""

import jax
import jax.numpy as jnp
import numpy as np

from assistax.scenes.geometry import norm, unit

SIGMA = 0.1  # σ of the reach terms, m² in r_t, m in r_t'
DECAY = 3.0  # 1/m, of r_te and of the alignment's envelope
PROXIMITY = 150.0  # 1/m², of the feeding terms: p is 0.22 at 10 cm, 0.69 at 5 cm
APPROACH_WIDTH = 0.01  # m²/s², of r_v
UP = np.array([0.0, 0.0, 1.0])
LEVEL = np.array([1.0, 1.0, 0.0])  # takes the height out of a vector


def boltzmann(x: jax.Array) -> jax.Array:
    """B(x) = x·exp(−x), largest (1/e) at x = 1: the shape of r_s, r_f and r_b."""
    return x * jnp.exp(-x)


def reach(distance: jax.Array) -> jax.Array:
    """r_t = exp(−d²/σ), distance d in m."""
    return jnp.exp(-jnp.square(distance) / SIGMA)


def exposed(normal: jax.Array, place: jax.Array, robot: jax.Array) -> jax.Array:
    """How far skin at `place` [..., 3] m faces a robot that stands at `robot` [3] m: [...] from 0 to 1, 1 when its
    outward normal [..., 3] points to the robot and 45° up, which is from where an arm comes. A mean of normals does,
    too."""
    level = (robot - place) * LEVEL
    along = jnp.sum(normal * level, -1) / jnp.maximum(norm(level), 1e-6)
    return 0.5 + 0.5**1.5 * (along + normal[..., 2])


def facing(one: jax.Array, other: jax.Array) -> jax.Array:
    """From 0, opposite, to 1, alike, of unit vectors [..., 3] and [3]."""
    return 0.5 * (1.0 + one @ other)


def envelope(distance: jax.Array) -> jax.Array:
    """exp(−3d), distance d in m: half of r_te, and what r_a is multiplied with."""
    return jnp.exp(-DECAY * distance)


def waist(distance: jax.Array, width: float = SIGMA) -> jax.Array:
    """r_t' = 1 − tanh(d_H/σ), distance d_H and width σ in m.

    Version 1 is wider: with the paper's σ of 0.1 m an arm at rest, 0.30 m away, is paid 0.5 % of the most, and 2 cm
    nearer 0.8 %.
    """
    return 1.0 - jnp.tanh(distance / width)


def rotation(relative: jax.Array) -> jax.Array:
    """2√2 − ‖R_1 − R_2‖_F for relative [3, 3] = R_1ᵀR_2: 2√2 when aligned, 0 when half a turn apart.

    The paper's r_R is the norm itself, which would reward misalignment; its bound is the same.
    """
    return 2.0 * 2.0**0.5 - norm((relative - jnp.eye(3)).ravel())


def proximity(distance: jax.Array) -> jax.Array:
    """p = exp(−150 d²), distance d in m: 1 at the mouth, 0 far away."""
    return jnp.exp(-PROXIMITY * jnp.square(distance))


def orientation(
    to_mouth: jax.Array, up: jax.Array, tip: jax.Array, inward: jax.Array | None = None, most_tilt: float | None = None
) -> jax.Array:
    """r_o = r_pour + (0.3 + 0.7p)·r_aim of a spoon with the unit directions up and tip [3].

    Level while far from the mouth, tilted toward it when near: r_pour = t·up for the direction
    t = normalise((1−p)·ẑ + p·û), and r_aim = tip·û. to_mouth [3] in m.

    From version 1 on: with `inward` [3], the unit direction into the mouth, r_aim = tip·inward, and t is at most
    `most_tilt` rad from ẑ; with the paper's, a spoon poured out under the chin is paid more than one in the mouth.
    """
    towards, p = unit(to_mouth), proximity(norm(to_mouth))
    target = unit((1.0 - p) * UP + p * towards)
    if most_tilt is not None:
        level = target * LEVEL
        tilt = jnp.minimum(jnp.arctan2(norm(level), target[2]), most_tilt)
        target = jnp.cos(tilt) * UP + jnp.sin(tilt) * unit(level)
    aim = towards if inward is None else inward
    return target @ up + (0.3 + 0.7 * p) * (tip @ aim)


def approach(speed: jax.Array, distance: jax.Array, top_speed: float) -> jax.Array:
    """r_v = exp(−(v − v*_app)²/0.01) with v*_app = top_speed·(1 − p): fast when far, still at the mouth."""
    wanted = top_speed * (1.0 - proximity(distance))
    return jnp.exp(-jnp.square(speed - wanted) / APPROACH_WIDTH)


def alignment(to_mouth: jax.Array, bristle: jax.Array, handle: jax.Array, inward: jax.Array | None = None) -> jax.Array:
    """r_align = ½·[bristle·û + (1 − |handle·ẑ|)]: bristles toward the mouth, handle level.

    From version 1 on: with `inward` [3], the unit direction into the mouth, bristle·inward; with the paper's, bristles
    that lie on a cheek and look past it are aligned.
    """
    towards = unit(to_mouth) if inward is None else inward
    return 0.5 * (bristle @ towards + 1.0 - jnp.abs(handle @ UP))
