"""Lines of CSV over TCP or a serial line."""

import math
import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from vibrissa.libraries import extra_library
from vibrissa.live.clock import SampleClock, epoch_offset
from vibrissa.live.samples import Counts, EndOfStreamError, Samples, Source

POSED = ("time", "px", "py", "pz", "qx", "qy", "qz", "qw", "fx", "fy", "fz", "tx", "ty", "tz")
"""Columns of a recording: time [s], pose of the sensor, wrench."""
BARE = ("time", "fx", "fy", "fz", "tx", "ty", "tz")
"""The same without the pose."""

_LONGEST_LINE = 4096
_LARGEST = 1e12
_QUATERNION_TOLERANCE = 1e-3
_CLOCK_JUMP = 1.0
_AFTER_RESTART = 1e-3
_READ = 65536


def parse_header(line: bytes) -> tuple[str, ...] | None:
    """Names of columns in any order, or None where the line is none of names.

    Raises
    ------
    ValueError
        If it holds names, but not those of `POSED` or `BARE`.
    """
    names = tuple(cell.strip() for cell in line.decode("utf-8", "replace").lstrip("\ufeff").split(","))
    if not any(name[:1].isalpha() and name.lower() not in ("nan", "inf", "infinity") for name in names):
        return None
    if sorted(names) in (sorted(POSED), sorted(BARE)):
        return names
    raise ValueError(f"columns {','.join(names)[:200]}; allowed are {','.join(POSED)} or {','.join(BARE)}")


def parse_line(line: bytes, columns: Sequence[str] | None = None) -> dict[str, float]:
    """Numbers of one line by column.

    Parameters
    ----------
    line
        Cells separated by commas.
    columns
        Their names; None for those of `POSED` or `BARE`, by their number.

    Raises
    ------
    ValueError
        If there are more cells or fewer, one is no finite number up to 1e12, or the quaternion is not of unit norm.
    """
    cells = line.split(b",")
    names = columns or {len(POSED): POSED, len(BARE): BARE}.get(len(cells), POSED)
    if len(cells) != len(names):
        raise ValueError(f"{len(cells)} cells; allowed are {len(names)}")
    if b"_" in line:
        raise ValueError("an underscore; allowed are numbers")
    row = dict(zip(names, map(float, cells), strict=True))
    if not all(abs(value) <= _LARGEST for value in row.values()):
        raise ValueError("a number that is not finite, or beyond 1e12; allowed are finite numbers")
    if "qw" in row and abs(math.hypot(*(row[name] for name in POSED[4:8])) - 1) > _QUATERNION_TOLERANCE:
        raise ValueError("a quaternion of another norm; allowed is 1")
    return row


class Line(ABC):
    """A stream of bytes."""

    @abstractmethod
    def open(self) -> None:
        """Begin."""

    @abstractmethod
    def receive(self, timeout: float) -> bytes:
        """Bytes that have come; none where there is none within `timeout` seconds. Raise EndOfStreamError at the end."""

    @abstractmethod
    def close(self) -> None:
        """Let go."""


class TcpLine(Line):
    """A server's bytes."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Connect, within 5 s."""
        self._socket = socket.create_connection(self._address, timeout=5)

    def receive(self, timeout: float) -> bytes:
        """Bytes that have come."""
        assert self._socket is not None
        self._socket.settimeout(timeout)
        try:
            data = self._socket.recv(_READ)
        except TimeoutError:
            return b""
        except ConnectionResetError as error:
            raise EndOfStreamError from error
        if not data:
            raise EndOfStreamError
        return data

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class SerialLine(Line):
    """A serial device's bytes; needs pyserial."""

    def __init__(self, device: str, baud: int) -> None:
        self._device, self._baud = device, baud
        self._port: Any = None

    def open(self) -> None:
        """Open the device. Raise ImportError where pyserial is missing."""
        serial = extra_library("serial", extra="live", need="serial lines need it")
        self._port = serial.Serial(self._device, self._baud, timeout=0)

    def receive(self, timeout: float) -> bytes:
        """Bytes that have come."""
        try:
            if self._port.timeout != timeout:
                self._port.timeout = timeout
            first = self._port.read(1)
            return bytes(first + self._port.read(self._port.in_waiting) if first else b"")
        except OSError as error:
            raise EndOfStreamError from error

    def close(self) -> None:
        """Close the device."""
        if self._port is not None:
            with suppress(OSError):
                self._port.close()
            self._port = None


class LineSource(Source):
    """Samples from lines of CSV; columns as in a recording, or without the pose.

    A first line may name the columns, in any order. `time` is the sender's: stamps are these times, moved onto the
    host's clock (`SampleClock`).

    Parameters
    ----------
    line
        Where the bytes come from.
    """

    waits = True

    def __init__(self, line: Line) -> None:
        self._line = line
        self.counts = Counts()
        self._rest = b""
        self._skipping = False
        self._columns: tuple[str, ...] | None = None
        self._first = True
        self._posed: bool | None = None
        self._number = 0
        self._last_time: float | None = None
        self._shift = 0.0
        self._clock = SampleClock()
        self._epoch = 0

    def open(self) -> None:
        """Connect, or open the device."""
        self._epoch = epoch_offset()
        self._line.open()

    def close(self) -> None:
        """Let go of the line."""
        self._line.close()

    def read(self, timeout: float) -> Samples | None:
        """Samples of the whole lines that have come."""
        data = self._line.receive(timeout)
        now = time.monotonic_ns()
        rows = [row for line in self._lines(data) if (row := self._row(line)) is not None]
        if not rows:
            return None
        posed = "qw" in rows[0]
        table = {name: np.array([row[name] for row in rows]) for name in (POSED if posed else BARE)}
        count = len(rows)
        self.counts.samples += count
        self._number += count
        return Samples(
            self._clock.stamps(np.round(table["time"] * 1e9).astype(np.int64), np.full(count, now)) + self._epoch,
            np.arange(self._number - count, self._number, dtype=np.int64),
            _columns_of(table, POSED[8:11]),
            _columns_of(table, POSED[11:]),
            np.ones(count, dtype=bool),
            np.full(count, now, dtype=np.int64),
            _columns_of(table, POSED[1:4]) if posed else None,
            _columns_of(table, POSED[4:8]) if posed else None,
        )

    def _lines(self, data: bytes) -> list[bytes]:
        *lines, self._rest = (self._rest + data).split(b"\n")
        if self._skipping and lines:
            lines, self._skipping = lines[1:], False
        if len(self._rest) > _LONGEST_LINE:
            # The rest of this line is waited for and thrown away.
            self.counts.malformed += not self._skipping
            self._rest, self._skipping = b"", True
        return [line.strip() for line in lines if line.strip()]

    def _row(self, line: bytes) -> dict[str, float] | None:
        try:
            names = parse_header(line)
            if names is not None:
                self._columns, self._first = names, False
                return None
            row = parse_line(line, self._columns)
            if self._posed not in (None, "qw" in row):
                raise ValueError("poses that begin or end in the middle; allowed are the columns of the first line")
        except ValueError:
            # The first line may be the rest of one that began before we listened.
            self.counts.malformed += not self._first
            self._first = False
            return None
        self._first, self._posed = False, "qw" in row
        return row | {"time": row["time"] + self._shift} if self._follows(row["time"]) else None

    def _follows(self, moment: float) -> bool:
        """Whether this is later than the last line, or of a clock that began anew: then it is moved behind the last."""
        back = 0.0 if self._last_time is None else self._last_time - moment
        if self._last_time is not None and 0 <= back < _CLOCK_JUMP:
            self.counts.duplicates += back == 0
            self.counts.late += back > 0
            return False
        if back > 0:
            self.counts.restarts += 1
            self._shift += back + _AFTER_RESTART
        self._last_time = moment
        return True


def _columns_of(table: dict[str, np.ndarray], names: Sequence[str]) -> np.ndarray:
    return np.stack([table[name] for name in names], axis=1)
