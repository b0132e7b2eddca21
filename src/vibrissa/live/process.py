"""Samples to contacts: tare, pose, inverse, batch by batch."""

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike

from vibrissa.contacts import Status
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse import Reconstruction, reconstruct
from vibrissa.live.poses import Poses, PoseSource
from vibrissa.live.samples import Samples, joined
from vibrissa.live.zero import Verdict, ZeroWatch
from vibrissa.reactions import VELOCITY_SPAN, velocities
from vibrissa.rod import Rod
from vibrissa.sensor import CHANNELS, RawRecording, Sensor
from vibrissa.sensor.noise import Pink, RandomWalk
from vibrissa.tolerances import Tolerances

MOST_ROWS = 64
"""Of one call of the inverse: one block of its lanes. More blocks would have to be compiled too."""
_WARM_SIZES = (1, MOST_ROWS)
_LEAST_TARE = 2
TARE_SECONDS = 1.0
"""Where the setup gives none."""
_ONE_ROW = RawRecording(
    np.zeros(1),
    np.zeros((1, 3)),
    np.array([[0.0, 0.0, 0.0, 1.0]]),
    np.zeros((1, 3)),
    np.zeros((1, 3)),
)
_ROW = ("time", "position", "orientation", "force", "torque")
_RESTLESS = 3.0
# For how long pink noise is stated as it is: of slower noise than a day's a tare knows.
_DAY = 86_400.0


@runtime_checkable
class Stage(Protocol):
    """What stands between the inverse and the sinks, such as a filter in time.
    `vibrissa.live.Processor` calls it with each batch, in order.

    Its method `reset()`, if it has one, is called where the sensor's zero was taken anew.
    """

    def push(self, found: Reconstruction) -> Reconstruction:
        """Return the batch with each row as it is known by now: the same rows."""


class Result(NamedTuple):
    """One batch: stamps (n,) [ns], arrivals (n,) [ns], whether it waited for the tare, poses and
    tared wrench (NaN where not known), contacts.
    """

    stamp: Int[np.ndarray, "n"]
    arrival: Int[np.ndarray, "n"]
    held: bool
    raw: RawRecording
    found: Reconstruction


class Processor:
    """Turns samples into contacts.

    Rows are held until the tare is over, and until their pose is known. A row that the sensor calls
    invalid, or that has no pose, is given on without contact, with `Status.BAD_DATA`. The tare
    begins with the first valid one. After a sensor was restarted its zero is compared with that
    before, and taken anew where it is another and the rod is known to be free
    (`vibrissa.live.zero`); until that is known, rows have the status `SETUP_CONTRADICTED`.

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
        As for `vibrissa.reconstruct`.
    tolerances
        As for `vibrissa.Sensor.reactions`.
    """

    def __init__(
        self,
        rod: Rod,
        sensor: Sensor,
        poses: PoseSource,
        *,
        stage: Stage | None = None,
        friction: float | None = None,
        tolerances: Tolerances | ArrayLike | None = None,
    ) -> None:
        self._rod, self._poses, self._stage, self._friction = rod, poses, stage, friction
        seconds = TARE_SECONDS if sensor.tare_seconds is None else sensor.tare_seconds
        self._sensor = sensor.updated(
            tare_seconds=seconds, rest_intervals=(), estimate_drift=False
        )
        self._errors = None if tolerances is None else sensor.setup_errors(tolerances)
        self._passed: deque[RawRecording] = deque()
        self._tare = self._sensor.tare(_ONE_ROW) if seconds == 0 else None
        self._held_by_tare = 0
        self._waiting: list[Samples] = []
        self._origin: int | None = None
        self._nothing = self._sensor.updated(tare_seconds=0.0).tare(_ONE_ROW)
        self.tare: Float[np.ndarray, 6] | None = None if self._tare is None else self._tare.offset
        self._zero: ZeroWatch | None = None
        self._news: list[tuple[str, bool]] = []
        self.restless = 0.0
        self.without_pose = 0
        self.unsure = 0
        self.zero_changes = 0

    def warm_up(self) -> None:
        """Compile, for every size of batch that may come, before samples do."""
        for rows in _WARM_SIZES:
            turn = np.tile([0.0, 0.0, 0.0, 1.0], (rows, 1))
            raw = RawRecording(
                np.arange(rows) * 1.0,
                np.zeros((rows, 3)),
                turn,
                np.ones((rows, 3)),
                np.zeros((rows, 3)),
            )
            reactions = self._sensor.reactions(
                raw, self._tare or self._nothing, tolerances=self._errors
            )
            reconstruct(self._rod, reactions, friction=self._friction, check=False)

    def push(self, samples: Samples) -> None:
        """Take samples in."""
        if not len(samples):
            return
        if self._origin is None:
            self._origin = int(samples.stamp[0])
        if self._tare is None and samples.restarts.any():
            samples = self._since_restart(samples)
        self._waiting.append(samples)
        if self._tare is None:
            self._try_tare()
        elif self._tare.coloured is None and len(samples) > 1:
            self._tare = replace(self._tare, coloured=self._coloured(0.0, samples.stamp))

    def _since_restart(self, samples: Samples) -> Samples:
        """Before the tare is over: what came from the sensor before its restart is of another zero,
        and not valid.
        """
        self._waiting = [
            replace(part, valid=np.zeros(len(part), dtype=bool)) for part in self._waiting
        ]
        last = int(np.flatnonzero(samples.restarts)[-1])
        return replace(samples, valid=samples.valid & (np.arange(len(samples)) >= last))

    def _coloured(
        self, start: float, stamp: Int[np.ndarray, "n"]
    ) -> tuple[tuple[Pink | RandomWalk, Float[np.ndarray, "6"]], ...]:
        """Pink noise and random walk of a stream that began at `start` [s] and goes on."""
        return tuple(
            self._sensor.noise.coloured_within(start, _DAY, float(np.median(np.diff(stamp))) * 1e-9)
        )

    def _try_tare(self) -> None:
        """From the leading time, once a sample lies behind it; as `Sensor.reactions` takes it from
        a recording.
        """
        assert self._sensor.tare_seconds is not None
        first = next(
            (part.stamp[np.argmax(part.valid)] for part in self._waiting if part.valid.any()), None
        )
        if first is None or self._waiting[-1].stamp[-1] < first + self._sensor.tare_seconds * 1e9:
            return
        samples = joined(self._waiting)
        self._waiting = [samples]
        rest = samples.rows(int(np.argmax(samples.valid)), len(samples))
        rows = (rest.stamp < first + self._sensor.tare_seconds * 1e9) & rest.valid
        count = int(np.count_nonzero(rows))
        if count < _LEAST_TARE:
            raise ValueError(
                f"tare_seconds = {self._sensor.tare_seconds}: {count} samples came within it; allowed are at least {_LEAST_TARE}"
            )
        raw = self._raw(
            rest, self._posed(rest) if self._sensor.mount is not None else _standing(len(rest))
        )
        self._tare = replace(
            self._sensor.tare(raw), coloured=self._coloured(float(raw.time[0]), rest.stamp)
        )
        self.tare = self._tare.offset
        self.restless = self._restlessness(raw.wrench[rows])
        stated = self._sensor.force_noise is not None
        noise = (
            np.sqrt(self._sensor.reading_variance)
            if stated
            else raw.wrench[rows].std(axis=0, ddof=1)
        )
        self._zero = ZeroWatch(
            noise, self._sensor.noise.resolution, self._rod.length, self._sensor.tare_seconds
        )
        self._held_by_tare = len(samples)

    def _restlessness(self, wrench: Float[np.ndarray, "n 6"]) -> float:
        """Largest standard deviation of the tare's samples over the sensor's noise; 0 where that is
        not known.
        """
        if self._sensor.force_noise is None:
            return 0.0
        return float(np.max(wrench.std(axis=0, ddof=1) / self._sensor.noise.white))

    @property
    def moved_during_tare(self) -> bool:
        """Whether the wrench varied by more than three times the noise while it was taken for zero."""
        return self.restless > _RESTLESS

    def ready(self, now: int) -> Iterator[Result]:
        """Batches that can be worked on at `now` [ns since 1970], for sources whose stamps are of
        the host's clock.
        """
        while self._waiting and (self._tare is not None or not self._waiting[0].valid[0]):
            samples = joined(self._waiting)
            self._waiting = [samples]
            known = (
                len(samples)
                if samples.position is not None
                else self._poses.ready(samples.stamp, now)
            )
            if self._tare is None and samples.valid.any():
                known = min(known, int(np.argmax(samples.valid)))
            if known == 0:
                return
            anew = np.flatnonzero(samples.restarts[1:known])
            count = min(known, MOST_ROWS, *(anew[:1] + 1).tolist())
            self._waiting = [samples.rows(count, len(samples))] if count < len(samples) else []
            yield self._result(samples.rows(0, count))

    @property
    def waiting(self) -> int:
        """Samples that are held."""
        return sum(map(len, self._waiting))

    def _result(self, samples: Samples) -> Result:
        tare = self._tare or self._nothing
        if self._zero is not None and samples.restarts[0]:
            self._zero.restart()
        poses = self._posed(samples)
        known = poses.known
        self.without_pose += int(np.count_nonzero(~known))
        raw = self._raw(samples, poses)
        reactions = self._sensor.reactions(
            raw, tare, tolerances=self._errors, velocity=self._velocity(raw, known)
        )
        found = reconstruct(self._rod, reactions, friction=self._friction, check=False)
        tared = raw.wrench - tare.readings(self._sensor, raw.time, raw.orientation)
        unsure = self._zero is not None and self._zero.pending
        self._watch(raw, tared, found)
        raw = replace(raw, force=tared[:, :3], torque=tared[:, 3:])
        if not known.all():
            raw = replace(
                raw,
                **{
                    name: np.where(known[:, None], getattr(raw, name), np.nan)
                    for name in ("position", "orientation")
                },
            )
        held, self._held_by_tare = self._held_by_tare > 0, max(self._held_by_tare - len(samples), 0)
        found = found if self._stage is None else self._stage.push(found)
        if unsure:
            self.unsure += len(samples)
            found = replace(
                found,
                status=np.where(
                    found.status == Status.OK, Status.SETUP_CONTRADICTED, found.status
                ).astype(np.int8),
            )
        return Result(samples.stamp, samples.arrival, held, raw, found)

    def _watch(
        self, raw: RawRecording, tared: Float[np.ndarray, "n 6"], found: Reconstruction
    ) -> None:
        """Follow the zero, and take it anew where it is another."""
        if self._zero is None:
            return
        verdict = self._zero.take(raw, tared, found)
        if verdict is Verdict.SAME:
            self._news.append(("the sensor's zero is as it was before the restart", False))
        if verdict is not Verdict.CHANGED:
            return
        assert self._tare is not None
        rest, before = self._zero.rest(), self._tare.offset
        stamp = np.round(rest.time * 1e9).astype(np.int64)
        self._tare = replace(
            self._sensor.tare(rest), coloured=self._coloured(float(rest.time[0]), stamp)
        )
        self.tare = self._tare.offset
        self.zero_changes += 1
        reset = getattr(self._stage, "reset", None)
        if reset is not None:
            reset()
        moved = ", ".join(
            f"{name} {value:+.4g}" for name, value in zip(CHANNELS, self.tare - before, strict=True)
        )
        self._news.append(
            (
                f"the sensor's zero is another after its restart ({moved} N, N m): it is tared again",
                True,
            )
        )

    def news(self) -> list[tuple[str, bool]]:
        """What happened since this was asked last, in lines, and whether each is a warning."""
        said, self._news = self._news, []
        return said

    def _velocity(
        self, raw: RawRecording, known: Bool[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n 6"] | None:
        """Of the clamp, one for the batch: between its last pose and one some 50 ms before; None
        where no pose comes late.
        """
        if self._errors is None or not self._errors.covariance[-1, -1]:
            return None
        last = np.flatnonzero(known)[-1:]
        self._passed.extend(
            RawRecording(*(getattr(raw, name)[last] for name in _ROW)) for _ in last
        )
        while (
            len(self._passed) > 2
            and self._passed[-1].time[0] - self._passed[1].time[0] >= VELOCITY_SPAN
        ):
            self._passed.popleft()
        if len(self._passed) < 2 or self._passed[-1].time[0] <= self._passed[0].time[0]:
            self._passed = deque(list(self._passed)[-1:])
            return np.zeros((len(raw.time), 6))
        ends = (self._passed[0], self._passed[-1])
        time, position, orientation = (
            np.concatenate([getattr(end, name) for end in ends]) for name in _ROW[:3]
        )
        clamp = position + np.einsum(
            "nij,j->ni", rotation_matrices(orientation), self._sensor.clamp_position
        )
        return np.broadcast_to(velocities(time, clamp, orientation)[1], (len(raw.time), 6))

    def _raw(self, samples: Samples, poses: Poses) -> RawRecording:
        """Samples as a recording, NaN for those without a pose or not valid."""
        assert self._origin is not None
        wrench = np.concatenate([samples.force, samples.torque], axis=1)
        wrench[~(samples.valid & poses.known)] = np.nan
        return RawRecording(
            (samples.stamp - self._origin) * 1e-9,
            poses.position,
            poses.orientation,
            wrench[:, :3],
            wrench[:, 3:],
        )

    def _posed(self, samples: Samples) -> Poses:
        if samples.position is not None and samples.orientation is not None:
            return Poses(samples.position, samples.orientation, np.ones(len(samples), dtype=bool))
        return self._poses.at(samples.stamp)


def _standing(count: int) -> Poses:
    return Poses(
        np.zeros((count, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)), np.ones(count, dtype=bool)
    )
