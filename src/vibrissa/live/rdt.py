"""RDT (raw data transfer), the UDP protocol of Ethernet force/torque sensors: requests and records
as bytes. No sockets here.
"""

import struct
from enum import IntEnum

import numpy as np
from jaxtyping import Float

from vibrissa.geometry.checks import positive

PORT = 49152
MOST_RECORDS = 40
"""Most records in one datagram: the maximum of the sensors' buffered mode."""
ERROR_BIT = 1 << 31
"""Status bit that the sensor sets if its reading is not to be trusted; the lower bits say why."""
STATUS_BITS = {
    0: "temperature out of range",
    1: "supply voltage out of range",
    2: "broken gauge",
    3: "busy",
    5: "other error",
    7: "calibration not accessible",
    16: "monitor condition latched",
    27: "gauge out of range",
    28: "simulated error",
    29: "calibration checksum error",
    30: "force or torque out of range",
    31: "error",
}
"""Meaning of the status bits (ATI Industrial Automation, "Manual, F/T Sensor, Ethernet Axia",
documents 9610-05-Ethernet Axia-09, table 4.9, and 9620-05-C-Ethernet Axia-02, table 5.7); other
sensors may give the lower ones other meanings.
"""
MODULUS = 1 << 32
"""Sequence numbers wrap to 0 here."""

RECORD = np.dtype(
    [("rdt_sequence", ">u4"), ("ft_sequence", ">u4"), ("status", ">u4"), ("counts", ">i4", (6,))]
)
"""One sample: number of the record in this stream, number of the sensor's own sample, status, and
counts of fx, fy, fz, tx, ty, tz.
"""

_REQUEST = struct.Struct(">HHI")
_HEADER = 0x1234


def counts_per_unit(counts_per_force: float, counts_per_torque: float) -> Float[np.ndarray, "6"]:
    """Counts of fx, fy, fz, tx, ty, tz per newton and per newton metre.

    Raises
    ------
    ValueError
        If a number is not greater than 0.
    """
    force = positive(counts_per_force, "counts_per_force")
    return np.repeat([force, positive(counts_per_torque, "counts_per_torque")], 3)


class Command(IntEnum):
    """What a request asks for."""

    STOP = 0x0000
    REAL_TIME = 0x0002
    """One record per datagram."""
    BUFFERED = 0x0003
    """Several records per datagram."""
    RESET_LATCH = 0x0041
    BIAS = 0x0042
    """Take the present wrench as zero."""


def request_bytes(command: Command, count: int = 0) -> bytes:
    """Eight bytes `>HHI`: 0x1234, command, and the number of records wanted, 0 for an endless
    stream.

    Raises
    ------
    ValueError
        If `count` does not fit into 32 bits.
    """
    if not 0 <= count < MODULUS:
        raise ValueError(f"count = {count}; allowed is a whole number from 0 to {MODULUS - 1}")
    return _REQUEST.pack(_HEADER, command, count)


def parse_request(data: bytes) -> tuple[Command, int]:
    """Command and count from the bytes of `request_bytes`.

    Raises
    ------
    ValueError
        If there are not eight bytes, they do not begin with 0x1234, or the command is unknown.
    """
    header, command, count = _REQUEST.unpack(data) if len(data) == _REQUEST.size else (0, 0, 0)
    if header != _HEADER or command not in list(Command):
        allowed = ", ".join(f"{known:#06x}" for known in Command)
        raise ValueError(
            f"request {data[:16].hex()} of {len(data)} bytes; allowed are {_REQUEST.size} that "
            f"begin with {_HEADER:#06x} and one of {allowed}"
        )
    return Command(command), count


def parse_records(data: bytes) -> np.ndarray:
    """Records (n,) of type `RECORD` in one datagram.

    Raises
    ------
    ValueError
        If the datagram is empty, longer than `MOST_RECORDS` records, or not a whole number of them.
    """
    count, rest = divmod(len(data), RECORD.itemsize)
    if rest or not 1 <= count <= MOST_RECORDS:
        raise ValueError(
            f"datagram of {len(data)} bytes; allowed are 1 to {MOST_RECORDS} records of "
            f"{RECORD.itemsize} bytes"
        )
    return np.frombuffer(data, dtype=RECORD)
