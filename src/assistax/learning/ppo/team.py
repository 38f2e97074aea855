"""The networks of a team: which there are, what each sees, and how learners share them."""

from typing import Any

import jax
import jax.numpy as jnp

from assistax.learning.networks import init_mlp, init_network, mlp, network_of
from assistax.learning.normalizer import normalize
from assistax.learning.partner_model import init_partner_model
from assistax.learning.ppo.config import PPOConfig


def beside(agent: str) -> str:
    """The name of the view of what the others of a learner see."""
    return f"beside {agent}"


class TeamNetworks:
    """An actor, a critic and, if asked for, a cost critic and a model of the partners for each learner.

    Holds no parameters. What networks see goes by the name of a view: a learner's observation, "global" for central
    critics, "who" the partners are (one-hot of `members`) for critics that know them, or what the others see, of which
    a model of the partners tells.
    """

    def __init__(self, env, config: PPOConfig, learners: tuple[str, ...], members: int = 0):
        self.config, self.learners, self._actions = config, learners, env.action_sizes
        self.critics = ("critic", "cost_critic") if config.constrained else ("critic",)
        self.units = config.hidden[0] if config.remembers else 0  # of memory
        self.sizes = {agent: env.observation_sizes[agent] for agent in learners}  # by view
        if config.central_critic:
            self.sizes["global"] = env.global_size
        if config.critic_knows_partner:
            self.sizes["who"] = members
        self._others = {agent: [other for other in env.agents if other != agent] for agent in learners}
        if config.partner_code:
            for agent, others in self._others.items():
                self.sizes[beside(agent)] = sum(env.observation_sizes[other] for other in others)
        who = ("who",) if config.critic_knows_partner else ()
        self._critic_sees = {a: ("global" if config.central_critic else a, *who) for a in learners}

    def init(self, key: jax.Array, initial_log_std: float | jax.Array) -> dict[str, Any]:
        """By learner, or under "shared", its networks."""
        c = self.config
        sizes, actions = self.sizes, self._actions

        def pair(key, seen, seen_by_critic, acts, told=0):
            actor_key, critic_key = jax.random.split(key)
            actor = init_network(actor_key, (seen + c.partner_code, *c.hidden, acts), 0.01, c.recurrent)
            actor["log_std"] = jnp.full(acts, initial_log_std, jnp.float32)
            critic = init_mlp(critic_key, (self.units + seen_by_critic, *c.hidden, 1), 1.0)
            networks = {"actor": actor, "critic": {"layers": critic}}
            if c.constrained:
                key = jax.random.fold_in(key, 1)  # the others are those of a training without
                critic = init_mlp(key, (self.units + seen_by_critic, *c.hidden, 1), 1.0)
                networks["cost_critic"] = {"layers": critic}
            if c.partner_code:
                key = jax.random.fold_in(key, 2)
                networks["partner_model"] = init_partner_model(key, seen, c.hidden, c.partner_code, told)
            return networks

        if c.share_parameters:  # see network_of
            count = len(self.learners)
            seen = max(sizes[agent] for agent in self.learners)
            seen_by_critic = max(map(self._critic_size, self.learners))
            acts = max(actions[agent] for agent in self.learners)
            return {"shared": pair(key, seen + count, seen_by_critic + count, acts)}
        keys = zip(self.learners, jax.random.split(key, len(self.learners)), strict=True)
        told = {a: sizes.get(beside(a), 0) + sum(actions[other] for other in self._others[a]) for a in self.learners}
        return {a: pair(k, sizes[a], self._critic_size(a), actions[a], told[a]) for a, k in keys}

    def of(self, params) -> dict[str, Any]:
        """By learner its "actor", its "critic" and, if there are any, its "cost_critic" and its "partner_model"."""
        if not self.config.share_parameters:
            return params
        shared, count, networks = params["shared"], len(self.learners), {}
        for i, agent in enumerate(self.learners):
            acts = self._actions[agent]
            own = network_of(shared["actor"], i, count, self.sizes[agent], acts)
            networks[agent] = {"actor": own | {"log_std": shared["actor"]["log_std"][:acts]}}
            for name in self.critics:
                seen = self.units + self._critic_size(agent)
                networks[agent][name] = network_of(shared[name], i, count, seen, 1)
        return networks

    def _critic_size(self, agent):
        return sum(self.sizes[view] for view in self._critic_sees[agent])

    def views(self, obs, global_obs, who=None):
        """All that networks see, by name, see above."""
        everything = {agent: obs[agent] for agent in self.learners} | {"global": global_obs, "who": who}
        if self.config.partner_code:
            everything |= {
                beside(agent): jnp.concatenate([obs[a] for a in self._others[agent]], -1) for agent in self.learners
            }
        return {view: everything[view] for view in self.sizes}

    def done_beside(self, actions):
        """By learner the others' actions [..., n], if there is a model that tells of them."""
        if not self.config.partner_code:
            return {}
        return {agent: jnp.concatenate([actions[a] for a in self._others[agent]], -1) for agent in self.learners}

    def seen(self, normalizer, views):
        """`views` [..., n] as the networks see them."""
        if not self.config.normalize_obs:
            return views
        return {view: normalize(normalizer[view], x) for view, x in views.items()}

    def value(self, critic, agent, seen, memory):
        """The critic's value [...] of what is `seen` and of the actor's `memory` after it."""
        parts = [seen[view] for view in self._critic_sees[agent]]
        if self.config.remembers:
            parts = [jax.lax.stop_gradient(memory), *parts]
        x = jnp.concatenate(parts, -1) if len(parts) > 1 else parts[0]
        return mlp(critic["layers"], x, self.config.activation)[..., 0]
