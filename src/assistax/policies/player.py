"""Who acts: a policy, and a player, which is a policy with the parameters of one member or of many.

A policy acts on one observation [n]; batch it with `jax.vmap`. Its parameters are a pytree given
with every call, so that a population is the same policy with a leading axis on the parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from assistax.errors import UsageError


class Policy(Protocol):
    """Hashable, as compiled programs are kept by it; a frozen dataclass is."""

    def initial_carry(self) -> Any:
        """Memory at the beginning of an episode; () for none."""
        ...

    def act(self, params: Any, carry: Any, obs: Any, reset: jax.Array, key: jax.Array, /):
        """(action, carry) for obs [n]; `reset` is true on the first step of an episode.

        A policy with the attribute `privileged = True` is given the EnvState instead of obs.
        """
        ...


@partial(jax.tree_util.register_dataclass, data_fields=("params",), meta_fields=("policy", "members", "by_person"))
@dataclass(frozen=True)
class Player:
    """Who plays one agent: in every episode one of its members.

    A pytree of its parameters, so that a jitted function that takes players is compiled once for all with the
    same policy and number of members. Every leaf of `params` is [members, ...]; () for a scripted policy.

    With `by_person` members are the rows of env.human.people, and body, preferences and policy are one draw: the
    environment draws the person (`state.person.index`), whose member then plays.
    """

    policy: Policy
    params: Any = ()
    members: int = 1
    by_person: bool = False

    def __post_init__(self):
        if self.members < 1:
            raise UsageError(f"A player needs one member or more, not {self.members}.")

    @classmethod
    def of(cls, policy: Policy, *members: Any) -> "Player":
        """With these members' parameters."""
        return cls(policy, stack(members), len(members))

    @property
    def privileged(self) -> bool:
        """Whether the policy is given the EnvState instead of an observation."""
        return getattr(self.policy, "privileged", False)

    def check(self) -> None:
        """Raise UsageError unless all parameters are stacked by member."""
        for leaf in jax.tree.leaves(self.params):
            if jnp.shape(leaf)[:1] != (self.members,):
                raise UsageError(
                    f"A player's parameters must be stacked, [members, ...] with {self.members} members, "
                    f"but one of them is {jnp.shape(leaf)}."
                )

    def draw(self, key: jax.Array, shape: tuple[int, ...] = ()) -> jax.Array:
        """Indices of members, uniform, int32 of this shape."""
        return jax.random.randint(key, shape, 0, self.members)

    def member(self, index: jax.Array | int) -> Any:
        """The parameters of one member."""
        return jax.tree.map(lambda x: x[index], self.params)


Team = dict[str, Player]
"""A player by agent."""


def stack(trees: Sequence[Any]) -> Any:
    """Pytrees of the same structure as one, with a leading axis."""
    return jax.tree.map(lambda *xs: jnp.stack(xs), *trees)
