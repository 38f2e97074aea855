"""From whom every reset draws a person."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from assistax.errors import UsageError, choose
from assistax.human import disability, population, preference
from assistax.human.disability import DISABILITIES
from assistax.human.profile import HumanProfile, Person, stack
from assistax.settings import check_count


@dataclass(frozen=True)
class HumanConfig:
    """From whom every reset draws a person; docs/humans.md tells it at length.

    Raises UsageError for people who cannot be.
    """

    # "none", one of the seven standard settings ("tremor+weakness"), "standard" to draw one of the
    # seven at every reset, or numbers: "strength=0.5 tremor=0.2 tremor_hz=4 motion=0.7".
    disability: str = "none"
    # "none": no preference reward; "default": the paper's default; "sweep": drawn at every reset;
    # or numbers: "speed=0.05:0.09 force=1.2:2 weights=0.3,0.35,-0.03".
    preference: str = "none"
    # Instead of both, a list of people of whom every reset draws one: "paper630", a JSON file, or
    # whatever else `population.people` takes. Kept in words: a run does not need the file again.
    people: str | tuple[Person, ...] | HumanProfile = "none"
    # How often each of those people is drawn, in proportion: a number for each, (2, 1, 1). (): all as often.
    weights: tuple[float, ...] = ()
    # Who sees the preference: "both" (the paper), "human" or "none". With "shown" the human does, and the robot sees
    # their expression. With "oracle" both do, and the robot is told the body as well (tremor, its frequency, strength
    # and motion), as a reference for robots that have to find out.
    visibility: str = "both"
    # The share of the person's action that is random, 0 to 1: to train a robot for people who do otherwise (E3T).
    random_share: float = 0.0
    # Episodes for which a person stays, and the partner, before the next one is drawn: a memory is kept for as long.
    redraw_every: int = 1

    def __post_init__(self):
        choose("visibility", self.visibility, ["both", "human", "none", "shown", "oracle"])
        if not 0.0 <= self.random_share <= 1.0:
            raise UsageError(f"env.human.random_share must be 0 to 1, not {self.random_share}.")
        check_count("env.human.redraw_every", self.redraw_every)
        if self.people != "none":
            if (self.disability, self.preference) != ("none", "none"):
                raise UsageError(
                    "env.human.people says all about who the person is: leave out env.human.disability and .preference."
                )
            if self.people != population.PAPER:
                object.__setattr__(self, "people", population.people(self.people))
        if "=" in self.disability:
            disability.parse(self.disability)
        else:
            choose("disability", self.disability, ["none", "standard", *DISABILITIES])
        if "=" in self.preference:
            preference.parse(self.preference)
        else:
            choose("preference", self.preference, ["none", "default", "sweep"])
        if self.weights and not (
            len(self.weights) == len(self.listed) and min(self.weights) >= 0 < sum(self.weights) < float("inf")
        ):
            raise UsageError(
                f"env.human.weights takes a number for each of the {len(self.listed)} people, 0 or more and not all 0, "
                f"not {self.weights}."
            )

    @cached_property
    def listed(self) -> tuple[Person, ...]:
        """Of whom every reset draws one."""
        if self.people != "none":
            return population.people(self.people)
        preferred = "default" if self.preference == "sweep" else self.preference
        names = DISABILITIES if self.disability == "standard" else [self.disability]
        return tuple(Person(name, preferred) for name in names)

    @cached_property
    def _profiles(self) -> HumanProfile:
        return stack(self.listed)

    @property
    def expressing(self) -> bool:
        """Whether the robot sees how people like it."""
        return self.preferring and self.visibility == "shown"

    @property
    def disabled(self) -> bool:
        """Whether anybody listed has a disability."""
        return any(person.disability != "none" for person in self.listed)

    @property
    def preferring(self) -> bool:
        """Whether anybody listed has preferences."""
        return self.preference == "sweep" or any(person.preference != "none" for person in self.listed)

    def draw(self, key: jax.Array, index: jax.Array | None = None) -> HumanProfile:
        """One of those listed, each as likely as any other or by `weights`; or the one in row `index` of the list."""
        which, key = jax.random.split(key)
        number = len(self.listed)
        # Not randint, which takes three times as many random bits and shows in the speed of a step.
        if index is None and self.weights:
            bounds = np.cumsum(self.weights[:-1]) / sum(self.weights)  # between neighbours
            index = (jax.random.uniform(which) >= jnp.asarray(bounds, jnp.float32)).sum(dtype=jnp.int32)
        elif index is None:
            index = (jax.random.uniform(which) * number).astype(jnp.int32) if number > 1 else jnp.int32(0)
        person = jax.tree.map(lambda x: jnp.asarray(x)[index], self._profiles)
        if self.preference == "sweep":
            person = dataclasses.replace(person, preference=preference.sample(key))
        return person
