"""CSV lines over TCP or a serial port."""

import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from dataclasses import KW_ONLY, dataclass

import numpy as np

from vibrissa.files import LARGEST
from vibrissa.libraries import extra_library
from vibrissa.live.address import naming
from vibrissa.live.clock import LEAST_STEP, SampleClock, Tick, epoch_offset
from vibrissa.live.poses import with_unit_norm
from vibrissa.live.samples import Counts, EndOfStreamError, Samples, Source
from vibrissa.sensor import CHANNELS

_PLACE, _TURN = ("px", "py", "pz"), ("qx", "qy", "qz", "qw")
POSED = ("time", *_PLACE, *_TURN, *CHANNELS)
"""Columns of a recording: time [s], pose of the sensor, wrench."""
BARE = ("time", *CHANNELS)
"""The same without the pose."""

_LONGEST_LINE = 4096  # bytes: ten times a recording's line with all digits
_LATEST = 4e9  # [s since 1970]: the year 2096
_CLOCK_JUMP = 1.0  # [s] back: swapped lines differ by less, reset clocks by more
_LONGEST_PAUSE = 60.0  # [s] ahead: sensors pause for less, reset clocks jump by more
_AFTER_RESTART = 1_000_000  # [ns], least step to the next sample: a usual period
_READ = 65536  # bytes: the size of a kernel buffer


class WrongColumnsError(ValueError):
    """A header names other columns than those needed: the numbers below it would be misread."""


def parse_header(line: bytes) -> tuple[str, ...] | None:
    """Column names, in any order and with others among them; None if the line is not a header.

    Raises
    ------
    WrongColumnsError
        If it names several columns of a recording, but neither all of `POSED` nor all of `BARE`
        without a pose.
    ValueError
        If it consists of other words.
    """
    cells = line.decode("utf-8", "replace").lstrip("\ufeff").split(",")
    names = tuple(cell.strip('" \t').lower() for cell in cells)
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
    """Numbers of one line by column name, those of `POSED` or `BARE`.

    Parameters
    ----------
    line
        Cells separated by commas.
    columns
        Their names; None for `POSED` or `BARE`, whichever fits the number of cells.

    Raises
    ------
    ValueError
        If the number of cells is wrong, one is not a finite number up to 1e12, the time is beyond
        4e9 s, or the quaternion is not of unit norm.
    """
    cells = line.replace(b"_", b"?").split(b",")
    names = columns or (BARE if len(cells) == len(BARE) else POSED)
    if len(cells) != len(names):
        raise ValueError(f"{len(cells)} cells; allowed are {len(names) if columns else '14 or 7'}")
    row = {name: float(cell) for name, cell in zip(names, cells, strict=True) if name in POSED}
    if not all(abs(value) <= LARGEST for value in row.values()) or abs(row["time"]) > _LATEST:
        raise ValueError(
            f"a number out of range; allowed are finite ones up to {LARGEST:g}, times [s] up to "
            f"{_LATEST:g}"
        )
    if "qw" in row:
        with_unit_norm(tuple(row[name] for name in _TURN))
    return row


Receive = Callable[[float], bytes]
"""Returns the bytes received, empty if none come within this many seconds; raises EndOfStreamError
at the end.
"""


@contextmanager
def tcp_line(host: str, port: int) -> Iterator[Receive]:
    """Receive from a TCP server; connects within 5 s. Raise an OSError that names the address if
    nobody answers.
    """
    with naming(f"tcp://{host}:{port}"):
        connection = socket.create_connection((host, port), timeout=5)

    def receive(timeout: float) -> bytes:
        connection.settimeout(timeout)
        try:
            data = connection.recv(_READ)
        except TimeoutError:
            return b""
        except ConnectionResetError:
            data = b""
        if not data:
            raise EndOfStreamError
        return data

    with connection:
        yield receive


@contextmanager
def serial_line(device: str, baud: int) -> Iterator[Receive]:
    """Receive from a serial device. Raise ImportError if pyserial is missing."""
    serial = extra_library("serial", extra="live", need="serial lines need it")
    port = serial.Serial(device, baud)

    def receive(timeout: float) -> bytes:
        try:
            if port.timeout != timeout:  # setting it reconfigures the device
                port.timeout = timeout
            first = port.read(1)
            return bytes(first + port.read(port.in_waiting) if first else b"")
        except OSError as error:
            raise EndOfStreamError from error

    with closing(port):
        yield receive


@dataclass(eq=False)
class LineSource(Source):
    """Samples from CSV lines with the columns of a recording, or the same without the pose.

    A header line may name the columns, in any order. `time` is the sender's: stamps are these
    times, counted from the arrival of the first line. If they jump back by a second or more, or
    ahead by more than a minute, the sender's clock was reset, and stamps continue from the last one
    by the time that passed here.

    Parameters
    ----------
    line
        Where the bytes come from: `tcp_line`, `serial_line`, or any other context manager that
        gives a `Receive`.
    on_host_clock
        Whether stamps follow the host's clock (`SampleClock`), as poses from elsewhere require;
        lines sent faster than their times say are then stamped as they come.

    Raises
    ------
    WrongColumnsError
        By `read`, if a line names other columns.
    """

    waits = True

    line: AbstractContextManager[Receive]
    _: KW_ONLY
    on_host_clock: bool = False

    def __post_init__(self) -> None:
        self.counts, self._closing, self._rest = Counts(), ExitStack(), b""
        self._columns: tuple[str, ...] | None = None
        self._posed: bool | None = None
        self._last: Tick | None = None
        self._clock = SampleClock() if self.on_host_clock else None
        self._first = True

    def open(self) -> None:
        """Connect, or open the device."""
        self._epoch = epoch_offset()
        self._receive = self._closing.enter_context(self.line)

    def close(self) -> None:
        """Close the line."""
        with suppress(OSError):
            self._closing.close()

    def read(self, timeout: float) -> Samples | None:
        """Samples of the complete lines received."""
        data, now = self._receive(timeout), time.monotonic_ns()
        *lines, rest = (self._rest + data).replace(b"\r", b"\n").split(b"\n")
        # An endless line must not fill the memory: its beginning is enough to reject it.
        self._rest = rest[: _LONGEST_LINE + 1]
        rows = [row for line in map(bytes.strip, lines) if line and (row := self._row(line, now))]
        if not rows:
            return None

        def columns(*names: str) -> np.ndarray:
            return np.array([[row[name] for name in names] for row in rows])

        count, first = len(rows), self.counts.samples
        self.counts.samples += count
        stamp, arrival = columns("stamp")[:, 0].astype(np.int64), np.full(count, now)
        return Samples(
            self._epoch + (stamp if self._clock is None else self._clock.stamps(stamp, arrival)),
            np.arange(first, first + count),
            columns(*CHANNELS[:3]),
            columns(*CHANNELS[3:]),
            np.ones(count, dtype=bool),
            arrival,
            columns(*_PLACE) if self._posed else None,
            columns(*_TURN) if self._posed else None,
            columns("anew")[:, 0] > 0,
        )

    def _row(self, line: bytes, now: int) -> dict[str, float] | None:
        """Numbers of a line, with `stamp` [ns] and `anew` added; None if it is no new row."""
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
            # The first line may be the tail of one that began before we listened.
            if isinstance(error, WrongColumnsError) and not (first and _end_of_header(line)):
                raise
            self.counts.malformed += not first
            self.complaint = str(error)
            return None
        self._posed = "qw" in numbers
        return self._in_time(numbers, now)

    def _in_time(self, numbers: dict[str, float], now: int) -> dict[str, float] | None:
        """The row, if it is later than the last one or the clock was reset."""
        moment, stamp, anew, last = numbers["time"], float(now), False, self._last
        if last is not None:
            step = moment - last.number
            if -_CLOCK_JUMP < step <= 0:
                self.counts.duplicates += step == 0
                self.counts.late += step < 0
                return None
            anew = not 0 < step <= _LONGEST_PAUSE
            self.counts.restarts += anew
            passed = max(now - last.arrival, _AFTER_RESTART) if anew else step * 1e9
            stamp = last.own + max(passed, LEAST_STEP)
        self._last = Tick(moment, stamp, now)
        return numbers | {"stamp": stamp, "anew": anew}


def _end_of_header(line: bytes) -> bool:
    """Whether this may be the tail of a header with the usual names."""
    return any(",".join(names).encode().endswith(line.lower()) for names in (POSED, BARE))
