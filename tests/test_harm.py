"""Harm by hand: filter, clamping, impact, comfort, and what may not count as either."""

import jax.numpy as jnp
import numpy as np
import pytest

from assistax.human import harm

DT = 0.008
REGIONS = list(harm.LIMITS)


def after(series, region="forearm"):
    """The state after forces [T] in N on one region."""
    state = harm.begin()
    for newtons in series:
        state = harm.advance(state, jnp.zeros(len(REGIONS)).at[REGIONS.index(region)].set(newtons), DT)
    return state


def filtered(series):
    """The low-pass filter, exactly: a first-order lag between samples that hold."""
    value, values = 0.0, []
    for newtons in np.asarray(series, np.float64):
        value = newtons + (value - newtons) * np.exp(-DT / harm.FILTER_SECONDS)
        values.append(value)
    return np.array(values)


def test_limits_are_the_published_ones():
    table = {name: (limit.clamping, limit.impact) for name, limit in harm.LIMITS.items()}
    assert table["head"] == (65, 90) and table["forearm"] == (160, 220) and table["torso"] == (140, 210)
    assert all(limit.comfort < limit.clamping < limit.impact for limit in harm.LIMITS.values())


@pytest.mark.parametrize("region", REGIONS)
def test_clamping_is_a_long_force_and_not_a_short_one(region):
    limit, steps = harm.LIMITS[region].clamping, int(harm.CLAMPING_SECONDS / DT)
    assert not after([limit + 1] * steps, region).clamped.any()  # half a second is not longer than half a second
    assert after([limit + 1] * (steps + 2), region).clamped.any()
    assert not after(([limit + 1] * steps + [limit - 1]) * 3, region).clamped.any()  # let go in between
    assert not after([limit - 1] * 1000, region).clamped.any()


@pytest.mark.parametrize("region", REGIONS)
def test_impact_is_a_filtered_peak_and_not_one_step_of_it(region):
    limit = harm.LIMITS[region].impact
    for series in ([2.4 * limit], [2.6 * limit], [1.5 * limit] * 2, [1.5 * limit] * 3):
        assert bool(after(series, region).hit.any()) == (filtered(series).max() > limit)
    np.testing.assert_allclose(
        after([100.0, 50.0, 0.0, 70.0]).peak, filtered([100.0, 50.0, 0.0, 70.0]).max(), rtol=1e-6
    )


def test_comfort_counts_time_and_newton_seconds():
    state = after([4.0, 11.0, 30.0, 9.0])
    np.testing.assert_allclose(state.uncomfortable, 2 * DT)
    np.testing.assert_allclose(state.impulse, DT * (1.0 + 20.0), rtol=1e-6)
    forces = jnp.zeros(len(REGIONS)).at[jnp.array([0, 3])].set(jnp.array([8.0, 12.0]))  # head and forearm
    np.testing.assert_allclose(harm.cost(forces, DT), DT * (3.0 + 2.0), rtol=1e-6)
    assert harm.cost(jnp.zeros(len(REGIONS)), DT) == 0.0
    assert harm.harmless(state) and not harm.harmless(after([1000.0] * 5))
    assert harm.outcomes(after([1000.0] * 100))["clamping"] == 1.0
