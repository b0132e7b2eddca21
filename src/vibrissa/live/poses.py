"""The sensor's pose at the time of a sample: constant, from a timed trail, or from a UDP stream."""

from __future__ import annotations

import json
import math
import socket
import threading
import time
from abc import ABC, abstractmethod
from bisect import bisect, bisect_left
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass
from operator import attrgetter
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from vibrissa.geometry.checks import finite_array
from vibrissa.live.address import listening
from vibrissa.live.samples import Flags, Nanoseconds, Quaternions, Vectors
from vibrissa.trail import Trail, between

_NORM = 1e-3  # tolerance: quaternions are printed with four digits or more
_LONGEST = 65536  # bytes: no datagram is longer
_MOST_HELD = 20_000  # poses: 20 s of the fastest robots
_STAMP = attrgetter("stamp")
_ANOTHER_CLOCK = 1_000_000_000  # [ns]: synchronised clocks differ by less


class Poses(NamedTuple):
    """Poses of the sensor frame in the world: (n, 3) [m] and x, y, z, w (n, 4), and whether they
    are known (n,).
    """

    position: Vectors
    orientation: Quaternions
    known: Flags


class PoseSource(ABC):
    """Gives the sensor's pose at any time."""

    malformed: int = 0
    """Datagrams that could not be read."""
    misplaced: int = 0
    """Poses stamped more than a second from their arrival: the clocks disagree."""

    def open(self) -> None:  # noqa: B027
        """Start. Raise OSError if an address cannot be listened on."""

    def close(self) -> None:  # noqa: B027
        """Release sockets; may be called twice."""

    def ready(self, stamp: Nanoseconds, now: int) -> int:  # noqa: ARG002
        """How many of the leading stamps (n,) [ns] have poses by now [ns]: by default all."""
        return len(stamp)

    @abstractmethod
    def at(self, stamp: Nanoseconds) -> Poses:
        """Poses at these times (n,) [ns], at least one."""


class TimedPoses(PoseSource):
    """A planned motion, which begins with the first sample. Between its poses the sensor moves
    straight and turns at a constant rate; after the last it stands still.

    Parameters
    ----------
    time
        (k,) [s] since the first sample, increasing.
    position, orientation
        Of the sensor frame: (k, 3) [m], and x, y, z, w (k, 4).

    Raises
    ------
    ValueError
        If shapes do not match, an entry is not finite, times do not increase, or a quaternion has
        zero norm.
    """

    def __init__(self, time: ArrayLike, position: ArrayLike, orientation: ArrayLike) -> None:
        self._time, self._motion = finite_array(time, "time"), Trail(position, orientation)
        if self._time.shape != self._motion.shape or np.any(np.diff(self._time) <= 0):
            raise ValueError(
                f"time has shape {self._time.shape}, the motion {self._motion.shape}; allowed are "
                "equal numbers, and increasing times"
            )
        self._start: int | None = None

    def at(self, stamp: Nanoseconds) -> Poses:
        """Poses at these times; the motion begins at the first stamp ever asked for."""
        if self._start is None:
            self._start = int(stamp[0])
        found = between(self._time, self._motion, (stamp - self._start) * 1e-9)
        return Poses(found.position, found.orientation, np.ones(len(stamp), dtype=bool))


class ConstantPose(PoseSource):
    """A sensor that does not move.

    Raises
    ------
    ValueError
        If `position` is not (3,), or `orientation` not a quaternion x, y, z, w.
    """

    def __init__(
        self, position: ArrayLike = (0.0, 0.0, 0.0), orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0)
    ) -> None:
        self._poses = TimedPoses([0.0], np.asarray(position)[None], orientation)

    def at(self, stamp: Nanoseconds) -> Poses:
        """The same pose at all times."""
        return self._poses.at(stamp)


def with_unit_norm(quaternion: tuple[float, ...]) -> tuple[float, ...]:
    """Return a quaternion x, y, z, w; raise ValueError unless its norm is 1."""
    norm = math.hypot(*quaternion)
    if abs(norm - 1) > _NORM:
        raise ValueError(f"a quaternion of norm {norm:g}; allowed is 1")
    return quaternion


_Number = Annotated[
    float, Field(gt=-1e9, lt=1e9, allow_inf_nan=False)
]  # m: no laboratory is larger


class PoseMessage(BaseModel):
    """One pose of a stream as JSON: `{"stamp": nanoseconds, "position": [x, y, z], "orientation":
    [x, y, z, w]}`; without a stamp, its time of arrival is used.

    Raises
    ------
    ValueError
        By `model_validate_json`, if it is not such an object, a number is not finite, or the
        quaternion is not of unit norm.
    """

    model_config = ConfigDict(extra="forbid", strict=True)

    stamp: Annotated[int, Field(ge=0, lt=2**62)] | None = None  # sums of two fit into 64 bits
    position: tuple[_Number, _Number, _Number]
    orientation: Annotated[
        tuple[_Number, _Number, _Number, _Number], AfterValidator(with_unit_norm)
    ]


def pose_bytes(
    stamp: int, position: Float[np.ndarray, "3"], orientation: Float[np.ndarray, "4"]
) -> bytes:
    """A `PoseMessage` as sent."""
    pose = {"stamp": stamp, "position": position.tolist(), "orientation": orientation.tolist()}
    return json.dumps(pose).encode()


@dataclass(eq=False)
class StreamedPoses(PoseSource):
    """Poses from JSON datagrams over UDP (`PoseMessage`), interpolated to the stamps of the
    samples.

    A sample waits up to `patience` for a pose at or after its stamp; then the last pose is used if
    it is no older than that, else the pose is unknown. Poses swapped on the way are put in order;
    one stamped more than a second ahead is ignored.

    Parameters
    ----------
    host, port
        Address to listen on; port 0 for any free one, which `open` fills in.
    patience
        How long to wait for a pose, and how old it may be [s].
    """

    host: str = "127.0.0.1"
    port: int = 49153
    _: KW_ONLY
    patience: float = 0.05

    def __post_init__(self) -> None:
        self._patience = round(self.patience * 1e9)
        self._held: list[PoseMessage] = []
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Listen, in a thread."""
        self._socket = listening(self.host, self.port)
        self._socket.settimeout(0.1)
        self.port = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._listen, name="poses", daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while (connection := self._socket) is not None:
            with suppress(OSError):
                self.take(connection.recv(_LONGEST), time.time_ns())

    def take(self, data: bytes, now: int) -> None:
        """Keep the pose in a datagram received at `now` [ns since 1970]; count it if it cannot be
        read.
        """
        try:
            message = PoseMessage.model_validate_json(data)
        except ValueError:
            self.malformed += 1
            return
        if message.stamp is None:
            message.stamp = now
        self.misplaced += abs(message.stamp - now) > _ANOTHER_CLOCK
        if message.stamp > now + _ANOTHER_CLOCK:
            return
        with self._lock:
            place = bisect(self._held, message.stamp, key=_STAMP)
            if not place or self._held[place - 1].stamp != message.stamp:
                self._held.insert(place, message)
                del self._held[:-_MOST_HELD]

    def close(self) -> None:
        """Stop listening."""
        connection, self._socket = self._socket, None
        if connection is not None:
            self._thread.join(1)
            connection.close()

    def ready(self, stamp: Nanoseconds, now: int) -> int:
        """Stamps up to the latest pose, and those that have waited long enough."""
        with self._lock:
            latest = _STAMP(self._held[-1]) if self._held else 0
        return int(np.searchsorted(stamp, max(latest, now - self._patience), side="right"))

    def at(self, stamp: Nanoseconds) -> Poses:
        """Poses at these times; poses no longer needed are dropped. Farther than the patience from
        the poses on both sides, the pose is unknown: a straight line would be a guess.
        """
        with self._lock:
            del self._held[: max(bisect(self._held, stamp[0], key=_STAMP) - 1, 0)]
            held = self._held[: bisect_left(self._held, stamp[-1], key=_STAMP) + 1]
        if not held:
            return ConstantPose().at(stamp)._replace(known=np.zeros(len(stamp), dtype=bool))
        moments = np.array([pose.stamp for pose in held])
        motion = Trail([pose.position for pose in held], [pose.orientation for pose in held])
        found = between((moments - moments[0]) * 1e-9, motion, (stamp - moments[0]) * 1e-9)
        nearest = np.abs(stamp[:, None] - moments).min(axis=1)
        return Poses(found.position, found.orientation, nearest <= self._patience)
