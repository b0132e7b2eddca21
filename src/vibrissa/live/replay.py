"""A recording played back as if it were live."""

import time
from dataclasses import dataclass, replace

import numpy as np

from vibrissa.live.samples import Counts, EndOfStreamError, Samples, Source
from vibrissa.sensor import RawRecording

_MOST_ROWS = 512  # per read: eight batches of the inverse


@dataclass(eq=False)
class ReplaySource(Source):
    """Rows of a recording, each when it is due; stamps are the recording's own times.

    Parameters
    ----------
    raw
        The recording.
    speed
        Seconds of the recording per second; infinity for as fast as rows are taken.

    Raises
    ------
    ValueError
        If `speed` is not greater than 0, or the recording is empty.
    """

    waits = True
    recorded = True

    raw: RawRecording
    speed: float = 1.0

    def __post_init__(self) -> None:
        raw = self.raw
        if not self.speed > 0:
            raise ValueError(f"speed = {self.speed}; allowed is a number greater than 0, or inf")
        if not len(raw.time):
            raise ValueError("the recording has no rows; allowed is at least one")
        self._due = np.round((raw.time - raw.time[0]) / self.speed * 1e9).astype(np.int64)
        stamp, rows = np.round(raw.time * 1e9).astype(np.int64), np.arange(len(raw.time))
        self._samples = Samples(
            # A repeated stamp was moved by less than a nanosecond.
            np.maximum.accumulate(stamp - rows) + rows,
            rows,
            raw.force,
            raw.torque,
            np.isfinite(raw.wrench).all(axis=1),
            self._due,
            raw.position,
            raw.orientation,
        )
        self.counts = Counts()

    def open(self) -> None:
        """Start the clock."""
        self._start = time.monotonic_ns()

    def read(self, timeout: float) -> Samples | None:
        """Rows that are due."""
        first = self.counts.samples
        if first == len(self._due):
            raise EndOfStreamError
        wait = (int(self._due[first]) + self._start - time.monotonic_ns()) * 1e-9
        time.sleep(min(max(wait, 0.0), timeout))
        now = time.monotonic_ns()
        due = int(np.searchsorted(self._due, now - self._start, side="right"))
        part = self._samples[first : min(due, first + _MOST_ROWS)]
        self.counts.samples += len(part)
        return replace(part, arrival=np.full(len(part), now)) if part else None

    def close(self) -> None:
        """Nothing is held open."""
