"""Adaptation: several episodes in a row with one partner, the robot's memory kept from one to the next.

A robot that finds out with whom it works gets better from episode to episode, and what it has found out can be read
from its memory: a linear probe predicts from it what the person likes, and the body. The oracle, who is told, is the
positive control.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax import programs
from assistax.env import Env
from assistax.errors import UsageError
from assistax.evaluation import turns
from assistax.evaluation.playing import EVALUATION_SEED, MOST_AT_ONCE
from assistax.evaluation.statistics import crossed_ci
from assistax.human import disability, preference
from assistax.human.profile import stack
from assistax.physics import check_faults
from assistax.policies import Player, Policy
from assistax.settings import check_count
from assistax.stamp import stamp
from assistax.teamwork.adhoc import MEASURES, draws
from assistax.teamwork.report import Meetings, meeting_env
from assistax.teamwork.scores import Scale
from assistax.teamwork.strangers import check_robots, check_strangers
from assistax.training.population import Population
from assistax.training.run import Run

PROBED = (1.0, 2.0, 4.0, 8.0)  # s of the first episode, after which the memory is read
RIDGE = 0.1  # penalty of the probe, for standardised memories


@dataclass(frozen=True)
class Lasting:
    """A policy whose memory does not end with an episode."""

    policy: Policy

    def initial_carry(self):
        return self.policy.initial_carry()

    def act(self, params, carry, obs, reset, key):
        return self.policy.act(params, carry, obs, jnp.zeros_like(reset), key)


class Series:
    """Episodes in a row with every partner of a population; compiled once for robots of one policy.

    Args:
      env: where, with the population's people.
      population: the partners.
      in_a_row: episodes with the same partner, between which the robot's memory is kept.
      repeats: such series with each partner.
    """

    def __init__(self, env: Env, population: Population, in_a_row: int, repeats: int):
        check_count("in_a_row", in_a_row)
        check_count("repeats", repeats)
        if env.config.human.people != population.people:
            raise UsageError("The environment's people (env.human.people) must be the population's.")
        self.env, self.population, self.in_a_row, self.repeats = env, population, in_a_row, repeats
        self._people = np.repeat(np.arange(len(population)), repeats)
        self._partner = population.partner("human", env=env)
        self._read = [t for t in (round(s / env.dt) - 1 for s in PROBED) if t < env.episode_length]
        self._play = programs.jit(jax.vmap(self._one, (None, 0, 0)))

    def __call__(self, robot: Player, seed: int = EVALUATION_SEED) -> dict[str, np.ndarray]:
        """MEASURES by name, [partners, repeats, in_a_row]; the same draws for every robot.

        "memory" [partners, repeats, times, numbers] is the robot's after PROBED seconds of the first episode, without
        numbers if it has none.
        """
        robot = Player(Lasting(robot.policy), robot.params, robot.members)
        keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(seed), draws(self.population, self.repeats))
        parts = []
        for start in range(0, len(keys), MOST_AT_ONCE):
            ids = np.minimum(np.arange(start, start + min(MOST_AT_ONCE, len(keys))), len(keys) - 1)
            out = self._play({"robot": robot, "human": self._partner}, keys[ids], jnp.asarray(self._people[ids]))
            out = jax.tree.map(lambda x, start=start: np.asarray(x)[: len(keys) - start], out)
            check_faults(out.pop("fault"), self.env.engine.name)
            parts.append(out)
        found = jax.tree.map(lambda *xs: np.concatenate(xs), *parts)
        return {name: x.reshape(len(self.population), self.repeats, *x.shape[1:]) for name, x in found.items()}

    def _one(self, team, key, person):
        env = self.env

        def episode(carry, key):
            params, turn = turns.begin(env, team, key, person)
            turn = turn._replace(carries=turn.carries | {"robot": carry})

            def step(seen, key):
                turn, playing = seen
                after, info, over = turns.advance(env, team, params, turn, key)
                # What follows the end of an episode that the task ended early changes nothing.
                turn = jax.tree.map(lambda new, old: jnp.where(playing, new, old), after, turn)
                memory = jnp.concatenate(
                    [x.ravel() for x in jax.tree.leaves(_memory(turn.carries["robot"]))] or [_NONE]
                )
                return (turn, playing & ~over), (jnp.where(playing, info["fault"], 0), memory)

            start = turn, jnp.bool_(True)
            (turn, _), (fault, memory) = jax.lax.scan(step, start, jax.random.split(key, env.episode_length))
            metrics = env.metrics(turn.state)
            measured = {name: metrics[name] for name in MEASURES if name in metrics}
            return turn.carries["robot"], measured | {"fault": fault.max(), "memory": memory[np.array(self._read, int)]}

        first = team["robot"].initial_carry()
        _, found = jax.lax.scan(episode, first, jax.random.split(key, self.in_a_row))
        return found | {"fault": found["fault"].max(), "memory": found["memory"][0]}


_NONE = jnp.zeros(0)


def _memory(carry: Any) -> Any:
    """What an Actor remembers: its carry is its memory and its noise."""
    return carry[0] if isinstance(carry, tuple) and carry else ()


def slope(scores: np.ndarray) -> np.ndarray:
    """What an episode more with the same partner is worth: least squares over the last axis of [..., in_a_row]."""
    x = np.arange(scores.shape[-1]) - (scores.shape[-1] - 1) / 2
    return scores @ x / (x @ x)


def probe(memory: np.ndarray, truth: np.ndarray, groups: np.ndarray, folds: int = 5) -> float:
    """How much of the truth can be read from a memory: R² of ridge regression, of partners that it was not fitted to.

    Args:
      memory: [n, numbers].
      truth: [n, m]; columns that do not vary are left out, the others standardised.
      groups: [n] the partner's index: a fold holds whole partners.

    Returns:
      mean over the columns: 1 is all, 0 or below nothing; NaN where there is no memory or too few partners.
    """
    partners = np.unique(groups)
    varies = np.ptp(truth, axis=0) > 1e-9
    if memory.shape[1] == 0 or len(partners) < folds or not varies.any():
        return float("nan")
    truth = (truth[:, varies] - truth[:, varies].mean(0)) / truth[:, varies].std(0)
    scale = memory.std(0)
    memory = (memory - memory.mean(0)) / np.where(scale > 1e-9, scale, 1.0)
    wrong = np.zeros(truth.shape)
    for fold in range(folds):
        out = np.isin(groups, partners[fold::folds])
        x, y = memory[~out], truth[~out]
        offset = x.mean(0), y.mean(0)
        x = x - offset[0]
        weights = np.linalg.solve(x.T @ x + RIDGE * len(x) * np.eye(x.shape[1]), x.T @ (y - offset[1]))
        wrong[out] = truth[out] - offset[1] - (memory[out] - offset[0]) @ weights
    return float(np.mean(1.0 - (wrong**2).mean(0) / (truth**2).mean(0)))


def about(population: Population) -> dict[str, np.ndarray]:
    """What a robot may find out: the partners' "preference" [partners, 7] and "body" [partners, 4]."""
    people = stack(population.people)
    preferences, bodies = jax.vmap(preference.vector)(people.preference), jax.vmap(disability.vector)(people.disability)
    return {"preference": np.asarray(preferences, float), "body": np.asarray(bodies, float)}


def summarize_series(
    seeds: Sequence[dict[str, np.ndarray]], truths: Mapping[str, np.ndarray], scale: Scale | None = None
) -> dict[str, Any]:
    """What one method's robots, a seed each, reach in series with the same partners; ready for JSON.

    Args:
      seeds: what `Series` returned of each.
      truths: what is looked for in their memories, see `about`.
      scale: of their returns, for a "score" beside the other measures, over those who are scored, if they are enough.

    Returns:
      by measure "by_episode", a mean for each episode of a row, and its "slope" with the 95 % interval "ci" for new
      seeds and new partners; "probe": by truth and seconds of the first episode R², a mean over seeds.
    """
    found: dict[str, Any] = {}
    by_episode = {name: np.stack([one[name].mean(1) for one in seeds]) for name in seeds[0].keys() & set(MEASURES)}
    if scale is not None and scale.enough:
        scores = scale(np.moveaxis(by_episode["return"], 1, -1))[..., scale.scored]
        by_episode["score"] = np.moveaxis(scores, -1, 1)
    for name, means in by_episode.items():  # [seeds, partners, in_a_row]
        found[name] = {"by_episode": [round(float(x), 4) for x in means.mean((0, 1))]}
        if means.shape[-1] > 1:
            found[name] |= {"slope": float(slope(means).mean()), "ci": crossed_ci(slope(means))}
    partners, repeats, times, _ = seeds[0]["memory"].shape
    groups = np.repeat(np.arange(partners), repeats)
    found["probe"] = {name: {} for name in truths}
    for name, truth in truths.items():
        for t, seconds in enumerate(PROBED[:times]):
            memories = [one["memory"][:, :, t].reshape(len(groups), -1) for one in seeds]
            r2 = np.mean([probe(memory, truth[groups], groups) for memory in memories])
            found["probe"][name][f"{seconds:g}"] = None if np.isnan(r2) else round(float(r2), 4)
    return found


def adaptation(
    methods: Mapping[str, Sequence[Run]],
    population: Population,
    in_a_row: int = 5,
    repeats: int = 4,
    seed: int = EVALUATION_SEED,
) -> dict[str, Any]:
    """Every method's robots in series with every partner.

    Args:
      methods: by name the runs whose robots are measured; a run's seeds are the method's.
      population: the partners, held-out ones.
      in_a_row, repeats: see Series.
      seed: of the draws.

    Returns:
      ready for JSON: "task", "partners" (ids), "in_a_row", "repeats" and "methods" (see summarize_series).

    Raises:
      UsageError: a run of another task, whose robot did not learn, or that was trained with one of the partners.
    """
    runs = [run for some in methods.values() for run in some]
    check_robots(runs, {"test": population})
    check_strangers(runs, {"test": population})
    envs = {
        run.folder: meeting_env(run, population) for run in runs
    }  # who does not fit is refused before anybody plays
    scale = Scale.of(Meetings(runs[0].config, population, repeats).plain.references(seed))
    truths, found = about(population), {}
    for name, runs in methods.items():
        seeds = []
        for run in runs:
            series = Series(envs[run.folder], population, in_a_row, repeats)
            seeds += [series(team["robot"], seed) for team in run.teams()]
        found[name] = summarize_series(seeds, truths, scale)
    sizes = {"in_a_row": in_a_row, "repeats": repeats, "seed": seed}
    return {"task": population.task, "partners": list(population.ids), **sizes, "methods": found} | stamp()
