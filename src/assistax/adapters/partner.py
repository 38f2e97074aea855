"""What the adapters have in common: batches of environments in which frozen partners play some of the agents."""

from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from assistax.env import Env, EnvState, Obs, make
from assistax.errors import UsageError, choose
from assistax.learning.partners import Partners
from assistax.policies import Player, check_acts
from assistax.pytree import pytree
from assistax.tasks import TaskSpec, task_spec
from assistax.training.configuration import people_of
from assistax.training.partners import find_partner
from assistax.training.population import Population

Who = str | Path | Player | Population
"""A frozen partner: "still", "trained", ..., see `training.partners.find_partner`; a population or a part of one, whose
people are then the environment's; or a player of one's own."""


def find_player(who: Who, env: Env, agent: str) -> Player:
    """The frozen partner who plays the agent; raises UsageError for one who cannot."""
    choose("agent", agent, env.agents)
    if not isinstance(who, Player):
        return find_partner(who if isinstance(who, Population) else str(who), env, agent).player
    who.check(env)
    obs, state = jax.eval_shape(env.reset, jax.random.key(0))
    check_acts(who, agent, obs[agent], state, env.action_sizes[agent])
    return who


def episode_keys(rng: np.random.Generator, n: int) -> jax.Array:
    """n keys drawn from NumPy's generator."""
    return jax.random.wrap_key_data(jnp.asarray(rng.integers(2**32, size=(n, 2), dtype=np.uint32)))


def check_action(action: Any, shape: tuple[int, ...], agent: str) -> np.ndarray:
    """The agent's action as an array; raises UsageError unless it has this shape and is finite."""
    action = np.asarray(action, np.float32)
    if action.shape != shape:
        raise UsageError(f"The {agent}'s action must have the shape {shape}, not {action.shape}.")
    if not np.isfinite(action).all():
        raise UsageError(f"The {agent}'s action is not finite.")
    return action


@pytree
class BatchState:
    """n environments side by side, with the partners in them."""

    env: EnvState  # [n]
    obs: Obs  # by agent [n, size], what comes before the next step
    first: jax.Array  # [n] whether the next step is the first of an episode
    waiting: jax.Array  # [n] whether the next step shows the new episode, without an action; of "next_step" only
    partners: dict[str, Any]
    key: jax.Array


class Step(NamedTuple):
    """What a step returns."""

    obs: Obs  # by agent [n, size]
    reward: jax.Array  # [n], of all agents
    terminated: jax.Array  # [n]
    truncated: jax.Array  # [n]
    info: dict[str, Any]  # as Env.step


class Batch:
    """Compiled functions of whole batches of one environment; holds no state but the programs.

    The frozen partners are arguments, so that environments with other parameters of the same partner share a program.
    An agent is a learner unless `players` has one for it.
    """

    def __init__(self, env: Env):
        self.env = env
        self.reset, self.step = jax.jit(self._reset), jax.jit(self._step, static_argnums=0)
        self.reset_where = jax.jit(self._reset_where)

    def _reset(
        self, players: Mapping[str, Player], keys: jax.Array, elapsed: jax.Array | int = 0
    ) -> tuple[Obs, BatchState]:
        """Begin an episode with each of keys [n]; `elapsed` [n] or one for all, as in Env.reset."""
        n = len(keys)
        keys, own = jnp.moveaxis(jax.vmap(jax.random.split)(keys), 1, 0)
        obs, state = jax.vmap(self.env.reset)(keys, jnp.broadcast_to(elapsed, n))
        key, partner_key = jax.random.split(own[0])
        partners = Partners(self.env, n, players).init(partner_key)
        return obs, BatchState(state, obs, jnp.ones(n, bool), jnp.zeros(n, bool), partners, key)

    def _reset_where(self, players: Mapping[str, Player], mask: jax.Array, keys: jax.Array, state: BatchState):
        """`reset` where mask [n] is true, as it was elsewhere."""
        _, fresh = self._reset(players, keys)
        state = _where(mask, fresh, state)
        return state.obs, state

    def _step(
        self, autoreset: str, players: Mapping[str, Player], state: BatchState, actions: Obs
    ) -> tuple[BatchState, Step]:
        """One control step.

        Args:
          autoreset: "same_step": `obs` begins the next episode and info["final_observation"] ends the old one;
            "next_step": `obs` ends the old one and the next step, whose action is ignored and whose reward is 0,
            begins the next; "disabled": `obs` ends it, and what comes after means nothing.
          actions: by learner [n, size].
        """
        n = len(state.first)
        if autoreset == "disabled" and self.env.config.human.redraw_every > 1:
            raise UsageError("Who stays for several episodes stays over automatic resets only: env.human.redraw_every.")
        key, partner_key, env_key, redraw_key = jax.random.split(state.key, 4)
        partners = Partners(self.env, n, players)
        moved, carried = partners.act(state.partners, state.env, state.obs, state.first, partner_key)
        advance = self.env.step_env if autoreset == "disabled" else self.env.step
        obs, env, rewards, terminated, truncated, info = jax.vmap(advance)(
            jax.random.split(env_key, n), state.env, moved | {agent: actions[agent] for agent in partners.learners}
        )
        reward, terminated, truncated = rewards[self.env.agents[0]], terminated["__all__"], truncated["__all__"]
        done = terminated | truncated
        after = BatchState(env, obs, done, jnp.zeros_like(done), partners.redraw(carried, env, done, redraw_key), key)
        if autoreset != "next_step":
            return after, Step(obs, reward, terminated, truncated, info)
        # Who waits stays where the automatic reset has put them; the step that all took is lost on them.
        waits = state.waiting
        final = info["final_observation"]
        shown = {agent: jnp.where(waits[:, None], state.obs[agent], final[agent]) for agent in final}
        info["final_observation"] = shown
        for name in ("fault", "cost", "robot_force", "reward_terms"):  # nothing happened to them
            info[name] = jax.tree.map(lambda x: jnp.where(waits, jnp.zeros_like(x), x), info[name])
        ends = (terminated & ~waits, truncated & ~waits)
        after = _where(waits, state, after)
        after = BatchState(after.env, after.obs, after.first, done & ~waits, after.partners, key)
        return after, Step(shown, jnp.where(waits, 0.0, reward), *ends, info)


def _where(mask: jax.Array, new: BatchState, old: BatchState) -> BatchState:
    """By environment; the key is the old one's."""

    @jax.vmap
    def choose_one(mask, new, old):
        return jax.tree.map(partial(jnp.where, mask), new, old)

    parts = [(s.env, s.obs, s.first, s.waiting, s.partners) for s in (new, old)]
    return BatchState(*choose_one(mask, *parts), old.key)


def batch_of(task: str | Env, engine: str = "auto", settings: Mapping[str, Any] | None = None) -> Batch:
    """The programs of an environment; those of the same task, engine and settings are compiled once.

    `settings` are as in `make`; an Env has its own.
    """
    settings = dict(settings or {})
    if isinstance(task, Env):
        if settings or engine not in ("auto", task.engine.name):
            raise UsageError("An environment that is made already has its own engine and settings; give the task's id.")
        return _batch_of_env(task)
    try:
        hash(tuple(settings.items()))
    except TypeError:
        return Batch(make(task, engine, **settings))
    return _batch_of_env(_env_of(task_spec(task), engine, tuple(sorted(settings.items()))))


BOTH = "both"  # agents learn; there is no partner


def beside(
    task: str | Env, agent: str, partner: Who, engine: str, settings: Mapping[str, Any], both: bool = False
) -> tuple[Batch, dict[str, Player]]:
    """The programs for one agent, and by agent who plays the other; with `both`, the agent may be BOTH: nobody."""
    if isinstance(task, str) and agent == "robot":
        settings = {**_people_of(partner), **settings}
    batch = batch_of(task, engine, settings)
    agents = batch.env.agents
    choose("agent", agent, (*agents, BOTH) if both else agents)
    if agent == BOTH:
        if partner != "still":
            raise UsageError(f'With agent="{BOTH}" nobody is left for a partner to play; leave the partner out.')
        return batch, {}
    other = next(other for other in agents if other != agent)
    return batch, {other: find_player(partner, batch.env, other)}


def _people_of(partner: Who) -> dict[str, Any]:
    """The settings of `make` that a population brings along as the human."""
    if isinstance(partner, Player):
        return {}
    found = people_of([partner if isinstance(partner, Population) else f"human={partner}"])
    return {name.removeprefix("env."): value for name, value in found.items()}


@lru_cache(maxsize=4)
def _env_of(spec: TaskSpec, engine: str, settings: tuple) -> Env:
    return make(spec.id, engine, **dict(settings))


@lru_cache(maxsize=4)
def _batch_of_env(env: Env) -> Batch:
    return Batch(env)
