"""Proximal policy optimisation (Schulman et al., 2017) for teams: IPPO without parameter sharing.

Each agent has an actor and a critic of its own, sees its own observation and is trained on the
shared reward (the paper's IPPO, feed-forward). One iteration is `collect`, then `improve`; both are
pure functions of a TrainState, to be jitted and, over seeds, vmapped.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax

from assistax.errors import UsageError, choose
from assistax.learning.gae import gae
from assistax.learning.networks import ACTIVATIONS, gaussian_entropy, gaussian_log_prob, init_mlp, mlp
from assistax.learning.normalizer import init_stats, normalize, update_stats
from assistax.pytree import pytree


@dataclass(frozen=True)
class PPOConfig:
    central_critic: bool = False  # critics see the global state (MAPPO) instead of the agent's own observation (IPPO)
    learning_rate: float = 3e-4
    anneal_learning_rate: bool = False  # linearly to zero over the run
    num_steps: int = 64  # per environment and iteration
    update_epochs: int = 8
    num_minibatches: int = 16
    clip_eps: float = 0.2
    clip_value: bool = False  # clip value changes like the policy's
    entropy_coef: float = 1e-3
    value_coef: float = 0.5
    gamma: float = 0.99
    gae_lambda: float = 0.95
    max_grad_norm: float = 0.5  # per network
    hidden: tuple[int, ...] = (128, 128)
    activation: str = "tanh"
    initial_log_std: float = 0.0
    normalize_obs: bool = True
    stagger: bool = True  # start the environments at different times of their episodes

    def __post_init__(self):
        for field in ("num_steps", "update_epochs", "num_minibatches"):
            if getattr(self, field) < 1:
                raise UsageError(f"ppo.{field} must be 1 or more, not {getattr(self, field)}.")
        for field in ("learning_rate", "clip_eps", "max_grad_norm"):
            if getattr(self, field) <= 0:
                raise UsageError(f"ppo.{field} must be above 0, not {getattr(self, field)}.")
        for field in ("gamma", "gae_lambda"):
            if not 0 <= getattr(self, field) <= 1:
                raise UsageError(f"ppo.{field} must be in [0, 1], not {getattr(self, field)}.")
        choose("activation", self.activation, ACTIVATIONS)


@pytree
class TrainState:
    """Everything a run needs to go on exactly."""

    params: dict[str, Any]  # agent -> {"actor": {"layers", "log_std"}, "critic": layers}
    opt_state: Any
    normalizer: dict[str, Any]  # agent -> RunningStats
    env_state: Any  # [num_envs, ...]
    obs: dict[str, jax.Array]  # agent -> [num_envs, n]
    key: jax.Array
    iteration: jax.Array  # int32


class PPO:
    """The trainer; holds no state. See `init`, `collect`, `improve`.

    Args:
      env: anything with the interface of `assistax.env.Env`.
      num_envs: environments stepped side by side.
      total_iterations: length of the run, for learning-rate annealing.
    """

    def __init__(self, env, config: PPOConfig, num_envs: int, total_iterations: int):
        self.env, self.config, self.num_envs = env, config, num_envs
        samples = num_envs * config.num_steps
        if samples % config.num_minibatches:
            raise UsageError(
                f"num_envs x ppo.num_steps = {num_envs} x {config.num_steps} = {samples} samples do not divide "
                f"into ppo.num_minibatches = {config.num_minibatches}."
            )
        rate = config.learning_rate
        if config.anneal_learning_rate:
            updates = total_iterations * config.update_epochs * config.num_minibatches
            rate = optax.linear_schedule(rate, 0.0, updates)
        self._adam = optax.adam(rate, eps=1e-5)

    def init(self, key: jax.Array) -> TrainState:
        c, env = self.config, self.env
        key, reset_key, net_key = jax.random.split(key, 3)
        params = {}
        for agent, agent_key in zip(env.agents, jax.random.split(net_key, len(env.agents)), strict=True):
            actor_key, critic_key = jax.random.split(agent_key)
            n, m = env.observation_sizes[agent], env.action_sizes[agent]
            layers = init_mlp(actor_key, (n, *c.hidden, m), out_scale=0.01)
            log_std = jnp.full(m, c.initial_log_std, jnp.float32)
            critic = init_mlp(critic_key, (n, *c.hidden, 1), out_scale=1.0)
            params[agent] = {"actor": {"layers": layers, "log_std": log_std}, "critic": critic}
        normalizer = {agent: init_stats(env.observation_sizes[agent]) for agent in env.agents}
        # In step, all environments would be at the same moment of the task in every batch.
        elapsed = jnp.arange(self.num_envs) * env.episode_length // self.num_envs * c.stagger
        obs, env_state = jax.vmap(env.reset)(jax.random.split(reset_key, self.num_envs), elapsed)
        opt_state = self._adam.init(params)
        return TrainState(params, opt_state, normalizer, env_state, obs, key, jnp.int32(0))

    # -- acting --------------------------------------------------------------------------------

    def _seen(self, normalizer, obs):
        """What the networks see of obs: dict of [..., n]."""
        if not self.config.normalize_obs:
            return obs
        return {agent: normalize(normalizer[agent], x) for agent, x in obs.items()}

    def collect(self, state: TrainState) -> tuple[TrainState, dict]:
        """Play `num_steps` in all environments: the batch, each array [num_steps, num_envs, ...]."""
        env, c = self.env, self.config

        def play(carry, key):
            env_state, obs, t = carry
            action_key, step_key = jax.random.split(key)
            actions, log_probs = {}, {}
            seen = self._seen(state.normalizer, obs)
            keys = jax.random.split(action_key, len(env.agents))
            for agent, agent_key in zip(env.agents, keys, strict=True):
                actor = state.params[agent]["actor"]
                mean = mlp(actor["layers"], seen[agent], c.activation)
                noise = jax.random.normal(agent_key, mean.shape)
                actions[agent] = mean + jnp.exp(actor["log_std"]) * noise
                log_probs[agent] = gaussian_log_prob(actions[agent], mean, actor["log_std"])
            step_keys = jax.random.split(step_key, self.num_envs)
            next_obs, env_state, rewards, terminated, truncated, info = jax.vmap(env.step)(
                step_keys, env_state, actions
            )
            done = terminated["__all__"] | truncated["__all__"]
            step = {
                "obs": obs,
                "final_obs": info["final_observation"],
                "actions": actions,
                "log_probs": log_probs,
                "rewards": rewards,
                "terminated": terminated["__all__"],
                "done": done,
            }
            # Staggered first episodes are cut short; they are learned from but not reported.
            whole = done & (t >= env.episode_length * c.stagger)
            ended = jax.tree.map(lambda x: jnp.sum(x * whole), info["metrics"])
            terms = jax.tree.map(jnp.mean, info["reward_terms"])
            log = {"episodes": whole.sum(), "ended": ended, "terms": terms, "fault": info["fault"].max()}
            return (env_state, next_obs, t + 1), (step, log)

        key, rollout_key = jax.random.split(state.key)
        keys = jax.random.split(rollout_key, c.num_steps)
        start = (state.env_state, state.obs, state.iteration * c.num_steps + 1)
        (env_state, obs, _), (batch, log) = jax.lax.scan(play, start, keys)
        episodes = log["episodes"].sum()
        batch["log"] = {
            "episodes": episodes,  # that ended in this iteration; the means below are over them
            "episode": jax.tree.map(lambda x: x.sum() / jnp.maximum(episodes, 1), log["ended"]),
            "reward": jax.tree.map(jnp.mean, log["terms"]),  # per step, by term
            "fault": log["fault"].max(),
        }
        state = TrainState(state.params, state.opt_state, state.normalizer, env_state, obs, key, state.iteration)
        return state, batch

    # -- learning ------------------------------------------------------------------------------

    def improve(self, state: TrainState, batch: dict) -> tuple[TrainState, dict]:
        """`update_epochs` passes over the batch; returns the means of the losses and the like."""
        c = self.config
        samples = {}
        for agent in self.env.agents:
            seen = self._seen({agent: state.normalizer[agent]}, {agent: batch["obs"][agent]})[agent]
            final = self._seen({agent: state.normalizer[agent]}, {agent: batch["final_obs"][agent]})[agent]
            critic = state.params[agent]["critic"]
            values, next_values = (mlp(critic, x, c.activation)[..., 0] for x in (seen, final))
            advantages = gae(
                batch["rewards"][agent],
                values,
                next_values,
                batch["terminated"],
                batch["done"],
                c.gamma,
                c.gae_lambda,
            )
            samples[agent] = {
                "obs": seen,
                "action": batch["actions"][agent],
                "log_prob": batch["log_probs"][agent],
                "advantage": advantages,
                "value": values,
                "target": advantages + values,
            }
        samples = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), samples)
        count = self.num_envs * c.num_steps

        def minibatch(carry, ids):
            params, opt_state = carry
            part = jax.tree.map(lambda x: x[ids], samples)
            grads, stats = jax.grad(self._loss, has_aux=True)(params, part)
            updates, opt_state = self._adam.update(clip_networks(grads, c.max_grad_norm), opt_state)
            return (optax.apply_updates(params, updates), opt_state), stats

        def epoch(carry, key):
            ids = jax.random.permutation(key, count).reshape(c.num_minibatches, -1)
            return jax.lax.scan(minibatch, carry, ids)

        key, epoch_key = jax.random.split(state.key)
        carry = (state.params, state.opt_state)
        keys = jax.random.split(epoch_key, c.update_epochs)
        (params, opt_state), stats = jax.lax.scan(epoch, carry, keys)
        stats = jax.tree.map(jnp.mean, stats)
        for agent, s in samples.items():
            residual = jnp.var(s["target"] - s["value"])
            stats[agent]["explained_variance"] = 1.0 - residual / (jnp.var(s["target"]) + 1e-8)
            stats[agent]["std"] = jnp.exp(params[agent]["actor"]["log_std"]).mean()
        # Only now, so that every log-probability above was computed with the rollout's own numbers.
        normalizer = {agent: update_stats(stats_, batch["obs"][agent]) for agent, stats_ in state.normalizer.items()}
        return TrainState(params, opt_state, normalizer, state.env_state, state.obs, key, state.iteration + 1), stats

    def _loss(self, params, part):
        losses, stats = zip(*(self._agent_loss(params[a], part[a]) for a in self.env.agents), strict=True)
        return sum(losses), dict(zip(self.env.agents, stats, strict=True))

    def _agent_loss(self, params, x):
        c = self.config
        mean = mlp(params["actor"]["layers"], x["obs"], c.activation)
        log_std = params["actor"]["log_std"]
        log_ratio = gaussian_log_prob(x["action"], mean, log_std) - x["log_prob"]
        policy_loss = clipped_policy_loss(log_ratio, x["advantage"], c.clip_eps)
        value = mlp(params["critic"], x["obs"], c.activation)[..., 0]
        error = jnp.square(value - x["target"])
        if c.clip_value:
            near = x["value"] + jnp.clip(value - x["value"], -c.clip_eps, c.clip_eps)
            error = jnp.maximum(error, jnp.square(near - x["target"]))
        value_loss = 0.5 * error.mean()
        entropy = gaussian_entropy(log_std)
        stats = {
            "policy_loss": policy_loss,
            "value_loss": value_loss,
            "entropy": entropy,
            "approx_kl": jnp.mean(jnp.expm1(log_ratio) - log_ratio),
            "clip_fraction": jnp.mean(jnp.abs(jnp.expm1(log_ratio)) > c.clip_eps),
        }
        return policy_loss + c.value_coef * value_loss - c.entropy_coef * entropy, stats


def clipped_policy_loss(log_ratio: jax.Array, advantage: jax.Array, clip_eps: float) -> jax.Array:
    """PPO's surrogate, with the advantages normalised over the minibatch [n]."""
    advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    ratio = jnp.exp(log_ratio)
    clipped = jnp.clip(ratio, 1.0 - clip_eps, 1.0 + clip_eps)
    return -jnp.minimum(ratio * advantage, clipped * advantage).mean()


def clip_networks(grads: dict, max_norm: float) -> dict:
    """Scale the gradient of each network (grads[agent][network]) to at most this norm."""

    def clip(grad):
        scale = jnp.minimum(1.0, max_norm / (optax.tree.norm(grad) + 1e-8))
        return jax.tree.map(partial(jnp.multiply, scale), grad)

    return {agent: {name: clip(grad) for name, grad in nets.items()} for agent, nets in grads.items()}
