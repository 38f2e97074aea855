"""Policies: learned or scripted, behind one call.

A policy acts on one observation [n]; batch it with `jax.vmap`. Its parameters are a pytree given
with every call, so that a population is the same policy with a leading axis on the parameters.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import jax
import jax.numpy as jnp

from assistax.errors import choose
from assistax.learning.networks import mlp, next_noise, step
from assistax.learning.normalizer import normalize
from assistax.learning.squashed import sample_squashed, split_head


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
class Still:
    """Does nothing."""

    action_size: int

    def initial_carry(self):
        return ()

    def act(self, params, carry, obs, reset, key):
        return jnp.zeros(self.action_size), carry


@dataclass(frozen=True)
class Random:
    """Uniform in [-1, 1], afresh at every step."""

    action_size: int

    def initial_carry(self):
        return ()

    def act(self, params, carry, obs, reset, key):
        return jax.random.uniform(key, (self.action_size,), minval=-1.0, maxval=1.0), carry


@dataclass(frozen=True)
class Actor:
    """A trained actor of PPO; params: {"actor": ..., "normalizer": ...}."""

    activation: str = "tanh"
    normalize_obs: bool = True
    deterministic: bool = True
    memory: int = 0  # units of its GRU; 0 for none
    noise_correlation: float = 0.0  # of what it draws, from one step to the next
    longest_action: int = 0  # as many numbers are drawn if not deterministic

    def initial_carry(self):
        """Its memory, and its noise."""
        return jnp.zeros(self.memory) if self.memory else (), jnp.zeros(self.longest_action)

    def act(self, params, carry, obs, reset, key):
        memory, noise = carry
        if self.normalize_obs:
            obs = normalize(params["normalizer"], obs)
        mean, memory = step(params["actor"], obs, memory, reset, self.activation)
        if self.deterministic:
            return mean, (memory, noise)
        noise = next_noise(noise, reset, self.noise_correlation, key)
        return mean + jnp.exp(params["actor"]["log_std"]) * noise[: mean.shape[-1]], (memory, noise)


@dataclass(frozen=True)
class SquashedActor:
    """A trained actor of SAC; params: {"actor": {"layers"}, "normalizer"}. Acts in (-1, 1)."""

    activation: str = "relu"
    normalize_obs: bool = True
    deterministic: bool = True  # tanh of the mean
    noise_correlation: float = 0.0  # of what it draws, from one step to the next
    longest_action: int = 0  # as many numbers are drawn if not deterministic

    def initial_carry(self):
        """Its noise."""
        return jnp.zeros(self.longest_action)

    def act(self, params, carry, obs, reset, key):
        if self.normalize_obs:
            obs = normalize(params["normalizer"], obs)
        mean, log_std = split_head(mlp(params["actor"]["layers"], obs, self.activation))
        if self.deterministic:
            return jnp.tanh(mean), carry
        noise = next_noise(carry, reset, self.noise_correlation, key)
        return sample_squashed(mean, log_std, noise[: mean.shape[-1]])[0], noise


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


SCRIPTED = {  # by name, who plays the robot and who the human
    "still": ("still", "still"),
    "random": ("random", "random"),
    "expert": ("expert", "still"),
    "considerate": ("considerate", "still"),
    "offer": ("expert", "offer"),
    "withdraw": ("expert", "withdraw"),
}
Team = dict[str, tuple[Policy, Any]]
"""By agent, a policy and its parameters."""


def scripted_policy(name: str, env, agent: str) -> Policy:
    """The policy called `name` for one seat: "still", "random", the robot's "expert" or "considerate", the human's
    "offer" or "withdraw"."""
    from assistax.policies.experts import Reflex, expert

    size = env.action_sizes[agent]
    makers: dict[str, Callable[[], Policy]] = {"still": lambda: Still(size), "random": lambda: Random(size)}
    if agent == "robot":
        makers |= {"expert": lambda: expert(env), "considerate": lambda: expert(env, considerate=True)}
    else:
        makers |= {"offer": lambda: Reflex(env, 1.0), "withdraw": lambda: Reflex(env, -1.0)}
    return makers[choose(f"{agent}'s policy", name, makers)]()


def scripted_team(name: str, env) -> Team:
    """The team called `name`, see SCRIPTED; "expert" has a still human."""
    seats = zip(env.agents, SCRIPTED[choose("policy", name, SCRIPTED)], strict=True)
    return {agent: (scripted_policy(seat, env, agent), ()) for agent, seat in seats}
