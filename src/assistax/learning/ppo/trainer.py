"""Proximal policy optimisation (Schulman et al., 2017) for teams: IPPO and MAPPO, with and without memory.

Every learning agent has an actor on its own observation and a critic of its own, which sees that
observation too (IPPO) or the global state (MAPPO); all are trained on the shared reward. With a GRU the
actor remembers and the critic reads its memory (but does not shape it): what happens next depends on the
state and on that memory, and on nothing else. One iteration is `collect`, then `improve`; both are pure
functions of a TrainState, to be jitted and, over seeds, vmapped.
"""

from collections.abc import Mapping
from dataclasses import field, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax

from assistax.devices import by_environment, part_of_batch
from assistax.errors import UsageError
from assistax.learning.actors import Actor
from assistax.learning.gae import gae, horizon
from assistax.learning.log import iteration_log, step_log
from assistax.learning.networks import gaussian_entropy, gaussian_log_prob, mlp, step, unroll
from assistax.learning.normalizer import init_stats, update_stats
from assistax.learning.partner_model import prediction_error, remembering, unroll_actor
from assistax.learning.partners import Partners
from assistax.learning.ppo.config import PPOConfig, most_log_std
from assistax.learning.ppo.constraint import check_cost, combined, in_means, init_constraint, updated
from assistax.learning.ppo.losses import adapted_rate, clip_networks, clipped_policy_loss, value_loss
from assistax.learning.ppo.team import TeamNetworks, beside
from assistax.learning.teacher import Teacher, imitation_loss, teaching_weight
from assistax.learning.tuned import overlaid
from assistax.policies import Player
from assistax.pytree import pytree


@pytree
class TrainState:
    """Everything a run needs to continue exactly."""

    params: dict[str, Any]  # learner, or "shared" -> {"actor": Network with "log_std", "critic": Network}
    opt_state: Any
    rate_scale: dict[str, jax.Array]  # by name in params, factor of its actor's learning rate, see adapted_rate
    normalizer: dict[str, Any]  # what is seen, see TeamNetworks -> RunningStats
    env_state: Any  # [num_envs, ...]
    obs: dict[str, jax.Array]  # agent -> [num_envs, n]
    reset: jax.Array  # [num_envs] whether obs begins an episode
    memory: dict[str, Any]  # learner -> its actor's carry before obs, [num_envs, units] or ()
    partner_state: dict[str, Any]  # of the frozen partners, see Partners
    key: jax.Array
    iteration: jax.Array  # int32
    constraint: Any = ()  # with ppo.cost_limit, a Constraint
    teacher: Any = ()  # with ppo.teacher, what its scripts remember, by learner
    tuned: dict[str, jax.Array] = field(default_factory=dict)  # settings that stand in for the configuration's


class PPO:
    """The trainer; holds no state. See `init`, `collect`, `improve`.

    Args:
      env: anything with the interface of `assistax.env.Env`.
      num_envs: environments stepped side by side.
      total_iterations: length of the run: what learning-rate annealing needs, and how `policy` explores.
      partners: by agent, the frozen partners, who do not learn.
    """

    def __init__(
        self,
        env,
        config: PPOConfig,
        num_envs: int,
        total_iterations: int,
        partners: Mapping[str, Player] | None = None,
    ):
        self.env, self.config, self.num_envs = env, config, num_envs
        self.partners = Partners(env, num_envs, partners)
        self.learners = self.partners.learners
        self.steps_per_iteration = num_envs * config.num_steps
        if config.remembers and num_envs % config.num_minibatches:
            raise UsageError(
                f"num_envs = {num_envs} sequences do not divide into ppo.num_minibatches = {config.num_minibatches}."
            )
        if self.steps_per_iteration % config.num_minibatches:
            raise UsageError(
                f"num_envs x ppo.num_steps = {num_envs} x {config.num_steps} = {self.steps_per_iteration} samples do "
                f"not divide into ppo.num_minibatches = {config.num_minibatches}."
            )
        if config.constrained:
            check_cost(env)
        self.teacher = Teacher(env, num_envs, config.teachers, self.learners)
        self._adam = optax.adam(1.0, eps=1e-5)  # its steps are multiplied by the learning rate
        self._updates = total_iterations * config.update_epochs * config.num_minibatches
        self._last_iteration = total_iterations - 1
        if config.critic_knows_partner and self.partners.members < 2:
            raise UsageError("ppo.critic_knows_partner needs a partner of several members; give one, human=POP.")
        self.networks = TeamNetworks(env, config, self.learners, self.partners.members)

    def init(self, key: jax.Array, tuned: Mapping[str, jax.Array] | None = None) -> TrainState:
        """A fresh state; `tuned` are settings by name that it carries in place of the configuration's."""
        tuned = dict(tuned or {})
        c, env = overlaid(self.config, tuned), self.env
        key, reset_key, net_key, partner_key = jax.random.split(key, 4)
        params = self.networks.init(net_key, c.initial_log_std)
        normalizer = {view: init_stats(size) for view, size in self.networks.sizes.items()}
        # In step, all environments would be at the same moment of the task in every batch.
        elapsed = jnp.arange(self.num_envs) * env.episode_length // self.num_envs * c.stagger
        obs, env_state = by_environment(env.reset)(jax.random.split(reset_key, self.num_envs), elapsed)
        blank = jnp.zeros((self.num_envs, self.networks.units)) if self.config.remembers else ()
        here = {
            "env_state": env_state,
            "obs": obs,
            "reset": jnp.ones(self.num_envs, bool),
            "memory": dict.fromkeys(self.learners, blank),
            "partner_state": self.partners.init(partner_key),
            "teacher": self.teacher.init(),
            "constraint": init_constraint(self.num_envs) if self.config.constrained else (),
        }
        return TrainState(
            params=params,
            opt_state=self._adam.init(params),
            rate_scale={name: jnp.ones(()) for name in params},
            normalizer=normalizer,
            key=key,
            iteration=jnp.int32(0),
            tuned=tuned,
            **part_of_batch(here),
        )

    # -- acting --------------------------------------------------------------------------------

    def _noise_correlation(self, c, iteration):
        """Of the exploration in this iteration: correlated noise finds the way, then disturbs."""
        correlated = not c.correlated_steps or iteration < c.correlated_steps / self.steps_per_iteration
        return c.noise_correlation * correlated

    def _correlated(self, state):
        """Whether its exploration ever is; known when compiling."""
        return self.config.noise_correlation > 0.0 or "noise_correlation" in state.tuned

    def policy(self, deterministic: bool = True) -> Actor:
        """The learners' policy, with `policy_params`, outside of training: explores as the run ends."""
        c = self.config
        longest = max(self.env.action_sizes[agent] for agent in self.learners)
        correlation = self._noise_correlation(c, self._last_iteration)
        return Actor(c.activation, c.normalize_obs, deterministic, self.networks.units, correlation, longest)

    def policy_params(self, state: TrainState) -> dict[str, Any]:
        """By learner, parameters for `policy`; of `state` only params and normalizer are read."""
        networks = self.networks.of(state.params)
        acting = {a: {n: networks[a][n] for n in ("actor", "partner_model") if n in networks[a]} for a in self.learners}
        return {a: acting[a] | {"normalizer": state.normalizer[a]} for a in self.learners}

    def collect(self, state: TrainState) -> tuple[TrainState, dict]:
        """Play `num_steps` in all environments: the batch, each array [num_steps, num_envs, ...]."""
        env, c = self.env, overlaid(self.config, state.tuned)
        params = self.policy_params(state)
        policy, correlated = self.policy(False), self._correlated(state)
        correlation = self._noise_correlation(c, state.iteration)
        global_obs = jax.vmap(env.global_obs) if c.central_critic else lambda _: None

        def play(carry, now):
            (env_state, obs, reset, memory, noise, partner_state, taught, so_far, t), (key, first) = carry, now
            forgets = reset & ~self.partners.stay(env_state)  # a memory is for as long as the partner stays
            # A rollout's noise knows nothing of the one before, so that its density is one of its own actions alone.
            kept = jnp.where(reset | first, 0.0, correlation)
            partner_key, redraw_key, step_key, *action_keys = jax.random.split(key, 3 + len(self.learners))
            actions, partner_state = self.partners.act(partner_state, env_state, obs, reset, partner_key)
            shown, taught = self._shown(c, state, taught, env_state, obs, reset, partner_key)
            memory, noise, log_probs = dict(memory), dict(noise), {}
            for agent, action_key in zip(self.learners, action_keys, strict=True):
                carry = memory[agent], noise[agent]
                actions[agent], carry, log_probs[agent] = policy.sample(
                    params[agent], carry, obs[agent], forgets, kept, action_key, correlated
                )
                memory[agent], noise[agent] = carry
            global_obs_before = global_obs(env_state)
            who = self.partners.who(partner_state, env_state) if c.critic_knows_partner else None
            step_keys = jax.random.split(step_key, self.num_envs)
            next_obs, env_state, rewards, terminated, truncated, info = by_environment(env.step)(
                step_keys, env_state, actions
            )
            done = terminated["__all__"] | truncated["__all__"]
            final = self.networks.views(info["final_observation"], info.get("final_global_observation"), who)
            played = {
                "obs": self.networks.views(obs, global_obs_before, who),
                "final_obs": final,
                "reset": forgets,
                "actions": {agent: actions[agent] for agent in self.learners},
                "log_probs": log_probs,
                "beside": self.networks.done_beside(actions),
                "shown": shown,
                "kept": kept if correlated else None,  # correlation of the noise with that of the step before
                "rewards": {agent: rewards[agent] for agent in self.learners},
                "terminated": terminated["__all__"],
                "done": done,
            }
            whole = done & (t >= env.episode_length * c.stagger)
            if self.config.constrained:
                total = so_far + info["cost"]
                played |= {"cost": info["cost"], "episode_cost": total, "whole": whole}
                so_far = jnp.where(done, 0.0, total)
            log = step_log(info, whole)
            partner_state = self.partners.redraw(partner_state, env_state, done, redraw_key)
            return (env_state, next_obs, done, memory, noise, partner_state, taught, so_far, t + 1), (played, log)

        key, rollout_key = jax.random.split(state.key)
        t = state.iteration * c.num_steps + 1
        noise = {agent: jnp.zeros((self.num_envs, env.action_sizes[agent])) for agent in self.learners}
        so_far = state.constraint.so_far if self.config.constrained else ()
        beside = state.partner_state, state.teacher
        start = (state.env_state, state.obs, state.reset, state.memory, noise, *beside, so_far, t)
        steps = jax.random.split(rollout_key, c.num_steps), jnp.arange(c.num_steps) == 0
        end, (batch, log) = jax.lax.scan(play, start, steps)
        env_state, obs, reset, memory, _, partner_state, taught, so_far, _ = end
        after = {"env_state": env_state, "obs": obs, "reset": reset, "memory": memory, "partner_state": partner_state}
        after |= {"teacher": taught}
        if self.config.constrained:
            whole = batch.pop("whole")
            batch["episode_cost"] = jnp.sum(batch["episode_cost"] * whole) / whole.sum()  # NaN if none ended
            after["constraint"] = replace(state.constraint, so_far=so_far)
        batch |= {"memory": state.memory, "log": iteration_log(log)}
        return replace(state, **part_of_batch(after), key=key), batch

    def _teaching(self, c, iteration):
        """The weight of the teacher's term in an iteration."""
        return teaching_weight(c.teaching_steps, c.teaching_floor, iteration * float(self.steps_per_iteration))

    def _shown(self, c, state, taught, env_state, obs, reset, key):
        """What the teachers would do, by the learner whom they teach [num_envs, n], and what their scripts remember."""
        if not self.teacher.players:
            return {}, taught
        blank = {a: jnp.zeros((self.num_envs, self.env.action_sizes[a])) for a in self.teacher.players}
        seen = taught, env_state, obs, reset, key
        over = self._teaching(c, state.iteration) <= 0.0
        return jax.lax.cond(over, lambda taught, *_: (blank, taught), self.teacher.show, *seen)

    # -- learning ------------------------------------------------------------------------------

    def _samples(self, state: TrainState, batch: dict):
        """What the update learns from, all with the numbers of the rollout's own networks.

        [num_steps, num_envs, ...]: "obs" as networks see it, "reset" and, by learner, its actions with
        their advantages and value targets.
        """
        c, networks = overlaid(self.config, state.tuned), self.networks.of(state.params)
        seen, final = (
            self.networks.seen(state.normalizer, batch["obs"]),
            self.networks.seen(state.normalizer, batch["final_obs"]),
        )
        samples = {"obs": seen, "reset": batch["reset"], "kept": batch["kept"]}
        advantages, cost_advantages = {}, {}
        for agent in self.learners:
            reader, reset = remembering(networks[agent]), batch["reset"]
            _, memory = unroll(reader, seen[agent], batch["memory"][agent], reset, c.activation)
            # The state that a step led to is met with that step's memory, also where a reset followed.
            _, after = step(reader, final[agent], memory, jnp.zeros_like(reset), c.activation)

            def judged(critic, rewards, memory=memory, after=after, agent=agent):
                values = self.networks.value(critic, agent, seen, memory)
                next_values = self.networks.value(critic, agent, final, after)
                ends = batch["terminated"], batch["done"]
                # Values are then means of the rewards to come. Advantages are normalised anyway.
                rewards = rewards / horizon(c.gamma, self.env.episode_length)
                advantages = gae(rewards, values, next_values, *ends, c.gamma, c.gae_lambda)
                return {"old": values, "target": advantages + values}, advantages

            samples[agent] = {"action": batch["actions"][agent], "log_prob": batch["log_probs"][agent]}
            if agent in batch["shown"]:
                samples[agent]["shown"] = batch["shown"][agent]
            if c.partner_code:
                samples[agent]["told"] = jnp.concatenate([final[beside(agent)], batch["beside"][agent]], -1)
            samples[agent]["critic"], advantages[agent] = judged(networks[agent]["critic"], batch["rewards"][agent])
            if self.config.constrained:
                costs = in_means(batch["cost"], state.constraint)
                values_of_cost = judged(networks[agent]["cost_critic"], costs)
                samples[agent]["cost_critic"], cost_advantages[agent] = values_of_cost
        if self.config.constrained:
            advantages = combined(advantages, cost_advantages, state.constraint.multiplier)
        for agent in self.learners:
            samples[agent]["advantage"] = advantages[agent]
        return samples

    def improve(self, state: TrainState, batch: dict) -> tuple[TrainState, dict]:
        """`update_epochs` passes over the batch; returns the means of the losses and the like."""
        c = overlaid(self.config, state.tuned)
        informed = {view: update_stats(state.normalizer[view], x) for view, x in batch["obs"].items()}
        # The first batch was played before anything was known of observations; its own statistics serve at once, as
        # a fresh actor's mean is near 0 whatever it sees. Later ones are used only from the next rollout on, so that
        # every log-probability is computed with the rollout's own numbers.
        used = {
            view: jax.tree.map(partial(jnp.where, stats.count == 0.0), informed[view], stats)
            for view, stats in state.normalizer.items()
        }
        if self.config.constrained:
            constraint = updated(state.constraint, batch["episode_cost"], c.cost_limit, c.multiplier_gains)
            # Who began with another run's knowledge has that run's mean in place of the first iteration's.
            known = (state.iteration == 0) & (constraint.per_step > 0.0)
            off = jnp.where(known, 0.0, batch["cost"].mean() - constraint.per_step)
            per_step = constraint.per_step + off / (state.iteration + 1)
            state = replace(state, constraint=replace(constraint, per_step=per_step))
        samples = self._samples(replace(state, normalizer=used), batch)
        samples = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), samples)
        teaching = self._teaching(c, state.iteration)
        # Without memory, every step is a sequence of its own.
        steps = jnp.arange(c.num_steps)[:, None] * self.num_envs if self.config.remembers else 0
        sequences = self.num_envs if self.config.remembers else self.steps_per_iteration

        def minibatch(carry, ids):
            params, opt_state = carry
            part = jax.tree.map(lambda x: x[steps + ids], samples)
            if (
                self._correlated(state) and not self.config.remembers
            ):  # the step before in the same environment, if there is one
                part["before"] = jax.tree.map(lambda x: x[jnp.maximum(ids - self.num_envs, 0)], samples)
            part = part_of_batch(part, axis=1 if self.config.remembers else 0)
            part_start = part_of_batch(jax.tree.map(lambda x: x[ids], batch["memory"]))
            grads, stats = jax.grad(partial(self._loss, c, teaching=teaching), has_aux=True)(params, part, part_start)
            rate = c.learning_rate
            if c.anneal_learning_rate:
                rate *= 1.0 - opt_state[0].count / self._updates
            updates, opt_state = self._adam.update(clip_networks(grads, c.max_grad_norm), opt_state)
            rates = {name: dict.fromkeys(params[name], rate) for name in params}
            for name, scale in state.rate_scale.items():
                rates[name]["actor"] = rate * scale
            updates = jax.tree.map(optax.tree.scale, rates, updates)
            return (optax.apply_updates(params, updates), opt_state), stats

        def epoch(carry, key):
            ids = jax.random.permutation(key, sequences).reshape(c.num_minibatches, -1)
            return jax.lax.scan(minibatch, carry, ids)

        key, epoch_key = jax.random.split(state.key)
        carry = (state.params, state.opt_state)
        (params, opt_state), stats = jax.lax.scan(epoch, carry, jax.random.split(epoch_key, c.update_epochs))
        stats = jax.tree.map(jnp.mean, stats)
        if c.final_log_std is not None:
            params = self._quieter(c, params, state.iteration)
        kl = {agent: stats[agent]["approx_kl"] for agent in self.learners}
        if c.share_parameters:
            kl = {"shared": sum(kl.values()) / len(kl)}
        desired_kl = dict.fromkeys(kl, c.desired_kl)
        if self.teacher.players:  # they may move a policy as far as they have to
            led = ("shared",) if c.share_parameters else self.teacher.players
            limited = (teaching <= c.teaching_floor) | ((c.teaching_kl > 0.0) & (c.desired_kl > 0.0))
            desired_kl |= dict.fromkeys(led, jnp.where(limited, c.desired_kl + teaching * c.teaching_kl, 0.0))
        rate_scale = {name: adapted_rate(state.rate_scale[name], kl[name], desired_kl[name]) for name in kl}
        for agent, networks in self.networks.of(params).items():
            value, target = samples[agent]["critic"]["old"], samples[agent]["critic"]["target"]
            stats[agent]["explained_variance"] = 1.0 - jnp.var(target - value) / (jnp.var(target) + 1e-8)
            stats[agent]["std"] = jnp.exp(networks["actor"]["log_std"]).mean()
            stats[agent]["rate_scale"] = rate_scale["shared" if c.share_parameters else agent]
        if self.config.constrained:
            stats["constraint"] = {"cost": state.constraint.cost, "multiplier": state.constraint.multiplier}
        state = replace(
            state,
            params=params,
            opt_state=opt_state,
            rate_scale=rate_scale,
            normalizer=informed,
            key=key,
            iteration=state.iteration + 1,
        )
        return state, stats

    def _quieter(self, c, params, iteration):
        """Actors whose noise is at most what is allowed by now: what noise did, their means must learn."""
        most = most_log_std(c, iteration + 1, self.steps_per_iteration, self._last_iteration + 1)
        actors = {name: networks["actor"] for name, networks in params.items()}
        quiet = {name: actor | {"log_std": jnp.minimum(actor["log_std"], most)} for name, actor in actors.items()}
        return {name: networks | {"actor": quiet[name]} for name, networks in params.items()}

    def _loss(self, c, params, part, start, teaching=0.0):
        losses, stats = {}, {}
        for agent, networks in self.networks.of(params).items():
            losses[agent], stats[agent] = self._agent_loss(c, agent, networks, part, start[agent], teaching)
        # Shared weights learn from all agents' samples together: the mean over them.
        return sum(losses.values()) / (len(losses) if c.share_parameters else 1), stats

    def _noise_before(self, c, agent, actor, part, mean):
        """The noise [..., n] in the action before, if there is one, to those who would have acted with this `actor`.

        Not the noise of the rollout: an actor that acts otherwise explains the same actions by other noise, and without
        that the gradient is another's (Korenkevych et al., 2019).
        """

        def noise(action, mean):
            return (action - mean) * jnp.exp(-actor["log_std"])

        if self.config.remembers:
            here = noise(part[agent]["action"], mean)
            return jnp.concatenate([jnp.zeros_like(here[:1]), here[:-1]])

        def played_again():
            before = part["before"]
            return noise(before[agent]["action"], mlp(actor["layers"], before["obs"][agent], c.activation))

        # Costs nothing any more once the noise is independent.
        return jax.lax.cond(jnp.any(part["kept"] > 0.0), played_again, lambda: jnp.zeros_like(mean))

    def _log_prob(self, c, agent, networks, part, start):
        """Log-probabilities [...] of `part`'s actions given those before, means [..., n], the memory, the code."""
        actor = networks["actor"]
        mean, memory, code = unroll_actor(networks, part["obs"][agent], start, part["reset"], c.activation)
        given = () if part["kept"] is None else (self._noise_before(c, agent, actor, part, mean), part["kept"])
        return gaussian_log_prob(part[agent]["action"], mean, actor["log_std"], *given), mean, memory, code

    def _agent_loss(self, c, agent, networks, part, start, teaching):
        x, log_std = part[agent], networks["actor"]["log_std"]
        log_prob, mean, memory, code = self._log_prob(c, agent, networks, part, start)
        log_ratio = log_prob - x["log_prob"]
        policy_loss = clipped_policy_loss(log_ratio, x["advantage"], c.clip_eps)
        clip = c.clip_eps if c.clip_value else None
        value = {
            name: self.networks.value(networks[name], agent, part["obs"], memory) for name in self.networks.critics
        }
        errors = {name: value_loss(value[name], **x[name], clip_eps=clip) for name in self.networks.critics}
        entropy = gaussian_entropy(log_std)
        stats = {
            "policy_loss": policy_loss,
            "value_loss": errors["critic"],
            "entropy": entropy,
            "approx_kl": jnp.mean(jnp.expm1(log_ratio) - log_ratio),
            "clip_fraction": jnp.mean(jnp.abs(jnp.expm1(log_ratio)) > c.clip_eps),
            "value_change": jnp.mean(jnp.abs(value["critic"] - x["critic"]["old"])),
        }
        if self.config.constrained:
            stats["cost_value_loss"] = errors["cost_critic"]
        loss = policy_loss + c.value_coef * sum(errors.values()) - c.entropy_coef * entropy
        if "shown" in x:
            stats["imitation_loss"] = imitation_loss(mean, x["shown"], log_std)
            loss += teaching * (c.teaching_coef * stats["imitation_loss"] - policy_loss)
        if c.partner_code:
            stats["prediction_error"] = prediction_error(networks["partner_model"], code, x["told"], c.activation)
            loss += stats["prediction_error"]
        return loss, stats
