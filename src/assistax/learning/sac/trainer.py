"""Soft actor-critic (Haarnoja et al., 2018) for teams: MASAC and ISAC without parameter sharing.

Every learning agent has an actor on its own observation. In MASAC one pair of critics judges the
team: it sees the global observation and everybody's actions, and its soft value counts the entropy
of every learner; where their rewards differ, the team's is the mean of the learners'. In ISAC each
learner has a pair of critics of its own, on its own observation, action and reward. One iteration is
`collect`, then `improve`; both are pure functions of a SACState, to be jitted with the state donated
(the replay is then written in place) and, over seeds, vmapped.
"""

from collections.abc import Mapping
from dataclasses import field, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax

from assistax.errors import UsageError
from assistax.learning.actors import SquashedActor
from assistax.learning.gae import horizon
from assistax.learning.log import iteration_log, step_log
from assistax.learning.networks import init_mlp, mlp
from assistax.learning.normalizer import RunningStats, init_stats, normalize, update_stats
from assistax.learning.partners import Partners
from assistax.learning.sac.config import SACConfig
from assistax.learning.sac.replay import Packing, Replay, add, init_replay, sample
from assistax.learning.squashed import sample_squashed, split_head
from assistax.learning.tuned import overlaid
from assistax.policies import Player
from assistax.pytree import pytree


@pytree
class SACState:
    """Everything a run needs to go on exactly."""

    params: dict[str, Any]  # "actor": by learner, "critic" and "target": pairs by critic, "log_alpha": by learner
    opt_state: dict[str, Any]  # of "actor", "critic", "log_alpha"
    normalizer: RunningStats  # of the rows that `Packing` makes
    replay: Replay
    env_state: Any  # [num_envs, ...]
    obs: dict[str, jax.Array]  # agent -> [num_envs, n]
    noise: dict[str, jax.Array]  # learner -> [num_envs, longest action], what it explored with before obs
    partner_state: dict[str, Any]  # of the frozen partners, see Partners
    others: dict[str, jax.Array]  # partner -> [num_envs, n], what it will do next
    key: jax.Array
    iteration: jax.Array  # int32
    tuned: dict[str, jax.Array] = field(default_factory=dict)  # settings that stand in for the configuration's


class SAC:
    """The trainer; holds no state. See `init`, `collect`, `improve`.

    Args:
      env: anything with the interface of `assistax.env.Env`.
      num_envs: environments stepped side by side.
      total_iterations: length of the run; not used, as nothing is annealed.
      partners: the frozen partners, who do not learn.
    """

    def __init__(
        self,
        env,
        config: SACConfig,
        num_envs: int,
        total_iterations: int,
        partners: Mapping[str, Player] | None = None,
    ):
        self.env, self.config, self.num_envs = env, config, num_envs
        self.partners = Partners(env, num_envs, partners)
        self.learners = self.partners.learners
        self.steps_per_iteration = num_envs * config.num_steps
        if config.buffer_size < self.steps_per_iteration:
            raise UsageError(
                f"sac.buffer_size = {config.buffer_size} must hold the transitions of an iteration, "
                f"num_envs x sac.num_steps = {num_envs} x {config.num_steps} = {self.steps_per_iteration}."
            )
        if config.joint_critics:  # critic -> what it sees, whose actions
            self._critics = {"team": ("global", tuple(env.agents))}
        else:
            self._critics = {agent: (agent, (agent,)) for agent in self.learners}
        self._packing = Packing(env)
        self._target_entropy = {agent: -float(env.action_sizes[agent]) for agent in self.learners}
        self._adam = optax.adam(1.0)  # its steps are multiplied by the learning rates

    def init(self, key: jax.Array, tuned: Mapping[str, jax.Array] | None = None) -> SACState:
        """A fresh state; `tuned` are settings by name that it carries in place of the configuration's."""
        tuned = dict(tuned or {})
        c, env = overlaid(self.config, tuned), self.env
        key, reset_key, actor_key, critic_key, partner_key, act_key = jax.random.split(key, 6)
        # In step, all environments would be at the same moment of the task.
        elapsed = jnp.arange(self.num_envs) * env.episode_length // self.num_envs * c.stagger
        obs, env_state = jax.vmap(env.reset)(jax.random.split(reset_key, self.num_envs), elapsed)
        partner_state = self.partners.init(partner_key)
        others, partner_state = self._partners_act(
            partner_state, env_state, obs, jnp.ones(self.num_envs, bool), act_key
        )

        actor = {}
        for agent, agent_key in zip(self.learners, jax.random.split(actor_key, len(self.learners)), strict=True):
            sizes = (env.observation_sizes[agent], *c.hidden, 2 * env.action_sizes[agent])
            actor[agent] = init_mlp(agent_key, sizes, out_scale=0.01)
        row = self._packing.pack(jax.vmap(env.global_obs)(env_state), obs)
        seen = self._packing.unpack(row)
        critic = {}
        for name, name_key in zip(self._critics, jax.random.split(critic_key, len(self._critics)), strict=True):
            sees, agents = self._critics[name]
            inputs = seen[sees].shape[-1] + sum(env.action_sizes[agent] for agent in agents)
            pair = [init_mlp(k, (inputs, *c.hidden, 1), out_scale=1.0) for k in jax.random.split(name_key)]
            critic[name] = pair
        log_alpha = {agent: jnp.log(jnp.float32(c.initial_alpha)) for agent in self.learners}
        params = {"actor": actor, "critic": critic, "log_alpha": log_alpha}
        opt_state = {name: self._adam.init(params[name]) for name in params}
        params["target"] = jax.tree.map(jnp.copy, critic)

        transition = {
            "obs": row[0],
            "next_obs": row[0],
            "actions": {agent: jnp.zeros(size) for agent, size in env.action_sizes.items()},
            "next_others": jax.tree.map(lambda x: x[0], others),
            "reward": dict.fromkeys(self._critics, jnp.float32(0.0)),
            "terminated": jnp.bool_(False),
        }
        shape = self.num_envs, self.policy(deterministic=False).longest_action
        return SACState(
            params=params,
            opt_state=opt_state,
            normalizer=init_stats(row.shape[-1]),
            replay=init_replay(transition, c.buffer_size, self.steps_per_iteration),
            env_state=env_state,
            obs=obs,
            noise={a: jax.random.normal(jax.random.fold_in(act_key, i), shape) for i, a in enumerate(self.learners)},
            partner_state=partner_state,
            others=others,
            key=key,
            iteration=jnp.int32(0),
            tuned=tuned,
        )

    # -- acting --------------------------------------------------------------------------------

    def policy(self, deterministic: bool = True) -> SquashedActor:
        """Acts as a learner, with its `policy_params`."""
        c = self.config
        longest = max(self.env.action_sizes[agent] for agent in self.learners)
        return SquashedActor(c.activation, c.normalize_obs, deterministic, c.noise_correlation, longest)

    def policy_params(self, state: SACState) -> dict[str, Any]:
        """By learner, the parameters for `policy`."""
        n = state.normalizer
        means, m2s = self._packing.unpack(n.mean), self._packing.unpack(n.m2)
        return {
            agent: {
                "actor": {"layers": state.params["actor"][agent]},
                "normalizer": RunningStats(n.count, means[agent], m2s[agent]),
            }
            for agent in self.learners
        }

    def collect(self, state: SACState) -> tuple[SACState, dict]:
        """Play `num_steps` in all environments, into the replay; the batch holds only the log."""
        env, c = self.env, overlaid(self.config, state.tuned)
        policy = replace(self.policy(deterministic=False), noise_correlation=c.noise_correlation)
        act = jax.vmap(policy.act, in_axes=(None, 0, 0, None, 0))
        params = self.policy_params(state)
        warming_up = state.iteration * float(self.steps_per_iteration) < c.warmup

        def play(carry, key):
            env_state, obs, noise, partner_state, others, t = carry
            act_key, random_key, step_key, redraw_key, partner_key = jax.random.split(key, 5)
            actions, noise = dict(others), dict(noise)
            for i, agent in enumerate(self.learners):
                keys = jax.random.split(jax.random.fold_in(act_key, i), self.num_envs)
                # The noise goes on where an episode begins: it is standard normal there too.
                chosen, noise[agent] = act(params[agent], noise[agent], obs[agent], False, keys)
                random = jax.random.uniform(jax.random.fold_in(random_key, i), chosen.shape, minval=-1.0)
                actions[agent] = jnp.where(warming_up, random, chosen)
            row = self._packing.pack(jax.vmap(env.global_obs)(env_state), obs)
            step_keys = jax.random.split(step_key, self.num_envs)
            obs, env_state, rewards, terminated, truncated, info = jax.vmap(env.step)(step_keys, env_state, actions)
            done = terminated["__all__"] | truncated["__all__"]
            partner_state = self.partners.redraw(partner_state, env_state, done, redraw_key)
            next_others, partner_state = self._partners_act(partner_state, env_state, obs, done, partner_key)
            transition = {
                "obs": row,
                "next_obs": self._packing.pack(info["final_global_observation"], info["final_observation"]),
                "actions": actions,
                # Nobody acts on the last observation of an episode; a partner's last action stands in there.
                "next_others": jax.tree.map(partial(_where, done), others, next_others),
                "reward": {name: self._reward(rewards, agents) for name, (_, agents) in self._critics.items()},
                "terminated": terminated["__all__"],  # not at a time limit: there the value goes on
            }
            log = step_log(info, done & (t >= env.episode_length * c.stagger))
            return (env_state, obs, noise, partner_state, next_others, t + 1), (transition, log)

        key, rollout_key = jax.random.split(state.key)
        t = state.iteration * c.num_steps + 1
        start = (state.env_state, state.obs, state.noise, state.partner_state, state.others, t)
        end, (chunk, log) = jax.lax.scan(play, start, jax.random.split(rollout_key, c.num_steps))
        env_state, obs, noise, partner_state, others, _ = end
        chunk = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), chunk)
        state = replace(
            state,
            normalizer=update_stats(state.normalizer, chunk["obs"]),
            replay=add(state.replay, chunk),
            env_state=env_state,
            obs=obs,
            noise=noise,
            partner_state=partner_state,
            others=others,
            key=key,
        )
        return state, {"log": iteration_log(log)}

    def _reward(self, rewards, agents) -> jax.Array:
        """What a critic of these agents is to foresee: the learners' reward, or their mean where rewards differ."""
        own = [rewards[agent] for agent in agents if agent in self.learners]
        return sum(own) / len(own)

    def _partners_act(self, partner_state, env_state, obs, reset, key):
        """The partners' actions as the joints receive them, for the critics must not see more."""
        actions, partner_state = self.partners.act(partner_state, env_state, obs, reset, key)
        return jax.tree.map(lambda x: jnp.clip(x, -1.0, 1.0), actions), partner_state

    # -- learning ------------------------------------------------------------------------------

    def improve(self, state: SACState, batch: dict) -> tuple[SACState, dict]:
        """`updates` gradient steps on samples of the replay; returns the means of the losses and the like."""
        del batch  # it is in the replay
        c = overlaid(self.config, state.tuned)
        key, update_key = jax.random.split(state.key)

        def update(carry, key):
            sample_key, step_key = jax.random.split(key)
            x = sample(state.replay, sample_key, c.batch_size)
            return self.gradient_step(c, carry, x, state.normalizer, step_key)

        start = (state.params, state.opt_state)
        (params, opt_state), stats = jax.lax.scan(update, start, jax.random.split(update_key, c.updates))
        state = replace(state, params=params, opt_state=opt_state, key=key, iteration=state.iteration + 1)
        return state, jax.tree.map(jnp.mean, stats)

    def gradient_step(self, c, learned, x: dict, normalizer: RunningStats, key: jax.Array):
        """Critics, actors, temperatures, then targets, on transitions x [batch_size, ...], with settings c.

        Returns ((params, opt_state), stats by learner).
        """
        params, opt_state = dict(learned[0]), dict(learned[1])
        seen, next_seen = self._see(x["obs"], normalizer), self._see(x["next_obs"], normalizer)
        next_key, actor_key = jax.random.split(key)
        alpha = jax.tree.map(jnp.exp, params["log_alpha"])

        def descend(name, loss, rate):
            grads, aux = jax.grad(loss, has_aux=True)(params[name])
            steps, opt_state[name] = self._adam.update(grads, opt_state[name])
            params[name] = optax.apply_updates(params[name], optax.tree.scale(rate, steps))
            return aux

        targets, ahead = self.soft_targets(c, params, x, next_seen, next_key), horizon(c.gamma, self.env.episode_length)

        def critic_loss(critics):
            judged = {name: self._judge(c, name, critics[name], seen, x["actions"]) for name in critics}
            errors = {name: [(q - targets[name]) / ahead for q in judged[name]] for name in judged}
            losses = {name: sum(jnp.square(error).mean() for error in errors[name]) for name in errors}
            return sum(losses.values()), (losses, {name: judged[name][0].mean() for name in judged})

        critic_losses, values = descend("critic", critic_loss, c.critic_learning_rate)

        def actor_loss(actors):
            actions, log_probs = self._draw(actors, seen, actor_key)
            cost = sum((alpha[agent] * log_probs[agent]).mean() for agent in self.learners)
            gain = sum(
                jnp.minimum(*self._judge(c, name, pair, seen, x["actions"] | actions)).mean()
                for name, pair in params["critic"].items()
            )
            return cost - gain, {agent: -log_probs[agent].mean() for agent in self.learners}

        entropy = descend("actor", actor_loss, c.actor_learning_rate)

        def alpha_loss(log_alphas):
            return temperature_loss(log_alphas, entropy, self._target_entropy), None

        descend("log_alpha", alpha_loss, c.alpha_learning_rate)
        params["target"] = optax.incremental_update(params["critic"], params["target"], c.tau)
        stats = {}
        for agent in self.learners:
            judge = "team" if c.joint_critics else agent
            stats[agent] = {
                "critic_loss": critic_losses[judge],
                "value": values[judge],
                "entropy": entropy[agent],
                "alpha": alpha[agent],
            }
        return (params, opt_state), stats

    def soft_targets(self, c, params, x: dict, next_seen: dict, key: jax.Array) -> dict[str, jax.Array]:
        """By critic, what it should say of the transitions [batch]: reward, and the soft value of what follows."""
        actions, log_probs = self._draw(params["actor"], next_seen, key)
        actions |= x["next_others"]
        goes_on = c.gamma * (1.0 - x["terminated"])
        targets = {}
        for name, (_, agents) in self._critics.items():
            value = jnp.minimum(*self._judge(c, name, params["target"][name], next_seen, actions))
            for agent in (a for a in agents if a in self.learners):
                value -= jnp.exp(params["log_alpha"][agent]) * log_probs[agent]
            targets[name] = x["reward"][name] + goes_on * value
        return targets

    def _see(self, row, normalizer) -> dict[str, jax.Array]:
        """What the networks see in a row [..., width], by agent and "global"."""
        return self._packing.unpack(normalize(normalizer, row) if self.config.normalize_obs else row)

    def _draw(self, actors, seen, key) -> tuple[dict, dict]:
        """Fresh actions [batch, n] of the learners, and their log-probabilities [batch]."""
        actions, log_probs = {}, {}
        for agent, agent_key in zip(self.learners, jax.random.split(key, len(self.learners)), strict=True):
            head = split_head(mlp(actors[agent], seen[agent], self.config.activation))
            noise = jax.random.normal(agent_key, head[0].shape)
            actions[agent], log_probs[agent] = sample_squashed(*head, noise)
        return actions, log_probs

    def _judge(self, c, name, pair, seen, actions) -> list[jax.Array]:
        """The two values [batch] that a pair of critics gives."""
        sees, agents = self._critics[name]
        x = jnp.concatenate([seen[sees], *(actions[agent] for agent in agents)], -1)
        ahead = horizon(c.gamma, self.env.episode_length)
        return [ahead * mlp(critic, x, self.config.activation)[..., 0] for critic in pair]


def temperature_loss(log_alpha: dict, entropy: dict, target: dict) -> jax.Array:
    """Its descent raises an agent's temperature where its entropy is below the target, and else lowers it."""
    return sum(log_alpha[agent] * (entropy[agent] - target[agent]) for agent in log_alpha)


def _where(mask: jax.Array, x: jax.Array, y: jax.Array) -> jax.Array:
    """x or y [num_envs, n] by mask [num_envs]."""
    return jnp.where(mask[:, None], x, y)
