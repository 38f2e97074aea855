"""LIAM (Papoudakis et al., 2021): who the partners are, told from what a learner has seen so far.

An encoder, a GRU, turns a learner's observations into a code; from it a decoder predicts what the others do now and see
next. The actor reads the code beside its observation and does not shape it, and the critic reads the encoder's memory.
"""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from assistax.learning.networks import Network, init_mlp, init_network, mlp, unroll


def init_partner_model(key: jax.Array, seen: int, hidden: Sequence[int], code: int, told: int) -> Network:
    """Encoder of observations [seen] to a code [code], and decoder of that to what it tells [told]."""
    encoder_key, decoder_key = jax.random.split(key)
    encoder = init_network(encoder_key, (seen, *hidden, code), 1.0, recurrent=True)
    return {"encoder": encoder, "decoder": {"layers": init_mlp(decoder_key, (code, *hidden[-1:], told), 1.0)}}


def remembering(own: dict[str, Any]) -> Network:
    """Which of a learner's networks its memory is of."""
    return own["partner_model"]["encoder"] if "partner_model" in own else own["actor"]


def unroll_actor(own: dict[str, Any], x: jax.Array, carry: Any, reset: jax.Array, activation: str):
    """A learner's mean actions along time, as `networks.unroll`: (means [T, ..., m], memory [T, ..., h], code).

    The code is [T, ..., code], () without a model of the partners.
    """
    if "partner_model" not in own:
        return *unroll(own["actor"], x, carry, reset, activation), ()
    code, memory = unroll(remembering(own), x, carry, reset, activation)
    seen = jnp.concatenate([x, jax.lax.stop_gradient(code)], -1)
    return mlp(own["actor"]["layers"], seen, activation), memory, code


def prediction_error(model: Network, code: jax.Array, truth: jax.Array, activation: str) -> jax.Array:
    """Mean squared error of what the decoder tells of the partners, against the truth [..., told]."""
    return jnp.mean(jnp.square(mlp(model["decoder"]["layers"], code, activation) - truth))
