"""Who to train a population with: lists of people by name."""

import re
from pathlib import Path

from assistax.errors import UsageError, choose
from assistax.human import population
from assistax.human.disability import DISABILITIES
from assistax.human.profile import Person

PREFERENCES = {  # one that is met by most ways of helping well, a gentle one and a brisk one
    "default": "default",
    "gentle": "speed=0.03:0.07 force=0.8:2 weights=0.35,0.3,-0.03",
    "brisk": "speed=0.12:0.2 force=2.5:4.5 weights=0.4,0.3,-0.01",
}
OPPOSITE = "opposite"  # the people of this name
MOST = len(PREFERENCES) + population.DRAWS


def people(name: str | Path) -> tuple[Person, ...]:
    """People of whom each is to have a team.

    Args:
      name: "8x3", healthy and the seven standard disabilities, each by three preferences: the three of PREFERENCES;
        "7x4", without the healthy, and by the paper's first drawn preference as well, and so on; "8" or "7", without
        preferences; "opposite", the eight by a gentle and a brisk preference, in an order in which each of four ways
        that are taught in turn is as often taught to the gentle as to the brisk; "paper630"; or a JSON file, see
        `population.people`.

    Raises:
      UsageError: there are no such people.
    """
    if name == OPPOSITE:
        tastes = [PREFERENCES["gentle"], PREFERENCES["brisk"]]
        bodies = enumerate(("none", *DISABILITIES))
        return tuple(Person(body, one) for i, body in bodies for one in tastes[:: (1, -1, -1, 1)[i % 4]])
    if not (found := re.fullmatch(r"([78])(?:x(\d{1,3}))?", str(name))):
        if name != population.PAPER and Path(name).suffix != ".json":
            choose("people", str(name), ["8x3", "8", "7x4", OPPOSITE, population.PAPER, "a file named *.json"])
        return population.people(name)
    bodies = ("none", *DISABILITIES)[-int(found[1]) :]
    if found[2] is None:
        return tuple(Person(body) for body in bodies)
    if not 1 <= (number := int(found[2])) <= MOST:
        raise UsageError(f"People have 1 to {MOST} preferences, for example 8x3, not {name}.")
    drawn = population.people(population.PAPER) if number > len(PREFERENCES) else ()
    words = [*PREFERENCES.values(), *(person.preference for person in drawn)][:number]
    return tuple(Person(body, one) for body in bodies for one in words)
