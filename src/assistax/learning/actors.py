"""Trained actors as policies, in training as outside of it."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from assistax.errors import UsageError
from assistax.inference import NumPyPolicy
from assistax.learning.networks import gaussian_log_prob, mlp, next_noise
from assistax.learning.normalizer import normalize, shift_and_scale
from assistax.learning.partner_model import unroll_actor
from assistax.learning.squashed import sample_squashed, split_head


@dataclass(frozen=True)
class Actor:
    """A trained actor of PPO; params: {"actor": ..., "normalizer": ...} and perhaps "partner_model"."""

    activation: str = "tanh"
    normalize_obs: bool = True
    deterministic: bool = True
    memory: int = 0  # units of its GRU; 0 for none
    noise_correlation: float = 0.0  # of what it draws, from one step to the next
    longest_action: int = 0  # as many numbers are drawn if not deterministic

    def initial_carry(self):
        """Its memory, and its noise."""
        return jnp.zeros(self.memory) if self.memory else (), jnp.zeros(self.longest_action)

    def act(self, params, carry, obs, reset, key):
        if self.deterministic:
            mean, memory = self._mean(params, carry[0], obs, reset)
            return mean, (memory, carry[1])
        return self.sample(params, carry, obs, reset, jnp.where(reset, 0.0, self.noise_correlation), key)[:2]

    def sample(self, params, carry, obs, reset, kept, key, correlated=True):
        """An action for obs [..., n] and reset [...], the carry, and its log-probability given the noise before.

        kept [...] is the correlation of its noise with that of the step before, 0 where an episode begins; with
        `correlated` false it is 0 throughout.
        """
        mean, memory = self._mean(params, carry[0], obs, reset)
        log_std = params["actor"]["log_std"]
        noise = next_noise(carry[1], kept, key)
        n = mean.shape[-1]
        action = mean + jnp.exp(log_std) * noise[..., :n]
        given = (carry[1][..., :n], kept) if correlated else ()
        return action, (memory, noise), gaussian_log_prob(action, mean, log_std, *given)

    def as_numpy(self, params) -> NumPyPolicy:
        """The same without JAX, its mean action."""
        return _as_numpy(self, params, squashed=False)

    def _mean(self, params, memory, obs, reset):
        if self.normalize_obs:
            obs = normalize(params["normalizer"], obs)
        mean, memory, _ = unroll_actor(params, obs[None], memory, reset[None], self.activation)
        return mean[0], jax.tree.map(lambda h: h[0], memory)


@dataclass(frozen=True)
class SquashedActor:
    """A trained actor of SAC; params: {"actor": {"layers"}, "normalizer"}. Acts in (-1, 1)."""

    activation: str = "relu"
    normalize_obs: bool = True
    deterministic: bool = True  # tanh of the mean
    noise_correlation: float = 0.0  # of what it draws, from one step to the next
    longest_action: int = 0  # as many numbers are drawn if not deterministic

    def initial_carry(self):
        """Its noise."""
        return jnp.zeros(self.longest_action)

    def act(self, params, carry, obs, reset, key):
        if self.normalize_obs:
            obs = normalize(params["normalizer"], obs)
        mean, log_std = split_head(mlp(params["actor"]["layers"], obs, self.activation))
        if self.deterministic:
            return jnp.tanh(mean), carry
        noise = next_noise(carry, jnp.where(reset, 0.0, self.noise_correlation), key)
        return sample_squashed(mean, log_std, noise[: mean.shape[-1]])[0], noise

    def as_numpy(self, params) -> NumPyPolicy:
        """The same without JAX, its mean action."""
        return _as_numpy(self, params, squashed=True)


def _as_numpy(actor: Actor | SquashedActor, params, squashed: bool) -> NumPyPolicy:
    if "partner_model" in params:
        raise UsageError("A robot with a model of its partners cannot be exported to NumPy.")
    net = jax.tree.map(lambda x: np.asarray(x, np.float32), params["actor"])
    size = len(net["layers"][0]["w"])
    mean, scale = np.zeros(size, np.float32), np.ones(size, np.float32)
    if actor.normalize_obs:
        mean, scale = (np.asarray(x, np.float32) for x in shift_and_scale(params["normalizer"]))
    weights, biases = ([layer[name] for layer in net["layers"]] for name in ("w", "b"))
    gru = (net["gru"]["w"], net["gru"]["b"]) if "gru" in net else None
    return NumPyPolicy(actor.activation, squashed, mean, scale, weights, biases, gru, normalized=actor.normalize_obs)
