"""Time stamps: the host's clock, made even by the sender's."""

import time

import numpy as np
from jaxtyping import Int

_DRIFT = 500e-6
_RESYNC = 100_000_000
_RATE_WINDOW = 500_000_000
_RATE_TOLERANCE = 0.2


def epoch_offset() -> int:
    """What turns the monotonic clock into nanoseconds since 1970: the tightest of a few readings."""
    best: tuple[int, int] | None = None
    for _ in range(5):
        before, now, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if best is None or after - before < best[0]:
            best = after - before, now - (before + after) // 2
    assert best is not None
    return best[1]


class RateWatch:
    """Notices a sender whose rate is another than was thought.

    In each window of half a second the least delay is taken, which a sender or a receiver that stalls for a moment does not change. Where it runs off by more than a
    fifth of the time, alike over two windows, the rate is wrong.
    """

    def __init__(self) -> None:
        self._begun: int | None = None
        self._least = 0
        self._seen: list[int] = []

    def factor(self, own: Int[np.ndarray, "n"], arrival: Int[np.ndarray, "n"]) -> float | None:
        """By how much the sender's period is longer than `own` (n,) [ns] supposes, if another; arrivals (n,) [ns]."""
        delay = int(np.min(arrival - own))
        if self._begun is None:
            self._begun, self._least = int(arrival[0]), delay
        if int(arrival[-1]) - self._begun < _RATE_WINDOW:
            self._least = min(self._least, delay)
            return None
        # A window may have been longer than it should; what counts is how long each was.
        self._seen = [*self._seen[-2:], self._least]
        self._begun, self._least = self._begun + _RATE_WINDOW, delay
        if int(arrival[-1]) - self._begun >= _RATE_WINDOW:
            self._begun, self._seen = int(arrival[-1]), []
            return None
        return self._judged()

    def _judged(self) -> float | None:
        if len(self._seen) < 3:
            return None
        first, second = (np.diff(self._seen) / _RATE_WINDOW).tolist()
        if abs(first) < _RATE_TOLERANCE or abs(second - first) > _RATE_TOLERANCE * abs(first) or first >= 1 or second >= 1:
            return None
        self._begun, self._seen = None, []
        return 1 / (1 - (first + second) / 2)


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
