"""What a stream did, in numbers and in words; its latency and its silences."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from vibrissa.contacts import ContactKind
from vibrissa.live.samples import Counts, Nanoseconds

_MOST_WARNINGS = 100  # a stream that falters for hours must not fill the memory
# From 1 µs to 7 minutes in steps of 1 %, the accuracy of a percentile.
_EDGES = 1e3 * 1.01 ** np.arange(2000)
_LEAST_SILENCE = 500_000_000
"""Shortest silence [ns]: networks and busy computers delay datagrams by less."""
_SILENT_STEPS = 20
"""It is also no shorter than this many sampling periods, for slow sensors."""


@dataclass
class Report:
    """What a stream did.

    Attributes
    ----------
    counts
        Counts of the source.
    contacts
        Rows with a contact, by kind.
    statuses
        Rows with a contact, by status.
    rows
        Rows given to the sinks.
    unused
        Samples recorded, but without a row: the stream ended before the tare was over, or before
        their pose came.
    overflow
        Samples thrown away because this process could not keep up.
    without_pose
        Rows whose pose was not known.
    malformed_poses, misplaced_poses
        Datagrams of the pose stream that could not be read; poses whose stamps lie more than a
        second from their arrival.
    seconds
        From the first sample to the end.
    cpu_share
        Share of one core used over that time.
    latency_median, latency_999
        Time from the arrival of a sample to its contact [s], median and 99.9th percentile, without
        rows that waited for the tare or behind rows that did. None if there were no others.
    moved_during_tare
        Whether the wrench varied by more than three times its noise during the tare.
    silent
        Whether the stream ended because the source fell silent.
    silences, silent_seconds
        How often a running source gave nothing for half a second or more, and for how long in
        total.
    unsure, zero_changes
        Rows flagged because a sensor had been restarted and its zero was unknown; how often the
        zero had changed and the sensor was tared again.
    warnings
        Warnings given during the run, and those from the numbers above at its end, one line each.
    """

    counts: Counts = field(default_factory=Counts)
    contacts: dict[str, int] = field(default_factory=lambda: {kind.name: 0 for kind in ContactKind})
    statuses: dict[str, int] = field(default_factory=dict)
    rows: int = 0
    unused: int = 0
    overflow: int = 0
    without_pose: int = 0
    malformed_poses: int = 0
    misplaced_poses: int = 0
    seconds: float = 0.0
    cpu_share: float = 0.0
    latency_median: float | None = None
    latency_999: float | None = None
    moved_during_tare: bool = False
    silent: bool = False
    silences: int = 0
    silent_seconds: float = 0.0
    unsure: int = 0
    zero_changes: int = 0
    warnings: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        # Called with one-line messages on what happens.
        self.notice: Callable[[str], object] = str

    def warn(self, text: str) -> None:
        """Issue and keep a warning, unless there are too many already."""
        if len(self.warnings) < _MOST_WARNINGS:
            self.warnings.append(text)
            self.notice(f"warning: {text}")

    def losses(self) -> list[str]:
        """What went wrong according to the numbers, one line each; empty if all is well."""
        counts = self.counts
        said = {
            f"{counts.lost} samples are lost, in {counts.gaps} gaps": counts.lost,
            f"{counts.invalid} samples are in error according to the sensor": counts.invalid,
            f"{counts.malformed} datagrams or lines could not be read": counts.malformed,
            f"{self.overflow} samples were thrown away: this computer does not keep up": (
                self.overflow
            ),
            "samples came at another rate than the setup says: stamps follow the rate seen": (
                counts.rate_changes
            ),
            f"{self.without_pose} rows have no pose": self.without_pose,
            f"{self.misplaced_poses} poses are stamped more than a second from their arrival: "
            "set both clocks, or leave the stamp out": self.misplaced_poses,
            f"{self.unsure} rows came while the sensor's zero was not known after a restart; "
            "their status says so": self.unsure,
        }
        return [text for text, count in said.items() if count]


class Latency:
    """A histogram of times with bins that widen by 1 %, so that percentiles are right to 1 %."""

    def __init__(self) -> None:
        self._counts = np.zeros(len(_EDGES), dtype=np.int64)

    def add(self, nanoseconds: Nanoseconds) -> None:
        """Count these times (n,)."""
        bins = np.searchsorted(_EDGES[:-1], nanoseconds)
        self._counts += np.bincount(bins, minlength=len(_EDGES))

    def percentile(self, percent: float) -> float | None:
        """Percentile [s], as the upper edge of its bin; None if nothing was counted."""
        if not self._counts.any():
            return None
        edge = np.percentile(_EDGES, percent, weights=self._counts, method="inverted_cdf")
        return float(edge) * 1e-9


class SilenceWatch:
    """Detects silences of a source from the arrivals of its samples [ns], and adds them up in a
    report.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        self._last = self._samples = self._lively = 0
        self._noticed = False

    def _silences(self, pause: Nanoseconds) -> np.ndarray:
        """Those of the pauses (n,) [ns] that are silences; none until enough samples have shown the
        sensor's pace.
        """
        if self._samples < _SILENT_STEPS:
            return pause[:0]
        pace = self._lively / (self._samples - 1)
        return pause[pause >= max(_LEAST_SILENCE, _SILENT_STEPS * pace)]

    def came(self, arrival: Nanoseconds) -> float | None:
        """Take note of arrivals (n,) of samples, or of the end, and return the longest silence [s]
        before one of them; None if there was none.
        """
        pause = np.diff(arrival, prepend=self._last if self._samples else arrival[0])
        silences = self._silences(pause)
        self._samples += len(arrival)
        self._last, self._noticed = int(arrival[-1]), False
        self._lively += int(pause.sum() - silences.sum())
        self._report.silences += len(silences)
        self._report.silent_seconds += float(silences.sum()) * 1e-9
        return float(silences.max()) * 1e-9 if len(silences) else None

    def begins(self, now: int) -> bool:
        """Whether a silence is first noticed now; true once per silence."""
        before, self._noticed = self._noticed, len(self._silences(np.array([now - self._last]))) > 0
        return self._noticed and not before
