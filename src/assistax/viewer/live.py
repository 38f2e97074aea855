"""An episode that is played some steps at a time, while somebody watches and pushes."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from assistax.env import Env
from assistax.evaluation import turns
from assistax.evaluation.filmed import Filmed
from assistax.physics import PUSH, check_faults
from assistax.policies import Team, check_team


class Played(NamedTuple):
    """The episode so far."""

    params: dict[str, Any]
    turn: turns.Turn
    steps: jax.Array  # int32
    over: jax.Array  # bool
    fault: jax.Array  # see PhysicsState
    terms: dict[str, jax.Array]  # of the reward, of the last step
    sums: dict[str, jax.Array]  # of the reward's terms, over the episode


class Live:
    """One episode at a time of a team in an environment.

    Args:
      env, team: as for an Evaluator.
      seed: of the first episode's draws.
    """

    def __init__(self, env: Env, team: Team, seed: int):
        check_team(team, env)
        self.env, self.team, self.seed = env, team, seed
        self.spots = turns.spots(env)
        self._begin, self._advance = jax.jit(self._first), jax.jit(self._some)
        self.unpushed = np.zeros((env.model.nbody, 6), np.float32)
        self.begin(seed)
        self.advance(0)  # compiles

    def begin(self, seed: int) -> None:
        """Another episode."""
        self.seed = seed
        self._key = jax.random.key(seed)
        self._take(self._begin(self.team, self._key))

    def advance(self, steps: int, push: np.ndarray | None = None) -> None:
        """Play on, until the episode is over.

        Args:
          steps: control steps.
          push: as physics.PUSH says, during all of them.

        Raises:
          SimulationError: the physics failed; the episode is over.
        """
        played = self._played
        self._take(self._advance(self.team, played, self._key, self.unpushed if push is None else push, steps))
        check_faults(self._played.fault, self.env.engine.name)

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return bool(self._played.over)

    @property
    def steps(self) -> int:
        """Control steps so far."""
        return int(self._played.steps)

    def terms(self) -> dict[str, tuple[float, float]]:
        """The reward's terms by name: in the last step, and summed over the episode."""
        return {name: (float(now), float(self._played.sums[name])) for name, now in self._played.terms.items()}

    def _take(self, result) -> None:
        self._played, seen = result
        seen = jax.tree.map(lambda x: np.asarray(x)[None], seen)
        self.moment = Filmed(self.env.name, self.env.dt, **seen, spots=self.spots, before=max(self.steps - 1, 0))

    def _first(self, team: Team, key):
        params, turn = turns.begin(self.env, team, key)
        after = jax.eval_shape(lambda: turns.advance(self.env, team, params, turn, key))[1]
        zeros = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), after["reward_terms"])
        played = Played(params, turn, jnp.int32(0), jnp.bool_(False), jnp.int32(0), zeros, zeros)
        return played, turns.seen(self.env, turn.state)

    def _some(self, team: Team, played: Played, key, push, steps):
        def step(carry):
            left, played = carry
            turn = _pushed(played.turn, push)
            step_key = jax.random.fold_in(key, played.steps)
            turn, info, over = turns.advance(self.env, team, played.params, turn, step_key)
            terms = info["reward_terms"]
            sums = {name: played.sums[name] + x for name, x in terms.items()}
            after = Played(played.params, _pushed(turn, None), played.steps + 1, over, info["fault"], terms, sums)
            return left - 1, after

        start = jnp.asarray(steps, jnp.int32), played
        _, played = jax.lax.while_loop(lambda carry: (carry[0] > 0) & ~carry[1].over, step, start)
        return played, turns.seen(self.env, played.turn.state)


def _pushed(turn: turns.Turn, push) -> turns.Turn:
    """With this push in the physics, or without any."""
    physics = turn.state.physics
    overrides = {name: x for name, x in physics.overrides.items() if name != PUSH}
    overrides |= {} if push is None else {PUSH: push}
    return turn._replace(
        state=dataclasses.replace(turn.state, physics=dataclasses.replace(physics, overrides=overrides))
    )
