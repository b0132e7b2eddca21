"""The loop: one thread reads the source, this one works and writes."""

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

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

_FLUSH = 25_000_000  # [ns]: half of what sinks are promised
_WAIT = 0.02  # [s] for samples, before poses that came are looked at
_LAST_WAIT = 0.2  # [s] for poses of the last samples: four times the usual patience


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
    positive(batch_seconds, "batch_seconds")
    not_negative(silence, "silence")
    with ExitStack() as closing:
        make_sinks = sinks if callable(sinks) else None
        loop = _Loop(source, processor, notice or (lambda _: None), closing, make_sinks)
        if not callable(sinks):
            loop.add(sinks)
        processor.warm_up()
        if poses is not None:
            closing.callback(poses.close)
            poses.open()
        closing.callback(source.close)
        source.open()
        stopping = stop or threading.Event()
        report = loop.run(stopping, duration or np.inf, silence or np.inf, batch_seconds)
    if poses is not None:
        report.malformed_poses, report.misplaced_poses = poses.malformed, poses.misplaced
    for text in report.losses():
        loop.say(text, warns=True)
    return report


@dataclass(eq=False)
class _Loop:
    source: Source
    processor: Processor
    notice: Callable[[str], None]
    closing: ExitStack
    make_sinks: Callable[[], Iterable[Sink]] | None

    def __post_init__(self) -> None:
        self._sinks: list[Sink] = []
        self._reader, self._silence = Reader(self.source), SilenceWatch()
        self._latency, self._report = Latency(), Report(self.source.counts)
        self._flushed = 0
        self._steady = np.inf
        self.processor.say = self.say
        self._first: int | None = None
        self._cpu = 0.0

    def add(self, sinks: Iterable[Sink]) -> None:
        """Give to these sinks too, and close them in the end."""
        for sink in sinks:
            self.closing.callback(sink.close)
            self._sinks.append(sink)

    def run(
        self, stop: threading.Event, duration: float, silence: float, batch_seconds: float
    ) -> Report:
        """Until the source, the duration or `stop` ends it; times in seconds."""
        self.closing.callback(self._reader.stop)
        self._reader.start()
        self.notice("waiting for samples")
        ended = silent = False
        begun = last = time.monotonic_ns()
        while not (stop.is_set() or ended or silent or self._seconds() > duration):
            begun = time.monotonic_ns()
            over, samples = self._reader.ended, self._reader.take(_WAIT)
            if samples is not None:
                last = begun
                self._take(samples)
            elif over:
                ended = True
            elif begun - last > silence * 1e9:
                silent = True
            elif not self.source.recorded and self._silence.begins(begun):
                text = "no samples come: is the sensor on, its cable in, or has another program"
                self.say(f"{text} taken its stream?", warns=True)
            self._work()
            time.sleep(max(batch_seconds - (time.monotonic_ns() - begun) * 1e-9, 0.0))
        lasting = self._silence.until(0 if ended else begun)
        self._report.silences, self._report.silent_seconds = lasting
        self._finish()
        why = f"nothing came for {silence:g} s" if silent else "the source ended before a sample"
        if self._first is None and (ended or silent):
            malformed = self.source.counts.malformed
            unread = f"{malformed} lines or datagrams could not be read, the last one for: "
            unread = f"; {unread}{self.source.complaint}" if malformed else ""
            raise SilentSourceError(f"{why}{unread}")
        if silent:
            self._report.silent = True
            self.say(f"{why}: the stream ends here", warns=True)
        return self._summed_up()

    def _seconds(self) -> float:
        """Since the first sample."""
        return 0.0 if self._first is None else (time.monotonic_ns() - self._first) * 1e-9

    def say(self, text: str, *, warns: bool = False) -> None:
        """Tell something; a warning is kept for the report, and not told where that is full."""
        if not warns:
            self.notice(text)
        elif self._report.warn(text):
            self.notice(f"warning: {text}")

    def _take(self, samples: Samples) -> None:
        if self._first is None:
            self._first, self._cpu = int(samples.arrival[0]), time.process_time()
            self.notice("first sample")
            self.add(self.make_sinks() if self.make_sinks is not None else ())
        pause = None if self.source.recorded else self._silence.came(samples.arrival)
        said = [] if pause is None else [f"samples come again after {pause:.2f} s"]
        if samples.anew.any():
            said.append(
                "numbers or clock begin anew: the sensor was restarted, or another program had its "
                "stream; its zero is compared with that before"
            )
        if said:
            self.say("; ".join(said), warns=True)
        for sink in self._sinks:
            sink.wrench(samples.stamp, samples.sequence, samples.force, samples.torque)
        self.processor.push(samples)

    def _work(self) -> None:
        for result in self.processor.ready(time.time_ns()):
            now = time.monotonic_ns()
            self._latency.add(now - result.arrival[result.arrival > self._steady])
            self._report.rows += len(result.stamp)
            for kind in ContactKind:
                self._report.contacts[kind.name] += int(np.sum(result.found.kind == kind))
            for sink in self._sinks:
                sink.contacts(result.stamp, result.raw, result.found)
            self._flush()
        self._flush()
        if self.processor.tare is not None:
            # Latencies count from here on: earlier rows waited for the tare, or behind such.
            self._steady = min(self._steady, time.monotonic_ns())

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
            self._take(samples)
        until = time.monotonic() + _LAST_WAIT
        self._work()
        untared = self.processor.tare is None
        while self.processor.waiting and not untared and time.monotonic() < until:
            time.sleep(0.01)
            self._work()
        if self._reader.error is not None:
            raise self._reader.error

    def _summed_up(self) -> Report:
        report, processor = self._report, self.processor
        report.overflow, report.unused = self._reader.overflow, processor.waiting
        report.without_pose, report.unsure = processor.without_pose, processor.unsure
        report.moved_during_tare = processor.moved_during_tare
        report.zero_changes = processor.zero_changes
        report.latency_median = self._latency.percentile(50)
        report.latency_999 = self._latency.percentile(99.9)
        if self._first is not None:
            report.seconds = self._seconds()
            report.cpu_share = (time.process_time() - self._cpu) / report.seconds
        return report
