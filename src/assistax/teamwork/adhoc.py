"""Robots beside partners, each of whom they meet as often as any other; `scores` makes a table of it."""

from collections.abc import Mapping

import numpy as np

from assistax.env import Env
from assistax.errors import UsageError
from assistax.evaluation.playing import EVALUATION_SEED, Evaluator
from assistax.policies import Player, scripted_policy
from assistax.settings import check_count
from assistax.training.population import Population

RATES = ("success", "safe_success")
HURT = ("clamping", "impact")  # rates, too
HARM = (*HURT, "peak_force", "seconds_above_comfort")  # of which less is better
MEASURES = ("return", *RATES, "task_return", "preference_return", *HARM)
NOBODYS = ("still", "random", "expert")  # robots that know nobody
CONSIDERATE = "considerate"  # the expert told the preferences


class Meeting:
    """All partners of a population, or part of one, in their order; compiled once for robots of one policy.

    Args:
      env: where, with the population's people; robots may know less of them than here, see `Meeting.of`.
      population: the partners.
      episodes: with each partner.
    """

    def __init__(self, env: Env, population: Population, episodes: int):
        check_count("episodes", episodes)
        if env.name != population.task:
            raise UsageError(f"The population is of {population.task} and cannot be met in {env.name}.")
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
