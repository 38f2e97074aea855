"""Who acts: a policy, and a player, which is a policy with the parameters of one member or of many.

A policy acts on one observation [n]; batch it with `jax.vmap`. Its parameters are a pytree given
with every call, so that a population is the same policy with a leading axis on the parameters.
"""

import dataclasses
from collections.abc import Mapping, Sequence
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

    def check(self, env: Any = None) -> None:
        """Raise UsageError unless parameters are stacked by member and, `by_person`, `env` has a person for each."""
        people = len(env.config.human.listed) if self.by_person and env is not None else self.members
        if people != self.members:
            raise UsageError(
                f"A player whose {self.members} members are each somebody of env.human.people cannot play where these "
                f"are {people}: give the environment their people (Population.people), or use by_person=False."
            )
        self._check_params()

    def _check_params(self) -> None:
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

    def take(self, rows: Any, by_person: bool = False) -> "Player":
        """The members rows[i] in this order, somebody perhaps several times."""
        params = jax.tree.map(lambda x: x[rows], self.params)
        return dataclasses.replace(self, params=params, members=len(rows), by_person=by_person)

    def initial_carry(self) -> Any:
        """Memory at the beginning of an episode."""
        return self.policy.initial_carry()

    def act(self, chosen: Any, carry: Any, obs: jax.Array, state: Any, reset: jax.Array, key: jax.Array):
        """(action, carry) of the member whose `member(index)` is `chosen`, for obs [n] and the EnvState."""
        return self.policy.act(chosen, carry, state if self.privileged else obs, reset, key)

    def act_as(self, index: jax.Array, carry: Any, obs: jax.Array, state: Any, reset: jax.Array, key: jax.Array):
        """`act` of the member `index`; reads only its parameters."""
        return self.act(self.member(index), carry, obs, state, reset, key)


@dataclass(frozen=True)
class Kinds:
    """Policies of several kinds, as the policy of a Mixed player."""

    policies: tuple[Policy, ...]

    def initial_carry(self) -> Any:
        return tuple(policy.initial_carry() for policy in self.policies)


@partial(jax.tree_util.register_dataclass, data_fields=("params",), meta_fields=("policy", "members", "by_person"))
@dataclass(frozen=True)
class Mixed(Player):
    """A player whose members have policies of several kinds; make it with `Mixed.of_players`.

    `params` are (kind [members], row [members], by kind its members' parameters). A step costs one kind's on a CPU in
    training, and all kinds' elsewhere.
    """

    policy: Any  # Kinds

    @classmethod
    def of_players(cls, players: Sequence[Player], kind: Any, row: Any, by_person: bool = False) -> "Mixed":
        """Member i is the member row[i] of players[kind[i]]."""
        params = jnp.asarray(kind), jnp.asarray(row), tuple(player.params for player in players)
        return cls(Kinds(tuple(player.policy for player in players)), params, len(kind), by_person)

    def take(self, rows: Any, by_person: bool = False) -> "Mixed":
        kinds, places, params = self.params
        chosen = kinds[rows], places[rows], params
        return dataclasses.replace(self, params=chosen, members=len(rows), by_person=by_person)

    @property
    def players(self) -> list[Player]:
        """Its members by kind."""
        return [
            Player(policy, params, max([len(x) for x in jax.tree.leaves(params)], default=1))
            for policy, params in zip(self.policy.policies, self.params[2], strict=True)
        ]

    def _check_params(self) -> None:
        for player in self.players:
            player._check_params()

    def member(self, index: jax.Array | int) -> Any:
        """Its kind, and of every kind the parameters of somebody: of its own kind, its own."""
        kinds, rows, _ = self.params
        return kinds[index], [
            p.member(jnp.where(kinds[index] == i, rows[index], 0)) for i, p in enumerate(self.players)
        ]

    def act(self, chosen: Any, carry: Any, obs: jax.Array, state: Any, reset: jax.Array, key: jax.Array):
        kind, params = chosen
        seen = obs, state, reset, key
        return self._switch(kind, carry, lambda i, player, own: player.act(params[i], own, *seen))

    def act_as(self, index: jax.Array, carry: Any, obs: jax.Array, state: Any, reset: jax.Array, key: jax.Array):
        seen = obs, state, reset, key
        kinds, rows, _ = self.params
        return self._switch(kinds[index], carry, lambda _, player, own: player.act_as(rows[index], own, *seen))

    def _switch(self, kind: jax.Array, carry: Any, act):
        def of(i, player):
            def branch(carry):
                action, own = act(i, player, carry[i])
                return action, (*carry[:i], own, *carry[i + 1 :])

            return branch

        return jax.lax.switch(kind, [of(i, player) for i, player in enumerate(self.players)], carry)


Team = dict[str, Player]
"""A player by agent."""


def check_team(team: Any, env: Any) -> None:
    """Raise UsageError unless `team` is a player for each agent of `env`, and nobody else."""
    if not isinstance(team, Mapping) or set(team) != set(env.agents):
        given = ", ".join(map(str, team)) if isinstance(team, Mapping) else type(team).__name__
        raise UsageError(f"A team is a dict with a player for {' and '.join(env.agents)}, not {given or 'nobody'}.")
    for agent, player in team.items():
        if not isinstance(player, Player):
            raise UsageError(f"Who plays the {agent} must be a Player, as Player.of(policy, params) makes one.")
        player.check(env)


def check_acts(player: Player, agent: str, obs: Any, state: Any, size: int) -> None:
    """Raise UsageError unless the player can play the agent, who observes obs [n] and acts with `size` numbers.

    Nothing is computed: `obs` and the EnvState may be shapes, as of `jax.eval_shape`, or what is being traced.
    """

    def act(player, obs, state):
        carry = player.initial_carry()
        return carry, player.act(player.member(0), carry, obs, state, jnp.bool_(True), jax.random.key(0))

    try:
        carry, (action, after) = jax.eval_shape(act, player, obs, state)
    except (TypeError, ValueError, KeyError, IndexError, AttributeError) as error:
        what = str(error).partition("\n")[0]
        raise UsageError(f"The {agent} cannot act on the {obs.shape[0]} numbers that it observes: {what}") from None
    if jnp.shape(action) != (size,):
        raise UsageError(f"The {agent} must act with {size} numbers, not with the shape {jnp.shape(action)}.")
    if jax.tree.map(jnp.shape, after) != jax.tree.map(jnp.shape, carry):
        raise UsageError(f"The {agent}'s policy must return a carry of the same shapes as its initial_carry.")


def stack(trees: Sequence[Any]) -> Any:
    """Pytrees of the same structure as one, with a leading axis."""
    return jax.tree.map(lambda *xs: jnp.stack(xs), *trees)
