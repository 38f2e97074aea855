"""Feed-forward networks as plain pytrees, and the diagonal Gaussian that policies draw from."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp

MLP = list[dict[str, jax.Array]]
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


def gaussian_log_prob(x: jax.Array, mean: jax.Array, log_std: jax.Array) -> jax.Array:
    """Log-density [...] of x [..., n] under independent normals."""
    z = (x - mean) * jnp.exp(-log_std)
    return -0.5 * jnp.sum(jnp.square(z) + 2.0 * log_std + jnp.log(2.0 * jnp.pi), -1)


def gaussian_entropy(log_std: jax.Array) -> jax.Array:
    """Entropy [...] of independent normals with log standard deviations log_std [..., n]."""
    return jnp.sum(log_std + 0.5 * jnp.log(2.0 * jnp.pi * jnp.e), -1)
