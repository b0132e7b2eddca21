"""A source that falls silent, and comes back."""

import numpy as np

from vibrissa.live.samples import Nanoseconds

_LEAST = 500_000_000
"""Shortest silence [ns]: networks and busy computers hold datagrams back for less."""
_STEPS = 20
"""Nor is it shorter than the time of so many samples, for slow sensors."""


class SilenceWatch:
    """Notices silences of a source by the arrivals of its samples [ns]."""

    def __init__(self) -> None:
        self._first = self._last = self._samples = self._ended = self.count = 0
        self._noticed = False

    def _silent(self, pause: Nanoseconds) -> np.ndarray:
        """Those pauses (n,) [ns] that are silences; none are until so many samples have shown the
        sensor's pace.
        """
        if self._samples < _STEPS:
            return pause[:0]
        pace = (self._last - self._first - self._ended) / (self._samples - 1)
        return pause[pause >= max(_LEAST, _STEPS * pace)]

    def came(self, arrival: Nanoseconds) -> float | None:
        """Take note of samples (n,), and return the longest silence [s] before one of them; None
        for none.
        """
        if not self._samples:
            self._first = self._last = int(arrival[0])
        silences = self._silent(np.diff(arrival, prepend=self._last))
        self._samples += len(arrival)
        self._last = int(arrival[-1])
        self._ended += int(silences.sum())
        self.count += len(silences)
        self._noticed = False
        return float(silences.max()) * 1e-9 if len(silences) else None

    def begins(self, now: int) -> bool:
        """Whether a silence is noticed now; once each."""
        before, self._noticed = self._noticed, len(self._silent(np.array([now - self._last]))) > 0
        return self._noticed and not before

    def until(self, now: int) -> tuple[int, float]:
        """How many silences there were, and their seconds, with one that has not ended."""
        lasting = self._silent(np.array([now - self._last]))
        return self.count + len(lasting), (self._ended + int(lasting.sum())) * 1e-9
