"""RDT as bytes: against the protocol's own layout, written out here by hand, and against anything
at all.
"""

import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vibrissa.live import rdt


@pytest.mark.parametrize(
    ("command", "count", "wire"),
    [
        (rdt.Command.STOP, 0, "1234 0000 00000000"),
        (rdt.Command.REAL_TIME, 0, "1234 0002 00000000"),
        (rdt.Command.BUFFERED, 1000, "1234 0003 000003e8"),
        (rdt.Command.BIAS, 2**32 - 1, "1234 0042 ffffffff"),
    ],
)
def test_requests(command: rdt.Command, count: int, wire: str) -> None:
    assert rdt.request_bytes(command, count) == bytes.fromhex(wire)
    assert rdt.parse_request(bytes.fromhex(wire)) == (command, count)


@pytest.mark.parametrize(
    "wire",
    [
        "",
        "1234",
        "1234 0002 0000000000",
        "3412 0002 00000000",
        "1234 0001 00000000",
        "1234 ffff 00000000",
    ],
)
def test_requests_that_are_none(wire: str) -> None:
    with pytest.raises(ValueError, match="allowed"):
        rdt.parse_request(bytes.fromhex(wire))


@pytest.mark.parametrize("count", [-1, 2**32])
def test_a_count_that_does_not_fit(count: int) -> None:
    with pytest.raises(ValueError, match="count"):
        rdt.request_bytes(rdt.Command.REAL_TIME, count)


def test_records() -> None:
    rows = [
        (1, 7, 0, 1, -2, 3, -4, 5, -6),
        (2**32 - 1, 2**32 - 1, 0x8001_0000, -(2**31), 2**31 - 1, 0, 0, 0, 0),
    ]
    found = rdt.parse_records(b"".join(struct.pack(">IIIiiiiii", *row) for row in rows))
    assert [
        (*map(int, record.tolist()[:3]), *record["counts"].tolist()) for record in found
    ] == rows


@pytest.mark.parametrize("size", [0, 1, 35, 37, 36 * 41, 65535])
def test_datagrams_of_another_size(size: int) -> None:
    with pytest.raises(ValueError, match="allowed"):
        rdt.parse_records(bytes(size))


@given(st.binary(max_size=1600))
def test_any_bytes_are_records_or_a_value_error(data: bytes) -> None:
    try:
        found = rdt.parse_records(data)
    except ValueError:
        assert len(data) % 36 or not 36 <= len(data) <= 1440
    else:
        assert np.array(found, dtype=rdt.RECORD).tobytes() == data


@given(st.binary(max_size=20))
def test_any_bytes_are_a_request_or_a_value_error(data: bytes) -> None:
    try:
        found = rdt.parse_request(data)
    except ValueError:
        return
    assert rdt.request_bytes(*found) == data
