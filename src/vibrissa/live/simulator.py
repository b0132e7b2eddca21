"""A simulated force/torque sensor: it answers RDT requests with what a sensor would feel."""

import select
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import KW_ONLY, asdict, dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrissa.geometry.checks import positive
from vibrissa.live import rdt
from vibrissa.live.address import listening
from vibrissa.live.clock import epoch_offset
from vibrissa.live.poses import pose_bytes
from vibrissa.sensor import RawRecording

_LISTEN = 0.01  # [s] between checks for requests
_LARGEST_COUNT = 2**31 - 1  # signed, 32 bits


@dataclass(frozen=True)
class Flaws:
    """Shares of datagrams, from 0 to 1, that are disturbed on the way.

    Attributes
    ----------
    drop
        Never sent.
    duplicate
        Sent twice.
    reorder
        Sent after the next one.
    malformed
        Followed by one that is cut off.
    error
        Sent with the error bit set in the status of their first record.

    Raises
    ------
    ValueError
        If a share is not from 0 to 1.
    """

    drop: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    malformed: float = 0.0
    error: float = 0.0

    def __post_init__(self) -> None:
        for name, share in asdict(self).items():
            if not 0 <= share <= 1:
                raise ValueError(f"{name} = {share}; allowed is a share from 0 to 1")


@dataclass
class Sent:
    """What a simulator did.

    Attributes
    ----------
    records, sent, dropped
        Records generated, records sent, and records dropped on purpose.
    poses
        Poses sent.
    malformed_requests
        Requests that could not be read.
    latest
        Largest delay [s].
    takeovers
        How often a client took the stream from another.
    """

    records: int = 0
    sent: int = 0
    dropped: int = 0
    poses: int = 0
    malformed_requests: int = 0
    latest: float = 0.0
    takeovers: int = 0


class _Sample(NamedTuple):
    counts: Int[np.ndarray, "6"]
    position: Float[np.ndarray, "3"]
    orientation: Float[np.ndarray, "4"]


@dataclass(eq=False)
class SensorSimulator:
    """Streams samples over UDP to whoever asked last, at a constant rate on the monotonic clock.

    There is only one stream: a client that asks takes it from the one that had it, which then finds
    its sensor silent. `notice` is told.

    Parameters
    ----------
    samples
        Blocks of what the sensor logs, one row every 1/rate; they may be endless.
    counts_per_force, counts_per_torque
        Counts per newton and per newton metre.
    rate
        Records per second.
    host, port
        Where to listen; 0 for any free port.
    buffer
        Records per datagram in buffered mode.
    flaws
        What goes wrong, at random.
    seed
        Seed of that randomness.
    poses
        Host and port to which the sensor's pose is sent as JSON, or None.
    pose_rate
        Poses per second.
    notice
        Called with one line when a client takes the stream from another; by default it does
        nothing.

    Raises
    ------
    ValueError
        If a number is not allowed.
    """

    samples: Iterator[RawRecording]
    _: KW_ONLY
    counts_per_force: float
    counts_per_torque: float
    rate: float
    host: str = "127.0.0.1"
    port: int = rdt.PORT
    buffer: int = 20
    flaws: Flaws = Flaws()
    seed: int = 0
    poses: tuple[str, int] | None = None
    pose_rate: float = 250.0
    notice: Callable[[str], object] = str

    def __post_init__(self) -> None:
        if not 1 <= self.buffer <= rdt.MOST_RECORDS:
            raise ValueError(f"buffer = {self.buffer}; allowed are 1 to {rdt.MOST_RECORDS} records")
        scale = rdt.counts_per_unit(self.counts_per_force, self.counts_per_torque)
        rate, pose_rate = positive(self.rate, "rate"), positive(self.pose_rate, "pose_rate")
        self._pose_every = max(1, round(rate / pose_rate))
        self._samples = (
            _Sample(np.rint(wrench * scale).astype(np.int64), position, orientation)
            for block in self.samples
            for wrench, position, orientation in zip(
                block.wrench, block.position, block.orientation, strict=True
            )
        )
        self._next: list[_Sample] = []
        self._rng = np.random.default_rng(self.seed)
        self._client: tuple[str, int] | None = None
        self._per_datagram = 1
        self._wanted, self._sequence = np.inf, 0
        self._bias = np.zeros(6, dtype=np.int64)
        self._swapped: list[bytes] = []
        self.sent = Sent()

    def open(self) -> None:
        """Listen, and fill in the port if any was allowed. Raise OSError if it is taken."""
        self._socket = listening(self.host, self.port)
        self._socket.settimeout(0)
        self.port = self._socket.getsockname()[1]

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()

    def run(self, *, duration: float | None = None, stop: threading.Event | None = None) -> Sent:
        """Answer requests until `stop` is set, the samples end, or `duration` seconds after the
        first request for records.
        """
        ended, epoch = stop or threading.Event(), epoch_offset()
        self._next = list(islice(self._samples, 1))
        while not ended.is_set() and self._client is None:
            self._listen(0.05)
        start = heard = now = time.monotonic_ns()
        last = np.inf if duration is None else start + duration * 1e9
        while not ended.is_set() and self._next and now < last:
            due = start + (self.sent.records + len(self._next) - 1) / self.rate * 1e9
            if due <= now:
                self._send(start, epoch)
            else:
                time.sleep(min((due - now) * 1e-9, _LISTEN))
            if now - heard > _LISTEN * 1e9:
                heard = now
                self._listen(0)
            now = time.monotonic_ns()
        return self.sent

    def _listen(self, timeout: float) -> None:
        while select.select([self._socket], [], [], timeout)[0]:
            timeout = 0
            with suppress(ConnectionRefusedError, BlockingIOError):
                data, sender = self._socket.recvfrom(2048)
                try:
                    self._obey(*rdt.parse_request(data), sender)
                except ValueError:
                    self.sent.malformed_requests += 1

    def _obey(self, command: rdt.Command, records: int, sender: tuple[str, int]) -> None:
        client = self._client
        match command:
            case rdt.Command.STOP if sender == client:
                self._client = None
            case rdt.Command.REAL_TIME | rdt.Command.BUFFERED:
                if client is not None and client != sender:
                    self.sent.takeovers += 1
                    before, after = (f"{host}:{port}" for host, port, *_ in (client, sender))
                    self.notice(
                        f"{after} asked for the stream, and {before} loses it: there is one "
                        "stream, for the client that asked last"
                    )
                self._client, self._sequence, self._wanted = sender, 0, records or np.inf
                self._per_datagram = self.buffer if command == rdt.Command.BUFFERED else 1
            case rdt.Command.BIAS if self._next:
                self._bias = self._next[0].counts

    def _send(self, start: int, epoch: int) -> None:
        """The next datagram, and the poses of its samples."""
        samples, sent, first = self._next, self.sent, self.sent.records
        for number, (_, position, orientation) in enumerate(samples, start=first):
            moment = start + round(number / self.rate * 1e9)
            if self.poses is not None and number % self._pose_every == 0:
                self._put(pose_bytes(moment + epoch, position, orientation), self.poses)
                sent.poses += 1
            sent.latest = max(sent.latest, (time.monotonic_ns() - moment) * 1e-9)
        sent.records += len(samples)
        self._next = list(islice(self._samples, self._per_datagram))
        if self._client is None:
            return
        count = int(min(len(samples), self._wanted - self._sequence))
        records, place = np.zeros(count, dtype=rdt.RECORD), np.arange(count)
        records["rdt_sequence"] = (self._sequence + 1 + place) % rdt.MODULUS
        records["ft_sequence"] = (first + place) % rdt.MODULUS
        counts = [sample.counts - self._bias for sample in samples[:count]]
        records["counts"] = np.clip(counts, -_LARGEST_COUNT, _LARGEST_COUNT)
        records["status"][0] = rdt.ERROR_BIT * self._happens("error")
        self._sequence += count
        self._datagram(records, self._client)
        if self._sequence == self._wanted:
            self._client = None

    def _datagram(self, records: np.ndarray, client: tuple[str, int]) -> None:
        """Send records, or what the flaws make of them."""
        if self._happens("drop"):
            self.sent.dropped += len(records)
            return
        self.sent.sent += len(records)
        data = records.tobytes()
        if not self._swapped and self._happens("reorder"):
            self._swapped = [data]
            return
        copies = [data] * (1 + self._happens("duplicate"))
        torn = [data[:-5]] * self._happens("malformed")
        for going in (*copies, *torn, *self._swapped):
            self._put(going, client)
        self._swapped = []

    def _happens(self, flaw: str) -> bool:
        return self._rng.random() < getattr(self.flaws, flaw)

    def _put(self, data: bytes, address: tuple[str, int]) -> None:
        with suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.sendto(data, address)
