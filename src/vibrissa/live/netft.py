"""Ethernet force/torque sensors that speak RDT over UDP."""

import errno
import socket
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise

import numpy as np
from jaxtyping import Int

from vibrissa.geometry.checks import positive
from vibrissa.live import rdt
from vibrissa.live.clock import RateWatch, SampleClock, epoch_offset
from vibrissa.live.ports import naming
from vibrissa.live.samples import Counts, Samples, Source, joined
from vibrissa.live.sequence import AHEAD, Sequencer

_RECEIVE_BUFFER = 16 * 2**20
# Linux names them SO_RCVBUFFORCE and SO_TIMESTAMPNS; Python does not.
_FORCE_BUFFER = 33
_STAMP_OPTION = 35
_KERNEL_STAMP = struct.Struct("@qq")
_ANCILLARY = 64
_LONGEST = 2048
_MOST_DATAGRAMS = 1024
_GATHER = 1e-3
_ASK_AGAIN = 1.0
_SETTLE = 50_000_000
# What is told of a rate that is another at first, and of one that is seen better later.
_OTHER_RATE, _OTHER_AGAIN = 0.01, 0.1
# Nobody listens there, or the cable is out: what the kernel says so may pass.
_AWAY = {errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ENETDOWN, errno.EHOSTDOWN}


class NetFtSource(Source):
    """Records of a sensor that is asked to stream.

    Datagrams from other addresses are ignored, since the socket is connected. Arrival is when the
    kernel had the datagram, where it says so. A sensor that falls silent is asked again every
    second.

    Parameters
    ----------
    host, port
        Address of the sensor.
    counts_per_force, counts_per_torque
        Counts for one newton and for one newton metre.
    rate
        Records a second, as the sensor is set.
    buffered
        Whether to ask for several records a datagram.
    bias
        Whether the sensor is to take its present wrench for zero first.
    error_bits
        Bits of the status of which one makes a sample invalid.

    Raises
    ------
    ValueError
        If a number is not greater than 0, or `error_bits` no whole number of 32 bits.
    """

    def __init__(
        self,
        host: str,
        port: int = rdt.PORT,
        *,
        counts_per_force: float,
        counts_per_torque: float,
        rate: float,
        buffered: bool = False,
        bias: bool = False,
        error_bits: int = rdt.ERROR_BIT,
    ) -> None:
        self._address = (host, port)
        self._scale = np.repeat(
            [
                1 / positive(counts_per_force, "counts_per_force"),
                1 / positive(counts_per_torque, "counts_per_torque"),
            ],
            3,
        )
        self._command = rdt.Command.BUFFERED if buffered else rdt.Command.REAL_TIME
        self._bias = bias
        if not 0 <= error_bits < rdt.MODULUS:
            raise ValueError(f"error_bits = {error_bits}; allowed is a whole number of 32 bits")
        self._error_bits = error_bits
        self._period = 1e9 / positive(rate, "rate")
        self._anchor = (0, 0)
        self._last: tuple[int, int] | None = None
        self._came = 0
        self._watch = RateWatch()
        self._early: list[tuple[np.ndarray, ...]] | None = []
        self._clock = SampleClock()
        self.counts = Counts()
        self._sequencer = Sequencer(self.counts)
        self._socket: socket.socket | None = None
        self._epoch = 0
        self._asked = 0.0
        self._stamped = False

    def open(self) -> None:
        """Connect, and ask for records without end."""
        with naming(f"netft://{self._address[0]}:{self._address[1]}"):
            family, kind, protocol, _, address = socket.getaddrinfo(
                *self._address, type=socket.SOCK_DGRAM
            )[0]
        self._epoch = epoch_offset()
        self._socket = socket.socket(family, kind, protocol)
        _widen(self._socket)
        if sys.platform == "linux":
            with suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, _STAMP_OPTION, 1)
                self._stamped = True
        self._socket.connect(address)
        if self._bias:
            self._request(rdt.Command.BIAS)
        self._request(self._command)

    def _request(self, command: rdt.Command) -> None:
        assert self._socket is not None
        self._asked = time.monotonic()
        with _away():
            self._socket.send(rdt.request_bytes(command))

    def read(self, timeout: float) -> Samples | None:
        """Samples that have come, in order; None where there is none within `timeout` seconds."""
        datagrams, arrival = self._receive(timeout)
        parsed, came = [], []
        for data, when in zip(datagrams, arrival, strict=True):
            try:
                records = rdt.parse_records(data)
            except ValueError as error:
                self.counts.malformed += 1
                self.complaint = str(error)
                continue
            parsed.append(records)
            came.append(np.full(len(records), when, dtype=np.int64))
        records = np.concatenate(parsed) if parsed else np.empty(0, dtype=rdt.RECORD)
        moments = np.concatenate(came) if came else np.empty(0, dtype=np.int64)
        ordered, number, moments = self._settled(
            *self._sequencer.accept(records, moments, time.monotonic_ns())
        )
        parts = [
            self._samples(ordered[part], number[part], moments[part]) for part in _streams(number)
        ]
        return joined(parts) if parts else None

    def _settled(self, *rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Hold the first records for a moment, so that the clock is set by the least late of many."""
        if self._early is None:
            return rows[0], rows[1], rows[2]
        self._early.append(rows)
        held = tuple(np.concatenate(part) for part in zip(*self._early, strict=True))
        arrival = held[2]
        if not len(arrival) or time.monotonic_ns() - int(arrival[0]) < _SETTLE:
            return rows[0][:0], rows[1][:0], rows[2][:0]
        self._early = None
        return held[0], held[1], held[2]

    def _samples(
        self, records: np.ndarray, number: Int[np.ndarray, "n"], arrival: Int[np.ndarray, "n"]
    ) -> Samples:
        status = records["status"].astype(np.int64)
        valid = (status & self._error_bits) == 0
        self.counts.samples += len(records)
        self.counts.flagged += int(np.count_nonzero(status))
        self.counts.invalid += int(np.count_nonzero(~valid))
        self.counts.status |= int(np.bitwise_or.reduce(status))
        wrench = records["counts"].astype(np.float64) * self._scale
        anew = np.zeros(len(records), dtype=bool)
        anew[0] = self._begins_anew(number, arrival)
        stamp = self._clock.stamps(self._own_time(number, arrival), arrival) + self._epoch
        self._came = int(arrival[-1])
        return Samples(
            stamp,
            number,
            np.ascontiguousarray(wrench[:, :3]),
            np.ascontiguousarray(wrench[:, 3:]),
            valid,
            arrival,
            anew=anew,
        )

    def _begins_anew(self, number: Int[np.ndarray, "n"], arrival: Int[np.ndarray, "n"]) -> bool:
        """Whether these are of another stream than the last ones; its numbers do not say what was
        lost between the two, but the time does.
        """
        if self._last is None or int(number[0]) - self._last[0] <= AHEAD:
            return False
        lost = max(round((int(arrival[0]) - self._came) / self._period) - 1, 0)
        self.counts.lost += lost
        self.counts.gaps += lost > 0
        return True

    def _own_time(
        self, number: Int[np.ndarray, "n"], arrival: Int[np.ndarray, "n"]
    ) -> Int[np.ndarray, "n"]:
        """The sensor's clock [ns], from its numbers and its rate: as set, or as seen where the two
        differ. In a stream that began anew it goes on.
        """
        if self._last is None or int(number[0]) - self._last[0] > AHEAD:
            self._anchor = (
                int(number[0]),
                0 if self._last is None else self._last[1] + round(self._period),
            )
            self._watch = RateWatch()
            self._clock.restart()
        own = self._since_anchor(number)
        factor = self._watch.factor(own, arrival)
        if factor is not None:
            self.counts.rate_changes += abs(factor - 1) > (
                _OTHER_AGAIN if self.counts.rate_changes else _OTHER_RATE
            )
            self._anchor = int(number[0]), int(own[0])
            self._period *= factor
            self._clock.restart()
            own = self._since_anchor(number)
        self._last = int(number[-1]), int(own[-1])
        return own

    def _since_anchor(self, number: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
        start, own = self._anchor
        return own + np.round((number - start) * self._period).astype(np.int64)

    def _receive(self, timeout: float) -> tuple[list[bytes], list[int]]:
        """Everything that is there, after the first datagram and a moment in which more may come."""
        assert self._socket is not None
        self._socket.settimeout(timeout)
        datagrams: list[bytes] = []
        arrival: list[int] = []
        try:
            self._take(datagrams, arrival)
            time.sleep(_GATHER)
            self._socket.settimeout(0)
            while len(datagrams) < _MOST_DATAGRAMS:
                self._take(datagrams, arrival)
        except (TimeoutError, BlockingIOError):
            pass
        except OSError as error:
            if error.errno not in _AWAY:
                raise
            # The kernel said so at once.
            time.sleep(min(timeout, 0.05))
        if not datagrams and time.monotonic() - self._asked > _ASK_AGAIN:
            self._request(self._command)
        elif datagrams:
            self._asked = time.monotonic()
        return datagrams, arrival

    def _take(self, datagrams: list[bytes], arrival: list[int]) -> None:
        assert self._socket is not None
        if not self._stamped:
            data = self._socket.recv(_LONGEST)
            when = time.monotonic_ns()
        else:
            data, ancillary, _, _ = self._socket.recvmsg(_LONGEST, _ANCILLARY)
            when = self._kernel_stamp(ancillary)
        datagrams.append(data)
        arrival.append(when)

    def _kernel_stamp(self, ancillary: list[tuple[int, int, bytes]]) -> int:
        now = time.monotonic_ns()
        for level, kind, data in ancillary:
            if (
                level == socket.SOL_SOCKET
                and kind == _STAMP_OPTION
                and len(data) == _KERNEL_STAMP.size
            ):
                seconds, nanoseconds = _KERNEL_STAMP.unpack(data)
                return min(now, seconds * 1_000_000_000 + nanoseconds - self._epoch)
        return now

    def close(self) -> None:
        """Ask the sensor to stop, and close the socket."""
        if self._socket is not None:
            with suppress(OSError):
                self._request(rdt.Command.STOP)
            self._socket.close()
            self._socket = None


@contextmanager
def _away() -> Iterator[None]:
    """Nobody may be there."""
    try:
        yield
    except OSError as error:
        if error.errno not in _AWAY:
            raise


def _streams(number: Int[np.ndarray, "n"]) -> Iterator[slice]:
    """Stretches in which no stream begins anew."""
    if len(number):
        breaks = (np.flatnonzero(np.diff(number) > AHEAD) + 1).tolist()
        yield from (slice(first, last) for first, last in pairwise([0, *breaks, len(number)]))


def _widen(connection: socket.socket) -> None:
    """Let the kernel hold many datagrams while Python is busy: beyond the usual limit where this
    process may.
    """
    for option in (socket.SO_RCVBUF, *((_FORCE_BUFFER,) if sys.platform == "linux" else ())):
        with suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, option, _RECEIVE_BUFFER)
