"""Who learns and who does not: every seat is learned, or played by a partner that stays as it is.

Ad-hoc teamwork is ordinary training with one seat given to a `Partner`: a scripted policy, or a
population of frozen ones of which every environment draws a member afresh for each episode.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from assistax.errors import UsageError, choose
from assistax.policies import Policy


@dataclass(frozen=True)
class Partner:
    """What plays a seat that does not learn.

    `params` are stacked: every leaf is [members, ...], or () for a scripted policy.
    """

    policy: Policy
    params: Any = ()
    members: int = 1

    def __post_init__(self):
        if self.members < 1:
            raise UsageError(f"A partner needs one member or more, not {self.members}.")
        for leaf in jax.tree.leaves(self.params):
            if jnp.shape(leaf)[:1] != (self.members,):
                raise UsageError(
                    f"A partner's parameters must be stacked, [members, ...] with {self.members} members, "
                    f"but one of them is {jnp.shape(leaf)}."
                )


class Seats:
    """The seats of `num_envs` environments side by side; holds no state.

    Args:
      env: anything with the interface of `assistax.env.Env`.
      num_envs: environments stepped side by side.
      partners: by agent, who plays its seat; agents without one are learners.
    """

    def __init__(self, env, num_envs: int, partners: Mapping[str, Partner] | None = None):
        self.num_envs, self.partners = num_envs, dict(partners or {})
        for agent in self.partners:
            choose("agent", agent, env.agents)
        self.learners = tuple(agent for agent in env.agents if agent not in self.partners)
        if not self.learners:
            raise UsageError(f"Partners play all seats ({', '.join(self.partners)}); leave one to learn.")

    def init(self, key: jax.Array) -> dict[str, Any]:
        """By partner: who plays in each environment, "index" [num_envs], and its "carry"."""
        seated = {}
        for agent, partner in self.partners.items():
            carry = partner.policy.initial_carry()
            carry = jax.tree.map(lambda x: jnp.broadcast_to(x, (self.num_envs, *jnp.shape(x))), carry)
            seated[agent] = {"index": jnp.zeros(self.num_envs, jnp.int32), "carry": carry}
        return self.redraw(seated, jnp.ones(self.num_envs, bool), key)

    def act(self, seated, env_state, obs, reset, key):
        """The partners' actions {agent: [num_envs, n]}, and `seated` with their carries moved on.

        Args:
          seated: what `init`, `redraw` or the last `act` returned.
          env_state: EnvState [num_envs], shown to privileged policies.
          obs: by agent [num_envs, n].
          reset: [num_envs] whether this is the first step of an episode.
          key: for policies that draw.
        """
        actions, moved = {}, {}
        for i, (agent, partner) in enumerate(self.partners.items()):
            seen = env_state if getattr(partner.policy, "privileged", False) else obs[agent]
            index, carry = seated[agent]["index"], seated[agent]["carry"]
            keys = jax.random.split(jax.random.fold_in(key, i), self.num_envs)
            actions[agent], carry = _act(partner, index, carry, seen, reset, keys)
            moved[agent] = {"index": index, "carry": carry}
        return actions, moved

    def redraw(self, seated, done, key):
        """`seated` with a fresh member, uniform over all, wherever an episode ended (done [num_envs])."""
        drawn = {}
        for i, (agent, partner) in enumerate(self.partners.items()):
            fresh = jax.random.randint(jax.random.fold_in(key, i), done.shape, 0, partner.members)
            drawn[agent] = seated[agent] | {"index": jnp.where(done, fresh, seated[agent]["index"])}
        return drawn


def _act(partner: Partner, index, carry, seen, reset, keys):
    """One step of a partner in all environments; what it costs does not grow with its members."""
    act = partner.policy.act
    if partner.members == 1:
        params = jax.tree.map(lambda x: x[0], partner.params)
        return jax.vmap(act, (None, 0, 0, 0, 0))(params, carry, seen, reset, keys)

    def one(args):
        i, *rest = args
        return act(jax.tree.map(lambda x: x[i], partner.params), *rest)

    # A CPU reads the chosen weights where they are; gathering a copy for every environment costs six
    # times as much there. An accelerator needs the environments side by side.
    everywhere = jax.lax.map if jax.default_backend() == "cpu" else lambda f, args: jax.vmap(f)(args)
    return everywhere(one, (index, carry, seen, reset, keys))
