"""The loop: one thread reads the source, this one works and writes."""

import threading
import time
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from vibrissa.contacts import ContactKind
from vibrissa.geometry.checks import not_negative, positive
from vibrissa.live.latency import Latency
from vibrissa.live.poses import PoseSource
from vibrissa.live.process import Processor
from vibrissa.live.reader import Reader
from vibrissa.live.report import Report
from vibrissa.live.samples import Samples, Source
from vibrissa.live.silence import SilenceWatch
from vibrissa.live.sinks import Sink

_FLUSH = 25_000_000
_LAST_WAIT = 0.2


class SilentSourceError(RuntimeError):
    """A source from which nothing came."""


def stream(
    source: Source,
    processor: Processor,
    sinks: Sequence[Sink] | Callable[[], Iterable[Sink]],
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
    source, processor
        Opened and warmed up here; the source is closed here.
    sinks
        Closed here. Or a function that makes them, which is called when the first sample is there:
        then a source that cannot be reached leaves no empty files.
    poses
        Those of the processor, opened and closed here; None where the source gives poses.
    duration
        Seconds after the first sample at which to end; None for no end.
    silence
        Seconds without any sample after which a source is taken for dead, and the stream ends; 0
        for never.
    batch_seconds
        Samples of so many seconds are worked on together: less costs more of the processor, more
        costs latency.
    stop
        Ends the stream when set.
    notice
        Is told, in one line, what happens; lines that begin with `warning:` are also in the report.

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
    loop = _Loop(
        source,
        processor,
        sinks,
        notice or (lambda _: None),
        positive(batch_seconds, "batch_seconds"),
    )
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
    for text in loop.report.losses():
        loop.warn(text)
    return loop.report


class _Loop:
    def __init__(
        self,
        source: Source,
        processor: Processor,
        sinks: Sequence[Sink] | Callable[[], Iterable[Sink]],
        notice: Callable[[str], None],
        batch_seconds: float,
    ) -> None:
        self._processor, self._notice, self._recorded = processor, notice, source.recorded
        self._make_sinks = sinks if callable(sinks) else None
        self._sinks: list[Sink] = [] if callable(sinks) else list(sinks)
        self._silence = SilenceWatch()
        self._reader = Reader(source)
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
                self._heard(samples)
                self._take(samples)
            elif not self._recorded and not self._reader.ended and self._silence.begins(begun):
                self.warn(
                    "no samples come: is the sensor on, its cable in, or has another program taken its stream?"
                )
            self._work()
            if self._reader.ended and samples is None:
                self._check_end()
                break
            if (
                duration is not None
                and self._first is not None
                and time.monotonic_ns() - self._first > duration * 1e9
            ):
                break
            if silence and time.monotonic_ns() - last > silence * 1e9:
                if self._first is None:
                    raise SilentSourceError(f"nothing came for {silence:g} s{self._unread()}")
                self.report.silent = True
                self.warn(f"nothing came for {silence:g} s: the stream ends here")
                break
            self._pause(begun)
        self._finish()

    def _check_end(self) -> None:
        if self._first is None and self._reader.error is None:
            raise SilentSourceError(f"the source ended before its first sample{self._unread()}")

    def _unread(self) -> str:
        malformed, why = self.report.counts.malformed, self._reader.complaint
        return (
            f"; {malformed} lines or datagrams could not be read, the last one for: {why}"
            if malformed
            else ""
        )

    def _begin(self, samples: Samples) -> None:
        if self._first is None:
            self._first, self._cpu = int(samples.arrival[0]), time.process_time()
            self._notice("first sample")
            for sink in self._make_sinks() if self._make_sinks is not None else ():
                self._sinks.append(sink)

    def warn(self, text: str) -> None:
        """Say and keep a warning."""
        if self.report.warn(text):
            self._notice(f"warning: {text}")

    def _heard(self, samples: Samples) -> None:
        """Say where samples come again after a silence, or begin anew."""
        pause = None if self._recorded else self._silence.came(samples.arrival)
        said = [] if pause is None else [f"samples come again after {pause:.2f} s"]
        if samples.restarts.any():
            said.append(
                "numbers or clock begin anew: the sensor was restarted, or another program had its stream; its zero is compared with that before"
            )
        if said:
            self.warn("; ".join(said))

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
                self.warn(
                    f"the wrench varied by {self._processor.restless:.1f} times its noise during the tare: is the rod free?"
                )

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
            for text, warns in self._processor.news():
                (self.warn if warns else self._notice)(text)
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
            self._heard(samples)
            self._take(samples)
        until = time.monotonic() + _LAST_WAIT
        self._work()
        while (
            self._processor.waiting
            and self._processor.tare is not None
            and time.monotonic() < until
        ):
            time.sleep(0.01)
            self._work()
        if self._reader.error is not None:
            raise self._reader.error

    def end(self) -> None:
        """Stop reading, and sum up."""
        self._reader.stop()
        report = self.report
        report.overflow, report.unused, report.without_pose = (
            self._reader.overflow,
            self._processor.waiting,
            self._processor.without_pose,
        )
        report.moved_during_tare = self._processor.moved_during_tare
        report.unsure, report.zero_changes = self._processor.unsure, self._processor.zero_changes
        report.silences, report.silent_seconds = self._silence.until(
            0 if self._reader.ended else time.monotonic_ns()
        )
        report.latency_median, report.latency_999 = (
            self._latency.percentile(50),
            self._latency.percentile(99.9),
        )
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
