"""Who learns and who does not: every agent is a learner, or is played by a frozen partner.

Ad-hoc teamwork is ordinary training with one agent given to a `Player`: a scripted policy, or a
population of frozen ones of which every environment draws a member afresh for each episode.
"""

from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from assistax.errors import UsageError, choose
from assistax.policies import Player


class Partners:
    """The frozen partners in `num_envs` environments side by side; holds no state.

    Args:
      env: anything with the interface of `assistax.env.Env`.
      num_envs: environments stepped side by side.
      players: by agent, who plays it; agents without a player are the learners.
    """

    def __init__(self, env, num_envs: int, players: Mapping[str, Player] | None = None):
        self._env, self.num_envs, self.players = env, num_envs, dict(players or {})
        for agent, player in self.players.items():
            choose("agent", agent, env.agents)
            player.check(env)
        self.learners = tuple(agent for agent in env.agents if agent not in self.players)
        if not self.learners:
            raise UsageError(f"Partners play all agents ({', '.join(self.players)}); leave one to learn.")

    def init(self, key: jax.Array) -> dict[str, Any]:
        """By agent: which member plays in each environment, "index" [num_envs], and its "carry"."""
        state = {}
        for agent, player in self.players.items():
            carry = player.initial_carry()
            carry = jax.tree.map(lambda x: jnp.broadcast_to(x, (self.num_envs, *jnp.shape(x))), carry)
            state[agent] = {"index": jnp.zeros(self.num_envs, jnp.int32), "carry": carry}
        return self._drawn(state, jnp.ones(self.num_envs, bool), key)

    def act(self, state, env_state, obs, reset, key):
        """The partners' actions {agent: [num_envs, n]}, and `state` with their carries moved on.

        Args:
          state: what `init`, `redraw` or the last `act` returned.
          env_state: EnvState [num_envs], shown to privileged policies.
          obs: by agent [num_envs, n].
          reset: [num_envs] whether this is the first step of an episode.
          key: for policies that draw.
        """
        actions, moved = {}, {}
        for i, (agent, player) in enumerate(self.players.items()):
            index, carry = self._index(agent, state, env_state), state[agent]["carry"]
            keys = jax.random.split(jax.random.fold_in(key, i), self.num_envs)
            actions[agent], carry = act_as_members(player, index, carry, obs[agent], env_state, reset, keys)
            moved[agent] = {"index": index, "carry": carry}
        return actions, moved

    @property
    def members(self) -> int:
        """Of all players together."""
        return sum(player.members for player in self.players.values())

    def who(self, state, env_state) -> jax.Array:
        """Which member of each player plays, one-hot [num_envs, members]; `state` and env_state as in `act`."""
        plays = [jax.nn.one_hot(self._index(a, state, env_state), p.members) for a, p in self.players.items()]
        return jnp.concatenate(plays, -1)

    def _index(self, agent, state, env_state):
        return env_state.person.index if self.players[agent].by_person else state[agent]["index"]

    def stay(self, env_state) -> jax.Array:
        """[num_envs] whether who plays was in the episode before as well; environments that know say so."""
        if not hasattr(self._env, "met_before"):
            return jnp.zeros(self.num_envs, bool)
        return jax.vmap(self._env.met_before)(env_state)

    def redraw(self, state, env_state, done, key):
        """`state` with a fresh member, uniform over all, where an episode ended (done [num_envs]) and who plays leaves.

        env_state is that of the next step, after the reset.
        """
        return self._drawn(state, done & ~self.stay(env_state), key)

    def _drawn(self, state, done, key):
        drawn = {}
        for i, (agent, player) in enumerate(self.players.items()):
            fresh = player.draw(jax.random.fold_in(key, i), done.shape)
            drawn[agent] = state[agent] | {"index": jnp.where(done, fresh, state[agent]["index"])}
        return drawn


def act_as_members(player: Player, index, *seen):
    """One step of a partner in all environments; what it costs does not grow with its members."""
    if player.members == 1:
        chosen = player.member(0)
        return jax.vmap(lambda *one: player.act(chosen, *one))(*seen)
    # A CPU reads the chosen weights where they are; gathering a copy for every environment costs six
    # times as much there. An accelerator needs the environments side by side.
    if jax.default_backend() == "cpu":
        return jax.lax.map(lambda args: player.act_as(*args), (index, *seen))
    return jax.vmap(player.act_as)(index, *seen)
