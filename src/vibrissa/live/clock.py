"""Time stamps on the host's clock, evened out by the sender's."""

import math
import time
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vibrissa.live.samples import Counts, Flags, Nanoseconds

LEAST_STEP = 1000
"""Least step between stamps [ns]: what seconds as 64-bit floats resolve over a century."""
AHEAD = 1_000_000
"""Sequence numbers farther ahead belong to another stream: minutes of the fastest sensors."""
_DRIFT = 500e-6  # quartz clocks differ by 100 ppm at most
_RESYNC = 100_000_000  # [ns]; networks and busy computers cause shorter delays
_RATE_WINDOW = 500_000_000  # [ns]; longer than senders or receivers stall
_NO_WINDOW = -2  # before the first window, which does not count as its successor
# Spans in windows, and the relative rate error to detect: over long spans delays matter less.
# Measured: no false alarm with delays of 0.15 s (test_sample_clock).
_RATE_SPANS = ((1, 0.2), (2, 0.05), (4, 0.01), (16, 3e-3), (64, 6e-4))
_ALIKE = 0.2  # relative difference allowed between two successive spans, measured there too
# Relative change beyond which a new rate is reported: at first what setups round to, later what a
# first, short span may have been wrong by.
_OTHER_RATE, _OTHER_AGAIN = 0.01, 0.1


def epoch_offset() -> int:
    """Offset [ns] of the time since 1970 from the monotonic clock: tightest of five readings."""
    readings = ((time.monotonic_ns(), time.time_ns(), time.monotonic_ns()) for _ in range(5))
    before, now, after = min(readings, key=lambda reading: reading[2] - reading[0])
    return now - (before + after) // 2


class RateWatch:
    """Detects a sender whose rate is not the assumed one.

    It takes the least delay in each window of half a second, which brief stalls of the sender or
    the receiver do not affect. The rate is wrong if this delay grows or shrinks alike over two
    successive spans of windows: by a fifth of the time over one window, or by less over more
    windows, down to 0.06 % over 64.
    """

    def __init__(self) -> None:
        self._begun, self._window, self._least = 0, _NO_WINDOW, 0
        self._seen: deque[int] = deque(maxlen=2 * _RATE_SPANS[-1][0] + 1)

    def factor(self, own: Nanoseconds, arrival: Nanoseconds) -> float | None:
        """Ratio of the sender's period to the one assumed in its times `own` (n,) [ns], or None if
        no difference is seen; arrivals (n,) [ns].
        """
        delay, now = int(np.min(arrival - own)), int(arrival[-1])
        window = (now - self._begun) // _RATE_WINDOW
        if window == self._window:
            self._least = min(self._least, delay)
            return None
        if window == self._window + 1:
            self._seen.append(self._least)
        else:  # after a pause, or at the start: earlier windows say nothing
            self._begun, window = int(arrival[0]), 0
            self._seen.clear()
        self._window, self._least = window, delay
        for span, tolerance in _RATE_SPANS:
            if len(self._seen) <= 2 * span:
                return None
            ends = [self._seen[-1 - place * span] for place in (2, 1, 0)]
            first, second = (np.diff(ends) / (span * _RATE_WINDOW)).tolist()
            alike = abs(second - first) <= _ALIKE * abs(first)
            if abs(first) >= tolerance and alike and max(first, second) < 1:
                self._window = _NO_WINDOW
                return 1 / (1 - (first + second) / 2)
        return None


class SampleClock:
    """Stamps samples that were taken at the sender's own times and arrived after uneven delays.

    Delays are never negative, so the best that the host can know is the sender's clock, shifted
    until it lies below all arrivals. The shift follows arrivals downwards at once, and upwards by
    500 ppm at most. If it is off by more than 0.1 s, the stream is taken to have paused.
    """

    def __init__(self) -> None:
        self._offset, self._last_own, self._last_stamp = -math.inf, 0, -(2**62)

    def restart(self) -> None:
        """Forget the shift of the sender's clock, which no longer holds."""
        self._offset = -math.inf

    def stamps(self, own: Nanoseconds, arrival: Nanoseconds) -> Nanoseconds:
        """Increasing stamps (n,) [ns] on the clock of `arrival`, for the sender's increasing times
        `own` (n,) [ns], at least one.
        """
        least, last = int(np.min(arrival - own)), int(own[-1])
        slack = least - self._offset
        if abs(slack) > _RESYNC:
            self._offset = least
        else:
            self._offset += min(slack, round(_DRIFT * (last - self._last_own)))
        earliest = self._last_stamp + LEAST_STEP * (1 + np.arange(len(own), dtype=np.int64))
        stamp = np.maximum(own + int(self._offset), earliest)
        self._last_own, self._last_stamp = last, int(stamp[-1])
        return stamp


class Tick(NamedTuple):
    """A sample's place in the sender's count and on its clock [ns], and its arrival here [ns]."""

    number: float
    own: float
    arrival: int


@dataclass(eq=False)
class SequenceClock:
    """Stamps samples that are numbered and evenly spaced.

    Attributes
    ----------
    period
        Sampling period [ns], as set on the sensor; replaced by the observed one if that differs.
    counts
        Counts changes of the rate, and samples lost where the numbering restarted.
    """

    period: float
    counts: Counts

    def __post_init__(self) -> None:
        self._clock, self._watch = SampleClock(), RateWatch()
        self._last: Tick | None = None

    def stamps(self, number: Nanoseconds, arrival: Nanoseconds) -> tuple[Nanoseconds, Flags]:
        """Stamps (n,) [ns] on the clock of `arrival` for numbers (n,), and whether a sample begins
        a new stream: there the sensor's clock is advanced by the time that passed here.
        """
        last = self._last or Tick(int(number[0]), 0, int(arrival[0]))
        steps = np.diff(number, prepend=int(last.number))
        anew = steps > AHEAD
        # A new stream's numbers do not say how much was lost before it, but the time does.
        passed = np.diff(arrival, prepend=last.arrival)[anew] / self.period
        lost = np.maximum(np.round(passed).astype(np.int64) - 1, 0)
        self.counts.lost += int(lost.sum())
        self.counts.gaps += int(np.count_nonzero(lost))
        steps[anew] = lost + 1
        if anew.any():
            self._clock.restart()
        count = np.cumsum(steps)
        own = int(last.own) + self._periods(count)
        factor = self._watch.factor(own, arrival)
        if factor is not None:
            least = _OTHER_AGAIN if self.counts.rate_changes else _OTHER_RATE
            self.counts.rate_changes += abs(factor - 1) > least
            self.period *= factor
            own = own[0] + self._periods(count - count[0])
            self._clock.restart()
        self._last = Tick(int(number[-1]), int(own[-1]), int(arrival[-1]))
        return self._clock.stamps(own, arrival), anew

    def _periods(self, count: Nanoseconds) -> Nanoseconds:
        """Duration [ns] of this many samples."""
        return np.round(count * self.period).astype(np.int64)
