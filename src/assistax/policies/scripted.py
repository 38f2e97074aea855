"""Policies without parameters, by name: nobody, noise, the experts and people who react."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from assistax.errors import choose
from assistax.policies import habits
from assistax.policies.experts import expert
from assistax.policies.people import Reflex, offer
from assistax.policies.player import Player, Policy, Team


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


SCRIPTED = {  # by name, who plays the robot and who the human
    "still": ("still", "still"),
    "random": ("random", "random"),
    "expert": ("expert", "still"),
    "considerate": ("considerate", "still"),
    "offer": ("expert", "offer"),
    "offer_slowly": ("expert", "offer_slowly"),
    "withdraw": ("expert", "withdraw"),
}


def scripted_policy(name: str, env, agent: str) -> Policy:
    """The policy called `name` for one agent: "still", "random", the robot's "expert" or "considerate", the human's
    "offer", "offer_slowly" or "withdraw"."""
    size = env.action_sizes[agent]
    makers: dict[str, Callable[[], Policy]] = {"still": lambda: Still(size), "random": lambda: Random(size)}
    if agent == "robot":
        makers |= {"expert": lambda: expert(env), "considerate": lambda: expert(env, considerate=True)}
    else:
        makers |= {
            "offer": lambda: offer(env),
            "offer_slowly": lambda: offer(env, speed=0.3),
            "withdraw": lambda: Reflex(env, -1.0),
        }
    return makers[choose(f"{agent}'s policy", name, makers)]()


def scripted_player(name: str, env, agent: str) -> Player:
    """The player of a scripted policy or, for the human, of a habit (see `policies.habits`)."""
    if agent == "human" and name in habits.HABITS:
        return habits.person(env, name)
    return Player(scripted_policy(name, env, agent))


def scripted_team(name: str, env) -> Team:
    """The team called `name`, see SCRIPTED; "expert" has a still human."""
    names = zip(env.agents, SCRIPTED[choose("policy", name, SCRIPTED)], strict=True)
    return {agent: Player(scripted_policy(one, env, agent)) for agent, one in names}
