"""Numbers without end in flat memory."""

import math

import numpy as np

_SHIFT = 12  # of a float32's 32 bits; the bits of non-negative floats are in the order of their values


class Distribution:
    """What was added so far to a collection of non-negative float32 numbers.

    Counts, means and the largest are exact; a quantile is that of a histogram whose bins are 0.05 % wide, so that it is
    right to 0.025 %.
    """

    def __init__(self):
        self._counts = np.zeros((1 << (31 - _SHIFT)), np.int64)
        self._total, self.peak, self.positive = 0.0, 0.0, 0

    def add(self, values: np.ndarray) -> None:
        """Values of any shape, finite and not below 0."""
        values = np.abs(np.ravel(values).astype(np.float32))  # abs: no -0
        self._counts += np.bincount(values.view(np.uint32) >> _SHIFT, minlength=self._counts.size)
        self._total += float(values.sum(dtype=np.float64))
        self.positive += int(np.count_nonzero(values))
        self.peak = max(self.peak, float(values.max(initial=0.0)))

    @property
    def mean(self) -> float:
        """Of all values."""
        return self._total / max(int(self._counts.sum()), 1)

    @property
    def mean_positive(self) -> float:
        """Of those above 0; 0 if there are none."""
        return self._total / max(self.positive, 1)

    def quantile(self, q: float) -> float:
        """Between the two nearest numbers, as NumPy's default."""
        upto = np.cumsum(self._counts)
        rank = q * (int(upto[-1]) - 1)
        low, high = (_middle(int(np.searchsorted(upto, r, "right"))) for r in (math.floor(rank), math.ceil(rank)))
        return min(low + (rank - math.floor(rank)) * (high - low), self.peak)


def _middle(bin: int) -> float:
    """Of a bin; the first holds 0 and what is next to it."""
    ends = np.array([bin << _SHIFT, (bin + 1) << _SHIFT], np.uint32).view(np.float32)
    return float(ends.astype(np.float64).mean()) if bin else 0.0
