"""The low-pass filter of forces, velocities and accelerations."""

from math import exp

import jax


def low_pass(past: jax.Array, now: jax.Array, dt: float, seconds: float) -> jax.Array:
    """The filtered signal one control step of `dt` s after it was `past`; its time constant is `seconds` long."""
    return past + (1.0 - exp(-dt / seconds)) * (now - past)
