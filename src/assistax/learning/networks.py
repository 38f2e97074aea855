"""Networks as plain pytrees, with or without memory, and the diagonal Gaussian that policies draw from."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

MLP = list[dict[str, jax.Array]]
Network = dict[str, Any]
"""{"layers": MLP} and, if it remembers, "gru": the first layer then feeds its gates."""
ACTIVATIONS = {"tanh": jnp.tanh, "relu": jax.nn.relu, "swish": jax.nn.swish}


def init_mlp(key: jax.Array, sizes: Sequence[int], out_scale: float) -> MLP:
    """Layers of the given sizes with orthogonal weights: gain √2, and `out_scale` in the last."""
    keys = jax.random.split(key, len(sizes) - 1)
    scales = [2.0**0.5] * (len(sizes) - 2) + [out_scale]
    return [
        {"w": jax.nn.initializers.orthogonal(scale)(k, (m, n), jnp.float32), "b": jnp.zeros(n)}
        for k, m, n, scale in zip(keys, sizes[:-1], sizes[1:], scales, strict=True)
    ]


def dense(layer: dict[str, jax.Array], x: jax.Array) -> jax.Array:
    """x [..., m] to [..., n] by an affine map."""
    # Flat, as the gradient of a product over several axes transposes them first: twice the time on a CPU.
    flat = x.reshape(-1, x.shape[-1]) if x.ndim > 2 else x
    return (flat @ layer["w"] + layer["b"]).reshape(*x.shape[:-1], -1)


def mlp(layers: MLP, x: jax.Array, activation: str) -> jax.Array:
    """Apply to x [..., sizes[0]]; no activation after the last layer."""
    for layer in layers[:-1]:
        x = ACTIVATIONS[activation](dense(layer, x))
    return dense(layers[-1], x)


def init_network(key: jax.Array, sizes: Sequence[int], out_scale: float, recurrent: bool) -> Network:
    """An MLP; if `recurrent` with a GRU of sizes[1] units in place of its first layer."""
    layers = init_mlp(key, sizes, out_scale)
    if not recurrent:
        return {"layers": layers}
    x_key, h_key = jax.random.split(jax.random.fold_in(key, 1))
    m, n = sizes[:2]

    def gates(key, scale, rows):
        orthogonal = jax.nn.initializers.orthogonal(scale)
        return jnp.concatenate([orthogonal(k, (rows, n), jnp.float32) for k in jax.random.split(key, 3)], axis=1)

    layers[0] = {"w": gates(x_key, 2.0**0.5, m), "b": jnp.zeros(3 * n)}
    return {"layers": layers, "gru": {"w": gates(h_key, 1.0, n), "b": jnp.zeros(n)}}


def gru_gates(x: jax.Array, recalled: jax.Array, h: jax.Array) -> jax.Array:
    """The next memory [..., n] (Cho et al., 2014; forget gate after the product, as cuDNN has it).

    Args:
      x: [..., 3n] what the input adds to the gates forget, update and new: input @ wx + b.
      recalled: [..., 3n] what the memory adds: h @ wh, and bh for the gate new.
      h: [..., n] the memory so far.
    """
    n = h.shape[-1]
    forget, update = jnp.split(jax.nn.sigmoid(x[..., : 2 * n] + recalled[..., : 2 * n]), 2, axis=-1)
    new = jnp.tanh(x[..., 2 * n :] + forget * recalled[..., 2 * n :])
    return new + update * (h - new)


@jax.custom_vjp
def remember(gru: dict[str, jax.Array], x: jax.Array, carry: jax.Array, reset: jax.Array) -> jax.Array:
    """A GRU's memory [T, ..., n] after each step.

    Its gradient is the plain one, but the weights' is one product after the scan, not a sum inside of it.

    Args:
      gru: "w" [n, 3n], weights of the memory, and "b" [n], its bias in the gate new.
      x: [T, ..., 3n] what the inputs add to the gates.
      carry: [..., n] memory before the first step.
      reset: [T, ...] whether the memory is emptied before a step.
    """
    return _remember(gru, x, carry, reset)[0]


def _remember(gru, x, carry, reset):
    b = jnp.pad(gru["b"], (2 * len(gru["b"]), 0))

    def step(h, now):
        x, forgotten = now
        recalled = h @ gru["w"] + b
        after = gru_gates(x, recalled, h)
        return _unless(forgotten, after), (h, recalled, after)

    # The memory is emptied at the end of the step before: written over itself, it would not be vectorised.
    next_reset = jnp.concatenate([reset[1:], jnp.zeros_like(reset[:1])])
    _, (before, recalled, after) = jax.lax.scan(step, _unless(reset[0], carry), (x, next_reset))
    return after, (gru, x, reset, before, recalled)


def _remember_back(residuals, d_after):
    gru, x, reset, before, recalled = residuals

    def step(dh, now):
        d_after, reset, *inputs = now
        dx, d_recalled, dh_direct = jax.vjp(gru_gates, *inputs)[1](d_after + dh)
        return _unless(reset, dh_direct + d_recalled @ gru["w"].T), (dx, d_recalled)

    start = jnp.zeros_like(before[0])
    d_carry, (dx, d_recalled) = jax.lax.scan(step, start, (d_after, reset, x, recalled, before), reverse=True)
    before, flat = (a.reshape(-1, a.shape[-1]) for a in (before, d_recalled))
    return {"w": before.T @ flat, "b": flat[:, -len(gru["b"]) :].sum(0)}, dx, d_carry, None


remember.defvjp(_remember, _remember_back)


def _unless(reset: jax.Array, h: jax.Array) -> jax.Array:
    """h [..., n], and zero where `reset` [...]."""
    return jnp.where(reset[..., None], 0.0, h)


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
    carries = remember(net["gru"], dense(first, x), carry, reset)
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


def next_noise(noise: jax.Array, kept: jax.Array, key: jax.Array) -> jax.Array:
    """Standard normal noise [..., n] one step after `noise`, with which it has the correlation `kept` [...]."""
    kept = kept[..., None]
    return kept * noise + jnp.sqrt(1.0 - jnp.square(kept)) * jax.random.normal(key, noise.shape)


def gaussian_log_prob(
    x: jax.Array, mean: jax.Array, log_std: jax.Array, before: jax.Array | None = None, kept: jax.Array | None = None
) -> jax.Array:
    """Log-density [...] of x [..., n] under independent normals; if their noise is correlated in time, given the past.

    Args:
      x: [..., n].
      mean: [..., n].
      log_std: [..., n].
      before: [..., n] the noise of the step before, in standard deviations.
      kept: [...] its correlation with the noise in x, see `next_noise`.
    """
    z, log_spread = (x - mean) * jnp.exp(-log_std), log_std
    if before is not None and kept is not None:
        kept = kept[..., None]
        z = (z - kept * before) * jax.lax.rsqrt(1.0 - jnp.square(kept))
        log_spread = log_std + 0.5 * jnp.log1p(-jnp.square(kept))
    return -0.5 * jnp.sum(jnp.square(z) + 2.0 * log_spread + jnp.log(2.0 * jnp.pi), -1)


def gaussian_entropy(log_std: jax.Array) -> jax.Array:
    """Entropy [...] of independent normals with log standard deviations log_std [..., n]."""
    return jnp.sum(log_std + 0.5 * jnp.log(2.0 * jnp.pi * jnp.e), -1)
