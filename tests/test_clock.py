"""The clock that the robot sees, for work that goes to and fro."""

import jax
import numpy as np
import pytest

import assistax
from assistax.errors import UsageError
from assistax.policies.experts.controller import to_and_fro


def test_the_robot_sees_sine_and_cosine_of_the_episodes_time_and_the_person_does_not():
    env = assistax.make("scratch-v3", engine="mujoco", episode_length=40)
    obs, state = env.reset(jax.random.key(0))
    place, step = env.obs_layout("robot")["clock"], jax.jit(env.step)
    assert "clock" not in env.obs_layout("human")
    whole = env.obs_layout("global")["clock"]
    for t in range(90):
        angle = 2.0 * np.pi * 1.5 * 0.008 * (t % 40)  # afresh with every episode
        np.testing.assert_allclose(obs["robot"][place], [np.sin(angle), np.cos(angle)], atol=1e-5)
        np.testing.assert_array_equal(env.global_obs(state)[whole], obs["robot"][place])
        obs, state, *_ = step(jax.random.key(t), state, {"robot": np.zeros(7), "human": np.zeros(3)})


def test_who_asks_for_no_clock_or_a_version_without_sees_none():
    sizes = {}
    for name, clock in (("scratch-v1", None), ("scratch-v3", 0.0), ("scratch-v1", 1.5), ("scratch-v3", None)):
        env = assistax.make(name, engine="mujoco", clock=clock)
        sizes[name, clock] = env.observation_sizes["robot"], env.observation_sizes["human"], env.global_size
        assert ("clock" in env.obs_layout("robot")) == (sizes[name, clock][0] == 42)
    assert sizes["scratch-v1", None] == sizes["scratch-v3", 0.0] == (40, 44, 58)
    assert sizes["scratch-v1", 1.5] == sizes["scratch-v3", None] == (42, 44, 60)


@pytest.mark.parametrize("clock", [-1.0, float("nan"), "fast", True, 63.0])
def test_a_clock_runs_at_a_number_of_hz(clock):
    with pytest.raises(UsageError, match="clock must be"):
        assistax.make("scratch-v3", engine="mujoco", clock=clock)


def test_a_swing_to_the_clock_is_as_fast_as_wished_and_goes_where_it_says():
    frequency, speed = 1.5, 0.06
    angle = 2.0 * np.pi * frequency * np.arange(0.0, 1.0 / frequency, 1e-5)
    place, velocity = to_and_fro(np.stack([np.sin(angle), np.cos(angle)]), speed, frequency)
    assert np.abs(velocity).mean() == pytest.approx(speed, rel=1e-3)
    np.testing.assert_allclose(np.gradient(place, 1e-5)[1:-1], np.asarray(velocity)[1:-1], atol=1e-4)
