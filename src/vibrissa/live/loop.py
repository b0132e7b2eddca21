"""The loop: one thread reads the source, this one works and writes."""

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from vibrissa.contacts import ContactKind
from vibrissa.geometry.checks import not_negative, positive
from vibrissa.live.latency import Latency
from vibrissa.live.poses import PoseSource
from vibrissa.live.process import Processor
from vibrissa.live.samples import Counts, EndOfStreamError, Samples, Source, joined
from vibrissa.live.sinks import Sink

_MOST_QUEUED = 200_000
_READ_WAIT = 0.05
_FLUSH = 25_000_000
_LAST_WAIT = 0.2


class SilentSourceError(RuntimeError):
    """A source from which nothing came."""


@dataclass
class Report:
    """What a stream did.

    Attributes
    ----------
    counts
        Of the source.
    contacts
        Rows with a contact, by kind.
    rows
        Rows given to the sinks.
    unused
        Samples recorded, but left without a row: the stream ended before the tare was over, or before their pose came.
    overflow
        Samples thrown away since this process could not keep up.
    without_pose
        Rows whose pose was not known.
    malformed_poses, misplaced_poses
        Datagrams of the pose stream that could not be read; poses whose stamps lie more than a second from their arrival.
    seconds
        From the first sample to the end.
    cpu_share
        Of one core, over that time.
    latency_median, latency_999
        From the arrival of a sample to its contact [s], and its 99.9th percentile; rows that waited for the tare, or behind such, left out. None where there were none.
    moved_during_tare
        Whether the wrench varied by more than three times its noise while it was taken for zero.
    silent
        Whether the stream ended since the source fell silent.
    """

    counts: Counts
    contacts: dict[str, int] = field(default_factory=lambda: {kind.name: 0 for kind in ContactKind})
    rows: int = 0
    unused: int = 0
    overflow: int = 0
    without_pose: int = 0
    malformed_poses: int = 0
    misplaced_poses: int = 0
    seconds: float = 0.0
    cpu_share: float = 0.0
    latency_median: float | None = None
    latency_999: float | None = None
    moved_during_tare: bool = False
    silent: bool = False

    def as_dict(self) -> dict[str, object]:
        """All figures, for JSON."""
        return asdict(self)


class _Reader:
    """Reads the source in a thread of its own, into a bounded queue."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._queue: deque[Samples] = deque()
        self._arrived = threading.Condition()
        self._queued = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="source", daemon=True)
        self.ended = False
        self.error: BaseException | None = None
        self.overflow = 0

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(5)

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                samples = self._source.read(_READ_WAIT)
                if samples is not None:
                    self._put(samples)
        except EndOfStreamError:
            pass
        except BaseException as error:
            self.error = error
        with self._arrived:
            self.ended = True
            self._arrived.notify()

    @property
    def complaint(self) -> str:
        return self._source.complaint

    def _put(self, samples: Samples) -> None:
        with self._arrived:
            while self._queued + len(samples) > _MOST_QUEUED and self._source.waits and not self._stop.is_set():
                self._arrived.wait(_READ_WAIT)
            if self._queued + len(samples) > _MOST_QUEUED:
                self.overflow += len(samples)
                return
            self._queue.append(samples)
            self._queued += len(samples)
            self._arrived.notify()

    def take(self, wait: float) -> Samples | None:
        """Everything that is there, or None after `wait` seconds."""
        with self._arrived:
            if not self._queue and not self.ended:
                self._arrived.wait(wait)
            parts, self._queued = list(self._queue), 0
            self._queue.clear()
            self._arrived.notify()
        return joined(parts) if parts else None


def stream(
    source: Source,
    processor: Processor,
    sinks: Sequence[Sink],
    *,
    poses: PoseSource | None = None,
    duration: float | None = None,
    silence: float = 5.0,
    batch_seconds: float = 0.005,
    stop: threading.Event | None = None,
    notice: Callable[[str], None] | None = None,
) -> Report:
    """Give a source's samples to the sinks, raw and as contacts, until it ends.

    Parameters
    ----------
    source, processor, sinks
        Opened, warmed up and closed here.
    poses
        Those of the processor, opened and closed here; None where the source gives poses.
    duration
        Seconds after the first sample at which to end; None for no end.
    silence
        Seconds without any sample after which a source is taken for dead, and the stream ends; 0 for never.
    batch_seconds
        Samples of so many seconds are worked on together: less costs more of the processor, more costs latency.
    stop
        Ends the stream when set.
    notice
        Is told, in one line, what happens.

    Returns
    -------
    Report
        What came, what was lost, how long it took.

    Raises
    ------
    ValueError
        If a number is not allowed, or too few samples came within the tare.
    SilentSourceError
        If not even a first sample came within `silence` seconds, or before the source ended.
    OSError
        If the source cannot be reached, or a sink cannot write.
    """
    if duration is not None:
        positive(duration, "duration")
    loop = _Loop(source, processor, sinks, notice or (lambda _: None), positive(batch_seconds, "batch_seconds"))
    try:
        processor.warm_up()
        if poses is not None:
            poses.open()
        source.open()
        loop.run(stop or threading.Event(), duration, not_negative(silence, "silence"))
    finally:
        loop.end()
        source.close()
        if poses is not None:
            poses.close()
        loop.close_sinks()
    if poses is not None:
        loop.report.malformed_poses, loop.report.misplaced_poses = poses.malformed, poses.misplaced
    return loop.report


class _Loop:
    def __init__(
        self, source: Source, processor: Processor, sinks: Sequence[Sink], notice: Callable[[str], None], batch_seconds: float
    ) -> None:
        self._processor, self._sinks, self._notice = processor, sinks, notice
        self._reader = _Reader(source)
        self._batch = batch_seconds
        self._latency = Latency()
        self._flushed = 0
        self._steady = 0
        self._first: int | None = None
        self._cpu = 0.0
        self._tared = processor.tare is not None
        self.report = Report(source.counts)

    def run(self, stop: threading.Event, duration: float | None, silence: float) -> None:
        self._reader.start()
        last = time.monotonic_ns()
        self._notice("waiting for samples")
        while not stop.is_set():
            begun = time.monotonic_ns()
            samples = self._reader.take(0.02)
            if samples is not None:
                last = begun
                self._begin(samples)
                self._take(samples)
            self._work()
            if self._reader.ended and samples is None:
                self._check_end()
                break
            if duration is not None and self._first is not None and time.monotonic_ns() - self._first > duration * 1e9:
                break
            if silence and time.monotonic_ns() - last > silence * 1e9:
                if self._first is None:
                    raise SilentSourceError(f"nothing came for {silence:g} s{self._unread()}")
                self.report.silent = True
                self._notice(f"nothing came for {silence:g} s")
                break
            self._pause(begun)
        self._finish()

    def _check_end(self) -> None:
        if self._first is None and self._reader.error is None:
            raise SilentSourceError(f"the source ended before its first sample{self._unread()}")

    def _unread(self) -> str:
        malformed, why = self.report.counts.malformed, self._reader.complaint
        return f"; {malformed} lines or datagrams could not be read, the last one for: {why}" if malformed else ""

    def _begin(self, samples: Samples) -> None:
        if self._first is None:
            self._first, self._cpu = int(samples.arrival[0]), time.process_time()
            self._notice("first sample")

    def _pause(self, begun: int) -> None:
        left = self._batch - (time.monotonic_ns() - begun) * 1e-9
        if left > 0:
            time.sleep(left)

    def _take(self, samples: Samples) -> None:
        for sink in self._sinks:
            sink.wrench(samples.stamp, samples.sequence, samples.force, samples.torque)
        self._processor.push(samples)
        if not self._tared and self._processor.tare is not None:
            self._tared = True
            shown = ", ".join(f"{value:.6g}" for value in self._processor.tare)
            self._notice(f"tare: {shown} (N, N m)")
            if self._processor.moved_during_tare:
                self._notice(f"the wrench varied by {self._processor.restless:.1f} times its noise during the tare: is the rod free?")

    def _work(self) -> None:
        for result in self._processor.ready(time.time_ns()):
            now = time.monotonic_ns()
            self._steady = now if result.held else self._steady
            self._latency.add(now - result.arrival[result.arrival > self._steady])
            self.report.rows += len(result.stamp)
            kinds = np.bincount(result.found.kind, minlength=len(ContactKind))
            for kind in ContactKind:
                self.report.contacts[kind.name] += int(kinds[kind])
            for sink in self._sinks:
                sink.contacts(result.stamp, result.raw, result.found)
            self._flush()
        self._flush()

    def _flush(self) -> None:
        now = time.monotonic_ns()
        if now - self._flushed >= _FLUSH:
            self._flushed = now
            for sink in self._sinks:
                sink.flush()

    def _finish(self) -> None:
        """What has come already is worked on, and poses that are due are awaited."""
        self._reader.stop()
        samples = self._reader.take(0)
        if samples is not None:
            self._begin(samples)
            self._take(samples)
        until = time.monotonic() + _LAST_WAIT
        self._work()
        while self._processor.waiting and self._processor.tare is not None and time.monotonic() < until:
            time.sleep(0.01)
            self._work()
        if self._reader.error is not None:
            raise self._reader.error

    def end(self) -> None:
        """Stop reading, and sum up."""
        self._reader.stop()
        report = self.report
        report.overflow, report.unused, report.without_pose = self._reader.overflow, self._processor.waiting, self._processor.without_pose
        report.moved_during_tare = self._processor.moved_during_tare
        report.latency_median, report.latency_999 = self._latency.percentile(50), self._latency.percentile(99.9)
        if self._first is not None:
            report.seconds = (time.monotonic_ns() - self._first) * 1e-9
            report.cpu_share = (time.process_time() - self._cpu) / report.seconds

    def close_sinks(self) -> None:
        """Each of them, also where one fails; the first failure is raised."""
        failure: Exception | None = None
        for sink in self._sinks:
            try:
                sink.close()
            except Exception as error:
                failure = failure or error
        if failure is not None:
            raise failure
