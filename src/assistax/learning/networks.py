"""Networks as plain pytrees, with or without memory, and the diagonal Gaussian that policies draw from."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

MLP = list[dict[str, jax.Array]]
Network = dict[str, Any]
"""{"layers": MLP} and, if it remembers, "gru", which follows the first layer."""
ACTIVATIONS = {"tanh": jnp.tanh, "relu": jax.nn.relu, "swish": jax.nn.swish}


def init_mlp(key: jax.Array, sizes: Sequence[int], out_scale: float) -> MLP:
    """Layers of the given sizes with orthogonal weights: gain √2, and `out_scale` in the last."""
    keys = jax.random.split(key, len(sizes) - 1)
    scales = [2.0**0.5] * (len(sizes) - 2) + [out_scale]
    return [
        {"w": jax.nn.initializers.orthogonal(scale)(k, (m, n), jnp.float32), "b": jnp.zeros(n)}
        for k, m, n, scale in zip(keys, sizes[:-1], sizes[1:], scales, strict=True)
    ]


def mlp(layers: MLP, x: jax.Array, activation: str) -> jax.Array:
    """Apply to x [..., sizes[0]]; no activation after the last layer."""
    for layer in layers[:-1]:
        x = ACTIVATIONS[activation](x @ layer["w"] + layer["b"])
    return x @ layers[-1]["w"] + layers[-1]["b"]


def init_network(key: jax.Array, sizes: Sequence[int], out_scale: float, recurrent: bool) -> Network:
    """An MLP; if `recurrent` with a GRU of sizes[1] units after its first layer."""
    if not recurrent:
        return {"layers": init_mlp(key, sizes, out_scale)}
    key, x_key, h_key = jax.random.split(key, 3)
    n = sizes[1]

    def gates(key):
        square = jax.nn.initializers.orthogonal()
        return jnp.concatenate([square(k, (n, n), jnp.float32) for k in jax.random.split(key, 3)], axis=1)

    gru = {"wx": gates(x_key), "wh": gates(h_key), "b": jnp.zeros(3 * n), "bh": jnp.zeros(n)}
    return {"layers": init_mlp(key, sizes, out_scale), "gru": gru}


def gru_cell(gru: dict[str, jax.Array], x: jax.Array, h: jax.Array) -> jax.Array:
    """The next memory [..., n] (Cho et al., 2014; forget gate after the product, as cuDNN has it).

    Args:
      gru: weights; the gates are in the order forget, update, new.
      x: [..., 3n] what the input adds to the gates: input @ wx + b.
      h: [..., n] the memory so far.
    """
    n = h.shape[-1]
    recalled = h @ gru["wh"]
    forget, update = jnp.split(jax.nn.sigmoid(x[..., : 2 * n] + recalled[..., : 2 * n]), 2, axis=-1)
    new = jnp.tanh(x[..., 2 * n :] + forget * (recalled[..., 2 * n :] + gru["bh"]))
    return new + update * (h - new)


def unroll(net: Network, x: jax.Array, carry: Any, reset: jax.Array, activation: str) -> tuple[jax.Array, Any]:
    """Apply along time.

    Args:
      net: a network; without memory, time is an axis like any other.
      x: [T, ..., n] inputs.
      carry: [..., h] memory before x[0], from `initial_carry`; () for a network without.
      reset: [T, ...] whether x[t] begins an episode: the memory is emptied before it.

    Returns:
      the outputs [T, ..., m], and the memory [T, ..., h] after each step.
    """
    if "gru" not in net:
        return mlp(net["layers"], x, activation), ()
    first, *rest = net["layers"]
    # All that does not depend on the memory is done for all steps at once.
    inputs = ACTIVATIONS[activation](x @ first["w"] + first["b"]) @ net["gru"]["wx"] + net["gru"]["b"]

    def remember(h, step):
        inputs, reset = step
        h = gru_cell(net["gru"], inputs, jnp.where(reset[..., None], 0.0, h))
        return h, h

    _, carries = jax.lax.scan(remember, carry, (inputs, reset))
    return mlp(rest, carries, activation), carries


def step(net: Network, x: jax.Array, carry: Any, reset: jax.Array, activation: str) -> tuple[jax.Array, Any]:
    """`unroll` by one step: x [..., n] to (output [..., m], carry [..., h])."""
    outputs, carries = unroll(net, x[None], carry, reset[None], activation)
    return outputs[0], jax.tree.map(lambda h: h[0], carries)


def network_of(shared: Network, index: int, count: int, inputs: int, outputs: int) -> Network:
    """One agent's view of a network that `count` agents share.

    The shared one reads [observation, zeros up to the longest, one-hot of the agent] and writes as many
    numbers as the longest action has. Zeros and ones need no multiplication: what is returned reads
    the observation [inputs] alone and writes [outputs], so no agent has dummy dimensions.
    """
    first, *between, last = shared["layers"]
    first = {"w": first["w"][:inputs], "b": first["b"] + first["w"][index - count]}
    last = {"w": last["w"][:, :outputs], "b": last["b"][:outputs]}
    return shared | {"layers": [first, *between, last]}


def gaussian_log_prob(x: jax.Array, mean: jax.Array, log_std: jax.Array) -> jax.Array:
    """Log-density [...] of x [..., n] under independent normals."""
    z = (x - mean) * jnp.exp(-log_std)
    return -0.5 * jnp.sum(jnp.square(z) + 2.0 * log_std + jnp.log(2.0 * jnp.pi), -1)


def gaussian_entropy(log_std: jax.Array) -> jax.Array:
    """Entropy [...] of independent normals with log standard deviations log_std [..., n]."""
    return jnp.sum(log_std + 0.5 * jnp.log(2.0 * jnp.pi * jnp.e), -1)
