"""Ad-hoc teamwork measured: robots beside partners, each of whom they meet as often as any other.

Paper: section "AHT pipeline": returns with the partners of training and with held-out ones, and the gap between them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from assistax.env import Env
from assistax.errors import UsageError
from assistax.evaluation.playing import EVALUATION_SEED, Evaluator
from assistax.evaluation.statistics import crossed_ci, gap_ci
from assistax.policies import Player, scripted_policy
from assistax.settings import check_count
from assistax.training.population import Population

RATES = ("success", "safe_success")
HURT = ("clamping", "impact")  # rates, too
HARM = (*HURT, "peak_force", "seconds_above_comfort")  # of which less is better
MEASURES = ("return", *RATES, "task_return", "preference_return", *HARM)
SCORES = {"score": "return", "gated_score": "gated_return"}  # and what each is of
NOBODYS = ("still", "random", "expert")  # robots whose best is worth 0
CONSIDERATE = "considerate"  # the expert told the preferences; shown, and no end of the scale
WORST = 0.1  # of the partners
LEAST = 0.1  # of the reference's return, by which it must be above the zero for a partner to be scored


class Meeting:
    """All partners of a population, or part of one, in their order; compiled once for robots of one policy.

    Args:
      env: where, with the population's people; robots may know less of them than here, see `Meeting.of`.
      population: the partners.
      episodes: with each partner.
    """

    def __init__(self, env: Env, population: Population, episodes: int):
        check_count("episodes", episodes)
        if env.config.human.people != population.people:
            raise UsageError("The environment's people (env.human.people) must be the population's.")
        population.check_observations("human", env, "the population")
        self.env, self.population, self.episodes = env, population, episodes
        self.partner = population.partner("human", env=env)
        self._people = np.repeat(np.arange(len(population)), episodes)
        self._draws = draws(population, episodes)
        self._evaluator = Evaluator(env, len(self._people))

    def __call__(self, robot: Player, seed: int = EVALUATION_SEED) -> dict[str, np.ndarray]:
        """MEASURES by name, [partners, episodes]; the same draws for every robot, see `draws`."""
        result = self._evaluator({"robot": robot, "human": self.partner}, seed, self._people, self._draws)
        found = result["metrics"]
        return {k: np.asarray(found[k], float).reshape(-1, self.episodes) for k in MEASURES if k in found}

    def references(self, seed: int = EVALUATION_SEED) -> dict[str, dict[str, np.ndarray]]:
        """What robots reach that know nobody (NOBODYS), CONSIDERATE, and each partner's own robot ("own")."""
        named = (*NOBODYS, CONSIDERATE) if self.env.config.human.preferring else NOBODYS
        found = {name: self.scripted(name, seed) for name in named}
        with_robot = np.array([row["robot"] for row in self.population.rows])
        if with_robot.any():
            kept = self.population.select(
                [one for one, has in zip(self.population.ids, with_robot, strict=True) if has]
            )
            place = np.where(with_robot, np.cumsum(with_robot) - 1, 0)  # of each partner's robot; anybody's for others
            robots = kept.partner("robot", deterministic=True)
            found["own"] = only(with_robot, self(robots.take(place, by_person=True), seed))
        return found

    def scripted(self, name: str, seed: int = EVALUATION_SEED) -> dict[str, np.ndarray]:
        """What the scripted robot of this name reaches."""
        return self(Player(scripted_policy(name, self.env, "robot")), seed)


def draws(population: Population, episodes: int) -> np.ndarray:
    """Numbers [partners * episodes] of what each episode draws: a partner's own, whoever else is there.

    Where it itches decides more than who it is. If all partners had the same few itches, a mean over partners would be
    one over these, and no interval over partners would tell.
    """
    own = np.array([int(one[:8], 16) for one in population.ids], np.uint32)
    return (own[:, None] + np.arange(episodes, dtype=np.uint32)).ravel()


def only(partners: np.ndarray, found: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What a robot reached with those partners (bool [partners]), and NaN with the others."""
    return {name: np.where(partners[:, None], x, np.nan) for name, x in found.items()}


@dataclass(frozen=True)
class Scale:
    """Returns as scores by partner: 0 for the best robot that knows nobody, 1 for the best that knows this partner."""

    zero: np.ndarray  # [partners]
    one: np.ndarray  # [partners], NaN where nobody knows the partner

    @classmethod
    def of(cls, references: Mapping[str, Mapping[str, np.ndarray]], measure: str = "return") -> "Scale":
        """Of a measure in SCORES; from `Meeting.references` and, whatever their names, best responses beside them.

        A robot knows the partners with whom its returns are numbers, see `only`.
        """
        means = {name: _gated(found)[measure].mean(1) for name, found in references.items()}
        zero = np.max([means[name] for name in NOBODYS], 0)
        known = [mean for name, mean in means.items() if name not in (*NOBODYS, CONSIDERATE)]
        return cls(zero, np.fmax.reduce([np.full_like(zero, np.nan), *known]))

    @property
    def scored(self) -> np.ndarray:
        """[partners] whether somebody who knows the partner is clearly better than who knows nobody."""
        return np.nan_to_num(self.one - self.zero, nan=-1.0) > LEAST * np.abs(np.nan_to_num(self.one))

    def __call__(self, returns: np.ndarray) -> np.ndarray:
        """Scores of returns [..., partners]; NaN for partners who are not scored."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.scored, (returns - self.zero) / (self.one - self.zero), np.nan)


def scales(references: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, Scale]:
    """By name the Scale of every score that these references give, see SCORES."""
    there = _gated(next(iter(references.values())))
    return {name: Scale.of(references, measure) for name, measure in SCORES.items() if measure in there}


def by_pair(
    seeds: Sequence[Mapping[str, np.ndarray]], scales: Mapping[str, Scale] | None = None
) -> dict[str, np.ndarray]:
    """Means over episodes, by measure [seeds, partners], of what one method's robots, a seed each, reach.

    With preferences also "gated_preference_return", to which only episodes add in which the task succeeded, and
    "gated_return" with it in place of the preference return; scores of the partners who are scored.
    """
    each = [_gated(one) for one in seeds]
    found = {name: np.stack([one[name].mean(1) for one in each]) for name in each[0]}
    for name, scale in (scales or {}).items():
        if scale.scored.any():
            found[name] = scale(found[SCORES[name]])[:, scale.scored]
    return found


def summarize(pairs: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """What `by_pair` found of one method, ready for JSON; without measures of which no partner has a number.

    Returns:
      by measure "mean", "ci" (95 %, for new seeds and new partners, see crossed_ci), "by_partner" [partners] (None for
      those whom a reference does not know) and "worst", the mean over the worst tenth of the partners.
    """
    return {name: _measure(name, x) for name, x in pairs.items() if not np.isnan(x).any(0).all()}


def gap(known: Mapping[str, np.ndarray], strange: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """The coordination gap by measure, of what `by_pair` found with partners of training and with held-out ones.

    "mean", of the first less that of the second, and "ci", see gap_ci.
    """
    found = {}
    for name, x in known.items():
        if name in strange:
            interval, most = gap_ci(x, strange[name]), 1.0 if name in (*RATES, *HURT) else np.inf
            found[name] = {"mean": float(x.mean() - strange[name].mean()), "ci": _bounded(interval, -most, most)}
    return found


def _gated(found: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """With what preferences pay counted only where the task succeeded, if there are preferences."""
    if "preference_return" not in found:
        return dict(found)
    gated = found["preference_return"] * found["success"]
    whole = found["return"] - found["preference_return"] + gated
    return {**found, "gated_preference_return": gated, "gated_return": whole}


def _measure(name: str, x: np.ndarray) -> dict[str, Any]:
    everybody, x = x.mean(0), x[:, ~np.isnan(x).any(0)]
    by_partner, interval = x.mean(0), crossed_ci(x)
    number = max(1, round(WORST * len(by_partner)))
    worst = np.sort(by_partner)[-number:] if name in HARM else np.sort(by_partner)[:number]
    if name in (*RATES, *HARM):
        interval = _bounded(interval, 0.0, 1.0 if name in (*RATES, *HURT) else np.inf)
    return {
        "mean": float(x.mean()),
        "ci": interval,
        "worst": float(worst.mean()),
        "by_partner": [None if np.isnan(value) else round(float(value), 4) for value in everybody],
        "by_seed": [round(float(value), 4) for value in x.mean(1)],
    }


def _bounded(interval: tuple[float, float] | None, low: float, high: float) -> tuple[float, float] | None:
    """The part of an interval, or None, that can be: Student's t knows no bounds."""
    return None if interval is None else (max(interval[0], low), min(interval[1], high))
