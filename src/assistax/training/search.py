"""Where hyperparameters are searched for: an interval, written "1e-4:1e-2", or choices, "4,8,16"."""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from assistax.errors import UsageError
from assistax.settings import parse_assignments

# What the paper's appendix sweeps. It does not say over which ranges: these hold everything in its tables
# (learning/presets.py), the rates with half a decade and more to spare.
SEARCH = {
    "ppo": {
        "ppo.learning_rate": "1e-5:1e-2",
        "ppo.clip_eps": "0.01:0.32",
        "ppo.entropy_coef": "1e-5:1e-2",
        "ppo.update_epochs": "4,8,16",
        "ppo.num_minibatches": "4,8,16",
    },
    "sac": {
        "sac.actor_learning_rate": "1e-5:1e-2",
        "sac.critic_learning_rate": "1e-5:1e-2",
        "sac.alpha_learning_rate": "1e-5:1e-2",
        "sac.tau": "1e-4:5e-2",
        "sac.updates": "32,64,128",
        "sac.num_steps": "8,16",
        "sac.batch_size": "128,512",
    },
}
Search = Mapping[str, str]
"""By name of a setting, where it is searched for."""


@dataclass(frozen=True)
class Interval:
    """Drawn from log-uniformly if it is above zero, else uniformly."""

    low: float
    high: float

    @property
    def log(self) -> bool:
        """Whether it is drawn from log-uniformly."""
        return self.low > 0

    def draw(self, rng: np.random.Generator) -> float:
        """A number with four digits, so that it can be typed again."""
        if self.log:
            return float(f"{math.exp(rng.uniform(math.log(self.low), math.log(self.high))):.4g}")
        return float(f"{rng.uniform(self.low, self.high):.4g}")


def intervals(search: Search) -> dict[str, Interval]:
    """The settings that are searched for in an interval."""
    found = {}
    for name, text in search.items():
        low, colon, high = text.partition(":")
        if not colon:
            continue
        try:
            found[name] = Interval(float(low), float(high))
        except ValueError:
            found[name] = Interval(math.nan, math.nan)
        if not -math.inf < found[name].low < found[name].high < math.inf:
            raise UsageError(f"{name} takes LOW:HIGH, for example 1e-4:1e-2, or choices like 4,8,16, not {text!r}.")
    return found


def choices(search: Search) -> dict[str, tuple]:
    """The settings that are chosen from a list."""
    found = {}
    for name, text in search.items():
        if ":" not in text:
            found[name] = tuple(parse_assignments([f"{name}={one}"])[name] for one in text.split(",") if one)
            if not found[name]:
                raise UsageError(f"{name} has nothing to choose from; write LOW:HIGH or choices like 4,8,16.")
    return found


def draw(search: Search, count: int, seed: int) -> list[dict[str, Any]]:
    """`count` settings by name: numbers at random, and the combinations of the choices equally often."""
    rng, numbers, lists = np.random.default_rng(seed), intervals(search), choices(search)
    combinations = list(itertools.product(*lists.values()))
    order = rng.permutation(len(combinations))
    drawn = []
    for i in range(count):
        settings = dict(zip(lists, combinations[order[i % len(order)]], strict=True))
        settings |= {name: interval.draw(rng) for name, interval in numbers.items()}
        drawn.append({name: settings[name] for name in search})
    return drawn
