"""The thread that reads a source, so that nothing is missed while another one works."""

import threading
from collections import deque

from vibrissa.live.samples import EndOfStreamError, Samples, Source, joined

_MOST_QUEUED = 200_000  # samples: half a minute of the fastest sensor, some 30 MB
_READ_WAIT = 0.05  # [s]: how late a stop may be seen


class Reader:
    """Reads the source in a thread of its own, into a bounded queue."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._queue: deque[Samples] = deque()
        self._arrived, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="source", daemon=True)
        self.error: BaseException | None = None
        self.overflow = 0

    @property
    def ended(self) -> bool:
        """Whether nothing more will come."""
        return not self._thread.is_alive()

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """Stop reading."""
        self._stop.set()
        if not self.ended:
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

    def _put(self, samples: Samples) -> None:
        while sum(map(len, list(self._queue))) + len(samples) > _MOST_QUEUED:
            if not self._source.waits:
                self.overflow += len(samples)
                return
            if self._stop.wait(_READ_WAIT):
                return
        self._queue.append(samples)
        self._arrived.set()

    def take(self, wait: float) -> Samples | None:
        """Everything that is there, or None after `wait` seconds."""
        self._arrived.wait(wait)
        self._arrived.clear()
        parts = [self._queue.popleft() for _ in range(len(self._queue))]
        return joined(parts) if parts else None
