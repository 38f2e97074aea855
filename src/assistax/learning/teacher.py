"""Kickstarting (Schmitt et al., 2018): a scripted team shows the learners what it would do in their place.

The learners act by themselves, from the first step on. In every state that they come to, the teacher, who may see all
of it, says what it would have done, and their loss has a term for the difference, whose weight falls to zero, or
nearly. From then on reward decides, so that learners can become better than the teacher.
"""

from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp

from assistax.env import AGENTS
from assistax.errors import choose
from assistax.learning.partners import act_as_members
from assistax.policies import Player
from assistax.policies.scripted import scripted_player


class Teacher:
    """Scripted policies beside `num_envs` environments; holds no state.

    Args:
      env: an `assistax.env.Env`, whose state the scripts may see.
      num_envs: environments stepped side by side.
      names: "human=offer": whom each teaches, and as who; the human also as somebody with a habit, "human=shy".
      learners: who learns at all; who does not, a frozen partner or nobody, is taught nothing.
    """

    def __init__(self, env, num_envs: int, names: Iterable[str], learners: tuple[str, ...]):
        self.num_envs = num_envs
        self.players: dict[str, Player] = {}
        for text in names:
            agent, _, name = text.partition("=")
            if choose("agent of ppo.teachers", agent, AGENTS) in learners:
                self.players[agent] = scripted_player(name, env, agent)

    def init(self) -> dict[str, Any]:
        """What each script remembers, by the learner that it teaches [num_envs, ...]."""
        carries = {agent: player.initial_carry() for agent, player in self.players.items()}
        return jax.tree.map(lambda x: jnp.broadcast_to(x, (self.num_envs, *jnp.shape(x))), carries)

    def show(self, carries, env_state, obs, reset, key):
        """By the learner that it teaches the actions [num_envs, n], each entry in [-1, 1], and the carries moved on."""
        actions, moved = {}, {}
        index = jnp.zeros(self.num_envs, jnp.int32)
        for agent, player in self.players.items():
            keys = jax.random.split(key, self.num_envs)
            action, moved[agent] = act_as_members(player, index, carries[agent], obs[agent], env_state, reset, keys)
            actions[agent] = jnp.clip(action, -1.0, 1.0)
        return actions, moved


def teaching_weight(teaching_steps, floor, steps_so_far) -> jax.Array:
    """Of imitation in the loss, where reward has the rest: 1 at first, evenly less, no less than `floor`.

    Without a floor it is 0 from `teaching_steps` on.
    """
    return jnp.clip(1.0 - steps_so_far / teaching_steps, floor, 1.0)


def imitation_loss(mean: jax.Array, shown: jax.Array, log_std: jax.Array) -> jax.Array:
    """How far the means [..., n] are from what was shown [..., n]: half the mean of squares, in standard deviations.

    That is the cross-entropy of the teacher with the policy, up to a constant, for a spread that does not learn
    from it: it would grow to explain what was not understood.
    """
    z = (mean - shown) * jnp.exp(-jax.lax.stop_gradient(log_std))
    return 0.5 * jnp.square(z).sum(-1).mean()
