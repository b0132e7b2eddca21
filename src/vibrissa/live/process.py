"""From samples to contacts: tare, pose, inverse, batch by batch."""

import warnings
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, replace
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from vibrissa.contacts import RecordingWarning, Status
from vibrissa.inverse import Reconstruction, reconstruct
from vibrissa.inverse.reconstruct import compile_for
from vibrissa.live.poses import ConstantPose, Poses, PoseSource
from vibrissa.live.report import Report
from vibrissa.live.samples import (
    Flags,
    Nanoseconds,
    Quaternions,
    Samples,
    Vectors,
    joined,
    rows_of,
)
from vibrissa.live.zero import RESTLESS, ZeroWatch
from vibrissa.numerics.kernel import compiled_well
from vibrissa.reactions import VELOCITY_SPAN, Reactions, velocities
from vibrissa.rod import Rod
from vibrissa.sensor import CHANNELS, RawRecording, Sensor, Tare
from vibrissa.sensor.raw import Times, Wrench
from vibrissa.tolerances import PARAMETERS, Tolerances
from vibrissa.trail import Trail

MOST_ROWS = 64
"""Rows per call of the inverse: one block of its lanes. More blocks would need compiling too."""
TARE_SECONDS = 1.0
"""Length of the tare if the setup gives none [s]."""
_KEPT = 20_000
"""Most rows by which rod, clamp and sensor are checked; of more, every other one goes."""
_PARTS = 100
"""Batches after which what is kept is put together."""
_DAY = 86_400.0  # [s] over which pink noise is modelled: the tare takes care of slower noise


@runtime_checkable
class Stage(Protocol):
    """A step between the inverse and the sinks, such as a filter over time.
    `vibrissa.live.Processor` calls it with each batch, in order.

    Its method `reset()`, if it has one, is called after the sensor was tared again.
    """

    def push(self, found: Reconstruction) -> Reconstruction:
        """Return the same rows, each with its contact as known by now."""


class Result(NamedTuple):
    """One batch: stamps (n,) [ns], arrivals (n,) [ns], poses and tared wrench (NaN where unknown),
    contacts.
    """

    stamp: Nanoseconds
    arrival: Nanoseconds
    raw: RawRecording
    found: Reconstruction


class _Places(NamedTuple):
    """Where the clamp was."""

    time: Times
    position: Vectors
    orientation: Quaternions


class _Readings(NamedTuple):
    """Rows as a recording has them."""

    time: Times
    position: Vectors
    orientation: Quaternions
    force: Vectors
    torque: Vectors


@dataclass(eq=False)
class Processor:
    """Turns samples into contacts.

    Rows are held until the tare is over and their pose is known. A row that the sensor marks as
    invalid, or that has no pose, is passed on without contact, with `Status.BAD_DATA`. The tare
    begins with the first valid row. After a restart of the sensor its zero is compared with the
    previous one; if it has changed, and the rod is known to be free, the sensor is tared again
    (`vibrissa.live.zero`). Until that is settled, rows have the status `SETUP_CONTRADICTED`.

    Parameters
    ----------
    rod, sensor
        From the setup; the first `sensor.tare_seconds` of the stream are the tare: one second if
        that is None. Rest intervals and drift estimation need a whole recording and are not used.
    poses
        Poses of the sensor frame, for sources that do not give them.
    stage
        A step between the inverse and the sinks, or None.
    friction
        Coulomb friction coefficient between rod and object: 0 for none, None if unknown.
    tolerances
        As for `vibrissa.Sensor.reactions`.

    Attributes
    ----------
    report
        Counts what is done here and takes messages on what happens. `stream` completes it.
    """

    rod: Rod
    sensor: Sensor
    poses: PoseSource
    _: KW_ONLY
    stage: Stage | None = None
    friction: float | None = None
    tolerances: Tolerances | ArrayLike | None = None

    def __post_init__(self) -> None:
        seconds = self.sensor.tare_seconds
        self._seconds = TARE_SECONDS if seconds is None else seconds
        self._errors = self.sensor.setup_errors(self.tolerances)
        self._sensor = self.sensor.carrying(self.rod).updated(
            tare_seconds=self._seconds, rest_intervals=(), estimate_drift=False
        )
        self._tare = self._sensor.updated(tare_seconds=0.0).tare(_unloaded(1))
        self._tared = not self._seconds
        self._waiting: Samples | None = None
        self._origin: int | None = None
        self._passed: list[_Places] = []
        self._kept: list[_Readings] = []
        self._zero: ZeroWatch | None = None
        self.report = Report()

    @property
    def tare(self) -> Wrench | None:
        """Offset to be subtracted [N], [N m]; None until it is known."""
        return self._tare.offset if self._tared else None

    @property
    def waiting(self) -> int:
        """Number of samples held."""
        return len(self._waiting or ())

    def warm_up(self) -> None:
        """Compile for every batch size that may come, before samples do."""
        with compiled_well():
            for rows in (1, MOST_ROWS):
                raw = _unloaded(rows)
                compile_for(self.rod, self._reactions(raw, np.zeros(rows, dtype=bool)))
                # In this pose, not that of the sensor, a soft rod may fall over.
                with suppress(ValueError):
                    self._sensor.rod_readings(raw)

    def push(self, samples: Samples) -> None:
        """Add samples."""
        if not samples:
            return
        if self._origin is None:
            self._origin = int(samples.stamp[0])
        waiting = joined([self._waiting, samples]) if self._waiting else samples
        if not self._tared and samples.anew.any():
            # Samples from before the sensor's restart have another zero.
            here = np.arange(len(waiting)) >= np.flatnonzero(waiting.anew)[-1]
            waiting = replace(waiting, valid=waiting.valid & here)
        self._waiting = waiting
        if not self._tared:
            self._try_tare(waiting[int(np.argmax(waiting.valid)) :])
        elif self._tare.coloured is None and len(samples) > 1:
            self._take_tare(self._tare, self._time(samples))

    def _try_tare(self, rest: Samples) -> None:
        """Tare from the leading seconds, once a sample lies beyond them; as `Sensor.reactions` does
        for a recording.
        """
        end, sensor = rest.stamp[0] + self._seconds * 1e9, self._sensor
        if not rest.valid[0] or rest.stamp[-1] < end:
            return
        # Without weights the tare needs no pose.
        weightless = sensor.mount is None and sensor.rod is None
        posed = ConstantPose().at(rest.stamp) if weightless else self._posed(rest)
        raw = self._raw(rest, posed)
        self._take_tare(sensor.tare(raw), raw.time)
        shown = ", ".join(f"{value:.6g}" for value in self._tare.offset)
        self.report.notice(f"tare: {shown} (N, N m)")
        noise = spread = np.nanstd(raw.wrench[rest.stamp < end], axis=0, ddof=1)
        if sensor.noise.known:
            noise, times = np.sqrt(sensor.reading_variance), np.max(spread / sensor.noise.white)
            self.report.moved_during_tare = bool(times > RESTLESS)
            if times > RESTLESS:
                text = f"the wrench varied by {times:.1f} times its noise during the tare"
                self.report.warn(f"{text}: is the rod free?")
        self._zero = ZeroWatch(noise, sensor.noise.resolution, self.rod.length, self._seconds)

    def _take_tare(self, tare: Tare, time: Times) -> None:
        """Use this tare from now on, with a covariance that includes pink noise and random walk,
        for an open-ended stream whose samples began at the first of these times [s].
        """
        interval = float(np.median(np.diff(time)))
        coloured = self._sensor.noise.coloured_within(float(time[0]), _DAY, interval)
        self._tare, self._tared = replace(tare, coloured=tuple(coloured)), True

    def ready(self, now: int) -> Iterator[Result]:
        """Batches that can be processed at `now` [ns since 1970], for sources stamped on the host's
        clock.
        """
        while self._waiting and (count := self._workable(self._waiting, now)):
            samples, self._waiting = self._waiting[:count], self._waiting[count:]
            yield self._result(samples)

    def _workable(self, samples: Samples, now: int) -> int:
        """How many leading samples form the next batch: of one zero, with poses, and, before the
        tare is known, only those in error.
        """
        ends = [len(samples), MOST_ROWS, *(np.flatnonzero(samples.anew[1:])[:1] + 1)]
        if samples.position is None:
            ends.append(self.poses.ready(samples.stamp, now))
        if not self._tared:
            ends += np.flatnonzero(samples.valid)[:1].tolist()
        return int(min(ends))

    def _result(self, samples: Samples) -> Result:
        posed, zero, unsure = self._posed(samples), self._zero, False
        raw = self._raw(samples, posed)
        found = self._found(raw, posed.known)
        free = self._tare.readings(self._sensor, raw.time, raw.orientation)
        tared = raw.wrench - free - self._sensor.rod_readings(raw)
        if zero is not None:
            if samples.anew[0]:
                zero.restart()
            unsure, same = zero.pending, zero.take(raw, tared, found)
            if same:
                self.report.notice("the sensor's zero is as it was before the restart")
            elif same is not None:
                self._tare_anew(zero.rest())
        found = found if self.stage is None else self.stage.push(found)
        if unsure:
            status = np.where(found.status == Status.OK, Status.SETUP_CONTRADICTED, found.status)
            found = replace(found, status=status.astype(np.int8))
        else:
            self._keep(raw, raw.whole & posed.known)
        self.report.unsure += unsure * len(samples)
        self.report.without_pose += int(np.count_nonzero(~posed.known))
        position, orientation = (np.where(posed.known[:, None], part, np.nan) for part in posed[:2])
        shown = replace(raw, position=position, orientation=orientation).with_wrench(tared)
        return Result(samples.stamp, samples.arrival, shown, found)

    def _found(self, raw: RawRecording, known: Flags) -> Reconstruction:
        """Contacts of rows, some of which may lack a pose."""
        return reconstruct(
            self.rod, self._reactions(raw, known), friction=self.friction, check=False
        )

    def _reactions(self, raw: RawRecording, known: Flags) -> Reactions:
        reactions = self._sensor.reactions(raw, self._tare, tolerances=self._errors)
        late = PARAMETERS.index("pose_delay")
        if self._errors is not None and self._errors.covariance[late, late]:
            velocity = self._velocity(raw.time, reactions.trail, known)
            reactions = replace(reactions, velocity=np.tile(velocity, (len(known), 1)))
        return reactions

    def _velocity(self, time: Times, clamp: Trail, known: Flags) -> Wrench:
        """Velocity of the clamp, one for the batch: from its last pose and one some 50 ms back."""
        here = rows_of(_Places(time, clamp.position, clamp.orientation), known)
        passed = joined([*self._passed, here])
        if len(passed.time) < 2:
            self._passed = [passed]
            return np.zeros(6)
        self._passed = [rows_of(passed, passed.time > passed.time[-1] - VELOCITY_SPAN)]
        return velocities(*rows_of(passed, [0, -1]))[1]

    def _tare_anew(self, rest: RawRecording) -> None:
        """Tare again, from readings at rest after a restart that changed the zero."""
        before, self._kept = self._tare.offset, []
        self._take_tare(self._sensor.tare(rest), rest.time)
        self.report.zero_changes += 1
        getattr(self.stage, "reset", lambda: None)()
        changes = zip(CHANNELS, self._tare.offset - before, strict=True)
        moved = ", ".join(f"{name} {value:+.4g}" for name, value in changes)
        text = f"the sensor's zero has changed with its restart ({moved} N, N m)"
        self.report.warn(f"{text}: it is tared again")

    def _keep(self, raw: RawRecording, rows: Flags) -> None:
        """Keep rows of the present zero and clock."""
        columns = (raw.time, raw.position, raw.orientation, raw.force, raw.torque)
        new = rows_of(_Readings(*columns), rows)
        if not len(new.time):
            return
        if self._kept and new.time[0] <= self._kept[-1].time[-1]:
            self._kept = []
        self._kept.append(new)
        if len(self._kept) > _PARTS:
            self._kept = [joined(self._kept)]
            if len(self._kept[0].time) > _KEPT:
                self._kept = [rows_of(self._kept[0], np.s_[::2])]

    def contradictions(self) -> list[str]:
        """What the rows so far say against rod, clamp and sensor, as `vibrissa.reconstruct` says it
        of a recording; nothing where the noise is unknown.
        """
        if not self._kept or not self._sensor.noise.known:
            return []
        self.report.notice("checking rod, clamp and sensor by the readings")
        raw = RawRecording(*joined(self._kept))
        whole = self._sensor.reactions(raw, self._tare, tolerances=self._errors)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RecordingWarning)
            return reconstruct(self.rod, whole, friction=self.friction).warnings

    def _time(self, samples: Samples) -> Times:
        """Time since the first sample [s]."""
        return (samples.stamp - self._origin) * 1e-9

    def _raw(self, samples: Samples, poses: Poses) -> RawRecording:
        """Samples as a recording, NaN for those that are invalid or have no pose."""
        good = (samples.valid & poses.known)[:, None]
        force, torque = (np.where(good, part, np.nan) for part in (samples.force, samples.torque))
        return RawRecording(self._time(samples), poses.position, poses.orientation, force, torque)

    def _posed(self, samples: Samples) -> Poses:
        if samples.position is None or samples.orientation is None:
            return self.poses.at(samples.stamp)
        return Poses(samples.position, samples.orientation, np.ones(len(samples), dtype=bool))


def _unloaded(rows: int) -> RawRecording:
    """Rows of a sensor at rest without load."""
    still = np.zeros((rows, 3))
    turn = np.tile([0.0, 0.0, 0.0, 1.0], (rows, 1))
    return RawRecording(np.arange(float(rows)), still, turn, still, still)
