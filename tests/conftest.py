"""Shared by all tests."""

import os

# Nearly all of the suite's time is compiling; what is compiled runs for milliseconds. Before JAX is imported.
os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"

import jax
import pytest

import assistax


@pytest.fixture(scope="session")
def scratch():
    """The scratch environment on the C engine, with episodes of 20 steps."""
    return assistax.make("scratch", engine="mujoco", episode_length=20)


def random_actions(env, key, batch=()):
    return {a: jax.random.uniform(key, (*batch, n), minval=-1, maxval=1) for a, n in env.action_sizes.items()}
