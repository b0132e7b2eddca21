"""A recording played as if it were live."""

import time

import numpy as np

from vibrissa.live.samples import Counts, EndOfStreamError, Samples, Source
from vibrissa.sensor import RawRecording

_MOST_ROWS = 512


class ReplaySource(Source):
    """Rows of a recording, each when its time has come; stamps are the recording's own times.

    Parameters
    ----------
    raw
        What was recorded.
    speed
        Seconds of the recording in a second; infinity for as fast as rows are taken.

    Raises
    ------
    ValueError
        If `speed` is not greater than 0, or the recording is empty.
    """

    waits = True
    recorded = True

    def __init__(self, raw: RawRecording, speed: float = 1.0) -> None:
        if not speed > 0:
            raise ValueError(f"speed = {speed}; allowed is a number greater than 0, or inf")
        if not len(raw.time):
            raise ValueError("the recording has no rows; allowed is at least one")
        self._raw, self._valid = raw, np.isfinite(raw.wrench).all(axis=1)
        self._due = np.round((raw.time - raw.time[0]) / speed * 1e9).astype(np.int64)
        self._stamp = np.round(raw.time * 1e9).astype(np.int64)
        self._next = 0
        self._start = 0
        self.counts = Counts()

    def open(self) -> None:
        """Start the clock."""
        self._start = time.monotonic_ns()

    def read(self, timeout: float) -> Samples | None:
        """Rows that are due."""
        if self._next == len(self._due):
            raise EndOfStreamError
        wait = (self._due[self._next] + self._start - time.monotonic_ns()) * 1e-9
        if wait > 0:
            time.sleep(min(wait, timeout))
            if wait > timeout:
                return None
        due = int(np.searchsorted(self._due, time.monotonic_ns() - self._start, side="right"))
        first, last = self._next, min(max(due, self._next + 1), self._next + _MOST_ROWS)
        self._next = last
        part, count = slice(first, last), last - first
        self.counts.samples += count
        # As fast as possible, nothing is ever late: a row arrives when it is read.
        arrival = np.maximum(
            self._due[part] + self._start, time.monotonic_ns() if self._due[-1] == 0 else 0
        )
        return Samples(
            self._stamp[part],
            np.arange(first, last, dtype=np.int64),
            self._raw.force[part],
            self._raw.torque[part],
            self._valid[part],
            arrival,
            self._raw.position[part],
            self._raw.orientation[part],
        )

    def close(self) -> None:
        """Nothing is held open."""
