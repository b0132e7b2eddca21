"""Ethernet force/torque sensors that speak RDT over UDP."""

import errno
import socket
import struct
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import KW_ONLY, dataclass

import numpy as np

from vibrissa.geometry.checks import positive
from vibrissa.live import rdt
from vibrissa.live.address import naming
from vibrissa.live.clock import SequenceClock, epoch_offset
from vibrissa.live.samples import Counts, Samples, Source
from vibrissa.live.sequence import ORDERED, Sequencer

# SO_TIMESTAMPNS and SO_RCVBUFFORCE, from Linux's asm-generic/socket.h.
_STAMPED, _FORCE_BUFFER = 35, 33
_KERNEL_STAMP = struct.Struct("@qq")  # struct timespec: seconds and nanoseconds
_ANCILLARY = 64  # bytes: room for one such stamp with its header
_BUFFER = 16 * 2**20  # bytes for the kernel to hold datagrams while Python is busy: seconds
_OPTIONS = {socket.SO_RCVBUF: _BUFFER}
if sys.platform == "linux":  # exceeds the usual limit if this process may
    _OPTIONS |= {_FORCE_BUFFER: _BUFFER, _STAMPED: 1}
_LONGEST = 2048  # bytes read of a datagram: more than a network frame holds
_MOST_DATAGRAMS = 1024  # per read: 0.15 s at 7000 a second
_GATHER = 1e-3  # [s] to let more arrive: at most a thousand reads a second
_ASK_AGAIN = 1.0  # [s] of silence
_SETTLE = 50_000_000  # [ns]; of the samples in that time, one comes with hardly any delay
# Nobody is listening, or the cable is out: this may pass.
_AWAY = {errno.ECONNREFUSED, errno.EHOSTUNREACH, errno.ENETUNREACH, errno.ENETDOWN, errno.EHOSTDOWN}


@dataclass(eq=False)
class NetFtSource(Source):
    """Samples that a sensor streams on request.

    Datagrams from other addresses are ignored, since the socket is connected. On Linux a record's
    arrival is when the kernel got its datagram. A sensor that falls silent is asked again every
    second.

    Parameters
    ----------
    host, port
        Address of the sensor.
    counts_per_force, counts_per_torque
        Counts per newton and per newton metre.
    rate
        Records per second, as set on the sensor.
    buffered
        Whether to ask for several records per datagram.
    bias
        Whether to have the sensor take its present wrench as zero first.
    error_bits
        Status bits, any of which makes a sample invalid.

    Raises
    ------
    ValueError
        If a number is not greater than 0, or `error_bits` is not a 32-bit whole number.
    """

    host: str
    port: int = rdt.PORT
    _: KW_ONLY
    counts_per_force: float
    counts_per_torque: float
    rate: float
    buffered: bool = False
    bias: bool = False
    error_bits: int = rdt.ERROR_BIT

    def __post_init__(self) -> None:
        if not 0 <= self.error_bits < rdt.MODULUS:
            allowed = "allowed is a whole number of 32 bits"
            raise ValueError(f"error_bits = {self.error_bits}; {allowed}")
        self._scale = 1 / rdt.counts_per_unit(self.counts_per_force, self.counts_per_torque)
        self.counts = Counts()
        self._sequencer = Sequencer(self.counts)
        self._clock = SequenceClock(1e9 / positive(self.rate, "rate"), self.counts)
        self._early, self._settle = np.zeros(0, dtype=ORDERED), _SETTLE
        self._stream = rdt.Command.BUFFERED if self.buffered else rdt.Command.REAL_TIME
        self._closing = ExitStack()
        self._asked = 0.0

    def open(self) -> None:
        """Connect, and ask for an endless stream."""
        with naming(f"netft://{self.host}:{self.port}"):
            found = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_DGRAM)
        family, kind, protocol, _, address = found[0]
        self._epoch = epoch_offset()
        self._socket = self._closing.enter_context(socket.socket(family, kind, protocol))
        for option, value in _OPTIONS.items():
            with suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, option, value)
        self._socket.connect(address)
        self._ask(*[rdt.Command.BIAS] * self.bias, self._stream)
        self._closing.callback(self._ask, rdt.Command.STOP)

    def _ask(self, *commands: rdt.Command) -> None:
        self._asked = time.monotonic()
        for command in commands:
            with _may_be_away():
                self._socket.send(rdt.request_bytes(command))

    def read(self, timeout: float) -> Samples | None:
        """Samples received, in order; None if there are none within `timeout` seconds."""
        sound, came = b"", []
        for data, moment in self._datagrams(timeout):
            try:
                came += [moment] * len(rdt.parse_records(data))
                sound += data
            except ValueError as error:
                self.counts.malformed += 1
                self.complaint = str(error)
        now, records = time.monotonic_ns(), np.frombuffer(sound, dtype=rdt.RECORD)
        rows = self._sequencer.accept(records, np.array(came, dtype=np.int64), now)
        rows = np.concatenate([self._early, rows])
        # The first records are held back briefly: the clock is set by the least delayed of many.
        if not len(rows) or now - rows["arrival"][0] < self._settle:
            self._early = rows
            return None
        self._early, self._settle = rows[:0], 0
        status = rows["record"]["status"].astype(np.int64)
        valid = (status & self.error_bits) == 0
        self.counts.samples += len(rows)
        self.counts.flagged += int(np.count_nonzero(status))
        self.counts.invalid += int(np.count_nonzero(~valid))
        self.counts.status |= int(np.bitwise_or.reduce(status))
        wrench = rows["record"]["counts"] * self._scale
        stamp, anew = self._clock.stamps(rows["number"], rows["arrival"])
        return Samples(
            stamp + self._epoch,
            rows["number"],
            wrench[:, :3],
            wrench[:, 3:],
            valid,
            rows["arrival"],
            anew=anew,
        )

    def _datagrams(self, timeout: float) -> list[tuple[bytes, int]]:
        """Wait for a datagram, and briefly for more; all that have come, each with its arrival
        [ns].
        """
        found: list[tuple[bytes, int]] = []
        with suppress(TimeoutError, BlockingIOError), _may_be_away():
            self._socket.settimeout(timeout)
            found.append(self._datagram())
            time.sleep(_GATHER)
            self._socket.settimeout(0)
            while len(found) < _MOST_DATAGRAMS:
                found.append(self._datagram())
        if found:
            self._asked = time.monotonic()
        elif time.monotonic() - self._asked > _ASK_AGAIN:
            self._ask(self._stream)
        return found

    def _datagram(self) -> tuple[bytes, int]:
        data, ancillary, _, _ = self._socket.recvmsg(_LONGEST, _ANCILLARY)
        arrival = time.monotonic_ns()
        for _, _, stamp in ancillary:
            seconds, nanoseconds = _KERNEL_STAMP.unpack(stamp)
            arrival = min(arrival, seconds * 1_000_000_000 + nanoseconds - self._epoch)
        return data, arrival

    def close(self) -> None:
        """Ask the sensor to stop, and close the socket."""
        with suppress(OSError):
            self._closing.close()


@contextmanager
def _may_be_away() -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno not in _AWAY:
            raise
