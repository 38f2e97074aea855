"""One person: disability and preference; and how persons are drawn."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from assistax.errors import choose
from assistax.human import disability, preference
from assistax.human.disability import DISABILITIES, Disability
from assistax.human.preference import Preference
from assistax.pytree import pytree


@pytree
class HumanProfile:
    """Travels with the environment's state; a batch may mix them."""

    disability: Disability
    preference: Preference


@dataclass(frozen=True)
class HumanConfig:
    """From whom every reset draws a person."""

    # "none", one of the seven standard settings ("tremor+weakness"), "standard" to draw one of the
    # seven at every reset, or numbers: "strength=0.5 tremor=0.2 tremor_hz=4 motion=0.7".
    disability: str = "none"
    # "none": no preference reward; "default": the paper's default; "sweep": drawn at every reset.
    preference: str = "none"
    visibility: str = "both"  # who sees the preference: "both" (the paper), "human" or "none"

    def __post_init__(self):
        choose("preference", self.preference, ["none", "default", "sweep"])
        choose("visibility", self.visibility, ["both", "human", "none"])
        if self.disability != "standard":
            disability.parse(self.disability)

    @property
    def disabled(self) -> bool:
        return self.disability != "none"

    @property
    def preferring(self) -> bool:
        return self.preference != "none"

    def draw(self, key: jax.Array) -> HumanProfile:
        """One person."""
        which, key = jax.random.split(key)
        if self.disability == "standard":
            people = [disability.disability(**settings) for settings in DISABILITIES.values()]
            stacked = jax.tree.map(lambda *x: jnp.stack(x), *people)
            index = jax.random.randint(which, (), 0, len(people))
            hard = jax.tree.map(lambda x: x[index], stacked)
        else:
            hard = disability.parse(self.disability)
        liked = preference.sample(key) if self.preference == "sweep" else preference.preference()
        return HumanProfile(hard, liked)
