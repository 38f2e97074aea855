"""Spaces of observations and actions, as Gymnasium has them, for JAX."""

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np


@dataclass(frozen=True)
class Box:
    """A box in R^n with bounds by entry, infinite unless given."""

    shape: tuple[int, ...]
    low: Any = -np.inf  # a number or [*shape]
    high: Any = np.inf
    dtype: Any = field(default=jnp.float32, repr=False)

    def __post_init__(self):
        for name in ("low", "high"):
            bound = np.broadcast_to(np.asarray(getattr(self, name), self.dtype), self.shape)
            object.__setattr__(self, name, bound)

    def contains(self, x: Any) -> bool:
        """Whether x has this shape, can have this dtype and lies within the bounds; NaN does not."""
        x = np.asarray(x)
        fits = x.shape == self.shape and np.can_cast(x.dtype, self.dtype, "same_kind")
        return bool(fits and np.all((x >= self.low) & (x <= self.high)))

    def sample(self, key: jax.Array) -> jax.Array:
        """[*shape], always finite: uniform where both bounds are, exponential from the only one, else normal."""
        uniform_key, exponential_key, normal_key = jax.random.split(key, 3)
        below, above = np.isfinite(self.low), np.isfinite(self.high)
        low, high = np.where(below, self.low, 0.0), np.where(above, self.high, 1.0)
        uniform = low + (high - low) * jax.random.uniform(uniform_key, self.shape, self.dtype)
        tail = jax.random.exponential(exponential_key, self.shape, self.dtype)
        one_sided = jnp.where(below, low + tail, high - tail)
        unbounded = jax.random.normal(normal_key, self.shape, self.dtype)
        x = jnp.where(below & above, uniform, jnp.where(below | above, one_sided, unbounded))
        return jnp.clip(x, self.low, self.high).astype(self.dtype)

    def __eq__(self, other: Any) -> bool:
        same = isinstance(other, Box) and self.shape == other.shape and self.dtype == other.dtype
        return same and np.array_equal(self.low, other.low) and np.array_equal(self.high, other.high)

    def __hash__(self) -> int:
        return hash((self.shape, self.low.tobytes(), self.high.tobytes()))
