"""One agent in the interface of Brax, which the training code of MuJoCo Playground expects, too.

from brax.training.agents.ppo import train as ppo
from assistax.adapters.brax import AgentEnv, wrap

env = AgentEnv("scratch-v3", partner="still")
ppo.train(env, wrap_env_fn=wrap, episode_length=env.episode_length, num_timesteps=1_000_000, num_envs=1024)
"""

import dataclasses
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from assistax.adapters import missing
from assistax.adapters.partner import BOTH, BatchState, Who, beside
from assistax.env import Env, Obs
from assistax.errors import UsageError

try:
    from brax.envs.base import Env as BraxEnv
    from brax.envs.base import State, Wrapper
except ImportError as error:
    raise missing(error, "brax") from None

if not hasattr(jax, "device_put_replicated"):  # the training of Brax 0.14.2 calls what JAX 0.10 no longer has
    jax.device_put_replicated = lambda tree, devices: jax.tree.map(lambda x: jnp.stack([x] * len(devices)), tree)


class AgentEnv(BraxEnv):
    """One environment for one agent, whose partner is part of it; or for both agents as one.

    Pure functions, to be batched by `jax.vmap`. A step never resets, and `done` is the end of the task itself: time
    limit and automatic resets are the business of Brax's wrappers, or of `wrap`. `metrics`, which Brax sums over
    an episode, has the outcomes of the episode (`success`, `peak_force`, ..., see `Env.metrics`) at its last step and 0
    before, and the reward's terms as "reward/TERM". Where the simulation breaks the reward is NaN, so that Brax's
    losses tell.

    Args:
      task: its id, for example "scratch-v3", or an Env.
      agent: "robot", "human", or "both": one agent that observes what either of them does and acts with the
        robot's actions followed by the human's.
      partner: who plays the other one: "still", "random", "trained", a team file, a run folder, ..., see
        `training.partners.find_partner`; or a `Population` or `Player`.
      engine: as in `assistax.make`.
      **settings: as in `assistax.make`, for example `episode_length=500`.

    Raises:
      UsageError: a task, engine, setting or partner that cannot be used.
    """

    def __init__(
        self, task: str | Env, *, agent: str = "robot", partner: Who = "still", engine: str = "auto", **settings: Any
    ):
        self._batch, self._players = beside(task, agent, partner, engine, settings, both=True)
        self.assistax, self.agent = self._batch.env, agent
        self.episode_length, self.dt = self.assistax.episode_length, self.assistax.dt

    @property
    def observation_size(self) -> int:
        return self.assistax.global_size if self.agent == BOTH else self.assistax.observation_sizes[self.agent]

    @property
    def action_size(self) -> int:
        sizes = self.assistax.action_sizes
        return sum(sizes.values()) if self.agent == BOTH else sizes[self.agent]

    @property
    def backend(self) -> str:
        """The physics engine's name."""
        return self.assistax.engine.name

    def reset(self, rng: jax.Array) -> State:
        """Begin an episode."""
        state, obs, metrics = self.begin(rng[None])
        zero, metrics = jnp.zeros(()), {name: x[0] for name, x in metrics.items()}
        return State(_keyless(state), obs[0], zero, zero, metrics, {"key": state.key})

    def step(self, state: State, action: jax.Array) -> State:
        """One control step of 8 ms, action [action_size]."""
        after, step = self.advance("disabled", state, action[None])
        step = jax.tree.map(lambda x: x[0], step)
        return state.replace(
            pipeline_state=_keyless(after),
            obs=step.obs,
            reward=step.reward,
            done=step.terminated,
            metrics=state.metrics | step.metrics,
            info=state.info | {"key": after.key},
        )

    # -- the same of whole batches, for `wrap` -------------------------------------------------------

    def begin(self, keys: jax.Array, elapsed: jax.Array | int = 0) -> tuple[BatchState, jax.Array, dict]:
        """(state, observations [n, observation_size], metrics), for keys [n] and `elapsed` as in Env.reset."""
        obs, state = self._batch.reset(self._players, keys, elapsed)
        action = jnp.zeros((len(keys), self.action_size))
        names = jax.eval_shape(partial(self._step, "disabled"), state, action)[1].metrics
        return state, self._observed(obs, state), dict.fromkeys(names, jnp.zeros(len(keys)))

    def advance(self, autoreset: str, state: State, action: jax.Array) -> tuple[BatchState, "BraxStep"]:
        """One step of a batch, see `Batch.step`; action [n, action_size]."""
        return self._step(autoreset, dataclasses.replace(state.pipeline_state, key=state.info["key"]), action)

    def _step(self, autoreset, before, action):
        actions = {self.agent: action}
        if self.agent == BOTH:
            size = self.assistax.action_sizes["robot"]
            actions = {"robot": action[:, :size], "human": action[:, size:]}
        after, step = self._batch.step(autoreset, self._players, before, actions)
        ended, info = step.terminated | step.truncated, step.info
        metrics = {name: jnp.where(ended, x, 0.0) for name, x in info["metrics"].items() if name not in _BRAX_COUNTS}
        metrics |= {f"reward/{name}": x for name, x in info["reward_terms"].items()}
        return after, BraxStep(
            self._observed(step.obs, after),
            jnp.where(info["fault"] == 0, step.reward, jnp.nan),
            jnp.float32(step.terminated),
            jnp.float32(step.truncated),
            metrics,
        )

    def _observed(self, obs: Obs, state: BatchState) -> jax.Array:
        return jax.vmap(self.assistax.global_obs)(state.env) if self.agent == BOTH else obs[self.agent]


class BraxStep(NamedTuple):
    """What Brax is told of a step, [n] each."""

    obs: jax.Array
    reward: jax.Array
    terminated: jax.Array
    truncated: jax.Array
    metrics: dict[str, jax.Array]


_BRAX_COUNTS = ("return", "length")  # itself


def _keyless(state: BatchState) -> BatchState:
    """Its key goes into `info`, which automatic resets of Brax do not turn back: episodes would repeat themselves."""
    return dataclasses.replace(state, key=None)


def wrap(
    env: AgentEnv,
    episode_length: int | None = None,
    action_repeat: int = 1,
    randomization_fn: Any = None,
    *,
    staggered: bool = False,
) -> "FreshEpisodes":
    """A batch of `env` with time limit and automatic resets, as the `wrap_env_fn` of Brax's training.

    Brax's own wrappers begin every episode of an environment as they began the first, with the same target and the
    same partner out of a population; these draw afresh, and are faster.

    Args:
      env: the environment of one agent.
      episode_length: that of `env`; another is refused.
      action_repeat: 1.
      randomization_fn: None; `human=...` and other settings of the environment randomise it.
      staggered: whether the first episodes begin at different times, so that they do not all end together; only for
        training without Brax's evaluations.

    Raises:
      UsageError: what it does not have.
    """
    if episode_length not in (None, env.episode_length):
        raise UsageError(
            f"The episodes of this environment have {env.episode_length} steps, not {episode_length}: "
            f"make it with episode_length={episode_length}."
        )
    if action_repeat != 1:
        raise UsageError(f"action_repeat must be 1, not {action_repeat}; make the environment with more substeps.")
    if randomization_fn is not None:
        raise UsageError("There is no randomization_fn here; settings of the environment randomise the person.")
    return FreshEpisodes(env, staggered)


class FreshEpisodes(Wrapper):
    """See `wrap`; `reset` takes keys [n], and all else is [n], too."""

    env: AgentEnv

    def __init__(self, env: AgentEnv, staggered: bool):
        super().__init__(env)
        self.staggered = staggered

    def reset(self, rng: jax.Array) -> State:
        n, length = len(rng), self.env.episode_length
        elapsed = jnp.arange(n) * length // n if self.staggered else jnp.zeros(n, jnp.int32)
        state, obs, metrics = self.env.begin(rng, elapsed)
        zeros = jnp.zeros(n)
        info = {"key": state.key, "steps": jnp.float32(elapsed)}
        info |= dict.fromkeys(("truncation", "time_out", "episode_done"), zeros)
        info["episode_metrics"] = dict.fromkeys(("sum_reward", "length", *metrics), zeros)
        return State(_keyless(state), obs, zeros, zeros, metrics, info)

    def step(self, state: State, action: jax.Array) -> State:
        after, step = self.env.advance("same_step", state, action)
        done, going_on = jnp.maximum(step.terminated, step.truncated), 1.0 - state.info["episode_done"]
        counted = {"sum_reward": step.reward, "length": jnp.ones_like(done), **step.metrics}
        so_far = state.info["episode_metrics"]
        info = {
            "key": after.key,
            "steps": state.info["steps"] * going_on + 1.0,
            "truncation": step.truncated,  # Brax's PPO drops such a step, as unbiased as bootstrapping from it
            "time_out": step.truncated,
            "episode_done": done,
            "episode_metrics": {name: so_far[name] * going_on + x for name, x in counted.items()},
        }
        return state.replace(
            pipeline_state=_keyless(after),
            obs=step.obs,
            reward=step.reward,
            done=done,
            metrics=state.metrics | step.metrics,
            info=state.info | info,
        )
