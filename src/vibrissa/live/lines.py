"""Lines of CSV over TCP or a serial line."""

import socket
import time
from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple

import numpy as np

from vibrissa.files import LARGEST
from vibrissa.libraries import extra_library
from vibrissa.live.clock import LEAST_STEP, SampleClock, Tick, epoch_offset
from vibrissa.live.ports import naming
from vibrissa.live.poses import with_unit_norm
from vibrissa.live.samples import Counts, EndOfStreamError, Samples, Source

_POSITION = ("px", "py", "pz")
_ORIENTATION = ("qx", "qy", "qz", "qw")
_FORCE = ("fx", "fy", "fz")
_TORQUE = ("tx", "ty", "tz")
POSED = ("time", *_POSITION, *_ORIENTATION, *_FORCE, *_TORQUE)
"""Columns of a recording: time [s], pose of the sensor, wrench."""
BARE = ("time", *_FORCE, *_TORQUE)
"""The same without the pose."""

_LONGEST_LINE = 4096  # bytes: ten times what a recording's line has with all digits
_LATEST = 4e9  # [s since 1970]: the year 2096
_CLOCK_JUMP = 1.0  # [s] back: lines are swapped by less, and clocks set by more
_LONGEST_PAUSE = 60.0  # [s] ahead: sensors pause for less, and clocks are set by more
_AFTER_RESTART = 1_000_000  # [ns] to the next sample at least: a usual period
_READ = 65536  # bytes: what a kernel's buffer holds


class WrongColumnsError(ValueError):
    """A line names other columns than those that are needed: the numbers below it would be taken
    for others.
    """


def parse_header(line: bytes) -> tuple[str, ...] | None:
    """Names of columns in any order, other names among them; None if the line does not hold names.

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
    words = [name for name in names if name[:1].isalpha() and name not in ("nan", "inf")]
    if 2 * len(words) < len(names) or not words:
        return None
    known = [name for name in names if name in POSED]
    if sorted(known) in (sorted(POSED), sorted(BARE)):
        return names
    kind = WrongColumnsError if len(known) > 1 else ValueError
    raise kind(
        f"columns {','.join(names)[:200]}; allowed are {','.join(POSED)} or {','.join(BARE)}, "
        "in any order, and others besides"
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
        If the number of cells is another, one is not a finite number up to 1e12, the time is
        beyond 4e9 s, or the quaternion is not of unit norm.
    """
    cells = line.split(b",")
    names = columns or (BARE if len(cells) == len(BARE) else POSED)
    if len(cells) != len(names):
        raise ValueError(f"{len(cells)} cells; allowed are {len(names) if columns else '14 or 7'}")
    if b"_" in line:
        raise ValueError("an underscore; allowed are numbers")
    row = {name: float(cell) for name, cell in zip(names, cells, strict=True) if name in POSED}
    if abs(row["time"]) > _LATEST:
        raise ValueError(f"time = {row['time']:g}; allowed are seconds, up to {_LATEST:g}")
    if not all(abs(value) <= LARGEST for value in row.values()):
        raise ValueError("a number that is not finite, or beyond 1e12; allowed are finite numbers")
    if "qw" in row:
        with_unit_norm(tuple(row[name] for name in _ORIENTATION))
    return row


class Line(ABC):
    """A stream of bytes."""

    _open: Any = None
    """The socket or device, which has a method `close`."""

    @abstractmethod
    def open(self) -> None:
        """Begin."""

    @abstractmethod
    def receive(self, timeout: float) -> bytes:
        """Bytes that have come; empty if there are none within `timeout` seconds. Raise
        EndOfStreamError at the end.
        """

    def close(self) -> None:
        """Release the line; may be called twice, and before `open`."""
        if self._open is not None:
            with suppress(OSError):
                self._open.close()


@dataclass(eq=False)
class TcpLine(Line):
    """A server's bytes."""

    host: str
    port: int

    def open(self) -> None:
        """Connect, within 5 s. Raise OSError, which names the address, if nobody answers."""
        with naming(f"tcp://{self.host}:{self.port}"):
            self._open = socket.create_connection((self.host, self.port), timeout=5)

    def receive(self, timeout: float) -> bytes:
        """Bytes that have come."""
        self._open.settimeout(timeout)
        try:
            data: bytes = self._open.recv(_READ)
        except TimeoutError:
            return b""
        except ConnectionResetError as error:
            raise EndOfStreamError from error
        if not data:
            raise EndOfStreamError
        return data


@dataclass(eq=False)
class SerialLine(Line):
    """A serial device's bytes; needs pyserial."""

    device: str
    baud: int

    def open(self) -> None:
        """Open the device. Raise ImportError if pyserial is missing."""
        serial = extra_library("serial", extra="live", need="serial lines need it")
        self._open = serial.Serial(self.device, self.baud)

    def receive(self, timeout: float) -> bytes:
        """Bytes that have come."""
        try:
            if self._open.timeout != timeout:  # to set it configures the device
                self._open.timeout = timeout
            first = self._open.read(1)
            return bytes(first + self._open.read(self._open.in_waiting) if first else b"")
        except OSError as error:
            raise EndOfStreamError from error


class _Row(NamedTuple):
    """Numbers of a line, its time [ns] since the first line, and whether the clock began anew."""

    numbers: dict[str, float]
    own: int
    anew: bool


@dataclass(eq=False)
class LineSource(Source):
    """Samples from lines of CSV; columns as in a recording, or without the pose.

    A first line may name the columns, in any order. `time` is the sender's: stamps are these times,
    counted from the arrival of the first line. Where they jump back by a second or more, or ahead
    by more than a minute, the sender's clock was set, and stamps continue from the last one by the
    time that passed here.

    Parameters
    ----------
    line
        Where the bytes come from.
    on_host_clock
        Whether stamps are to follow the host's clock (`SampleClock`), as poses from elsewhere
        require; lines that are sent faster than their times say are then stamped as they come.

    Raises
    ------
    WrongColumnsError
        By `read`, if a line names other columns.
    """

    waits = True

    line: Line
    _: KW_ONLY
    on_host_clock: bool = False

    def __post_init__(self) -> None:
        self.counts = Counts()
        self._rest = b""
        self._columns: tuple[str, ...] | None = None
        self._first = True
        self._posed: bool | None = None
        self._last: Tick | None = None
        self._anchor = Tick(0, 0, 0)
        self._clock = SampleClock() if self.on_host_clock else None
        self._begun = self._epoch = 0

    def open(self) -> None:
        """Connect, or open the device."""
        self._epoch = epoch_offset()
        self.line.open()

    def close(self) -> None:
        """Close the line."""
        self.line.close()

    def read(self, timeout: float) -> Samples | None:
        """Samples of the whole lines that have come."""
        data, now = self.line.receive(timeout), time.monotonic_ns()
        *lines, rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        # A line without end takes no memory: its beginning is enough to reject it.
        self._rest = rest[: _LONGEST_LINE + 1]
        rows = [row for line in lines if line.strip() and (row := self._row(line.strip(), now))]
        return self._samples(rows, now) if rows else None

    def _samples(self, rows: list[_Row], now: int) -> Samples:
        def columns(*names: str) -> np.ndarray:
            return np.array([[row.numbers[name] for name in names] for row in rows])

        count, first = len(rows), self.counts.samples
        self.counts.samples += count
        if not first:
            self._begun = now
        own = np.array([row.own for row in rows], dtype=np.int64)
        arrival = np.full(count, now)
        stamp = own + self._begun if self._clock is None else self._clock.stamps(own, arrival)
        return Samples(
            stamp + self._epoch,
            np.arange(first, first + count),
            columns(*_FORCE),
            columns(*_TORQUE),
            np.ones(count, dtype=bool),
            arrival,
            columns(*_POSITION) if self._posed else None,
            columns(*_ORIENTATION) if self._posed else None,
            np.array([row.anew for row in rows]),
        )

    def _row(self, line: bytes, now: int) -> _Row | None:
        first, self._first = self._first, False
        try:
            names = parse_header(line)
            if names is not None:
                self._columns = names
                return None
            if len(line) > _LONGEST_LINE:
                raise ValueError(f"a line of more than {_LONGEST_LINE} bytes")
            numbers = parse_line(line, self._columns)
            if self._posed not in (None, "qw" in numbers):
                raise ValueError("poses begin or end midway; allowed are the first line's columns")
        except ValueError as error:
            # The first line may be the rest of one that began before we listened.
            if isinstance(error, WrongColumnsError) and not (first and _end_of_header(line)):
                raise
            if first:
                self.complaint = str(error)
            else:
                self.reject(str(error))
            return None
        self._posed = "qw" in numbers
        return self._in_time(numbers, now)

    def _in_time(self, numbers: dict[str, float], now: int) -> _Row | None:
        """The row, if it is later than the last one or of a clock that was set."""
        moment, last = numbers["time"], self._last
        if last is None:
            own, anew = 0, False
            self._anchor = Tick(moment, 0, now)
        else:
            step = moment - last.number
            if -_CLOCK_JUMP < step <= 0:
                self.counts.duplicates += step == 0
                self.counts.late += step < 0
                return None
            anew = not 0 < step <= _LONGEST_PAUSE
            if anew:
                self.counts.restarts += 1
                passed = max(now - last.arrival, _AFTER_RESTART)
                self._anchor = Tick(moment, last.own + passed, now)
            since = round((moment - self._anchor.number) * 1e9)
            own = max(self._anchor.own + since, last.own + LEAST_STEP)
        self._last = Tick(moment, own, now)
        return _Row(numbers, own, anew)


def _end_of_header(line: bytes) -> bool:
    """Whether this may be the end of a line with the usual names."""
    return any(",".join(names).encode().endswith(line.lower()) for names in (POSED, BARE))
