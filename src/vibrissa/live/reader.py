"""The thread that reads a source, so that nothing is missed while another one works."""

import threading
from collections import deque

from vibrissa.live.samples import EndOfStreamError, Samples, Source, joined

_MOST_QUEUED = 200_000
_READ_WAIT = 0.05


class Reader:
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
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """Read no more."""
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
        """What was wrong with the last of what could not be read."""
        return self._source.complaint

    def _put(self, samples: Samples) -> None:
        with self._arrived:
            while (
                self._queued + len(samples) > _MOST_QUEUED
                and self._source.waits
                and not self._stop.is_set()
            ):
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
