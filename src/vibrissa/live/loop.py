"""The loop: one thread reads the source, this one works and writes."""

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack

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
        loop = _Loop(source, processor, sinks, notice or (lambda _: None), closing)
        processor.warm_up()
        if poses is not None:
            closing.callback(poses.close)
            poses.open()
        closing.callback(source.close)
        source.open()
        ended = stop or threading.Event()
        report = loop.run(ended, duration or np.inf, silence or np.inf, batch_seconds)
    if poses is not None:
        report.malformed_poses, report.misplaced_poses = poses.malformed, poses.misplaced
    for text in report.losses():
        loop.say(text, warns=True)
    return report


class _Loop:
    def __init__(
        self,
        source: Source,
        processor: Processor,
        sinks: Sequence[Sink] | Callable[[], Iterable[Sink]],
        notice: Callable[[str], None],
        closing: ExitStack,
    ) -> None:
        self._source, self._processor, self._notice = source, processor, notice
        self._closing = closing
        self._make_sinks = sinks if callable(sinks) else None
        self._sinks: list[Sink] = []
        self._add([] if callable(sinks) else sinks)
        self._reader, self._silence, self._latency = Reader(source), SilenceWatch(), Latency()
        self._report = Report(source.counts)
        self._flushed = self._steady = 0
        self._first: int | None = None
        self._cpu = 0.0

    def _add(self, sinks: Iterable[Sink]) -> None:
        for sink in sinks:
            self._closing.callback(sink.close)
            self._sinks.append(sink)

    def run(
        self, stop: threading.Event, duration: float, silence: float, batch_seconds: float
    ) -> Report:
        """Until the source, the duration or `stop` ends it; times in seconds."""
        self._closing.callback(self._reader.stop)
        self._reader.start()
        self._notice("waiting for samples")
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
            elif not self._source.recorded and self._silence.begins(begun):
                text = "no samples come: is the sensor on, its cable in, or has another program"
                self.say(f"{text} taken its stream?", warns=True)
            self._work()
            time.sleep(max(batch_seconds - (time.monotonic_ns() - begun) * 1e-9, 0.0))
        lasting = self._silence.until(0 if ended else begun)
        self._report.silences, self._report.silent_seconds = lasting
        self._finish()
        why = f"nothing came for {silence:g} s" if silent else "the source ended"
        if self._first is None and (ended or silent):
            malformed = self._source.counts.malformed
            unread = f"{malformed} lines or datagrams could not be read, the last one for: "
            unread = f"; {unread}{self._source.complaint}" if malformed else ""
            raise SilentSourceError(f"{why} before its first sample{unread}")
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
            self._notice(text)
        elif self._report.warn(text):
            self._notice(f"warning: {text}")

    def _take(self, samples: Samples) -> None:
        if self._first is None:
            self._first, self._cpu = int(samples.arrival[0]), time.process_time()
            self._notice("first sample")
            self._add(self._make_sinks() if self._make_sinks is not None else ())
        pause = None if self._source.recorded else self._silence.came(samples.arrival)
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
        self._processor.push(samples)
        self._tell_news()

    def _tell_news(self) -> None:
        for text, warns in self._processor.news():
            self.say(text, warns=warns)

    def _work(self) -> None:
        for result in self._processor.ready(time.time_ns()):
            now = time.monotonic_ns()
            self._steady = now if result.held else self._steady
            self._latency.add(now - result.arrival[result.arrival > self._steady])
            self._report.rows += len(result.stamp)
            for kind in ContactKind:
                self._report.contacts[kind.name] += int(np.sum(result.found.kind == kind))
            for sink in self._sinks:
                sink.contacts(result.stamp, result.raw, result.found)
            self._flush()
            self._tell_news()
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
            self._take(samples)
        until = time.monotonic() + _LAST_WAIT
        self._work()
        untared = self._processor.tare is None
        while self._processor.waiting and not untared and time.monotonic() < until:
            time.sleep(0.01)
            self._work()
        if self._reader.error is not None:
            raise self._reader.error

    def _summed_up(self) -> Report:
        report, processor = self._report, self._processor
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
