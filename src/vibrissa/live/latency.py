"""Times of many samples in little memory."""

import numpy as np

from vibrissa.live.samples import Nanoseconds

# From 1 µs in steps of 1 %, the accuracy of a percentile, to 7 minutes.
_EDGES = 1e3 * 1.01 ** np.arange(2000)


class Latency:
    """Counts times in bins that widen by 1 %, so that every percentile is right to 1 %."""

    def __init__(self) -> None:
        self._counts = np.zeros(len(_EDGES) + 1, dtype=np.int64)

    def add(self, nanoseconds: Nanoseconds) -> None:
        """Count these (n,)."""
        self._counts += np.bincount(
            np.searchsorted(_EDGES, nanoseconds), minlength=len(self._counts)
        )

    def percentile(self, percent: float) -> float | None:
        """Time [s] that this share of all does not exceed: the upper end of its bin; None if none
        was counted.
        """
        total = np.cumsum(self._counts)
        if not total[-1]:
            return None
        place = int(np.searchsorted(total, total[-1] * percent / 100))
        return float(_EDGES[min(place, len(_EDGES) - 1)] * 1e-9)
