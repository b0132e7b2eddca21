"""Records in order: what is lost, late, double or swapped is counted as it is."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vibrissa.live.rdt import RECORD
from vibrissa.live.samples import Counts
from vibrissa.live.sequence import Sequencer

MS = 1_000_000


class Stream:
    """Feeds numbers to a sequencer, each at its time in milliseconds."""

    def __init__(self) -> None:
        self.counts = Counts()
        self._sequencer = Sequencer(self.counts)
        self.out: list[int] = []
        self.wrapped: list[int] = []

    def feed(self, numbers: list[int], at: float, sample: int = 0) -> "Stream":
        """These came together; what they hold goes by `sample`."""
        records = np.zeros(len(numbers), dtype=RECORD)
        records["rdt_sequence"] = [number % 2**32 for number in numbers]
        records["ft_sequence"] = sample
        moment = round(at * MS)
        arrival = np.full(len(numbers), moment, dtype=np.int64)
        rows = self._sequencer.accept(records, arrival, moment)
        wrapped = rows["record"]["rdt_sequence"]
        assert np.array_equal(wrapped, rows["number"] % 2**32)
        assert np.all(rows["arrival"] <= moment)
        self.out += rows["number"].tolist()
        self.wrapped += wrapped.tolist()
        return self

    def has(self, **counts: int) -> bool:
        """Whether these are the counts, and all others zero."""
        return vars(self.counts) == vars(Counts(**counts))


def test_in_order() -> None:
    stream = Stream().feed([1, 2, 3], 0).feed([], 1).feed([4], 2)
    assert stream.out == [1, 2, 3, 4]
    assert stream.has()


def test_a_gap_is_lost_after_a_while() -> None:
    stream = Stream().feed([1, 2], 0).feed([6, 7], 1)
    assert stream.out == [1, 2]
    stream.feed([8], 5)
    assert stream.out == [1, 2, 6, 7, 8]
    assert stream.has(lost=3, gaps=1)
    stream.feed([4], 6).feed([4], 7)
    assert stream.out == [1, 2, 6, 7, 8]
    assert stream.has(lost=3, gaps=1, late=1, duplicates=1)


def test_neighbours_that_are_swapped() -> None:
    stream = Stream().feed([1, 3], 0).feed([2], 1).feed([4], 2)
    assert stream.out == [1, 2, 3, 4]
    assert stream.has(reordered=1)


def test_doubles() -> None:
    stream = Stream().feed([1, 1, 2], 0).feed([2, 3, 5, 5], 1).feed([4], 2)
    assert stream.out == [1, 2, 3, 4, 5]
    assert stream.has(duplicates=3, reordered=1)


def test_numbers_wrap() -> None:
    stream = Stream().feed([2**32 - 2, 2**32 - 1], 0).feed([0, 1], 1).feed([3], 2).feed([4], 9)
    assert stream.out == [2**32 - 2, 2**32 - 1, 2**32, 2**32 + 1, 2**32 + 3, 2**32 + 4]
    assert stream.wrapped == [2**32 - 2, 2**32 - 1, 0, 1, 3, 4]
    assert stream.has(lost=1, gaps=1)


@pytest.mark.parametrize("jump", [1, 3_000_000])
def test_a_stream_that_begins_anew(jump: int) -> None:
    """A sensor that was switched off and on: numbers go on increasing here, and nothing counts as
    lost.
    """
    stream = Stream().feed(list(range(50_000, 50_010)), 0).feed([jump, jump + 1], 1)
    assert np.all(np.diff(stream.out) > 0)
    assert stream.wrapped[-2:] == [jump, jump + 1]
    assert stream.has(restarts=1)


@pytest.mark.parametrize("before", [2, 600, 1000])
def test_a_stream_that_begins_anew_before_it_was_long(before: int) -> None:
    """Asked again after a silence, the sensor numbers from 1: the same numbers, other samples; none
    is a double.
    """
    stream = (
        Stream()
        .feed(list(range(1, before + 1)), 0)
        .feed([1, 2, 3], 2000, sample=7)
        .feed([4], 2001, sample=7)
    )
    assert len(stream.out) == before + 4
    assert np.all(np.diff(stream.out) > 0)
    assert stream.wrapped[-4:] == [1, 2, 3, 4]
    assert stream.has(restarts=1)


def test_a_new_stream_of_which_some_is_lost() -> None:
    """The second record is lost, and the first two that came are swapped: the one that cannot be
    placed is damage.
    """
    stream = (
        Stream()
        .feed(list(range(5000, 5010)), 0)
        .feed([3, 1, 4], 1, sample=1)
        .feed([5], 9, sample=1)
    )
    assert stream.wrapped[-3:] == [1, 4, 5]
    assert stream.has(restarts=1, malformed=1, lost=2, gaps=1)


@pytest.mark.parametrize("number", [0, 77, 2**31, 123_456_789, 2**32 - 1, 4_500])
def test_damage_as_long_as_a_record_is_no_new_stream(number: int) -> None:
    """Bytes that happen to be 36, with any number, between records: counted and left out, again and
    again.
    """
    stream = Stream().feed(list(range(5000, 5010)), 0)
    for place in range(20):
        stream.feed([number], 1 + place, sample=100 + place).feed([5010 + place], 1 + place)
    assert stream.out == list(range(5000, 5030))
    assert stream.has(malformed=20)


def test_doubles_of_a_whole_datagram() -> None:
    """Forty records that were given on, byte for byte again: no new stream, whatever their number."""
    numbers = list(range(1, 41))
    stream = Stream().feed(numbers, 0).feed(numbers, 1).feed([41], 2)
    assert stream.out == list(range(1, 42))
    assert stream.has(duplicates=40)


@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 3)), max_size=60))
def test_any_numbers_come_out_increasing(rows: list[tuple[int, int]]) -> None:
    """Nothing is given on twice, and every record is somewhere in the counts."""
    stream = Stream()
    for place, (number, sample) in enumerate(rows):
        stream.feed([number], place * 0.1, sample=sample)
    stream.feed([], 1e6)
    assert np.all(np.diff(stream.out) > 0)
    counts = stream.counts
    aside = len(rows) - len(stream.out) - counts.duplicates - counts.malformed - counts.late
    assert aside in (0, 1)


@given(st.data())
def test_any_mix_adds_up(data: st.DataObject) -> None:
    """What comes out is increasing and came in; lost, doubles and out add up to what was sent."""
    count = data.draw(st.integers(2, 80))
    start = data.draw(st.sampled_from([1, 2**31 - 20, 2**32 - 30]))
    dropped = data.draw(st.sets(st.integers(1, count - 2), max_size=10)) if count > 2 else set()
    sent = [start + number for number in range(count) if number not in dropped]
    places = [place + data.draw(st.floats(0, 3)) for place in range(len(sent))]
    doubles = data.draw(st.lists(st.sampled_from(sent), max_size=5))
    order = [
        sent[0],
        *(number for _, number in sorted(zip(places[1:], sent[1:], strict=True))),
        *doubles,
    ]
    stream, rest = Stream(), list(order)
    for moment in range(len(order)):
        size = data.draw(st.integers(0, 6))
        stream.feed(rest[:size], moment * 0.1)
        rest = rest[size:]
    stream.feed(rest, 50).feed([], 60)
    assert stream.out == sorted(set(stream.out))
    assert set(stream.out) <= set(sent)
    assert len(stream.out) + stream.counts.late == len(sent)
    assert stream.counts.lost == len(dropped) + stream.counts.late
    assert stream.counts.duplicates == len(doubles)
