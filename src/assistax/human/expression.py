"""What a person's face says of how they are touched, in place of the preferences that a robot is seldom told."""

import jax
import jax.numpy as jnp

from assistax.filters import low_pass
from assistax.human.preference import TOUCH, Preference

FELT_SECONDS = 0.1  # of the low-pass filter: how long it takes until a force shows
CLEARLY = (1.0, 0.03)  # N, m/s: from so much more or less than is liked on the face says it as clearly as it can


def feel(felt: jax.Array, force: jax.Array, dt: float) -> jax.Array:
    """The force in N that shows, `dt` s after it was `felt`, while the tool presses with `force` N."""
    return low_pass(felt, force, dt, FELT_SECONDS)


def expression(felt: jax.Array, speed: jax.Array, person: Preference) -> jax.Array:
    """[2] in [-1, 1], for force and for speed: below 0 less is liked, above 0 more; 0 as it is, and untouched.

    Args:
      felt: N, see `feel`.
      speed: m/s, of the tool over the skin.
    """
    now, ranges = jnp.stack([felt, speed]), jnp.stack([person.force, person.speed])
    missing = jnp.maximum(ranges[:, 0] - now, 0.0) - jnp.maximum(now - ranges[:, 1], 0.0)
    return jnp.where(felt > TOUCH, jnp.clip(missing / jnp.array(CLEARLY), -1.0, 1.0), 0.0)
