"""What a setup says of a live sensor: [rdt] and [pose]."""

from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from vibrissa.io.config import NO_TURN, ORIGIN, NotNegative, Positive, Quaternion, Table, Vector

Path = Annotated[
    str,
    StringConstraints(strict=True, min_length=1),
    Field(description="the path of a file, seen from the setup's folder"),
]
Bits = Annotated[int, Field(strict=True, ge=0, lt=1 << 32, description="a whole number of 32 bits")]
Boolean = Annotated[bool, Field(strict=True, description="true or false")]
Listen = Annotated[
    str,
    StringConstraints(strict=True, pattern=r"^udp://.+$"),
    Field(description="udp://HOST:PORT, such as udp://127.0.0.1:49153"),
]
Port = Annotated[int, Field(strict=True, ge=1, le=65535, description="a port from 1 to 65535")]


class RdtTable(Table):
    """An Ethernet sensor that speaks RDT: counts for one newton and for one newton metre, records a
    second, whether it sends several a datagram.

    `error_bits` are those of the status of which one makes a sample invalid.
    """

    counts_per_force: Positive
    counts_per_torque: Positive
    rate: Positive
    buffered: Boolean = False
    bias: Boolean = False
    error_bits: Bits = 1 << 31


class ConstantPoseTable(Table):
    """A sensor that stands: pose of the sensor frame in the world."""

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
    path: Path


class CasePoseTable(Table):
    """The motion of a case's trails, as `vibrissa simulate-sensor` plays it: clamp poses; it begins
    with the first sample.
    """

    kind: Literal["case"]
    path: Path
    rest: NotNegative
    sweep: Positive
    pause: Positive = 0.5


PoseTable = Annotated[
    ConstantPoseTable | UdpPoseTable | TrailPoseTable | CasePoseTable,
    Field(discriminator="kind", description="constant, udp, trail or case"),
]
