"""Where the sensor is at the time of a sample: fixed, from a trail in time, or from a stream over
UDP.
"""

import json
import math
import socket
import threading
import time
from abc import ABC, abstractmethod
from bisect import bisect_left
from collections import deque
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation, Slerp

from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import unit_quaternions
from vibrissa.live.ports import listening

_LONGEST = 65536
_MOST_HELD = 20_000
_LARGEST = 1e9
_QUATERNION_TOLERANCE = 1e-3
_LARGEST_STAMP = 2**62
_ANOTHER_CLOCK = 1_000_000_000
_MOST_SWAPPED = 64


class Poses(NamedTuple):
    """Of the sensor frame in the world: (n, 3) [m], x, y, z, w (n, 4), and whether they are known
    (n,).
    """

    position: Float[np.ndarray, "n 3"]
    orientation: Float[np.ndarray, "n 4"]
    known: Bool[np.ndarray, "n"]


class PoseSource(ABC):
    """Gives the sensor's pose at any time."""

    malformed: int = 0
    misplaced: int = 0
    """Poses whose stamps lie more than a second from their arrival: the sender's clock is another.
    """

    @abstractmethod
    def open(self) -> None:
        """Begin. Raise OSError where an address cannot be listened at."""

    @abstractmethod
    def close(self) -> None:
        """Let go of sockets; may be called twice."""

    @abstractmethod
    def ready(self, stamp: Int[np.ndarray, "n"], now: int) -> int:
        """How many of the leading stamps (n,) [ns] can be answered by now [ns]."""

    @abstractmethod
    def at(self, stamp: Int[np.ndarray, "n"]) -> Poses:
        """Poses at these times (n,) [ns]."""


class ConstantPose(PoseSource):
    """A sensor that stands.

    Raises
    ------
    ValueError
        If `position` is not (3,), or `orientation` no quaternion x, y, z, w.
    """

    def __init__(
        self, position: ArrayLike = (0.0, 0.0, 0.0), orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0)
    ) -> None:
        self._position = finite_array(position, "position", last=3, ndim=1)
        self._orientation = unit_quaternions(
            finite_array(orientation, "orientation", last=4, ndim=1), "orientation"
        )

    def open(self) -> None:
        """Nothing is to be opened."""

    def close(self) -> None:
        """Nothing is held open."""

    def ready(self, stamp: Int[np.ndarray, "n"], now: int) -> int:  # noqa: ARG002
        """All."""
        return len(stamp)

    def at(self, stamp: Int[np.ndarray, "n"]) -> Poses:
        """The pose."""
        count = len(stamp)
        return Poses(
            np.tile(self._position, (count, 1)),
            np.tile(self._orientation, (count, 1)),
            np.ones(count, dtype=bool),
        )


class TimedPoses(PoseSource):
    """A motion planned in time, which begins with the first sample; between its poses the sensor
    moves straight and turns evenly, after the last it stands.

    Parameters
    ----------
    time
        (k,) [s] from the first sample on, increasing.
    position, orientation
        Of the sensor frame: (k, 3) [m], and x, y, z, w (k, 4).

    Raises
    ------
    ValueError
        If shapes do not fit, an entry is not finite, times do not increase, or a quaternion has
        zero norm.
    """

    def __init__(self, time: ArrayLike, position: ArrayLike, orientation: ArrayLike) -> None:
        moments = finite_array(time, "time", ndim=1)
        points, turns = (
            finite_array(position, "position", last=3, ndim=2),
            unit_quaternions(orientation, "orientation"),
        )
        if not len(moments) or not len(moments) == len(points) == len(turns):
            raise ValueError(
                f"time, position, orientation have {len(moments)}, {len(points)}, {len(turns)} rows; allowed are equal numbers"
            )
        if np.any(np.diff(moments) <= 0):
            raise ValueError("time does not increase; allowed are increasing times")
        self._time, self._position, self._orientation = moments, points, turns
        self._start: int | None = None

    def open(self) -> None:
        """Nothing is to be opened."""

    def close(self) -> None:
        """Nothing is held open."""

    def ready(self, stamp: Int[np.ndarray, "n"], now: int) -> int:  # noqa: ARG002
        """All."""
        return len(stamp)

    def at(self, stamp: Int[np.ndarray, "n"]) -> Poses:
        """Poses at these times; the first stamp ever asked for is the motion's beginning."""
        if self._start is None and len(stamp):
            self._start = int(stamp[0])
        since = (stamp - (self._start or 0)) * 1e-9
        return Poses(
            *between(self._time, self._position, self._orientation, since),
            np.ones(len(stamp), dtype=bool),
        )


def between(
    time: Float[np.ndarray, "k"],
    position: Float[np.ndarray, "k 3"],
    orientation: Float[np.ndarray, "k 4"],
    moment: Float[np.ndarray, "n"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"]]:
    """Poses (n, …) at these times: straight and evenly turned between their neighbours, the
    outermost beyond the ends.
    """
    within = np.clip(moment, time[0], time[-1])
    first = max(int(np.searchsorted(time, within.min(), side="right")) - 1, 0) if len(within) else 0
    last = (
        min(int(np.searchsorted(time, within.max(), side="left")) + 1, len(time))
        if len(within)
        else 1
    )
    part = slice(first, last)
    points = np.stack(
        [np.interp(within, time[part], position[part, axis]) for axis in range(3)], axis=1
    )
    if last - first < 2 or np.all(orientation[part] == orientation[first]):
        return points, np.tile(orientation[first], (len(within), 1))
    return points, np.asarray(
        Slerp(time[part], Rotation.from_quat(orientation[part]))(within).as_quat()
    )


class PoseMessage(NamedTuple):
    """One pose of a stream: stamp [ns since 1970] or None, position [m], quaternion x, y, z, w."""

    stamp: int | None
    position: tuple[float, float, float]
    orientation: tuple[float, float, float, float]


def parse_pose(data: bytes) -> PoseMessage:
    """Pose from JSON: `{"stamp": nanoseconds, "position": [x, y, z], "orientation": [x, y, z, w]}`;
    without a stamp, that of its arrival is meant.

    Raises
    ------
    ValueError
        If it is not such an object, a number is not finite, or the quaternion is not of unit norm.
    """
    try:
        content = json.loads(data)
    except RecursionError as error:
        raise ValueError("nested too deep; allowed is one JSON object") from error
    if not isinstance(content, dict) or not {"position", "orientation"} <= set(content) <= {
        "stamp",
        "position",
        "orientation",
    }:
        raise ValueError(
            "allowed is a JSON object with position, orientation and, optionally, stamp"
        )
    stamp = content.get("stamp")
    if stamp is not None and (
        not isinstance(stamp, int) or isinstance(stamp, bool) or not 0 <= stamp < _LARGEST_STAMP
    ):
        raise ValueError(f"stamp = {str(stamp)[:40]}; allowed are whole nanoseconds since 1970")
    position, orientation = (
        _numbers(content["position"], "position", 3),
        _numbers(content["orientation"], "orientation", 4),
    )
    if abs(math.hypot(*orientation) - 1) > _QUATERNION_TOLERANCE:
        raise ValueError("orientation: the norm is not 1; allowed is a unit quaternion x, y, z, w")
    x, y, z, w = orientation
    return PoseMessage(stamp, (position[0], position[1], position[2]), (x, y, z, w))


def _numbers(value: object, name: str, count: int) -> list[float]:
    if (
        not isinstance(value, list)
        or len(value) != count
        or any(isinstance(part, bool) or not isinstance(part, int | float) for part in value)
    ):
        raise ValueError(f"{name}: allowed are {count} numbers")
    if not all(abs(part) < _LARGEST for part in value):
        raise ValueError(
            f"{name}: a number that is not finite, or beyond {_LARGEST:g}; allowed are finite numbers"
        )
    return [float(part) for part in value]


def pose_bytes(
    stamp: int, position: Float[np.ndarray, "3"], orientation: Float[np.ndarray, "4"]
) -> bytes:
    """Undo `parse_pose`."""
    return json.dumps(
        {"stamp": stamp, "position": position.tolist(), "orientation": orientation.tolist()}
    ).encode()


class StreamedPoses(PoseSource):
    """Poses from JSON datagrams over UDP, interpolated to the stamps of the samples.

    A sample waits for a pose at or after its stamp for up to `patience`; then the last pose holds,
    if it is no older than that, else the pose is not known. Poses that were swapped on the way are
    put in order; one that is stamped more than a second ahead is left out.

    Parameters
    ----------
    host, port
        Address to listen at.
    patience
        How long a pose may be awaited, and how far back it may lie [s].
    """

    def __init__(
        self, host: str = "127.0.0.1", port: int = 49153, *, patience: float = 0.05
    ) -> None:
        self._address = (host, port)
        self._patience = round(patience * 1e9)
        self._held: deque[PoseMessage] = deque(maxlen=_MOST_HELD)
        self._lock = threading.Lock()
        self._socket: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self.received = 0
        self.malformed = 0
        self.misplaced = 0

    @property
    def port(self) -> int:
        """That is listened at; also where 0 was asked for."""
        return int(self._socket.getsockname()[1]) if self._socket is not None else self._address[1]

    def open(self) -> None:
        """Listen, in a thread."""
        self._socket = listening(*self._address)
        self._socket.settimeout(0.1)
        self._thread = threading.Thread(
            target=self._listen, args=(self._socket,), name="poses", daemon=True
        )
        self._thread.start()

    def _listen(self, connection: socket.socket) -> None:
        while self._socket is connection:
            with suppress(TimeoutError):
                try:
                    self.take(connection.recv(_LONGEST), time.time_ns())
                except OSError as error:
                    if not isinstance(error, TimeoutError):
                        return

    def take(self, data: bytes, now: int) -> None:
        """Keep the pose of one datagram that came at `now` [ns since 1970]; count what cannot be
        read.
        """
        try:
            message = parse_pose(data)
        except ValueError:
            self.malformed += 1
            return
        stamp = now if message.stamp is None else message.stamp
        self.misplaced += abs(stamp - now) > _ANOTHER_CLOCK
        if stamp > now + _ANOTHER_CLOCK:
            return
        with self._lock:
            self.received += 1
            self._insert(message._replace(stamp=stamp), stamp)

    def _insert(self, message: PoseMessage, stamp: int) -> None:
        place = len(self._held)
        while place and (self._held[place - 1].stamp or 0) > stamp:
            place -= 1
        if len(self._held) - place > _MOST_SWAPPED or (
            place and self._held[place - 1].stamp == stamp
        ):
            return
        if place == len(self._held):
            self._held.append(message)
        elif len(self._held) < _MOST_HELD:
            self._held.insert(place, message)

    def close(self) -> None:
        """Stop listening."""
        connection, self._socket = self._socket, None
        if connection is not None and self._thread is not None:
            self._thread.join(1)
            connection.close()

    def ready(self, stamp: Int[np.ndarray, "n"], now: int) -> int:
        """Stamps up to the latest pose, and those that have waited long enough."""
        with self._lock:
            latest = self._held[-1].stamp if self._held else None
        return int(np.searchsorted(stamp, max(latest or 0, now - self._patience), side="right"))

    def at(self, stamp: Int[np.ndarray, "n"]) -> Poses:
        """Poses at these times; poses before the first of them are forgotten."""
        held = self._around(stamp)
        count = len(stamp)
        if not held:
            return Poses(
                np.zeros((count, 3)),
                np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
                np.zeros(count, dtype=bool),
            )
        moments = np.array([message.stamp for message in held], dtype=np.int64)
        origin = int(moments[0])
        position, orientation = (np.array([message[field] for message in held]) for field in (1, 2))
        orientation /= np.linalg.norm(orientation, axis=1, keepdims=True)
        points, turns = between(
            (moments - origin) * 1e-9, position, orientation, (stamp - origin) * 1e-9
        )
        known = (stamp >= origin - self._patience) & (stamp <= moments[-1] + self._patience)
        return Poses(points, turns, known & ~self._within_a_gap(stamp, moments))

    def _around(self, stamp: Int[np.ndarray, "n"]) -> list[PoseMessage]:
        if not len(stamp):
            return []
        with self._lock:
            while len(self._held) > 1 and (self._held[1].stamp or 0) <= stamp[0]:
                self._held.popleft()
            held = list(self._held)
        last = bisect_left([message.stamp or 0 for message in held], int(stamp[-1]))
        return held[: last + 1]

    def _within_a_gap(
        self, stamp: Int[np.ndarray, "n"], moments: Int[np.ndarray, "k"]
    ) -> Bool[np.ndarray, "n"]:
        """Farther than the patience from the poses on both sides: a straight line between them
        would be a guess.
        """
        after = np.clip(np.searchsorted(moments, stamp), 0, len(moments) - 1)
        before = np.clip(after - 1, 0, len(moments) - 1)
        return (
            np.minimum(np.abs(moments[after] - stamp), np.abs(stamp - moments[before]))
            > self._patience
        )
