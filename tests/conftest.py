"""Shared by all tests."""

import jax
import pytest

import assistax


@pytest.fixture(scope="session")
def scratch():
    """The scratch environment on the C engine, with episodes of 20 steps."""
    return assistax.make("scratch", engine="mujoco", episode_length=20)


def random_actions(env, key, batch=()):
    return {a: jax.random.uniform(key, (*batch, n), minval=-1, maxval=1) for a, n in env.action_sizes.items()}
