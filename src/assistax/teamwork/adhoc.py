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
from assistax.evaluation.statistics import crossed_ci
from assistax.policies import Player, scripted_policy
from assistax.settings import check_count
from assistax.training.population import Population

MEASURES = ("return", "success", "safe_success", "task_return", "preference_return", "peak_force")
MEASURES += ("seconds_above_comfort", "clamping", "impact")
RATES = ("success", "safe_success")
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
        self.env, self.population, self.episodes = env, population, episodes
        self.partner = population.partner("human", env=env)
        self._people = np.repeat(np.arange(len(population)), episodes)
        self._evaluator = Evaluator(env, len(self._people))

    def __call__(self, robot: Player, seed: int = EVALUATION_SEED) -> dict[str, np.ndarray]:
        """MEASURES by name, [partners, episodes]; the same draws for every robot."""
        result = self._evaluator({"robot": robot, "human": self.partner}, seed, self._people)
        found = result["metrics"]
        return {k: np.asarray(found[k], float).reshape(-1, self.episodes) for k in MEASURES if k in found}

    def references(self) -> dict[str, dict[str, np.ndarray]]:
        """What robots reach that know nobody (NOBODYS), CONSIDERATE, and each partner's own robot ("own")."""
        named = (*NOBODYS, CONSIDERATE) if self.env.config.human.preferring else NOBODYS
        found = {name: self.scripted(name) for name in named}
        if all(row["robot"] for row in self.population.rows):
            found["own"] = self(self.population.partner("robot", deterministic=True))
        return found

    def scripted(self, name: str, seed: int = EVALUATION_SEED) -> dict[str, np.ndarray]:
        """What the scripted robot of this name reaches."""
        return self(Player(scripted_policy(name, self.env, "robot")), seed)


@dataclass(frozen=True)
class Scale:
    """Returns as scores by partner: 0 for the best robot that knows nobody, 1 for the best that knows this partner."""

    zero: np.ndarray  # [partners]
    one: np.ndarray  # [partners]

    @classmethod
    def of(cls, references: Mapping[str, Mapping[str, np.ndarray]]) -> "Scale":
        """From `Meeting.references`, and best responses beside them, whatever their names."""
        means = {name: found["return"].mean(1) for name, found in references.items()}
        zero = np.max([means[name] for name in NOBODYS], 0)
        known = [mean for name, mean in means.items() if name not in (*NOBODYS, CONSIDERATE)]
        return cls(zero, np.max(known, 0) if known else np.full_like(zero, np.nan))

    @property
    def scored(self) -> np.ndarray:
        """[partners] whether somebody who knows the partner is clearly better than who knows nobody."""
        return np.nan_to_num(self.one - self.zero, nan=-1.0) > LEAST * np.abs(np.nan_to_num(self.one))

    def __call__(self, returns: np.ndarray) -> np.ndarray:
        """Scores of returns [..., partners]; NaN for partners who are not scored."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.scored, (returns - self.zero) / (self.one - self.zero), np.nan)


def summarize(seeds: Sequence[Mapping[str, np.ndarray]], scale: Scale | None = None) -> dict[str, Any]:
    """What one method's robots, a seed each, reach with the same partners; ready for JSON.

    Returns:
      by measure "mean", "ci" (95 %, for new seeds and new partners, see crossed_ci), "by_partner" [partners] and
      "worst", the mean over the worst tenth of the partners; "gated_preference_return" counts only episodes in which
      the task succeeded; "score" with a scale, over the partners who are scored.
    """
    found: dict[str, np.ndarray] = {
        k: np.stack([one[k].mean(1) for one in seeds]) for k in seeds[0]
    }  # [seeds, partners]
    if "preference_return" in found:
        gated = [(one["preference_return"] * one["success"]).mean(1) for one in seeds]
        found["gated_preference_return"] = np.stack(gated)
    if scale is not None and scale.scored.any():
        found["score"] = scale(found["return"])[:, scale.scored]
    return {name: _measure(name, x) for name, x in found.items()}


def gap(train: Mapping[str, Any], test: Mapping[str, Any]) -> dict[str, float]:
    """The coordination gap by measure: the mean with partners of training, less that with held-out ones."""
    return {name: train[name]["mean"] - test[name]["mean"] for name in train if name in test}


def _measure(name: str, x: np.ndarray) -> dict[str, Any]:
    by_partner, interval = x.mean(0), crossed_ci(x)
    number = max(1, round(WORST * len(by_partner)))
    low = name in ("return", *RATES, "score")
    worst = np.sort(by_partner)[:number] if low else np.sort(by_partner)[-number:]
    if interval is not None and name in RATES:  # Student's t knows no bounds
        interval = max(interval[0], 0.0), min(interval[1], 1.0)
    return {
        "mean": float(x.mean()),
        "ci": interval,
        "worst": float(worst.mean()),
        "by_partner": [round(float(value), 4) for value in by_partner],
        "by_seed": [round(float(value), 4) for value in x.mean(1)],
    }
