"""The streaming loop: one thread reads the source, this one processes and writes."""

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from queue import Empty, Full, Queue

import numpy as np

from vibrissa.contacts import ContactKind, Status
from vibrissa.geometry.checks import not_negative, positive
from vibrissa.live.process import Processor
from vibrissa.live.report import Latency, Report, SilenceWatch
from vibrissa.live.samples import EndOfStreamError, Samples, Source, joined
from vibrissa.live.sinks import Sink

_FLUSH = 25_000_000  # [ns]: half the interval promised to sinks
_WAIT = 0.02  # [s] to wait for samples before looking at new poses
_READ_WAIT = 0.05  # [s]: how late a stop may be noticed
_LAST_WAIT = 0.2  # [s] to wait for poses of the last samples: four times the usual patience
_QUEUED = 30_000  # reads: half a minute of the fastest sensor, some 30 MB
_QUEUED_WAITING = 64  # reads, if the source can wait


class SilentSourceError(RuntimeError):
    """No sample came from a source."""


def stream(
    source: Source,
    processor: Processor,
    sinks: Sequence[Sink] | Callable[[], Iterable[Sink]],
    *,
    duration: float | None = None,
    silence: float = 5.0,
    batch_seconds: float = 0.005,
    stop: threading.Event | None = None,
    notice: Callable[[str], None] | None = None,
) -> Report:
    """Stream a source's samples to the sinks, raw and as contacts, until it ends.

    Parameters
    ----------
    source, processor
        Opened and warmed up here, as are the processor's poses; source and poses are closed here.
    sinks
        Closed here. Or a function that makes them, called when the first sample comes, so that an
        unreachable source leaves no empty files.
    duration
        Seconds to run after the first sample; None for no limit.
    silence
        Seconds without a sample after which a source is considered dead and the stream ends; 0 for
        never.
    batch_seconds
        Seconds of samples processed together: fewer cost more CPU time, more cost latency.
    stop
        Ends the stream when set.
    notice
        Called with one-line messages on what happens; those that begin with `warning:` are also in
        the report.

    Returns
    -------
    Report
        What came, what was lost, how long it took.

    Raises
    ------
    ValueError
        If a number is not allowed, or too few samples came during the tare.
    SilentSourceError
        If no sample came within `silence` seconds, or before the source ended.
    OSError
        If the source cannot be reached, or a sink cannot write.
    """
    if duration is not None:
        positive(duration, "duration")
    positive(batch_seconds, "batch_seconds")
    not_negative(silence, "silence")
    report, poses = processor.report, processor.poses
    report.counts, report.notice = source.counts, notice or str
    with ExitStack() as closing:
        loop = _Loop(source, processor, sinks if callable(sinks) else lambda: (), closing)
        if not callable(sinks):
            loop.add(sinks)
        processor.warm_up()
        for opened in (poses, source):
            closing.callback(opened.close)
            opened.open()
        loop.run(stop or threading.Event(), duration or np.inf, silence or np.inf, batch_seconds)
    report.malformed_poses, report.misplaced_poses = poses.malformed, poses.misplaced
    for text in [*processor.contradictions(), *report.losses()]:
        report.warn(text)
    return report


class _Loop:
    """What `stream` does between opening and closing."""

    def __init__(
        self,
        source: Source,
        processor: Processor,
        make_sinks: Callable[[], Iterable[Sink]],
        closing: ExitStack,
    ) -> None:
        self._source, self._processor, self._report = source, processor, processor.report
        self._make_sinks, self._closing = make_sinks, closing
        self._sinks: list[Sink] = []
        self._queue: Queue[Samples] = Queue(_QUEUED_WAITING if source.waits else _QUEUED)
        self._ending = threading.Event()
        self._silence, self._latency = SilenceWatch(self._report), Latency()
        self._flushed, self._cpu = 0, 0.0
        self._first = self._steady = np.inf

    def add(self, sinks: Iterable[Sink]) -> None:
        """Write to these sinks too, and close them at the end."""
        for sink in sinks:
            self._closing.callback(sink.close)
            self._sinks.append(sink)

    def run(
        self, stop: threading.Event, duration: float, silence: float, batch_seconds: float
    ) -> None:
        """Run until the source, the duration or `stop` ends it; times in seconds."""
        report, watched = self._report, not self._source.recorded
        threads = self._closing.enter_context(ThreadPoolExecutor(1, "source"))
        self._closing.callback(self._ending.set)
        reading = threads.submit(self._read)
        report.notice("waiting for samples")
        why = ""
        begun = last = time.monotonic_ns()
        while not (stop.is_set() or why or self._seconds() > duration):
            begun = time.monotonic_ns()
            over = reading.done()
            if self._take(_WAIT):
                last = begun
            elif over:
                why = "the source ended before a sample"
            elif begun - last > silence * 1e9:
                why, report.silent = f"nothing came for {silence:g} s", True
            elif watched and self._silence.begins(begun):
                text = "no samples arrive: is the sensor on, its cable in, or has another program"
                report.warn(f"{text} taken its stream?")
            self._work()
            time.sleep(max(batch_seconds - (time.monotonic_ns() - begun) * 1e-9, 0.0))
        if report.silent or not why:
            self._silence.came(np.array([begun]))
        self._ending.set()
        error = reading.exception()
        self._finish()
        if error is not None:
            raise error
        if why and self._first == np.inf:
            malformed, last_one = report.counts.malformed, self._source.complaint
            unread = f"; {malformed} lines or datagrams could not be read, the last one because: "
            raise SilentSourceError(f"{why}{unread}{last_one}" if malformed else why)
        if report.silent:
            report.warn(f"{why}: the stream ends here")

    def _read(self) -> None:
        """Run in a thread of its own: samples go into a bounded queue, so that none are missed
        while the other thread works.
        """
        with suppress(EndOfStreamError):
            while not self._ending.is_set():
                samples = self._source.read(_READ_WAIT)
                while samples is not None:
                    with suppress(Full):
                        self._queue.put(samples, timeout=_READ_WAIT)
                        break
                    if not self._source.waits or self._ending.is_set():
                        self._report.overflow += len(samples)
                        break

    def _seconds(self) -> float:
        """Seconds since the first sample."""
        return (time.monotonic_ns() - self._first) * 1e-9

    def _take(self, wait: float) -> bool:
        """Pass on everything queued; false if nothing comes within `wait` seconds."""
        parts: list[Samples] = []
        with suppress(Empty):
            parts.append(self._queue.get(timeout=wait))
            while True:
                parts.append(self._queue.get_nowait())
        if not parts:
            return False
        samples = joined(parts)
        if self._first == np.inf:
            self._first, self._cpu = int(samples.arrival[0]), time.process_time()
            self._report.notice("first sample")
            self.add(self._make_sinks())
        pause = None if self._source.recorded else self._silence.came(samples.arrival)
        said = [] if pause is None else [f"samples came again after {pause:.2f} s"]
        if samples.anew.any():
            said.append(
                "numbering or clock restarted: the sensor was restarted, or another program had "
                "its stream; its zero is compared with the previous one"
            )
        if said:
            self._report.warn("; ".join(said))
        for sink in self._sinks:
            sink.wrench(samples.stamp, samples.sequence, samples.force, samples.torque)
        self._processor.push(samples)
        return True

    def _work(self) -> None:
        for result in self._processor.ready(time.time_ns()):
            now = time.monotonic_ns()
            self._latency.add(now - result.arrival[result.arrival > self._steady])
            self._report.rows += len(result.stamp)
            for kind in ContactKind:
                self._report.contacts[kind.name] += int(np.sum(result.found.kind == kind))
            for status in result.found.status[result.found.in_contact].tolist():
                name = Status(status).name
                self._report.statuses[name] = self._report.statuses.get(name, 0) + 1
            for sink in self._sinks:
                sink.contacts(result.stamp, result.raw, result.found)
            self._flush()
        self._flush()
        if self._processor.tare is not None:
            # Latencies count from here on: earlier rows waited for the tare, or behind rows that
            # did.
            self._steady = min(self._steady, time.monotonic_ns())

    def _flush(self) -> None:
        now = time.monotonic_ns()
        if now - self._flushed >= _FLUSH:
            self._flushed = now
            for sink in self._sinks:
                sink.flush()

    def _finish(self) -> None:
        """Process what has come, wait for poses that are due, and complete the report."""
        report, processor = self._report, self._processor
        self._take(0)
        until = time.monotonic() + _LAST_WAIT
        self._work()
        while processor.waiting and processor.tare is not None and time.monotonic() < until:
            time.sleep(0.01)
            self._work()
        report.unused = processor.waiting
        report.latency_median = self._latency.percentile(50)
        report.latency_999 = self._latency.percentile(99.9)
        if self._first < np.inf:
            report.seconds = self._seconds()
            report.cpu_share = (time.process_time() - self._cpu) / report.seconds
