"""Play a team on fixed seeds and say how it did: whole episodes, each counted once."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from assistax import programs
from assistax.devices import by_environment
from assistax.env import Env
from assistax.evaluation import turns
from assistax.evaluation.distribution import Distribution
from assistax.evaluation.filmed import Filmed
from assistax.evaluation.statistics import bootstrap_ci, proportion_ci
from assistax.human import harm
from assistax.physics import check_faults
from assistax.policies import Team, check_team
from assistax.settings import check_count, check_seed

EVALUATION_SEED = 20_260_000  # evaluation draws are the same for all runs, and not those of training
MOST_AT_ONCE = 256  # episodes side by side; more are played in turns, so that memory does not grow with them


class Evaluator:
    """Plays whole episodes in one environment with any team; compiled once for teams of the same policies.

    Args:
      env: where.
      episodes: how many.
    """

    def __init__(self, env: Env, episodes: int):
        check_count("episodes", episodes)
        self.env, self.episodes = env, episodes
        turns = -(-episodes // MOST_AT_ONCE)
        self._at_once = -(-episodes // turns)
        self._play = programs.jit(by_environment(self._one, whole=1))

    def __call__(
        self, team: Team, seed: int = EVALUATION_SEED, people: Any = None, draws: Any = None
    ) -> dict[str, Any]:
        """Play.

        Args:
          team: who.
          seed: of what episodes draw.
          people: [episodes] rows of the environment's list of people, who it is in each episode. None draws people.
          draws: [episodes] numbers below 2³² of what each episode draws; None has others for each.

        Returns:
          arrays by name, first axis the episode: "terms" (each reward term's sum over the episode),
          "metrics" (see Env.metrics, at the episode's last step), "person" the row of the list of people that the
          reset drew; "force", a Distribution in N over all steps of all episodes; "filmed", what a film needs of the
          episode that is `typical` among the first MOST_AT_ONCE, a Filmed.

        Raises:
          UsageError: an agent without a Player, or one who cannot act on what it observes here.
        """
        check_seed("seed", seed)
        check_team(team, self.env)
        people = None if people is None else np.asarray(people, np.int32)
        if draws is None:
            keys = jax.random.split(jax.random.key(seed), self.episodes)
        else:
            keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(seed), np.asarray(draws, np.uint32))
        force, parts = Distribution(), []
        first: Any = None
        for start in range(0, self.episodes, self._at_once):
            ids = np.arange(start, start + self._at_once)
            fresh = ids < self.episodes  # the last turn is filled up with its last episode, for one compiled program
            ids = np.minimum(ids, self.episodes - 1)
            who = None if people is None else people[ids]
            out = jax.tree.map(np.asarray, self._play(team, keys[ids], who))
            out = jax.tree.map(lambda x, fresh=fresh: x[fresh], out)
            check_faults(out.pop("fault"), self.env.engine.name)
            turn = out.pop("playing"), out.pop("series")
            force.add(out.pop("robot_force")[turn[0]])
            first = first or turn  # all turns' would not fit into memory
            parts.append(out)
        result = jax.tree.map(lambda *xs: np.concatenate(xs), *parts) | {"force": force}
        playing, series = first
        episode = typical(result["metrics"]["return"], len(playing))
        series = jax.tree.map(lambda x: x[episode][playing[episode]], series)
        return result | {"filmed": Filmed(self.env.name, self.env.dt, **series, spots=turns.spots(self.env))}

    def _one(self, team: Team, key, person):
        env = self.env
        reset_key, key = jax.random.split(key)
        params, turn = turns.begin(env, team, reset_key, person)
        person = turn.state.person.index

        def step(carry, key):
            turn, playing = carry
            turn, info, over = turns.advance(env, team, params, turn, key)
            out = {k: info[k] for k in ("reward_terms", "robot_force", "fault")}
            out |= {"playing": playing, "series": turns.seen(env, turn.state)}
            return (turn, playing & ~over), out

        keys = jax.random.split(key, env.config.episode_length)
        _, out = jax.lax.scan(step, (turn, jnp.bool_(True)), keys)
        on = out["playing"]
        last = on.sum() - 1
        return {
            "terms": jax.tree.map(lambda x: jnp.sum(x * on), out["reward_terms"]),
            "metrics": jax.tree.map(lambda x: x[last], out["series"]["metrics"]),
            "person": person,
            "fault": jnp.where(on, out["fault"], 0).max(),
            **{name: out[name] for name in ("robot_force", "playing", "series")},
        }


def play(env: Env, team: Team, episodes: int, seed: int = EVALUATION_SEED) -> dict[str, Any]:
    """Play a team once, see Evaluator."""
    return Evaluator(env, episodes)(team, seed)


def by_episode(result: dict[str, Any]) -> dict[str, Any]:
    """Metrics and terms of what an Evaluator returned, ready for JSON: lists with a number per episode."""
    return jax.tree.map(lambda x: np.round(x.astype(float), 4).tolist(), {k: result[k] for k in ("metrics", "terms")})


def summarize(result: dict[str, Any]) -> dict[str, Any]:
    """Means with 95 % intervals over episodes, as plain numbers ready for JSON.

    The 95th percentile of the force is right to 0.025 %, see Distribution.
    """
    metrics = dict(result["metrics"])
    returns, success = metrics.pop("return"), metrics.pop("success")
    force: Distribution = result["force"]
    apart = [name for name in ("task_return", "preference_return") if name in metrics]  # only with preferences
    harmed = [name for name in harm.OUTCOMES if name in metrics]  # from version 1 of a task on
    safe = metrics.pop("safe_success") if harmed else np.zeros(0)
    return {
        "episodes": len(returns),
        "mean_return": float(returns.mean()),
        "return_ci": bootstrap_ci(returns),
        **{name: _mean(metrics.pop(name)) for name in apart},
        "terms": {name: float(total.mean()) for name, total in result["terms"].items()},
        "success_rate": float(success.mean()),
        "success_ci": proportion_ci(int(success.sum()), len(success)),
        **({"safe_success_rate": float(safe.mean())} if harmed else {}),
        **({"safe_success_ci": proportion_ci(int(safe.sum()), len(safe))} if harmed else {}),
        **({"harm": {name: _mean(metrics.pop(name)) for name in harmed}} if harmed else {}),
        "force": {
            "mean": force.mean,
            "mean_in_contact": force.mean_positive,
            "p95": force.quantile(0.95),
            "peak": force.peak,
        },
        "outcomes": {name: _mean(x) for name, x in metrics.items()},
    }


def _mean(x: np.ndarray) -> dict[str, Any]:
    return {"mean": float(x.mean()), "ci": bootstrap_ci(x)}


def typical(returns: np.ndarray, first: int) -> int:
    """The episode with the median return, or the nearest to it among the first ones: what usually happens."""
    median = np.sort(returns)[len(returns) // 2]
    return int(np.argmin(np.abs(returns[:first] - median)))


def evaluate(env: Env, team: Team, episodes: int = 64, seed: int = EVALUATION_SEED) -> dict[str, Any]:
    """`summarize(play(...))`."""
    return summarize(play(env, team, episodes, seed))
