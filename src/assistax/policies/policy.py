"""What a policy is: learned or scripted, behind one call.

A policy acts on one observation [n]; batch it with `jax.vmap`. Its parameters are a pytree given
with every call, so that a population is the same policy with a leading axis on the parameters.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import jax
import jax.numpy as jnp


class Policy(Protocol):
    def initial_carry(self) -> Any:
        """Memory at the beginning of an episode; () for none."""
        ...

    def act(self, params: Any, carry: Any, obs: Any, reset: jax.Array, key: jax.Array, /):
        """(action, carry) for obs [n]; `reset` is true on the first step of an episode.

        A policy with the attribute `privileged = True` is given the EnvState instead of obs.
        """
        ...


@dataclass(frozen=True)
class Drawn:
    """A member of a population, drawn afresh at the first step of every episode; params: [members, ...]."""

    policy: Policy
    members: int

    @property
    def privileged(self):
        return getattr(self.policy, "privileged", False)

    def initial_carry(self):
        return jnp.int32(0), self.policy.initial_carry()

    def act(self, params, carry, obs, reset, key):
        index, carry = carry
        draw_key, key = jax.random.split(key)
        index = jnp.where(reset, jax.random.randint(draw_key, (), 0, self.members), index)
        action, carry = self.policy.act(jax.tree.map(lambda x: x[index], params), carry, obs, reset, key)
        return action, (index, carry)


Team = dict[str, tuple[Policy, Any]]
"""By agent, a policy and its parameters."""
