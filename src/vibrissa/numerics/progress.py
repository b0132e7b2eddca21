"""How far a long computation has come, for whoever wants to know."""

import threading
from collections.abc import Callable
from typing import TypeAlias

Progress: TypeAlias = Callable[[int, int], None]
"""Called now and then with the work done and its total."""


class Tally:
    """Work done, added up over all threads; `progress`, if given, is called by one at a time."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0
        self._adding = threading.Lock()

    def add(self, work: int) -> None:
        """Count more work as done, and tell."""
        if self._progress is not None and work:
            with self._adding:
                self._done += work
                self._progress(self._done, self._total)


class Stages:
    """Rows that go through several stages together; each tallies its share of them."""

    def __init__(self, tally: Tally, rows: int, count: int) -> None:
        self._tally, self._left, self._each = tally, rows, rows // count

    def end_one(self) -> None:
        """Tally one of the stages, not the last."""
        self._left -= self._each
        self._tally.add(self._each)

    def end(self) -> None:
        """Tally all that is left."""
        self._tally.add(self._left)


class Guess:
    """Steps of work whose number is guessed, as a fit's: the total grows if it takes more."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def step(self) -> None:
        """Count one more step as done, and tell."""
        self._done += 1
        self._total = max(self._total, self._done + 1)
        if self._progress is not None:
            self._progress(self._done, self._total)

    def expect(self, more: int) -> None:
        """State how many steps there are still to come."""
        self._total = self._done + more

    def end(self) -> None:
        """Tell that all is done."""
        if self._progress is not None:
            self._progress(self._total, self._total)
