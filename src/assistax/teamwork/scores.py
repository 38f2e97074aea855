"""What robots reach with partners as the numbers of a table: means, scores, regret, the gap, and how sure they are.

Paper: section "AHT pipeline": returns with the partners of training and with held-out ones, and the gap between them.
Pairs are arrays [seeds, partners] of means over episodes, with NaN for partners whom a reference does not know.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from assistax.evaluation.statistics import Interval, crossed_ci, gap_ci, paired_ci, proportion_ci
from assistax.teamwork.adhoc import CONSIDERATE, HARM, HURT, NOBODYS, RATES

Pairs = Mapping[str, np.ndarray]
"""By measure [seeds, partners]."""

SCORES = {"score": "return", "gated_score": "gated_return", "preference_score": "gated_preference_return"}
"""And what each is of."""

REGRETS = {"regret": "return", "safe_regret": "safe_success"}
SHARES = (*RATES, *HURT)  # from 0 to 1
LESS = (*HARM, *REGRETS)  # of these less is better
WORST = 0.1  # of the partners
LEAST = 0.1  # of the reference's return, by which it must be above the zero for a partner to be scored
FEWEST = 5  # partners who are scored, for a score: a mean over fewer says who they are, and not how good a robot is


@dataclass(frozen=True)
class Scale:
    """A measure as scores by partner: 0 for the best robot that knows nobody, 1 for the best that knows this partner.

    Robots that know nobody are the still, the random and the scripted one (NOBODYS).
    """

    zero: np.ndarray  # [partners]
    one: np.ndarray  # [partners], NaN where nobody knows the partner

    @classmethod
    def of(cls, references: Mapping[str, Pairs], measure: str = "return") -> "Scale":
        """From `Meeting.references` and, whatever their names, best responses beside them.

        A robot knows the partners with whom its returns are numbers, see `adhoc.only`.
        """
        means = {name: gated(found)[measure].mean(1) for name, found in references.items()}
        zero = np.max([means[name] for name in NOBODYS], 0)
        known = [mean for name, mean in means.items() if name not in (*NOBODYS, CONSIDERATE)]
        return cls(zero, np.fmax.reduce([np.full_like(zero, np.nan), *known]))

    @property
    def scored(self) -> np.ndarray:
        """[partners] whether somebody who knows the partner is clearly better than who knows nobody."""
        return np.nan_to_num(self.one - self.zero, nan=-1.0) > LEAST * np.abs(np.nan_to_num(self.one))

    @property
    def enough(self) -> bool:
        """Whether so many are scored that a mean over them is a score."""
        return bool(self.scored.sum() >= FEWEST)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Scores of values [..., partners]; NaN for partners who are not scored."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.scored, (values - self.zero) / (self.one - self.zero), np.nan)

    def regret(self, values: np.ndarray) -> np.ndarray:
        """What values [..., partners] are short of those of the best that knows the partner; NaN where nobody does."""
        return self.one - values


def scales(references: Mapping[str, Pairs]) -> dict[str, Scale]:
    """By measure the Scale that these references give, for SCORES and REGRETS."""
    there = gated(next(iter(references.values())))
    measures = dict.fromkeys((*SCORES.values(), *REGRETS.values()))
    return {measure: Scale.of(references, measure) for measure in measures if measure in there}


def by_pair(seeds: Sequence[Pairs], scales: Mapping[str, Scale] | None = None) -> dict[str, np.ndarray]:
    """Means over episodes of what one method's robots, a seed each, reach with each partner.

    Args:
      seeds: by seed and measure [partners, episodes].
      scales: by measure, see `scales`.

    Returns:
      by measure [seeds, partners]; with preferences also "gated_preference_return", to which only episodes add in which
      the task succeeded, and "gated_return" with it in place of the preference return; SCORES, if FEWEST partners are
      scored, NaN with the others; REGRETS, NaN with partners whom nobody knows.
    """
    each, scales = [gated(one) for one in seeds], scales or {}
    found = {name: np.stack([one[name].mean(1) for one in each]) for name in each[0]}
    for name, measure in SCORES.items():
        if measure in scales and scales[measure].enough:
            found[name] = scales[measure](found[measure])
    for name, measure in REGRETS.items():
        if measure in scales:
            found[name] = scales[measure].regret(found[measure])
    return found


def summarize(pairs: Pairs) -> dict[str, Any]:
    """What `by_pair` found of one method, ready for JSON; without measures of which no partner has a number.

    Returns:
      by measure "mean", "ci" (95 %, for new seeds and new partners, see crossed_ci; of shares that are all 0 or all 1
      Wilson's, for new partners), "worst" (the mean over the worst tenth of each seed's partners) and "by_pair"
      [seeds, partners], None for partners without a number.
    """
    return {name: _measure(name, x) for name, x in pairs.items() if _there(x).any()}


def gap(known: Pairs, strange: Pairs) -> dict[str, Any]:
    """The coordination gap by measure, of what `by_pair` found with partners of training and with held-out ones.

    "mean", of the first less that of the second, and "ci", see gap_ci. In REGRETS the gap is that of what robots are
    short of, so that it does not count that partners of one kind are easier to help.
    """
    found = {}
    for name in known.keys() & strange.keys():
        a, b = (x[:, _there(x)] for x in (known[name], strange[name]))
        if a.size and b.size:
            found[name] = _less(name, a, b, gap_ci(a, b))
    return found


def difference(ours: Pairs, theirs: Pairs) -> dict[str, Any]:
    """By measure what one method reaches more than another with the same partners: "mean" and "ci", see paired_ci."""
    found = {}
    for name in ours.keys() & theirs.keys():
        there = _there(ours[name]) & _there(theirs[name])
        if there.any():
            a, b = ours[name][:, there], theirs[name][:, there]
            found[name] = _less(name, a, b, paired_ci(a, b))
    return found


def gated(found: Pairs) -> dict[str, np.ndarray]:
    """With what preferences pay counted only in episodes in which the task succeeded, if there are preferences."""
    if "preference_return" not in found:
        return dict(found)
    gated = found["preference_return"] * found["success"]
    whole = found["return"] - found["preference_return"] + gated
    return {**found, "gated_preference_return": gated, "gated_return": whole}


def _there(x: np.ndarray) -> np.ndarray:
    """[partners] of whom there are numbers."""
    return np.logical_not(np.isnan(x).any(axis=0))


def _measure(name: str, everybody: np.ndarray) -> dict[str, Any]:
    x = everybody[:, _there(everybody)]
    interval = crossed_ci(x)
    if interval is None and name in SHARES and x.mean() in (0.0, 1.0):
        interval = proportion_ci(round(x.mean() * x.shape[1]), x.shape[1])
    if name in (*SHARES, *HARM):
        interval = _bounded(interval, 0.0, 1.0 if name in SHARES else np.inf)
    number, ordered = max(1, round(WORST * x.shape[1])), np.sort(x, 1)
    worst = ordered[:, -number:] if name in LESS else ordered[:, :number]
    pairs = [[None if np.isnan(value) else round(float(value), 4) for value in seed] for seed in everybody]
    return {"mean": float(x.mean()), "ci": interval, "worst": float(worst.mean()), "by_pair": pairs}


def _less(name: str, a: np.ndarray, b: np.ndarray, interval: Interval | None) -> dict[str, Any]:
    """What `a` has on average more than `b`."""
    most = 1.0 if name in (*SHARES, "safe_regret") else np.inf
    return {"mean": float(a.mean() - b.mean()), "ci": _bounded(interval, -most, most)}


def _bounded(interval: Interval | None, low: float, high: float) -> Interval | None:
    """The part of an interval that can be: Student's t knows no bounds."""
    return None if interval is None else (max(interval[0], low), min(interval[1], high))
