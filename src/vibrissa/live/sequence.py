"""Records in the order of their numbers: gaps are counted, swapped neighbours put in order,
duplicates dropped.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vibrissa.live.clock import AHEAD
from vibrissa.live.rdt import MODULUS, MOST_RECORDS, RECORD
from vibrissa.live.samples import Counts, Nanoseconds

# Records remembered to detect duplicates: 0.14 s at 7000 a second, longer than network delays.
_BACK = 1000
# Records that may wait for a missing one: 0.07 s at 7000 a second, beyond any patience.
_MOST_HELD = 512
_BYTES = np.dtype(f"V{RECORD.itemsize}")
_ORDERED = [("number", "i8"), ("record", _BYTES), ("arrival", "i8")]
ORDERED = np.dtype([("number", "i8"), ("record", RECORD), ("arrival", "i8")])
"""A record in order: its unwrapped number, the record, and its arrival [ns]."""


class _Record(NamedTuple):
    """A record as it came: its wrapped number, its bytes, and its arrival."""

    wrapped: int
    content: bytes
    came: int


@dataclass(eq=False)
class Sequencer:
    """Passes records on in the order of their 32-bit numbers, which wrap.

    A record whose predecessor is missing is held for up to `patience`; then the gap counts as lost.
    A record that came before, byte for byte, is a duplicate. A record whose number fits nowhere
    (passed on before with other content, more than 1000 back, or more than a million ahead) is set
    aside: if the next one continues from it, the stream restarted; otherwise the record was
    corrupt.

    Attributes
    ----------
    counts
        Where losses are counted.
    patience
        How long to wait for a missing number [ns].
    """

    counts: Counts
    patience: int = 3_000_000

    def __post_init__(self) -> None:
        self._next = -1  # until the first record
        self._held: dict[int, _Record] = {}
        # The last 1000 records passed on, by number; None for a number that was given up.
        self._past: dict[int, bytes | None] = {}
        self._aside: _Record | None = None
        self._out: list[tuple[int, bytes, int]] = []

    def accept(self, records: np.ndarray, arrival: Nanoseconds, now: int) -> np.ndarray:
        """Take records (n,) of type `RECORD` as they came, and return those now in order, of type
        `ORDERED`; `now` [ns] is on the clock of `arrival`.
        """
        contents = records.view(_BYTES).tolist()
        for row in zip(records["rdt_sequence"].tolist(), contents, arrival.tolist(), strict=True):
            self._take(_Record(*row))
        while self._held and (
            len(self._held) > _MOST_HELD
            or now - min(record.came for record in self._held.values()) >= self.patience
        ):
            self._give_up()
        while len(self._past) > _BACK:
            del self._past[next(iter(self._past))]
        out, self._out = self._out, []
        return np.array(out, dtype=_ORDERED).view(ORDERED)

    def _take(self, record: _Record) -> None:
        wrapped, content, _ = record
        if self._next < 0:
            self._next = wrapped
        half = MODULUS // 2
        number = self._next + (wrapped - self._next + half) % MODULUS - half
        seen = self._past.get(number, b"")
        if number in self._held or seen == content:
            self.counts.duplicates += 1
        elif seen is None:
            self._past[number] = content
            self.counts.late += 1
        elif self._next <= number <= self._next + AHEAD:
            self._set_aside(None)
            self._held[number] = record
            self.counts.reordered += max(self._give_held(self._next) - 1, 0)
        elif self._aside and 1 <= (wrapped - self._aside.wrapped) % MODULUS <= MOST_RECORDS:
            self._begin_anew(self._aside, record)
        else:
            self._set_aside(record)

    def _set_aside(self, record: _Record | None) -> None:
        """Set a record aside in place of the previous one, which was corrupt."""
        self.counts.malformed += self._aside is not None
        self._aside = record

    def _begin_anew(self, *records: _Record) -> None:
        """Continue the numbering with a new stream's first records."""
        self._aside = None
        while self._held:
            self._give_up()
        self.counts.restarts += 1
        self._past.clear()
        self._next += MODULUS - self._next % MODULUS + records[0].wrapped
        for record in records:
            self._take(record)

    def _give_held(self, first: int) -> int:
        """Pass on the records held from this number on, and return how many there were."""
        self._next = first
        while self._next in self._held:
            _, content, came = self._held.pop(self._next)
            self._out.append((self._next, content, came))
            self._past[self._next] = content
            self._next += 1
        return self._next - first

    def _give_up(self) -> None:
        """Skip the numbers before the first held record."""
        first = min(self._held)
        self.counts.gaps += 1
        self.counts.lost += first - self._next
        self._past |= dict.fromkeys(range(max(self._next, first - _BACK), first))
        self._give_held(first)
