"""Time stamps: the host's clock, made even by the sender's."""

import time
from collections import deque

import numpy as np
from jaxtyping import Int

_DRIFT = 500e-6
_RESYNC = 100_000_000
LEAST_STEP = 1000
"""Between stamps [ns]: what 64-bit seconds tell apart over a century."""
_RATE_WINDOW = 500_000_000
# Spans in windows, and the share of the time by which the sender has to run off: over long spans
# what delays do matters less.
_RATE_SPANS = ((1, 0.2), (2, 0.05), (4, 0.01), (16, 3e-3), (64, 6e-4))
_ALIKE = 0.2


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

    In each window of half a second the least delay is taken, which a sender or a receiver that
    stalls for a moment does not change. Where it runs off, alike over two spans of windows, by a
    fifth of the time over one window, or by less over more of them, down to 0.06 % over 64, the
    rate is wrong.
    """

    def __init__(self) -> None:
        self._begun: int | None = None
        self._least = 0
        self._seen: deque[int] = deque(maxlen=2 * _RATE_SPANS[-1][0] + 1)

    def factor(self, own: Int[np.ndarray, "n"], arrival: Int[np.ndarray, "n"]) -> float | None:
        """By how much the sender's period is longer than `own` (n,) [ns] supposes, if another;
        arrivals (n,) [ns].
        """
        delay = int(np.min(arrival - own))
        if self._begun is None:
            self._begun, self._least = int(arrival[0]), delay
        if int(arrival[-1]) - self._begun < _RATE_WINDOW:
            self._least = min(self._least, delay)
            return None
        # A window may have been longer than it should; what counts is how long each was.
        self._seen.append(self._least)
        self._begun, self._least = self._begun + _RATE_WINDOW, delay
        if int(arrival[-1]) - self._begun >= _RATE_WINDOW:
            self._begun = int(arrival[-1])
            self._seen.clear()
            return None
        return self._judged()

    def _judged(self) -> float | None:
        for span, tolerance in _RATE_SPANS:
            if len(self._seen) <= 2 * span:
                return None
            ends = np.array([self._seen[-1 - place * span] for place in (2, 1, 0)])
            first, second = (np.diff(ends) / (span * _RATE_WINDOW)).tolist()
            if (
                abs(first) >= tolerance
                and abs(second - first) <= _ALIKE * abs(first)
                and max(first, second) < 1
            ):
                self._begun = None
                self._seen.clear()
                return 1 / (1 - (first + second) / 2)
        return None


class SampleClock:
    """Stamps of samples that were taken at the sender's own times and arrived after uneven delays.

    Delays are never negative, so the sender's clock, moved until it lies below all arrivals, is the
    best that the host can know. It follows arrivals downwards at once, and upwards by 500 ppm at
    most, more than quartzes differ. Where it is off by 0.1 s the stream is taken to have paused.
    """

    def __init__(self) -> None:
        self._offset: int | None = None
        self._last_own = 0
        self._last_stamp = -(2**62)
        self.resyncs = 0

    def restart(self) -> None:
        """Forget the sender's clock: it began anew."""
        self._offset = None

    def stamps(
        self, own: Int[np.ndarray, "n"], arrival: Int[np.ndarray, "n"]
    ) -> Int[np.ndarray, "n"]:
        """Stamps (n,) [ns] on the clock of `arrival`, increasing, for the sender's times `own` (n,)
        [ns], increasing.
        """
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
        earliest = self._last_stamp + LEAST_STEP * (1 + np.arange(len(own), dtype=np.int64))
        stamp = np.maximum(own + self._offset, earliest)
        self._last_own, self._last_stamp = int(own[-1]), int(stamp[-1])
        return stamp
