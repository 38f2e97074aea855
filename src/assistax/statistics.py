"""Means with 95 % intervals."""

import numpy as np


def bootstrap_ci(values, resamples: int = 10_000, seed: int = 0) -> tuple[float, float]:
    """95 % percentile-bootstrap interval of the mean of values [n]; (mean, mean) for one value."""
    values = np.asarray(values, np.float64)
    ids = np.random.default_rng(seed).integers(len(values), size=(resamples, len(values)))
    low, high = np.percentile(values[ids].mean(1), [2.5, 97.5])
    return float(low), float(high)


def proportion_ci(successes: int, trials: int) -> tuple[float, float]:
    """95 % Wilson score interval of a proportion: sound also at 0 and at 1."""
    z, p = 1.959964, successes / trials
    centre = p + z * z / (2 * trials)
    spread = z * np.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    return max(0.0, float((centre - spread) / scale)), min(1.0, float((centre + spread) / scale))
