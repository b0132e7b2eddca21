"""Lines of CSV over TCP and a serial line, whatever they hold."""

import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from bench_files import HEADER, RECORDING, recording_table
from hypothesis import given
from hypothesis import strategies as st

from vibrissa.live.lines import (
    BARE,
    POSED,
    LineSource,
    WrongColumnsError,
    parse_header,
    parse_line,
    serial_line,
    tcp_line,
)
from vibrissa.live.samples import EndOfStreamError, Samples, joined

LINES = RECORDING.splitlines()


@contextmanager
def pieces(*given: bytes) -> Iterator[Callable[[float], bytes]]:
    """A line that gives these, one at a time."""
    left = list(given)

    def receive(timeout: float) -> bytes:
        if not left:
            raise EndOfStreamError
        return left.pop(0)

    yield receive


def everything(source: LineSource) -> Samples | None:
    source.open()
    parts = []
    until = time.monotonic() + 10
    try:
        while time.monotonic() < until:
            part = source.read(0.1)
            if part is not None:
                parts.append(part)
    except EndOfStreamError:
        pass
    finally:
        source.close()
    return joined(parts) if parts else None


def check(found: Samples | None, rows: slice = slice(None), *, paced: bool = True) -> None:
    """Against the numbers that were sent; times too, unless stamps follow the host's clock and
    lines were sent faster than they say.
    """
    table = recording_table()[rows]
    assert found is not None
    for part, columns in (
        (found.position, slice(1, 4)),
        (found.orientation, slice(4, 8)),
        (found.force, slice(8, 11)),
        (found.torque, slice(11, 14)),
    ):
        np.testing.assert_allclose(part, table[:, columns], atol=6e-6)
    assert np.all(np.diff(found.stamp) > 0)
    if paced:
        np.testing.assert_allclose(np.diff(found.stamp) * 1e-9, np.diff(table[:, 0]), atol=1e-6)


@pytest.mark.parametrize("size", [1, 7, 100, 1_000_000])
def test_lines_in_pieces_of_any_size(size: int) -> None:
    data = RECORDING.encode()
    source = LineSource(
        pieces(*(data[start : start + size] for start in range(0, len(data), size)))
    )
    found = everything(source)
    assert len(found or ()) == source.counts.samples == 40
    assert source.counts.malformed == 0
    check(found)


def test_on_the_hosts_clock_no_line_is_stamped_after_it_came() -> None:
    """Lines that were sent faster than their times say."""
    source = LineSource(pieces(RECORDING.encode()), on_host_clock=True)
    found = everything(source)
    check(found, paced=False)
    assert found is not None
    assert np.all(found.stamp <= time.time_ns() + 1_000_000)


def test_without_a_header_and_without_poses() -> None:
    check(everything(LineSource(pieces("\n".join(LINES[1:]).encode() + b"\n"))))
    bare = "\n".join(",".join([line.split(",")[0], *line.split(",")[8:]]) for line in LINES[1:])
    found = everything(LineSource(pieces(bare.encode() + b"\r\n")))
    assert found is not None
    assert found.position is None
    np.testing.assert_allclose(found.force, recording_table()[:, 8:11], atol=6e-6)


def test_columns_in_another_order() -> None:
    order = np.random.default_rng(0).permutation(14)
    text = "\n".join(",".join(np.array(line.split(","))[order]) for line in LINES)
    check(everything(LineSource(pieces(text.encode() + b"\n"))))


@pytest.mark.parametrize("end", ["\r", "\r\n"])
def test_other_ends_of_lines(end: str) -> None:
    check(everything(LineSource(pieces((end.join(LINES) + end).encode()))))


def test_further_columns_are_left_out() -> None:
    names = " , ".join(f'"{name}"' for name in ["state", *LINES[0].upper().split(",")])
    source = LineSource(
        pieces("\n".join([names, *(f"ok,{line}" for line in LINES[1:]), ""]).encode())
    )
    check(everything(source))
    assert source.counts.malformed == 0


@pytest.mark.parametrize(
    "names",
    [
        "t,tx,ty,tz,fx,fy,fz",
        "time,px,py,pz,fx,fy,fz,tx,ty,tz",
        "time,fx,fy,fz,tx,ty,ty",
        "fz,fy,fx,tx,ty,tz",
    ],
)
def test_other_columns_are_no_guess(names: str) -> None:
    """Numbers below such names would be taken for others."""
    with pytest.raises(WrongColumnsError, match=r"allowed are time,px"):
        everything(LineSource(pieces(f"{names}\n1,2,3,4,5,6,7\n".encode())))


def test_the_rest_of_a_line_of_names_is_no_error() -> None:
    source = LineSource(pieces((LINES[0][20:] + "\n" + "\n".join(LINES[1:]) + "\n").encode()))
    check(everything(source))
    assert source.counts.malformed == 0


def test_a_clock_that_is_set_or_damaged_moves_nothing() -> None:
    """Times far ahead and far back, again and again, and those that no clock shows: others keep
    their distances.
    """
    table = [line.split(",", 1) for line in LINES[1:]]
    text = [LINES[0]]
    for place, (moment, rest) in enumerate(table):
        text += [f"{moment},{rest}"]
        if place % 10 == 4:
            text += [f"{wrong},{rest}" for wrong in ("3.9e9", "-3.9e9", "1e11", "-1e300")]
    source = LineSource(pieces(("\n".join(text) + "\n").encode()))
    found = everything(source)
    assert found is not None
    assert (source.counts.restarts, source.counts.malformed, len(found)) == (12, 8, 48)
    assert np.all(np.diff(found.stamp) > 0)
    assert found.stamp[-1] - found.stamp[0] < 1e9 * (float(table[-1][0]) - float(table[0][0])) + 5e8
    assert len(np.unique(found.stamp * 1e-9 - found.stamp[0] * 1e-9)) == 48


def test_bad_lines_are_counted_and_left_out() -> None:
    bad = [
        "nonsense",
        "1,2,3",
        ",".join(["nan"] * 14),
        "x" * 10_000,
        LINES[6].replace(",", ";"),
        LINES[5][:-1] + "_0",
        ",".join(["1e300"] * 14),
        "\0\xff",
    ]
    text = "\n".join([*LINES[:6], *bad, *LINES[6:]]) + "\n"
    source = LineSource(pieces(text.encode("latin-1")))
    check(everything(source))
    assert source.counts.malformed == len(bad)


def test_a_line_without_end_takes_no_memory() -> None:
    source = LineSource(
        pieces(LINES[0].encode() + b"\n", *[b"7" * 60_000] * 50, b"\n" + LINES[1].encode() + b"\n")
    )
    found = everything(source)
    assert len(found or ()) == 1
    assert source.counts.malformed == 1


def test_time_that_stands_goes_back_or_begins_anew() -> None:
    text = "\n".join([*LINES[:30], LINES[29], LINES[27], *LINES[30:40], *LINES[1:11]]) + "\n"
    source = LineSource(pieces(text.encode()))
    found = everything(source)
    assert found is not None
    assert np.all(np.diff(found.stamp) > 0)
    assert (source.counts.duplicates, source.counts.late, source.counts.restarts, len(found)) == (
        1,
        1,
        1,
        39 + 10,
    )


def test_poses_do_not_begin_in_the_middle() -> None:
    bare = ",".join([LINES[3].split(",")[0], *LINES[3].split(",")[8:]])
    source = LineSource(pieces(("\n".join([*LINES[1:3], bare, *LINES[4:]]) + "\n").encode()))
    found = everything(source)
    assert found is not None
    assert found.position is not None
    assert (len(found), source.counts.malformed) == (39, 1)


def test_the_rest_of_a_line_that_began_before_is_no_error() -> None:
    source = LineSource(pieces(("0.3,17\n" + "\n".join(LINES[1:]) + "\n").encode()))
    check(everything(source))
    assert source.counts.malformed == 0


@given(
    st.one_of(
        st.binary(max_size=60),
        st.lists(st.floats().map(repr), min_size=6, max_size=15).map(
            lambda cells: ",".join(cells).encode()
        ),
    )
)
def test_any_line_is_numbers_or_a_value_error(line: bytes) -> None:
    try:
        parse_header(line)
        row = parse_line(line)
    except ValueError:
        return
    assert tuple(row) in (POSED, BARE)
    assert abs(row["time"]) <= 4e9
    assert np.all(np.isfinite(list(row.values())))


@contextmanager
def serving(data: bytes) -> Iterator[int]:
    """A server on the loopback address that sends this to the first who connects."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection:
                connection.sendall(data)

        thread = threading.Thread(target=serve)
        thread.start()
        yield server.getsockname()[1]
        thread.join(5)


def test_over_tcp() -> None:
    with serving(RECORDING.encode()) as port:
        check(everything(LineSource(tcp_line("127.0.0.1", port))))


def test_over_a_serial_line() -> None:
    """A pseudo terminal stands for the device."""
    import tty

    master, slave = os.openpty()
    tty.setraw(slave)
    source = LineSource(serial_line(os.ttyname(slave), 115200))
    source.open()
    try:
        os.write(master, "\n".join([HEADER, *LINES[1:15]]).encode() + b"\n")
        parts: list[Samples] = []
        until = time.monotonic() + 10
        while sum(map(len, parts)) < 14 and time.monotonic() < until:
            part = source.read(0.1)
            parts += [part] if part is not None else []
        check(joined(parts), slice(0, 14))
        os.close(master)
        with pytest.raises(EndOfStreamError):
            while time.monotonic() < until:
                source.read(0.1)
    finally:
        source.close()
        os.close(slave)


def test_without_pyserial_the_error_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(ImportError, match=r"pip install 'vibrissa\[live\]'"):
        LineSource(serial_line("/dev/null", 9600)).open()
