"""Times of many samples in little memory."""

import numpy as np
from jaxtyping import Int

_LEAST = 1e3
_RATIO = 1.01
_BINS = 2000


class Latency:
    """Counts times in bins that widen by 1 %, from 1 µs to some minutes, so that every percentile
    is right to 1 %.
    """

    def __init__(self) -> None:
        self._counts = np.zeros(_BINS, dtype=np.int64)

    def add(self, nanoseconds: Int[np.ndarray, "n"]) -> None:
        """Count these (n,)."""
        place = np.log(np.maximum(nanoseconds, _LEAST) / _LEAST) / np.log(_RATIO)
        self._counts += np.bincount(np.minimum(place.astype(np.int64), _BINS - 1), minlength=_BINS)

    @property
    def count(self) -> int:
        """How many there were."""
        return int(self._counts.sum())

    def percentile(self, percent: float) -> float | None:
        """Time [s] that this share of all does not exceed: the upper end of its bin; None where
        there was none.
        """
        if not self.count:
            return None
        place = int(np.searchsorted(np.cumsum(self._counts), self.count * percent / 100))
        return float(_LEAST * _RATIO ** (min(place, _BINS - 1) + 1) * 1e-9)
