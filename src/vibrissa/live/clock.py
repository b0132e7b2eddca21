"""Time stamps: the host's clock, made even by the sender's."""

import time

import numpy as np
from jaxtyping import Int

_DRIFT = 500e-6
_RESYNC = 100_000_000


def epoch_offset() -> int:
    """What turns the monotonic clock into nanoseconds since 1970: the tightest of a few readings."""
    best: tuple[int, int] | None = None
    for _ in range(5):
        before, now, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if best is None or after - before < best[0]:
            best = after - before, now - (before + after) // 2
    assert best is not None
    return best[1]


class SampleClock:
    """Stamps of samples that were taken at the sender's own times and arrived after uneven delays.

    Delays are never negative, so the sender's clock, moved until it lies below all arrivals, is the best that the host can know. It follows arrivals downwards at once,
    and upwards by 500 ppm at most, more than quartzes differ. Where it is off by 0.1 s the stream is taken to have paused.
    """

    def __init__(self) -> None:
        self._offset: int | None = None
        self._last_own = 0
        self._last_stamp = -(2**62)
        self.resyncs = 0

    def restart(self) -> None:
        """Forget the sender's clock: it began anew."""
        self._offset = None

    def stamps(self, own: Int[np.ndarray, "n"], arrival: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        """Stamps (n,) [ns] on the clock of `arrival`, increasing, for the sender's times `own` (n,) [ns], increasing."""
        if not len(own):
            return np.empty(0, dtype=np.int64)
        if self._offset is None:
            self._offset, self._last_own = int(np.min(arrival - own)), int(own[0])
        slack = int(np.min(arrival - own)) - self._offset
        if abs(slack) > _RESYNC:
            self._offset += slack
            self.resyncs += 1
        else:
            self._offset += min(slack, round(_DRIFT * max(int(own[-1]) - self._last_own, 0)))
        earliest = self._last_stamp + 1 + np.arange(len(own), dtype=np.int64)
        stamp = np.maximum(own + self._offset, earliest)
        self._last_own, self._last_stamp = int(own[-1]), int(stamp[-1])
        return stamp
