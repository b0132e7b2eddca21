"""Records in the order of their numbers: gaps counted, swapped neighbours put right, doubles
dropped.
"""

from collections import deque
from collections.abc import Iterable

import numpy as np
from jaxtyping import Int

from vibrissa.live.rdt import MODULUS
from vibrissa.live.samples import Counts

AHEAD = 1_000_000
"""Numbers farther ahead are those of another stream."""

_HALF = MODULUS // 2
_BACK = 1000
_MOST_HELD = 512
_MOST_MISSED = 4096
_FOLLOWS = 40


class Sequencer:
    """Gives records on in the order of their 32-bit numbers, which wrap.

    A record whose predecessor is missing is held for up to `patience` seconds; then the gap is
    taken for lost. A record that came before, byte for byte, is a double. One whose number fits
    nowhere, since it was given on with another content, or lies back by more than 1000 or ahead by
    more than a million, is kept aside: where the next one goes on from it, the stream began anew,
    else it was damage.

    Parameters
    ----------
    counts
        Where losses are counted.
    patience
        How long to wait for a missing number [s].
    """

    def __init__(self, counts: Counts, patience: float = 0.003) -> None:
        self._counts = counts
        self._patience = round(patience * 1e9)
        self._next: int | None = None
        self._held: dict[int, tuple[np.void, int]] = {}
        self._missed: dict[int, bool] = {}
        self._given: deque[tuple[int, np.ndarray]] = deque()
        self._aside: tuple[int, np.void, int] | None = None

    def accept(
        self, records: np.ndarray, arrival: Int[np.ndarray, "n"], now: int
    ) -> tuple[np.ndarray, Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
        """Take records as they came and return those that are in order by now, their unwrapped
        numbers (m,) and arrivals (m,).

        Parameters
        ----------
        records
            (n,) with a field `rdt_sequence`; may be empty.
        arrival
            (n,) [ns].
        now
            The present [ns], on the clock of `arrival`.
        """
        number = records["rdt_sequence"].astype(np.int64)
        if (
            not self._held
            and len(records)
            and np.all(np.diff(number) == 1)
            and self._continues(int(number[0]))
        ):
            self._forget_aside()
            start = int(number[0]) if self._next is None else self._next
            self._next = start + len(records)
            self._remember(start, records)
            return records, start + np.arange(len(records), dtype=np.int64), arrival
        out: list[tuple[int, np.void, int]] = []
        for row, came, wrapped in zip(records, arrival.tolist(), number.tolist(), strict=True):
            self._take(row, came, wrapped, out)
        self._release(out, now)
        return _gathered(out, records.dtype)

    def _continues(self, wrapped: int) -> bool:
        return self._next is None or wrapped == self._next % MODULUS

    def _take(
        self, row: np.void, came: int, wrapped: int, out: list[tuple[int, np.void, int]]
    ) -> None:
        if self._next is None:
            self._next = wrapped
        ahead = (wrapped - self._next + _HALF) % MODULUS - _HALF
        number = self._next + ahead
        if not -_BACK <= ahead <= AHEAD or (ahead < 0 and not self._known(number, row)):
            self._doubt(row, came, wrapped, out)
            return
        if ahead < 0 or number in self._held:
            self._again(number)
            return
        self._forget_aside()
        if ahead > 0:
            self._held[number] = (row, came)
            return
        self._give(number, row, came, out)
        self._follow(out)

    def _known(self, number: int, row: np.void) -> bool:
        """Whether the record was missed, or is one that was given on."""
        if number in self._missed:
            return True
        for start, records in reversed(self._given):
            if start <= number < start + len(records):
                return records[number - start].tobytes() == row.tobytes()
        return False

    def _doubt(
        self, row: np.void, came: int, wrapped: int, out: list[tuple[int, np.void, int]]
    ) -> None:
        """Keep a record that fits nowhere aside, or take it for a new stream's if the last such one
        was just before it.
        """
        before = self._aside
        if before is None or not 1 <= (wrapped - before[0]) % MODULUS <= _FOLLOWS:
            self._forget_aside()
            self._aside = (wrapped, row, came)
            return
        assert self._next is not None
        self._aside = None
        while self._held:
            self._skip(out)
        self._counts.restarts += 1
        self._missed.clear()
        self._given.clear()
        first = max(self._next, 0) + MODULUS - self._next % MODULUS + before[0]
        self._give(first, before[1], before[2], out)
        self._take(row, came, wrapped, out)

    def _forget_aside(self) -> None:
        self._counts.malformed += self._aside is not None
        self._aside = None

    def _give(
        self, number: int, row: np.void, came: int, out: list[tuple[int, np.void, int]]
    ) -> None:
        out.append((number, row, came))
        self._remember(number, np.asarray(row).reshape(1))
        self._next = number + 1

    def _remember(self, start: int, records: np.ndarray) -> None:
        self._given.append((start, records))
        while self._given[0][0] + len(self._given[0][1]) < start - _BACK:
            self._given.popleft()

    def _again(self, number: int) -> None:
        if self._missed.get(number, False):
            self._missed[number] = False
            self._counts.late += 1
        else:
            self._counts.duplicates += 1

    def _follow(self, out: list[tuple[int, np.void, int]]) -> None:
        """Held records that are next now: they had come before their predecessor."""
        assert self._next is not None
        while self._held and self._next in self._held:
            self._give(self._next, *self._held.pop(self._next), out)
            self._counts.reordered += 1

    def _release(self, out: list[tuple[int, np.void, int]], now: int) -> None:
        while self._held:
            oldest = min(came for _, came in self._held.values())
            if now - oldest < self._patience and len(self._held) <= _MOST_HELD:
                return
            self._skip(out)

    def _skip(self, out: list[tuple[int, np.void, int]]) -> None:
        """Give up the numbers before the first held record."""
        assert self._next is not None
        first = min(self._held)
        self._counts.gaps += 1
        self._counts.lost += first - self._next
        self._miss(range(max(self._next, first - _MOST_MISSED), first))
        self._next = first
        before = self._counts.reordered
        self._follow(out)
        self._counts.reordered = before

    def _miss(self, numbers: Iterable[int]) -> None:
        self._missed.update(dict.fromkeys(numbers, True))
        while len(self._missed) > _MOST_MISSED:
            del self._missed[next(iter(self._missed))]


def _gathered(
    out: list[tuple[int, np.void, int]], kind: np.dtype
) -> tuple[np.ndarray, Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
    rows = np.array([row for _, row, _ in out], dtype=kind)
    return (
        rows,
        np.array([number for number, _, _ in out], dtype=np.int64),
        np.array([came for _, _, came in out], dtype=np.int64),
    )
