"""Lines of CSV over TCP or a serial line."""

import math
import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from vibrissa.libraries import extra_library
from vibrissa.live.clock import LEAST_STEP, SampleClock, epoch_offset
from vibrissa.live.ports import naming
from vibrissa.live.samples import Counts, EndOfStreamError, Samples, Source

POSED = ("time", "px", "py", "pz", "qx", "qy", "qz", "qw", "fx", "fy", "fz", "tx", "ty", "tz")
"""Columns of a recording: time [s], pose of the sensor, wrench."""
BARE = ("time", "fx", "fy", "fz", "tx", "ty", "tz")
"""The same without the pose."""

_LONGEST_LINE = 4096
_LARGEST = 1e12
_LATEST = 4e9
_QUATERNION_TOLERANCE = 1e-3
_CLOCK_JUMP = 1.0
_LONGEST_PAUSE = 60.0
_AFTER_RESTART = 1_000_000
_READ = 65536


class WrongColumnsError(ValueError):
    """A line names columns, but not those that are needed: what follows cannot be told."""


def parse_header(line: bytes) -> tuple[str, ...] | None:
    """Names of columns in any order, or None where the line is none of names. Further columns may
    be among them.

    Raises
    ------
    WrongColumnsError
        If it names several columns of a recording, but neither all of `POSED` nor all of `BARE`
        without a pose.
    ValueError
        If it holds other words.
    """
    cells = line.decode("utf-8", "replace").lstrip("\ufeff").split(",")
    names = tuple(cell.strip().strip('"').strip().lower() for cell in cells)
    words = [
        name for name in names if name[:1].isalpha() and name not in ("nan", "inf", "infinity")
    ]
    if 2 * len(words) < len(names) or not words:
        return None
    known = [name for name in names if name in POSED]
    if sorted(known) in (sorted(POSED), sorted(BARE)):
        return names
    kind = WrongColumnsError if len(known) > 1 else ValueError
    raise kind(
        f"columns {','.join(names)[:200]}; allowed are {','.join(POSED)} or {','.join(BARE)}, in any order, and others besides"
    )


def parse_line(line: bytes, columns: Sequence[str] | None = None) -> dict[str, float]:
    """Numbers of one line by column, those of `POSED` or `BARE`.

    Parameters
    ----------
    line
        Cells separated by commas.
    columns
        Their names; None for those of `POSED` or `BARE`, by their number.

    Raises
    ------
    ValueError
        If there are more cells or fewer, one is no finite number up to 1e12, the time is beyond 4e9
        s, or the quaternion is not of unit norm.
    """
    cells = line.split(b",")
    names = columns or {len(POSED): POSED, len(BARE): BARE}.get(len(cells), POSED)
    if len(cells) != len(names):
        raise ValueError(f"{len(cells)} cells; allowed are {len(names) if columns else '14 or 7'}")
    if b"_" in line:
        raise ValueError("an underscore; allowed are numbers")
    row = {name: float(cell) for name, cell in zip(names, cells, strict=True) if name in POSED}
    if abs(row["time"]) > _LATEST:
        raise ValueError(f"time = {row['time']:g}; allowed are seconds, up to {_LATEST:g}")
    if not all(abs(value) <= _LARGEST for value in row.values()):
        raise ValueError("a number that is not finite, or beyond 1e12; allowed are finite numbers")
    if (
        "qw" in row
        and abs(math.hypot(*(row[name] for name in POSED[4:8])) - 1) > _QUATERNION_TOLERANCE
    ):
        raise ValueError("a quaternion of another norm; allowed is 1")
    return row


class Line(ABC):
    """A stream of bytes."""

    @abstractmethod
    def open(self) -> None:
        """Begin."""

    @abstractmethod
    def receive(self, timeout: float) -> bytes:
        """Bytes that have come; none where there is none within `timeout` seconds. Raise
        EndOfStreamError at the end.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go."""


class TcpLine(Line):
    """A server's bytes."""

    def __init__(self, host: str, port: int) -> None:
        self._address = (host, port)
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Connect, within 5 s. Raise OSError, which names the address, where nobody answers."""
        with naming(f"tcp://{self._address[0]}:{self._address[1]}"):
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

    A first line may name the columns, in any order. `time` is the sender's: stamps are these times,
    counted from the arrival of the first line. Where they run back by a second, or ahead by a
    minute, the sender's clock was set, and they go on from the last one by the time that passed
    here.

    Parameters
    ----------
    line
        Where the bytes come from.
    on_host_clock
        Whether stamps are to follow the host's clock (`SampleClock`), as poses need that come from
        elsewhere; lines that are sent faster than their times say are then stamped as they come.

    Raises
    ------
    WrongColumnsError
        By `read`, if a line names other columns.
    """

    waits = True

    def __init__(self, line: Line, *, on_host_clock: bool = False) -> None:
        self._line = line
        self.counts = Counts()
        self._rest = b""
        self._skipping = False
        self._columns: tuple[str, ...] | None = None
        self._first = True
        self._posed: bool | None = None
        self._number = 0
        self._last: tuple[float, int] | None = None
        self._own = 0
        self._anchor = 0.0, 0
        self._clock = SampleClock() if on_host_clock else None
        self._begun: int | None = None
        self._epoch = 0
        self._anew = False

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
        rows, own, anew = [], [], []
        for line in self._lines(data):
            row = self._row(line, now)
            if row is not None:
                rows.append(row)
                own.append(self._own)
                anew.append(self._anew)
        return (
            self._samples(rows, np.array(own, dtype=np.int64), np.array(anew), now)
            if rows
            else None
        )

    def _samples(
        self,
        rows: list[dict[str, float]],
        own: Int[np.ndarray, "n"],
        anew: Bool[np.ndarray, "n"],
        now: int,
    ) -> Samples:
        posed, count = "qw" in rows[0], len(rows)
        table = {name: np.array([row[name] for row in rows]) for name in (POSED if posed else BARE)}
        arrival = np.full(count, now, dtype=np.int64)
        self._begun = now if self._begun is None else self._begun
        self.counts.samples += count
        self._number += count
        return Samples(
            (self._begun + own if self._clock is None else self._clock.stamps(own, arrival))
            + self._epoch,
            np.arange(self._number - count, self._number, dtype=np.int64),
            _columns_of(table, POSED[8:11]),
            _columns_of(table, POSED[11:]),
            np.ones(count, dtype=bool),
            arrival,
            _columns_of(table, POSED[1:4]) if posed else None,
            _columns_of(table, POSED[4:8]) if posed else None,
            anew,
        )

    def _lines(self, data: bytes) -> list[bytes]:
        *lines, self._rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        if self._skipping and lines:
            lines, self._skipping = lines[1:], False
        if len(self._rest) > _LONGEST_LINE:
            # The rest of this line is waited for and thrown away.
            if not self._skipping:
                self._damaged(f"a line of more than {_LONGEST_LINE} bytes")
            self._rest, self._skipping = b"", True
        return [line.strip() for line in lines if line.strip()]

    def _damaged(self, why: str) -> None:
        self.counts.malformed += 1
        self.complaint = why

    def _row(self, line: bytes, now: int) -> dict[str, float] | None:
        try:
            names = parse_header(line)
            if names is not None:
                self._columns, self._first = names, False
                return None
            row = parse_line(line, self._columns)
            if self._posed not in (None, "qw" in row):
                raise ValueError(
                    "poses that begin or end in the middle; allowed are the columns of the first line"
                )
        except ValueError as error:
            if isinstance(error, WrongColumnsError) and not (self._first and _end_of_header(line)):
                raise
            # The first line may be the rest of one that began before we listened.
            if not self._first:
                self._damaged(str(error))
            self.complaint = self.complaint or str(error)
            self._first = False
            return None
        self._first, self._posed = False, "qw" in row
        return row if self._follows(row["time"], now) else None

    def _follows(self, moment: float, now: int) -> bool:
        """Whether this is later than the last line, or of a clock that was set; `_own` is then its
        time [ns] since the first line.
        """
        least, self._anew = 0, False
        if self._last is None:
            self._anchor = moment, 0
        else:
            least = self._own + LEAST_STEP
            step = moment - self._last[0]
            if -_CLOCK_JUMP < step <= 0:
                self.counts.duplicates += step == 0
                self.counts.late += step < 0
                return False
            if not 0 < step <= _LONGEST_PAUSE:
                self.counts.restarts += 1
                self._anew = True
                self._anchor = moment, self._own + max(now - self._last[1], _AFTER_RESTART)
        self._last = moment, now
        self._own = max(self._anchor[1] + round((moment - self._anchor[0]) * 1e9), least)
        return True


def _end_of_header(line: bytes) -> bool:
    """Whether this may be the end of a line with the usual names."""
    return any(",".join(names).encode().endswith(line.strip().lower()) for names in (POSED, BARE))


def _columns_of(table: dict[str, np.ndarray], names: Sequence[str]) -> np.ndarray:
    return np.stack([table[name] for name in names], axis=1)
