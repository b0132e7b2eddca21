"""A force/torque sensor that is not there: it answers RDT requests with what a sensor would feel."""

import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float, Int

from vibrissa.geometry.checks import positive
from vibrissa.live import rdt
from vibrissa.live.clock import epoch_offset
from vibrissa.live.ports import listening
from vibrissa.live.poses import pose_bytes
from vibrissa.sensor import RawRecording

_LISTEN = 0.01
_LARGEST_COUNT = 2**31 - 1
_DEFAULT_BUFFER = 20


@dataclass(frozen=True)
class Flaws:
    """Shares of datagrams, from 0 to 1, to which something happens on the way.

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
        With the error bit in the status of their first record.

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
        for name in (field.name for field in fields(self)):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} = {getattr(self, name)}; allowed is a share from 0 to 1")


@dataclass
class Sent:
    """What a simulator did.

    Attributes
    ----------
    records, sent, dropped
        Records made, those that left it, and those dropped on purpose.
    poses
        Sent.
    malformed_requests
        Those that could not be read.
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


class SensorSimulator:
    """Streams samples over UDP to whoever asked last, at an even rate by the monotonic clock.

    There is one stream: a client that asks takes it from the one that had it, which then finds its
    sensor silent. `notice` is told.

    Parameters
    ----------
    samples
        Blocks of what the sensor logs, one row every 1/rate; they end, or they do not.
    counts_per_force, counts_per_torque
        Counts for one newton and for one newton metre.
    rate
        Records a second.
    host, port
        Where to listen; 0 for any free port.
    buffer
        Records a datagram where the buffered mode is asked for.
    flaws
        What goes wrong, at random.
    seed
        Of that randomness.
    poses
        Host and port to which the sensor's pose is sent as JSON, or None.
    pose_rate
        Poses a second.
    notice
        Is told, in one line, when a client takes the stream from another.

    Raises
    ------
    ValueError
        If a number is not allowed.
    """

    def __init__(
        self,
        samples: Iterator[RawRecording],
        *,
        counts_per_force: float,
        counts_per_torque: float,
        rate: float,
        host: str = "127.0.0.1",
        port: int = rdt.PORT,
        buffer: int = _DEFAULT_BUFFER,
        flaws: Flaws = Flaws(),
        seed: int = 0,
        poses: tuple[str, int] | None = None,
        pose_rate: float = 250.0,
        notice: Callable[[str], None] | None = None,
    ) -> None:
        if not 1 <= buffer <= rdt.MOST_RECORDS:
            raise ValueError(f"buffer = {buffer}; allowed are 1 to {rdt.MOST_RECORDS} records")
        self._samples = samples
        self._scale = np.repeat(
            [
                positive(counts_per_force, "counts_per_force"),
                positive(counts_per_torque, "counts_per_torque"),
            ],
            3,
        )
        self._rate, self._address, self._buffer, self._flaws = (
            positive(rate, "rate"),
            (host, port),
            buffer,
            flaws,
        )
        self._rng = np.random.default_rng(seed)
        self._poses = poses
        self._pose_every = max(1, round(rate / positive(pose_rate, "pose_rate")))
        self._socket: socket.socket | None = None
        self._listener: tuple[object, ...] | None = None
        self._per_datagram = 1
        self._wanted = 0
        self._sequence = 0
        self._bias = np.zeros(6, dtype=np.int64)
        self._counts = np.empty((0, 6), dtype=np.int64)
        self._block: RawRecording | None = None
        self._place = 0
        self._swapped: bytes | None = None
        self._notice = notice or (lambda _: None)
        self.sent = Sent()

    @property
    def port(self) -> int:
        """That is listened at, once open; also where 0 was asked for."""
        return int(self._socket.getsockname()[1]) if self._socket is not None else self._address[1]

    def open(self) -> None:
        """Listen. Raise OSError where the port is taken."""
        self._socket = listening(*self._address)
        self._socket.settimeout(0)

    def close(self) -> None:
        """Stop listening."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def run(self, *, duration: float | None = None, stop: threading.Event | None = None) -> Sent:
        """Answer requests until `stop` is set, the samples end, or `duration` seconds after the
        first request for records.
        """
        assert self._socket is not None, "open() comes first"
        ended, epoch = stop or threading.Event(), epoch_offset()
        while not ended.is_set() and not self._streaming:
            self._listen(0.05)
        start = time.monotonic_ns()
        heard = start
        while not ended.is_set():
            now = time.monotonic_ns()
            if duration is not None and now - start >= duration * 1e9:
                break
            due = int((now - start) * 1e-9 * self._rate) + 1
            if due - self.sent.records >= self._per_datagram and not self._send(start, due, epoch):
                break
            if now - heard > _LISTEN * 1e9:
                heard = now
                self._listen(0)
            self._wait(start)
        return self.sent

    @property
    def _streaming(self) -> bool:
        return self._listener is not None

    def _wait(self, start: int) -> None:
        """Until the next datagram is due."""
        due = start + (self.sent.records + self._per_datagram - 1) / self._rate * 1e9
        left = (due - time.monotonic_ns()) * 1e-9
        if left > 0:
            time.sleep(min(left, _LISTEN))

    def _listen(self, timeout: float) -> None:
        assert self._socket is not None
        while select.select([self._socket], [], [], timeout)[0]:
            try:
                data, sender = self._socket.recvfrom(2048)
                request = rdt.parse_request(data)
            except ValueError:
                self.sent.malformed_requests += 1
                continue
            except ConnectionRefusedError:
                continue
            except BlockingIOError:
                return
            self._obey(request, sender)
            timeout = 0

    def _obey(self, request: rdt.Request, sender: tuple[object, ...]) -> None:
        match request.command:
            case rdt.Command.STOP:
                if sender == self._listener:
                    self._listener = None
            case rdt.Command.REAL_TIME | rdt.Command.BUFFERED:
                self._taken_over(sender)
                self._listener, self._sequence, self._wanted = sender, 0, request.records
                self._per_datagram = self._buffer if request.command == rdt.Command.BUFFERED else 1
            case rdt.Command.BIAS:
                self._fill()
                if self._place < len(self._counts):
                    self._bias = self._counts[self._place].copy()

    def _taken_over(self, sender: tuple[object, ...]) -> None:
        if self._listener is not None and self._listener != sender:
            self.sent.takeovers += 1
            before, after = (f"{client[0]}:{client[1]}" for client in (self._listener, sender))
            self._notice(
                f"{after} asked for the stream, and {before} loses it: there is one stream, for the client that asked last"
            )

    def _fill(self) -> bool:
        """Have a block with rows left; False where the samples have ended."""
        while self._place >= len(self._counts):
            block = next(self._samples, None)
            if block is None:
                return False
            wrench = np.concatenate([block.force, block.torque], axis=1)
            self._block, self._place = block, 0
            self._counts = np.clip(
                np.rint(wrench * self._scale), -_LARGEST_COUNT, _LARGEST_COUNT
            ).astype(np.int64)
        return True

    def _send(self, start: int, due: int, epoch: int) -> bool:
        """Send what is due, in whole datagrams; False where the samples have ended."""
        while due - self.sent.records >= self._per_datagram:
            rows = []
            for _ in range(self._per_datagram):
                if not self._fill():
                    return False
                moment = start + round(self.sent.records / self._rate * 1e9)
                self._tell_pose(moment + epoch)
                rows.append(self._counts[self._place])
                self._place += 1
                self.sent.records += 1
            self.sent.latest = max(self.sent.latest, (time.monotonic_ns() - moment) * 1e-9)
            self._datagram(np.array(rows))
        return True

    def _datagram(self, counts: Int[np.ndarray, "k 6"]) -> None:
        if not self._streaming:
            return
        if self._wanted:
            counts = counts[: self._wanted - self._sequence]
        records = np.zeros(len(counts), dtype=rdt.RECORD)
        self._sequence += len(counts)
        records["rdt_sequence"] = (
            self._sequence - len(counts) + 1 + np.arange(len(counts))
        ) % rdt.MODULUS
        records["ft_sequence"] = (
            self.sent.records - len(counts) + np.arange(len(counts))
        ) % rdt.MODULUS
        records["counts"] = np.clip(counts - self._bias, -_LARGEST_COUNT, _LARGEST_COUNT)
        if self._happens("error"):
            records["status"][0] = rdt.ERROR_BIT
        self._give(records.tobytes(), len(counts))
        if self._wanted and self._sequence >= self._wanted:
            self._listener = None

    def _happens(self, name: str) -> bool:
        share = getattr(self._flaws, name)
        return bool(share) and self._rng.random() < share

    def _give(self, data: bytes, records: int) -> None:
        if self._happens("drop"):
            self.sent.dropped += records
            return
        self.sent.sent += records
        if self._swapped is None and self._happens("reorder"):
            self._swapped = data
            return
        self._put(data)
        if self._happens("duplicate"):
            self._put(data)
        if self._happens("malformed"):
            self._put(data[:-5])
        if self._swapped is not None:
            self._put(self._swapped)
            self._swapped = None

    def _put(self, data: bytes) -> None:
        assert self._socket is not None
        with suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.sendto(data, self._listener)  # type: ignore[arg-type]

    def _tell_pose(self, stamp: int) -> None:
        if self._poses is None or self.sent.records % self._pose_every or self._block is None:
            return
        assert self._socket is not None
        position: Float[np.ndarray, 3] = self._block.position[self._place]
        with suppress(BlockingIOError, ConnectionRefusedError):
            self._socket.sendto(
                pose_bytes(stamp, position, self._block.orientation[self._place]), self._poses
            )
        self.sent.poses += 1
