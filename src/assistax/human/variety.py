"""Who to train a population with: lists of people by name."""

from pathlib import Path

from assistax.human import population
from assistax.human.disability import DISABILITIES
from assistax.human.profile import Person

PREFERENCES = {  # one that is met by most ways of helping well, a gentle one and a brisk one
    "default": "default",
    "gentle": "speed=0.03:0.07 force=0.8:2 weights=0.35,0.3,-0.03",
    "brisk": "speed=0.12:0.2 force=2.5:4.5 weights=0.4,0.3,-0.01",
}
STANDARD = "8x3"  # healthy and the seven standard disabilities, by three preferences


def people(name: str | Path) -> tuple[Person, ...]:
    """ "8x3", "8" (without preferences), "paper630" or a JSON file, see `population.people`."""
    bodies = ("none", *DISABILITIES)
    if name == STANDARD:
        return tuple(Person(body, words) for body in bodies for words in PREFERENCES.values())
    if name == "8":
        return tuple(Person(body) for body in bodies)
    return population.people(name)
