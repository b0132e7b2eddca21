"""The zero of a restarted sensor: whether it is as before, and when it can be taken anew."""

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
"""Standard deviations of the noise beyond which readings are not at rest."""
_CHECK = 0.25  # [s] of quiet readings that are compared with those before: many samples, and soon
_EVERY = 0.05  # [s] between looks: few beside the time of a tare
# In lengths of the tare: rows that it is taken from (`Sensor.tare` needs some behind its end), and
# rows that are kept for it.
_TARED, _KEPT = 1.01, 1.2
_FEWEST = 5  # rows that give a mean and a deviation
_WHOLE = 0.99  # share of a time that counts as all of it: samples do not fall on its ends
_DEVIATIONS = 6.0  # of a mean by which it may be off: once in 10⁸ looks by chance
# Share of the rod's length, and radians, within which a pose is the same: a robot returns to a
# place to a tenth of that.
_NEAR, _NEAR_TURN = 0.01, 0.01
_FEW = 0.1  # share of samples that noise may make look like contacts, or like none


class _Rows(NamedTuple):
    """Rows in time: as logged, the wrench without tare, and whether a single sample is in contact,
    or in one that explains it.
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
    they are what they were. It can be **taken anew** from quiet readings of the tare's length at a
    pose at which the rod was free: that of the tare, or that of the restart if the rod was free
    then. If the sensor never moved, its pose says nothing, and readings that a contact would
    explain are not taken for a zero. Else it stays **unknown**.

    Attributes
    ----------
    noise, resolution
        Of a reading (6,) [N], [N m].
    length
        Of the rod [m].
    seconds
        Of the tare.
    pending
        Whether the zero is not known since a restart.
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
        """What comes from now on is of a sensor whose zero is not known."""
        if not self.pending:
            self._before = self._last(self._check)
        self._blocks.clear()
        self.pending = True
        self._free = [] if self._home is None else [self._home]
        if self._before is not None and self._before.touching.mean() <= _FEW:
            self._free.append(self._before)

    def take(self, raw: RawRecording, tared: Wrenches, found: Reconstruction) -> bool | None:
        """Take rows as logged, their wrench without tare (n, 6), NaN where it is not good, and
        their contacts sample by sample. Return whether the zero is the same as before the restart;
        None without one, and as long as that is not known.
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
        """The rows by which the zero was found to be another."""
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
        """The last rows of so many seconds; None if there are fewer."""
        if not self._blocks:
            return None
        rows = joined(self._blocks)
        last = rows_of(rows, rows.time >= rows.time[-1] - seconds)
        enough = rows.time[-1] - rows.time[0] >= _WHOLE * seconds
        return last if enough and len(last.time) >= _FEWEST else None

    def _quiet(self, rows: _Rows | None) -> _Rows | None:
        """The same rows if they are at rest."""
        if rows is None or np.any(rows.tared.std(axis=0, ddof=1) > RESTLESS * self.noise):
            return None
        return rows

    def _at(self, rows: _Rows, place: _Rows) -> bool:
        """Whether the sensor was where the last of other rows was."""
        off = np.linalg.norm(rows.position - place.position[-1], axis=1).max()
        aligned = np.abs(rows.orientation @ place.orientation[-1]).min()
        return bool(off <= _NEAR * self.length and aligned >= np.cos(_NEAR_TURN / 2))
