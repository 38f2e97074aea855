"""One person: disability and preference together, as arrays and as words."""

from dataclasses import dataclass

import jax
import numpy as np

from assistax.human import disability, preference
from assistax.human.disability import Disability
from assistax.human.preference import Preference
from assistax.pytree import pytree


@pytree
class HumanProfile:
    """Travels with the environment's state; a batch may mix them, a list of people is a stack of them."""

    disability: Disability
    preference: Preference
    index: jax.Array  # int32: the row in the list of people from which it was drawn


@dataclass(frozen=True)
class Person:
    """One person in the words of the command line: see `disability.parse` and `preference.parse`."""

    disability: str = "none"
    preference: str = "none"  # then there is no preference reward, and the profile has the paper's default

    def __post_init__(self):
        disability.parse(self.disability)
        if self.preference != "none":
            preference.parse(self.preference)


def stack(people: tuple[Person, ...]) -> HumanProfile:
    """Their profiles, every leaf [len(people), ...] in NumPy."""
    preferred = [preference.parse("default" if p.preference == "none" else p.preference) for p in people]
    hard = [disability.parse(p.disability) for p in people]
    stacked = (jax.tree.map(lambda *x: np.stack(x), *parts) for parts in (hard, preferred))
    return HumanProfile(*stacked, np.arange(len(people), dtype=np.int32))  # ty: ignore[invalid-argument-type]


def unstack(profiles: HumanProfile) -> tuple[Person, ...]:
    """`stack`, backwards: the words for profiles [n]; raises UsageError where one is impossible."""
    profiles = jax.tree.map(np.asarray, profiles)
    people = []
    for i in range(len(profiles.disability.tremor)):
        hard, preferred = (
            jax.tree.map(lambda x, i=i: x[i], part) for part in (profiles.disability, profiles.preference)
        )
        people.append(Person(disability.spell(hard), preference.spell(preferred)))
    return tuple(people)
