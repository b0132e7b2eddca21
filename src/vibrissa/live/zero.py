"""The zero of a restarted sensor: whether it is as before, and when to tare again."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vibrissa.contacts import Status
from vibrissa.inverse import Reconstruction
from vibrissa.live.samples import Flags, Quaternions, Vectors, Wrenches, joined, rows_of
from vibrissa.sensor import RawRecording
from vibrissa.sensor.raw import Times, Wrench

RESTLESS = 3.0
"""Readings that scatter by more standard deviations of the noise than this are not at rest."""
_CHECK = 0.25  # [s] of quiet readings compared with those before: many samples, yet soon there
_EVERY = 0.05  # [s] between checks: short compared with a tare
# In tare lengths: rows it is taken from (`Sensor.tare` needs some beyond its end), and rows kept
# for it.
_TARED, _KEPT = 1.01, 1.2
_FEWEST = 5  # rows for a mean and a standard deviation
_WHOLE = 0.99  # share of an interval that counts as all of it: samples do not fall on its ends
_DEVIATIONS = 6.0  # standard deviations a mean may be off: more by chance once in 10⁸ checks
# Share of the rod's length, and radians, within which poses count as the same: robots repeat a pose
# to a tenth of that.
_NEAR, _NEAR_TURN = 0.01, 0.01
_FEW = 0.1  # share of samples that noise may make look like contact, or like none


class _Rows(NamedTuple):
    """Rows in time: as logged, the tared wrench, and whether each sample by itself is in contact,
    and in one that explains it.
    """

    time: Times
    position: Vectors
    orientation: Quaternions
    force: Vectors
    torque: Vectors
    tared: Wrenches
    touching: Flags
    explained: Flags


@dataclass(eq=False)
class ZeroWatch:
    """Compares resting levels before and after a restart.

    The zero is **the same** if quiet readings are zero again, or if the sensor has not moved and
    they are what they were. The sensor can be **tared again** from quiet readings of the tare's
    length at a pose where the rod was free: that of the tare, or that of the restart if the rod was
    free then. If the sensor never moved, its pose says nothing, and readings that a contact would
    explain are not taken as a zero. Otherwise the zero stays **unknown**.

    Attributes
    ----------
    noise, resolution
        Noise and resolution of a reading (6,) [N], [N m].
    length
        Length of the rod [m].
    seconds
        Length of the tare [s].
    pending
        Whether the zero has been unknown since a restart.
    """

    noise: Wrench
    resolution: Wrench
    length: float
    seconds: float
    pending: bool = False

    def __post_init__(self) -> None:
        self._check = min(_CHECK, self.seconds)
        self._blocks: deque[_Rows] = deque()
        self._home: _Rows | None = None
        self._before: _Rows | None = None
        self._free: list[_Rows] = []
        self._moved = False
        self._looked = -np.inf

    def restart(self) -> None:
        """From now on the sensor's zero is unknown."""
        if not self.pending:
            self._before = self._last(self._check)
        self._blocks.clear()
        self.pending = True
        self._free = [] if self._home is None else [self._home]
        if self._before is not None and self._before.touching.mean() <= _FEW:
            self._free.append(self._before)

    def take(self, raw: RawRecording, tared: Wrenches, found: Reconstruction) -> bool | None:
        """Take rows as logged, their tared wrench (n, 6), NaN where it is invalid, and their
        contacts sample by sample. Return whether the zero is the same as before the restart; None
        without one, or until that is known.
        """
        touching = found.in_contact
        explained = touching & (found.status == Status.OK)
        logged = (raw.time, raw.position, raw.orientation, raw.force, raw.torque)
        good = np.isfinite(tared).all(axis=1)
        rows = rows_of(_Rows(*logged, tared, touching, explained), good)
        if not len(rows.time):
            return None
        self._blocks.append(rows)
        now = float(rows.time[-1])
        while self._blocks[0].time[-1] < now - _KEPT * self.seconds:
            self._blocks.popleft()
        self._home = self._home or rows_of(rows, slice(1))
        self._moved |= not self._at(rows, self._home)
        if not self.pending or now - self._looked < _EVERY:
            return None
        self._looked = now
        same = self._same()
        self.pending = same is None
        return same

    def rest(self) -> RawRecording:
        """The rows in which the zero was found to have changed."""
        return RawRecording(*joined(self._blocks)[:5])

    def _same(self) -> bool | None:
        short, before = self._quiet(self._last(self._check)), self._quiet(self._before)
        if short is None:
            return None
        level = short.tared.mean(axis=0)
        levels = [level]
        if before is not None and self._at(short, before):
            levels.append((level - before.tared.mean(axis=0)) / np.sqrt(2))
        # The mean of rounded readings is off by up to half a step: by a quarter on average.
        tolerance = _DEVIATIONS * np.hypot(
            self.noise / np.sqrt(len(short.time)), self.resolution / 4
        )
        if np.any(np.all(np.abs(levels) <= tolerance, axis=1)):
            return True
        whole = self._quiet(self._last(_TARED * self.seconds))
        if whole is None or (not self._moved and whole.explained.mean() > _FEW):
            return None
        return False if any(self._at(whole, rows) for rows in self._free) else None

    def _last(self, seconds: float) -> _Rows | None:
        """The rows of the last so many seconds; None if there are not enough."""
        if not self._blocks:
            return None
        rows = joined(self._blocks)
        last = rows_of(rows, rows.time >= rows.time[-1] - seconds)
        enough = rows.time[-1] - rows.time[0] >= _WHOLE * seconds
        return last if enough and len(last.time) >= _FEWEST else None

    def _quiet(self, rows: _Rows | None) -> _Rows | None:
        """These rows if they are at rest, else None."""
        if rows is None or np.any(rows.tared.std(axis=0, ddof=1) > RESTLESS * self.noise):
            return None
        return rows

    def _at(self, rows: _Rows, place: _Rows) -> bool:
        """Whether the sensor stayed where it was in the last row of `place`."""
        off = np.linalg.norm(rows.position - place.position[-1], axis=1).max()
        aligned = np.abs(rows.orientation @ place.orientation[-1]).min()
        return bool(off <= _NEAR * self.length and aligned >= np.cos(_NEAR_TURN / 2))
