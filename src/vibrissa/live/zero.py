"""The zero of a sensor that was restarted: whether it is as before, and when it can be taken anew."""

from collections import deque
from enum import Enum
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.contacts import Status
from vibrissa.inverse import Reconstruction
from vibrissa.sensor import RawRecording

_CHECK = 0.25
"""Seconds of quiet readings that are compared with those before: many samples, and soon."""
_EVERY = 0.05
_LONGER = 1.01, 1.2
"""Rows that are looked at and kept, in lengths of the tare: `Sensor.tare` needs some behind it."""
_FEWEST = 5
_RESTLESS = 3.0
"""Standard deviations of the noise beyond which readings are not at rest, as for the first tare."""
_DEVIATIONS = 6.0
# Parts of the rod's length, and radians, within which a pose is the same: a robot comes back to a
# place to a tenth of that.
_NEAR, _NEAR_TURN = 0.01, 0.01
# Share of samples that noise may make look like contacts, or like none.
_FEW = 0.1


class Verdict(Enum):
    """What is known of a zero."""

    UNKNOWN = "unknown"
    SAME = "same"
    CHANGED = "changed"


class _Rows(NamedTuple):
    """Rows in time: as logged, without tare, and whether single samples touch, or are a sound
    contact.
    """

    raw: RawRecording
    tared: Float[np.ndarray, "n 6"]
    touching: Bool[np.ndarray, "n"]
    explained: Bool[np.ndarray, "n"]


class ZeroWatch:
    """Compares resting levels before and after a restart.

    The zero is taken for **the same** where quiet readings are zero again, or where the sensor has
    not moved and they are what they were. It can be **taken anew** from quiet readings of the
    tare's length at a pose at which the rod was free: that of the tare, or that of the restart if
    the rod was free then. Where the sensor never moved, a pose says nothing, and readings that a
    contact would explain are not taken for a zero. Else it stays **unknown**.

    Parameters
    ----------
    noise, resolution
        Of a reading (6,) [N], [N m].
    length
        Of the rod [m].
    seconds
        Of the tare.
    """

    def __init__(
        self,
        noise: Float[np.ndarray, "6"],
        resolution: Float[np.ndarray, "6"],
        length: float,
        seconds: float,
    ) -> None:
        self._noise, self._resolution = noise, resolution
        self._near, self._seconds = _NEAR * length, seconds
        self._check = min(_CHECK, seconds)
        self._blocks: deque[_Rows] = deque()
        self._free: list[tuple[np.ndarray, np.ndarray]] = []
        self._before: _Rows | None = None
        self._home: tuple[np.ndarray, np.ndarray] | None = None
        self._moved = False
        self._looked = -np.inf
        self.pending = False

    def restart(self) -> None:
        """What comes from now on is of a sensor whose zero is not known."""
        self._before = self._last(self._check) if not self.pending else self._before
        self._blocks.clear()
        self.pending = True
        self._free = [] if self._home is None else [self._home]
        if self._before is not None and self._before.touching.mean() <= _FEW:
            self._free.append((self._before.raw.position[-1], self._before.raw.orientation[-1]))

    def take(
        self, raw: RawRecording, tared: Float[np.ndarray, "n 6"], found: Reconstruction
    ) -> Verdict:
        """Rows as logged, NaN where they are not good, without tare (n, 6), and their contacts
        sample by sample.
        """
        good = np.isfinite(tared).all(axis=1) & np.isfinite(raw.position).all(axis=1)
        if not good.any():
            return Verdict.UNKNOWN
        columns = (raw.time, raw.position, raw.orientation, raw.force, raw.torque)
        kept = RawRecording(*(column[good] for column in columns))
        touching = found.in_contact[good]
        self._blocks.append(
            _Rows(kept, tared[good], touching, touching & (found.status[good] == Status.OK))
        )
        now = float(kept.time[-1])
        while self._blocks[0].raw.time[-1] < now - _LONGER[1] * self._seconds:
            self._blocks.popleft()
        if self._home is None:
            self._home = kept.position[0], kept.orientation[0]
        self._moved |= not self._at(kept, self._home)
        if not self.pending or now - self._looked < _EVERY:
            return Verdict.UNKNOWN
        self._looked = now
        verdict = self._verdict()
        self.pending = verdict is Verdict.UNKNOWN
        return verdict

    def rest(self) -> RawRecording:
        """The rows by which the zero was found to be another."""
        return self._joined().raw

    def _verdict(self) -> Verdict:
        short = self._last(self._check)
        if short is None or not self._quiet(short):
            return Verdict.UNKNOWN
        level = short.tared.mean(axis=0)
        tolerance = _DEVIATIONS * np.sqrt(
            self._noise**2 / len(short.tared) + (self._resolution / 4) ** 2
        )
        if np.all(np.abs(level) <= tolerance):
            return Verdict.SAME
        before = self._before
        if (
            before is not None
            and self._quiet(before)
            and self._at(short.raw, (before.raw.position[-1], before.raw.orientation[-1]))
            and np.all(np.abs(level - before.tared.mean(axis=0)) <= np.sqrt(2) * tolerance)
        ):
            return Verdict.SAME
        whole = self._last(_LONGER[0] * self._seconds)
        if (
            whole is None
            or not self._quiet(whole)
            or not any(self._at(whole.raw, pose) for pose in self._free)
        ):
            return Verdict.UNKNOWN
        if not self._moved and whole.explained.mean() > _FEW:
            return Verdict.UNKNOWN
        return Verdict.CHANGED

    def _joined(self) -> _Rows:
        parts = list(self._blocks)
        names = ("time", "position", "orientation", "force", "torque")
        raw = RawRecording(
            *(np.concatenate([getattr(part.raw, name) for part in parts]) for name in names)
        )
        tared, touching, explained = (
            np.concatenate([part[field] for part in parts]) for field in (1, 2, 3)
        )
        return _Rows(raw, tared, touching, explained)

    def _last(self, seconds: float) -> _Rows | None:
        """The last rows of so many seconds; None where there are fewer."""
        if not self._blocks:
            return None
        rows = self._joined()
        time = rows.raw.time
        first = int(np.searchsorted(time, time[-1] - seconds))
        if len(time) - first < _FEWEST or (first == 0 and time[-1] - time[0] < 0.99 * seconds):
            return None
        raw = RawRecording(
            *(
                getattr(rows.raw, name)[first:]
                for name in ("time", "position", "orientation", "force", "torque")
            )
        )
        return _Rows(raw, rows.tared[first:], rows.touching[first:], rows.explained[first:])

    def _quiet(self, rows: _Rows) -> bool:
        return bool(np.all(rows.tared.std(axis=0, ddof=1) <= _RESTLESS * self._noise))

    def _at(self, raw: RawRecording, pose: tuple[np.ndarray, np.ndarray]) -> bool:
        position, orientation = pose
        off = np.linalg.norm(raw.position - position, axis=1).max()
        aligned = np.abs(raw.orientation @ orientation).min()
        return bool(off <= self._near and aligned >= np.cos(_NEAR_TURN / 2))
