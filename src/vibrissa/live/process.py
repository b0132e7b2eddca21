"""Samples to contacts: tare, pose, inverse, batch by batch."""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass, replace
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.contacts import Status
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse import Reconstruction, reconstruct
from vibrissa.live.poses import ConstantPose, Poses, PoseSource
from vibrissa.live.samples import Flags, Nanoseconds, Samples, Wrenches, joined
from vibrissa.live.zero import RESTLESS, Verdict, ZeroWatch
from vibrissa.reactions import VELOCITY_SPAN, velocities
from vibrissa.rod import Rod
from vibrissa.sensor import CHANNELS, RawRecording, Sensor, Tare
from vibrissa.tolerances import PARAMETERS, Tolerances

Velocities = Float[np.ndarray, "n 6"]
MOST_ROWS = 64
"""Of one call of the inverse: one block of its lanes. More blocks would have to be compiled too."""
TARE_SECONDS = 1.0
"""Where the setup gives none."""
_DAY = 86_400.0  # [s] for which pink noise is stated as it is: slower noise a tare knows


@runtime_checkable
class Stage(Protocol):
    """What stands between the inverse and the sinks, such as a filter in time.
    `vibrissa.live.Processor` calls it with each batch, in order.

    Its method `reset()`, if it has one, is called when the sensor's zero was taken anew.
    """

    def push(self, found: Reconstruction) -> Reconstruction:
        """Return the batch with each row as it is known by now: the same rows."""


class Result(NamedTuple):
    """One batch: stamps (n,) [ns], arrivals (n,) [ns], poses and tared wrench (NaN where not
    known), contacts.
    """

    stamp: Nanoseconds
    arrival: Nanoseconds
    raw: RawRecording
    found: Reconstruction


class _Place(NamedTuple):
    """Where the clamp was."""

    time: float
    position: Float[np.ndarray, "3"]
    orientation: Float[np.ndarray, "4"]


@dataclass(eq=False)
class Processor:
    """Turns samples into contacts.

    Rows are held until the tare is over, and until their pose is known. A row that the sensor calls
    invalid, or that has no pose, is passed on without contact, with `Status.BAD_DATA`. The tare
    begins with the first valid one. After a sensor was restarted its zero is compared with that
    before, and taken anew if it is another and the rod is known to be free (`vibrissa.live.zero`);
    until that is known, rows have the status `SETUP_CONTRADICTED`.

    Parameters
    ----------
    rod, sensor
        Of the setup; the first `sensor.tare_seconds` of samples, taken from the stream, are its
        tare: one second where that is None. Rest intervals and an estimated drift need a whole
        recording and are not used.
    poses
        Of the sensor frame, for sources that do not know it.
    stage
        Between the inverse and the sinks, or None.
    friction
        Coulomb's coefficient between rod and object: 0 for none, None where it is not known.
    tolerances
        As for `vibrissa.Sensor.reactions`.
    """

    rod: Rod
    sensor: Sensor
    poses: PoseSource
    _: KW_ONLY
    stage: Stage | None = None
    friction: float | None = None
    tolerances: Tolerances | ArrayLike | None = None

    def __post_init__(self) -> None:
        seconds, given = self.sensor.tare_seconds, self.tolerances
        self._seconds = TARE_SECONDS if seconds is None else seconds
        self._errors = None if given is None else self.sensor.setup_errors(given)
        self._sensor = self.sensor.updated(
            tare_seconds=self._seconds, rest_intervals=(), estimate_drift=False
        )
        self._nothing = self._sensor.updated(tare_seconds=0.0).tare(_unloaded(1))
        self._tare = None if self._seconds else self._nothing
        self._waiting: list[Samples] = []
        self._origin: int | None = None
        self._passed: deque[_Place] = deque()
        self._zero: ZeroWatch | None = None
        # Is told, in a line, what happens; `warns` where that is a warning. `stream` sets it.
        self.say: Callable[..., None] = lambda *_, **__: None
        self.moved_during_tare = False
        self.without_pose = self.unsure = self.zero_changes = 0

    @property
    def tare(self) -> Float[np.ndarray, "6"] | None:
        """What is taken off [N], [N m]; None as long as that is not known."""
        return None if self._tare is None else self._tare.offset

    @property
    def waiting(self) -> int:
        """Samples that are held."""
        return sum(map(len, self._waiting))

    def warm_up(self) -> None:
        """Compile, for every size of batch that may come, before samples do."""
        for rows in (1, MOST_ROWS):
            raw = replace(_unloaded(rows), force=np.ones((rows, 3)))
            self._found(raw, self._tare or self._nothing, None)

    def push(self, samples: Samples) -> None:
        """Take samples in."""
        if not len(samples):
            return
        if self._origin is None:
            self._origin = int(samples.stamp[0])
        if self._tare is None and samples.anew.any():
            # What came from the sensor before its restart is of another zero.
            valid = np.arange(len(samples)) >= np.flatnonzero(samples.anew)[-1]
            self._waiting = [replace(part, valid=part.valid & False) for part in self._waiting]
            samples = replace(samples, valid=samples.valid & valid)
        self._waiting.append(samples)
        if self._tare is None:
            self._try_tare()
        elif self._tare.coloured is None and len(samples) > 1:
            time = (samples.stamp - self._origin) * 1e-9
            self._tare = self._going_on(self._tare, 0.0, time)

    def _try_tare(self) -> None:
        """From the leading time, once a sample lies behind it; as `Sensor.reactions` takes it from
        a recording.
        """
        samples = joined(self._waiting)
        self._waiting = [samples]
        rest = samples.rows(int(np.argmax(samples.valid)), len(samples))
        end = rest.stamp[0] + self._seconds * 1e9
        if not rest.valid[0] or rest.stamp[-1] < end:
            return
        # Without a mount that weighs, the tare needs no pose.
        posed = ConstantPose().at(rest.stamp) if self._sensor.mount is None else self._posed(rest)
        raw = self._raw(rest, posed)
        self._tare = self._going_on(self._sensor.tare(raw), raw.time[0], raw.time)
        shown = ", ".join(f"{value:.6g}" for value in self._tare.offset)
        self.say(f"tare: {shown} (N, N m)")
        noise = spread = np.nanstd(raw.wrench[rest.stamp < end], axis=0, ddof=1)
        if self._sensor.force_noise is not None:
            times = float(np.max(spread / self._sensor.noise.white))
            noise = np.sqrt(self._sensor.reading_variance)
            self.moved_during_tare = times > RESTLESS
            if self.moved_during_tare:
                text = f"the wrench varied by {times:.1f} times its noise during the tare"
                self.say(f"{text}: is the rod free?", warns=True)
        self._zero = ZeroWatch(noise, self._sensor.noise.resolution, self.rod.length, self._seconds)

    def _going_on(self, tare: Tare, start: float, time: Float[np.ndarray, "n"]) -> Tare:
        """A tare whose covariance holds pink noise and random walk of a stream that began at
        `start` [s] and goes on, by times (n,) [s] of its samples.
        """
        interval = float(np.median(np.diff(time)))
        coloured = self._sensor.noise.coloured_within(float(start), _DAY, interval)
        return replace(tare, coloured=tuple(coloured))

    def ready(self, now: int) -> Iterator[Result]:
        """Batches that can be worked on at `now` [ns since 1970], for sources whose stamps are of
        the host's clock.
        """
        while self._waiting:
            samples = joined(self._waiting)
            count = self._workable(samples, now)
            self._waiting = [samples.rows(count, len(samples))] if count < len(samples) else []
            if count == 0:
                return
            yield self._result(samples.rows(0, count))

    def _workable(self, samples: Samples, now: int) -> int:
        """How many leading samples are the next batch."""
        if self._tare is None and samples.valid[0]:
            return 0
        ends = [len(samples), MOST_ROWS]
        if samples.position is None:
            ends.append(self.poses.ready(samples.stamp, now))
        if self._tare is None:
            ends += np.flatnonzero(samples.valid)[:1].tolist()
        ends += (np.flatnonzero(samples.anew[1:])[:1] + 1).tolist()
        return min(ends)

    def _result(self, samples: Samples) -> Result:
        tare = self._tare or self._nothing
        if self._zero is not None and samples.anew[0]:
            self._zero.restart()
        poses = self._posed(samples)
        self.without_pose += int(np.count_nonzero(~poses.known))
        raw = self._raw(samples, poses)
        found = self._found(raw, tare, self._velocity(raw, poses.known))
        tared = raw.wrench - tare.readings(self._sensor, raw.time, raw.orientation)
        unsure = self._zero is not None and self._zero.pending
        self._watch(raw, tared, found)
        found = found if self.stage is None else self.stage.push(found)
        if unsure:
            self.unsure += len(samples)
            status = np.where(found.status == Status.OK, Status.SETUP_CONTRADICTED, found.status)
            found = replace(found, status=status.astype(np.int8))
        known = poses.known[:, None]
        shown = RawRecording(
            raw.time,
            np.where(known, raw.position, np.nan),
            np.where(known, raw.orientation, np.nan),
            tared[:, :3],
            tared[:, 3:],
        )
        return Result(samples.stamp, samples.arrival, shown, found)

    def _found(self, raw: RawRecording, tare: Tare, velocity: Velocities | None) -> Reconstruction:
        reactions = self._sensor.reactions(raw, tare, tolerances=self._errors, velocity=velocity)
        return reconstruct(self.rod, reactions, friction=self.friction, check=False)

    def _watch(self, raw: RawRecording, tared: Wrenches, found: Reconstruction) -> None:
        """Follow the zero, and take it anew if it is another."""
        if self._zero is None or self._tare is None:
            return
        verdict = self._zero.take(raw, tared, found)
        if verdict is Verdict.SAME:
            self.say("the sensor's zero is as it was before the restart")
        if verdict is not Verdict.CHANGED:
            return
        rest, before = self._zero.rest(), self._tare.offset
        self._tare = self._going_on(self._sensor.tare(rest), rest.time[0], rest.time)
        self.zero_changes += 1
        reset = getattr(self.stage, "reset", None)
        if reset is not None:
            reset()
        changes = zip(CHANNELS, self._tare.offset - before, strict=True)
        moved = ", ".join(f"{name} {value:+.4g}" for name, value in changes)
        text = f"the sensor's zero has changed with its restart ({moved} N, N m): it is tared again"
        self.say(text, warns=True)

    def _velocity(self, raw: RawRecording, known: Flags) -> Velocities | None:
        """Of the clamp, one for the batch: between its last pose and one some 50 ms before; None
        if no pose comes late.
        """
        late = PARAMETERS.index("pose_delay")
        if self._errors is None or not self._errors.covariance[late, late]:
            return None
        for row in np.flatnonzero(known)[-1:]:
            arm = rotation_matrices(raw.orientation[row]) @ self._sensor.clamp_position
            place = _Place(raw.time[row], raw.position[row] + arm, raw.orientation[row])
            self._passed.append(place)
        passed = self._passed
        while len(passed) > 2 and passed[-1].time - passed[1].time >= VELOCITY_SPAN:
            passed.popleft()
        if len(passed) < 2:
            return np.zeros((len(raw.time), 6))
        time, position, orientation = map(np.array, zip(passed[0], passed[-1], strict=True))
        return np.broadcast_to(velocities(time, position, orientation)[1], (len(raw.time), 6))

    def _raw(self, samples: Samples, poses: Poses) -> RawRecording:
        """Samples as a recording, NaN for those without a pose or not valid."""
        assert self._origin is not None
        good = (samples.valid & poses.known)[:, None]
        return RawRecording(
            (samples.stamp - self._origin) * 1e-9,
            poses.position,
            poses.orientation,
            np.where(good, samples.force, np.nan),
            np.where(good, samples.torque, np.nan),
        )

    def _posed(self, samples: Samples) -> Poses:
        if samples.position is not None and samples.orientation is not None:
            return Poses(samples.position, samples.orientation, np.ones(len(samples), dtype=bool))
        return self.poses.at(samples.stamp)


def _unloaded(rows: int) -> RawRecording:
    """Rows of a sensor that stands and feels nothing."""
    still = np.zeros((rows, 3))
    return RawRecording(
        np.arange(float(rows)), still, np.tile([0.0, 0.0, 0.0, 1.0], (rows, 1)), still, still
    )
