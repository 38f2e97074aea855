"""How a person is written: "strength=0.5 tremor=0.2", "speed=0.05:0.09 weights=0.3,0.35,-0.03"."""

import re
from collections.abc import Mapping

import numpy as np

from assistax.errors import UsageError, choose

Parts = Mapping[str, tuple[str, tuple[int, ...]]]
"""By name, what a part must be ("a range LEAST:MOST") and how many numbers that takes ((2,))."""


def read(what: str, text: str, parts: Parts) -> dict[str, tuple[float, ...]]:
    """ "a=1 b=0.5:2" to {"a": (1.0,), "b": (0.5, 2.0)}; raises UsageError, which names `what` it is about."""
    values = {}
    for part in text.split():
        name, _, numbers = part.partition("=")
        kind, counts = parts[choose(f"part of a {what}", name, parts)]
        if name in values:
            raise UsageError(f"A {what}'s {name} is given twice: {text!r}.")
        try:
            values[name] = tuple(float(number) for number in re.split("[:,]", numbers))
        except ValueError:
            values[name] = ()
        if len(values[name]) not in counts:
            raise UsageError(f"A {what}'s {name} must be {kind}, not {numbers!r}.")
    return values


def number(x) -> str:
    """The shortest decimal that reads back as the same float32."""
    return str(np.float32(x)).removesuffix(".0")
