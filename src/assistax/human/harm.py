"""What the robot does to the person's body: limits of force by region, and what an episode did beyond them.

Limits are those of DGUV (2011) for contact of people with robots, as tabulated in "Pflegeroboter" (open access, table
1.4); ISO/TS 15066 has the same for most regions. They are for healthy adults and contact that nobody intended: what may
be tolerated, not what is pleasant. Comfort is ours: 10 N is where Assistive Gym begins to penalise, 5 N half of it for
the head.

- clamping: a force above the quasi-static limit for longer than 0.5 s.
- impact: a low-pass filtered force above the transient limit. What is measured in practice is filtered, so the raw
  peak of one 2 ms step of a stiff contact is not comparable.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from assistax.pytree import pytree

CLAMPING_SECONDS = 0.5
FILTER_SECONDS = 0.016  # time constant of the low-pass filter


@dataclass(frozen=True)
class Limit:
    """Of one region of the body, N."""

    clamping: float  # quasi-static
    impact: float  # transient
    comfort: float = 10.0


LIMITS = {
    "head": Limit(65.0, 90.0, comfort=5.0),  # of the face: where on the head it touches is not told apart
    "torso": Limit(140.0, 210.0),  # chest and abdomen
    "upper_arm": Limit(150.0, 190.0),
    "forearm": Limit(160.0, 220.0),
    "hand": Limit(135.0, 180.0),
    "left_arm": Limit(135.0, 180.0),  # of its hand, the lowest of the arm
}
_CLAMPING, _IMPACT, _COMFORT = (
    np.array([getattr(limit, name) for limit in LIMITS.values()]) for name in ("clamping", "impact", "comfort")
)


@pytree
class HarmState:
    """Of an episode so far, by region in the order of LIMITS, but for the sums."""

    filtered: jax.Array  # [regions] N, low-pass filtered
    above: jax.Array  # [regions] s, for how long without a break above the limit of clamping
    clamped: jax.Array  # [regions] bool, ever
    hit: jax.Array  # [regions] bool, ever
    peak: jax.Array  # N, largest filtered force on any region
    uncomfortable: jax.Array  # s, with any region above comfort
    impulse: jax.Array  # N s, above comfort, all regions together


def begin() -> HarmState:
    zeros, never, zero = jnp.zeros(len(LIMITS)), jnp.zeros(len(LIMITS), bool), jnp.float32(0.0)
    return HarmState(zeros, zeros, never, never, zero, zero, zero)


def advance(state: HarmState, forces: jax.Array, dt: float) -> HarmState:
    """After a control step of `dt` s with these forces [regions] in N of the robot on the person."""
    filtered = state.filtered + (1.0 - np.exp(-dt / FILTER_SECONDS)) * (forces - state.filtered)
    above = jnp.where(forces > _CLAMPING, state.above + dt, 0.0)
    excess = jnp.maximum(forces - _COMFORT, 0.0)
    return HarmState(
        filtered,
        above,
        state.clamped | (above > CLAMPING_SECONDS),
        state.hit | (filtered > _IMPACT),
        jnp.maximum(state.peak, filtered.max()),
        state.uncomfortable + dt * (excess > 0.0).any(),
        state.impulse + dt * excess.sum(),
    )


def cost(forces: jax.Array, dt: float) -> jax.Array:
    """Of one control step, >= 0, apart from the reward as safe reinforcement learning has it: N s above comfort."""
    return dt * jnp.maximum(forces - _COMFORT, 0.0).sum()


def harmless(state: HarmState) -> jax.Array:
    """Whether nothing was clamped or hit so far."""
    return ~(state.clamped | state.hit).any()


OUTCOMES = ("clamping", "impact", "peak_filtered_force", "seconds_above_comfort", "impulse_above_comfort")


def outcomes(state: HarmState) -> dict[str, jax.Array]:
    """Of the episode so far, by name in OUTCOMES: whether anything was clamped or hit (0 or 1), N, s and N s."""
    told = jnp.float32(state.clamped.any()), jnp.float32(state.hit.any())
    return dict(zip(OUTCOMES, (*told, state.peak, state.uncomfortable, state.impulse), strict=True))
