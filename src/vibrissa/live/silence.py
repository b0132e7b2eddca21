"""A source that stops, and comes again."""

import numpy as np
from jaxtyping import Int

_LEAST = 500_000_000
"""Shortest silence [ns]: networks and busy computers hold datagrams back for less."""
_STEPS = 20
"""And no shorter than the time of so many samples, for slow sensors."""


class SilenceWatch:
    """Notices silences of a source by the arrivals of its samples [ns]."""

    def __init__(self) -> None:
        self._first: int | None = None
        self._last = 0
        self._samples = 0
        self._noticed = False
        self.count = 0
        self._ended = 0

    @property
    def _least(self) -> float:
        """Shortest pause [ns] that is one; none is, before so many samples have shown the sensor's
        pace.
        """
        if self._first is None or self._samples < _STEPS:
            return np.inf
        return max(_LEAST, _STEPS * (self._last - self._first - self._ended) / (self._samples - 1))

    def came(self, arrival: Int[np.ndarray, "n"]) -> float | None:
        """Take note of samples (n,), and return the longest silence [s] before one of them; None
        for none.
        """
        if self._first is None:
            self._first = self._last = int(arrival[0])
        pauses = np.diff(arrival, prepend=self._last)
        silences = pauses[pauses >= self._least]
        self._samples += len(arrival)
        self._last = int(arrival[-1])
        self._ended += int(silences.sum())
        self.count += len(silences)
        self._noticed = False
        return float(silences.max()) * 1e-9 if len(silences) else None

    def begins(self, now: int) -> bool:
        """Whether a silence is noticed now; once each."""
        if self._noticed or now - self._last < self._least:
            return False
        self._noticed = True
        return True

    def until(self, now: int) -> tuple[int, float]:
        """How many silences there were, and their seconds, with one that has not ended."""
        lasting = now - self._last if now - self._last >= self._least else 0
        return self.count + (lasting > 0), (self._ended + lasting) * 1e-9
