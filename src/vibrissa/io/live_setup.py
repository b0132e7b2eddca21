"""What a setup says of a live sensor: [rdt] and [pose]."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from vibrissa.io.config import (
    NO_TURN,
    ORIGIN,
    Boolean,
    NotNegative,
    Positive,
    Quaternion,
    Table,
    Vector,
    number,
)

PoseFile = Annotated[Path, Field(description="the path of a file, seen from the setup's folder")]
Listen = Annotated[
    str,
    StringConstraints(strict=True, pattern=r"^udp://.+$"),
    Field(description="udp://HOST:PORT, such as udp://127.0.0.1:49153"),
]


class RdtTable(Table):
    """An Ethernet sensor that speaks RDT: counts for one newton and for one newton metre, records a
    second, whether it sends several a datagram.

    A sample is invalid if any of the status bits `error_bits` is set.
    """

    counts_per_force: Positive
    counts_per_torque: Positive
    rate: Positive
    buffered: Boolean = False
    bias: Boolean = False
    error_bits: Annotated[int, number("a whole number of 32 bits", ge=0, lt=1 << 32)] = 1 << 31


class ConstantPoseTable(Table):
    """A sensor that stands still: pose of the sensor frame in the world."""

    kind: Literal["constant"]
    position: Vector = ORIGIN
    orientation: Quaternion = NO_TURN


class UdpPoseTable(Table):
    """Poses of the sensor frame as JSON over UDP."""

    kind: Literal["udp"]
    listen: Listen = "udp://127.0.0.1:49153"
    patience: Positive = 0.05


class TrailPoseTable(Table):
    """A motion of the sensor frame from a CSV file with the columns time,x,y,z,qx,qy,qz,qw; it
    begins with the first sample.
    """

    kind: Literal["trail"]
    path: PoseFile


class CasePoseTable(Table):
    """The motion of a case's trails, as `vibrissa simulate-sensor` plays it: clamp poses; it begins
    with the first sample.
    """

    kind: Literal["case"]
    path: PoseFile
    rest: NotNegative
    sweep: Positive
    pause: Positive = 0.5


PoseTable = Annotated[
    ConstantPoseTable | UdpPoseTable | TrailPoseTable | CasePoseTable,
    Field(discriminator="kind", description="constant, udp, trail or case"),
]
