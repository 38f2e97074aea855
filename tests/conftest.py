"""Shared by all tests."""

import os

import jax
import pytest

import assistax


def pytest_configure(config):
    """Before JAX first compiles: most of the suite's time is compiling what then runs for milliseconds."""
    if config.option.markexpr == "not slow":
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_backend_optimization_level=0"


@pytest.fixture(scope="session")
def scratch():
    """The scratch environment on the C engine, with episodes of 20 steps."""
    return assistax.make("scratch", engine="mujoco", episode_length=20)


def random_actions(env, key, batch=()):
    return {a: jax.random.uniform(key, (*batch, n), minval=-1, maxval=1) for a, n in env.action_sizes.items()}
