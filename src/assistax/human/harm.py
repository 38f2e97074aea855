"""What the robot's force does to the person's body, by region.

Limits from DGUV 2011, tabulated in Bendel (ed.), *Pflegeroboter* (open access, table 1.4): for healthy adults and
unintended contact, so the most that may be tolerated in care and not what to aim for. The thigh, which they leave out,
has that of ISO/TS 15066:2016, table A.2. Comfort from Assistive Gym, which penalises 10 N; for the face half of that.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from assistax.filters import low_pass
from assistax.pytree import pytree
from assistax.scenes import geometry


class Limits(NamedTuple):
    """Of one region, in N."""

    comfort: float
    clamping: float  # for longer than CLAMPING_SECONDS
    impact: float  # at any time, low-pass filtered
    geoms: tuple[str, ...]  # of the person, where a scene measures them; for the head's parts see `forces`


REGIONS = {
    "face": Limits(5.0, 65.0, 90.0, ()),
    "skull": Limits(10.0, 130.0, 175.0, ()),
    "neck": Limits(10.0, 35.0, 35.0, ("throat",)),  # and under the chin; the throat's
    "trunk": Limits(10.0, 140.0, 210.0, ("chest", "belly", "pelvis")),  # the chest's
    "thigh": Limits(10.0, 220.0, 440.0, ("right_thigh", "left_thigh")),
    "upper_arm": Limits(10.0, 150.0, 190.0, ("right_upper_arm", "left_upper_arm")),
    "forearm": Limits(10.0, 160.0, 220.0, ("right_forearm", "left_forearm")),
    "hand": Limits(10.0, 135.0, 180.0, ("right_hand", "left_hand")),
}
CLAMPING_SECONDS = 0.5
FILTER_SECONDS = 0.008  # of the low-pass filter: one step of a stiff contact is not what a test device would read
FACE, UNDER = 0.5, -0.8  # cosines: the face is within 60° of straight ahead, the neck within 37° of straight down

_COMFORT, _CLAMPING, _IMPACT = (np.array([limits[i] for limits in REGIONS.values()]) for i in range(3))


@pytree
class HarmState:
    """Of the episode so far; regions in the order of REGIONS."""

    filtered: jax.Array  # [regions] N
    peak: jax.Array  # [regions] N, of the filtered force
    pressing: jax.Array  # [regions] s, since the force was last within the limit for clamping
    clamped: jax.Array  # bool
    seconds: jax.Array  # s above comfort anywhere
    impulse: jax.Array  # N s above comfort, of all regions


def begin() -> HarmState:
    """At the beginning of an episode: none."""
    zero = jnp.zeros(len(REGIONS))
    return HarmState(zero, zero, zero, jnp.bool_(False), jnp.float32(0.0), jnp.float32(0.0))


def forces(s: dict[str, jax.Array]) -> jax.Array:
    """The robot's force [regions] in N from the scene's sensors by name; of a pair of limbs the larger one.

    The head is a sphere. Where on it a force acts is told from its direction, which is straight in up to friction,
    17° at most.
    """
    head = s["robot_force_head"]
    outward = -geometry.unit(geometry.matrix(s["mouth_quat"]).T @ head)
    face, under = outward[0] > FACE, outward[2] < UNDER
    where = {"face": face & ~under, "neck": under, "skull": ~face & ~under}
    on = {name: here * jnp.linalg.norm(head) for name, here in where.items()}
    for name, limits in REGIONS.items():
        parts = [jnp.linalg.norm(s[f"robot_force_{geom}"]) for geom in limits.geoms if f"robot_force_{geom}" in s]
        if parts:
            on[name] = jnp.stack([on.get(name, jnp.float32(0.0)), *parts]).max()
    return jnp.stack([on[name] for name in REGIONS])


def cost(force: jax.Array) -> jax.Array:
    """Of forces [regions] in one control step: 0 up to comfort, 1 at a region's limit for clamping, added up."""
    return (jnp.maximum(force - _COMFORT, 0.0) / (_CLAMPING - _COMFORT)).sum()


def advance(force: jax.Array, state: HarmState, dt: float) -> HarmState:
    """Book forces [regions] of one control step of `dt` seconds."""
    filtered = low_pass(state.filtered, force, dt, FILTER_SECONDS)
    pressing = jnp.where(filtered > _CLAMPING, state.pressing + dt, 0.0)
    over = jnp.maximum(force - _COMFORT, 0.0)
    return HarmState(
        filtered,
        jnp.maximum(state.peak, filtered),
        pressing,
        state.clamped | (pressing > CLAMPING_SECONDS).any(),
        state.seconds + dt * (over > 0.0).any(),
        state.impulse + dt * over.sum(),
    )


def outcomes(state: HarmState) -> dict[str, jax.Array]:
    """By name: 0 or 1 for `clamping` and `impact`, s and N s above comfort, the filtered peak on every region in N."""
    return {
        "clamping": state.clamped.astype(jnp.float32),
        "impact": (state.peak > _IMPACT).any().astype(jnp.float32),
        "seconds_above_comfort": state.seconds,
        "impulse_above_comfort": state.impulse,
    } | {f"peak_force_{name}": state.peak[i] for i, name in enumerate(REGIONS)}


OUTCOMES = ("clamping", "impact", "seconds_above_comfort", "impulse_above_comfort")
OUTCOMES += tuple(f"peak_force_{name}" for name in REGIONS)


def safe(state: HarmState) -> jax.Array:
    """Whether nobody was clamped or hit beyond the limits."""
    return ~state.clamped & (state.peak <= _IMPACT).all()
