"""One experiment: rod, sensor and, if known, the object (`setup.toml`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import numpy as np
from jaxtyping import Float
from pydantic import Field, StringConstraints

from vibrissa.io.calibration import CalibrationTable
from vibrissa.io.config import (
    IN_ONE,
    NO_TURN,
    ORIGIN,
    Boolean,
    Finite,
    Lengths,
    NotNegative,
    Positive,
    Quaternion,
    Site,
    Table,
    Vector,
    load,
    number,
    several,
    table_of,
)
from vibrissa.io.objects import ObjectTable
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.io.rod import RodTable
from vibrissa.numerics.progress import Progress
from vibrissa.rod import Rod
from vibrissa.sensor import LowPass, Mount, Sensor
from vibrissa.sensor.presets import PRESETS
from vibrissa.surfaces import Surface
from vibrissa.tolerances import Tolerances

PoseFile = Annotated[Path, Field(description="the path of a file, relative to the setup's folder")]
Listen = Annotated[
    str,
    StringConstraints(strict=True, pattern=r"^udp://.+$"),
    Field(description="udp://HOST:PORT, such as udp://127.0.0.1:49153"),
]


class RdtTable(Table):
    """An Ethernet sensor that speaks RDT: counts per newton and per newton metre, records per
    second, and whether a datagram holds several records.

    A sample is invalid if any of the status bits in `error_bits` is set.
    """

    counts_per_force: Positive
    counts_per_torque: Positive
    rate: Positive
    buffered: Boolean = False
    bias: Boolean = False
    error_bits: Annotated[int, number("a whole number of 32 bits", ge=0, lt=1 << 32)] = 1 << 31


class ConstantPoseTable(Table):
    """A stationary sensor: pose of the sensor frame in the world."""

    kind: Literal["constant"]
    position: Vector = ORIGIN
    orientation: Quaternion = NO_TURN


class UdpPoseTable(Table):
    """Poses of the sensor frame as JSON over UDP."""

    kind: Literal["udp"]
    listen: Listen = "udp://127.0.0.1:49153"
    patience: Positive = 0.05


class TrailPoseTable(Table):
    """Motion of the sensor frame from a CSV file with the columns time,x,y,z,qx,qy,qz,qw, starting
    at the first sample.
    """

    kind: Literal["trail"]
    path: PoseFile


class CasePoseTable(Table):
    """Motion along a case's trails (clamp poses), as `vibrissa simulate-sensor` plays it, starting
    at the first sample.
    """

    kind: Literal["case"]
    path: PoseFile
    rest: NotNegative
    sweep: Positive
    pause: Positive = 0.5


PoseTable: TypeAlias = ConstantPoseTable | UdpPoseTable | TrailPoseTable | CasePoseTable


@dataclass(frozen=True)
class Setup:
    """What is needed to read a recording.

    Attributes
    ----------
    rod
        The rod, SI units.
    sensor
        Mount, and sign, frame and noise of the wrench. It is told of the rod if loads act along it.
    surface
        The scanned object, or None.
    recording
        Layout of its recordings; None for CSV as `write_recording` writes it, and for the names of
        that header in other formats.
    rdt, pose
        For a live sensor, or None: its counts and rates, and where its pose comes from.
    calibration
        What is known about the numbers of a calibrated setup, or None.
    tolerances
        How well the other numbers are known; None if the setup does not say.
    """

    rod: Rod
    sensor: Sensor
    surface: Surface | None = None
    recording: RecordingTable | None = None
    rdt: RdtTable | None = None
    pose: PoseTable | None = None
    calibration: CalibrationTable | None = None
    tolerances: Tolerances | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensor", self.sensor.carrying(self.rod))

    @property
    def parameter_covariance(self) -> Float[np.ndarray, "parameters parameters"] | None:
        """Covariance of the errors of `vibrissa.tolerances.PARAMETERS`: the calibration's joint
        covariance for what it determined, the rest as stated; None without either.
        """
        if self.calibration is None:
            return None if self.tolerances is None else self.tolerances.covariance
        return self.calibration.parameter_covariance((self.tolerances or Tolerances()).covariance)


Interval = Annotated[tuple[NotNegative, ...], several(2, "a pair (start, stop) of seconds")]
Row = Annotated[tuple[Finite, ...], several(6, "six finite numbers, fx, fy, fz, tx, ty, tz")]
Matrix = Annotated[tuple[Row, ...], several(6, "six rows of six finite numbers")]
Gain = Annotated[tuple[Positive, ...], several(6, "six numbers greater than 0, forces and torques")]
Figure = Annotated[
    NotNegative | Annotated[tuple[NotNegative, ...], several(3, "")],
    IN_ONE,
    Field(description="a number of at least 0, or three, one for each axis"),
]
Noise = Annotated[
    Positive | Lengths,
    IN_ONE,
    Field(description="a number greater than 0, or three, one for each axis"),
]
Deviations = Annotated[
    NotNegative | Annotated[tuple[NotNegative, ...], several(6, "")],
    IN_ONE,
    Field(description="a number of at least 0, or six, one for each channel"),
]


MountTable = table_of(
    Mount, {"mass": NotNegative, "center": Vector, "gravity": Vector, "estimated": Boolean}
)
LowPassTable = table_of(
    LowPass,
    {
        "cutoff": Positive,
        "order": Annotated[Literal[1, 2], Field(description="1 or 2")],
        "delay": NotNegative,
    },
)
TolerancesTable = table_of(
    Tolerances,
    {
        **dict.fromkeys(
            ("youngs_modulus", "radius", "length", "pose_delay", "object_scale"), NotNegative
        ),
        **dict.fromkeys(("clamp_position", "clamp_orientation", "object_position"), Figure),
        "gain": Deviations,
    },
)


class SensorTable(Table):
    """Fields of `vibrissa.sensor.Sensor`, SI units. Omitted ones come from the preset, if one is
    named.
    """

    clamp_position: Vector
    clamp_orientation: Quaternion
    wrench: Annotated[
        Literal["on_sensor", "on_rod"],
        Field(
            description="'on_sensor' (exerted by the rod on the sensor) or 'on_rod' "
            "(the support reaction)"
        ),
    ]
    preset: Annotated[
        str, Field(pattern=f"^({'|'.join(PRESETS)})?$", description=", ".join(PRESETS))
    ] = ""
    wrench_frame: Annotated[
        Literal["sensor", "world"], Field(description="'sensor' or 'world'")
    ] = "sensor"
    wrench_point: Vector = ORIGIN
    tare_seconds: NotNegative | None = None
    rest_intervals: Annotated[
        tuple[Interval, ...], Field(description="a list of pairs (start, stop) of seconds")
    ] = ()
    force_noise: Noise | None = None
    torque_noise: Noise | None = None
    noise_corner: NotNegative = 0.0
    force_random_walk: Figure = 0.0
    torque_random_walk: Figure = 0.0
    force_resolution: Figure = 0.0
    torque_resolution: Figure = 0.0
    force_range: Lengths | None = None
    torque_range: Lengths | None = None
    position_noise: NotNegative = 0.0
    orientation_noise: NotNegative = 0.0
    force_drift: Vector = ORIGIN
    torque_drift: Vector = ORIGIN
    estimate_drift: Boolean = False
    cross_talk: Matrix | None = None
    low_pass: LowPassTable | None = None  # type: ignore[valid-type]
    mount: MountTable | None = None  # type: ignore[valid-type]
    gain: Gain = (1.0,) * 6

    def build(self, site: Site) -> Sensor:
        """Return the sensor."""
        given = {"tare_seconds": None} | PRESETS.get(self.preset, {}) | self.arguments(site)
        given.pop("preset", None)
        if given.get("cross_talk") is not None:
            given["cross_talk"] = np.array(given["cross_talk"])
        return Sensor(**given)


class SetupFile(Table):
    """The whole file."""

    rod: RodTable  # type: ignore[valid-type]
    sensor: SensorTable
    object: ObjectTable | None = None  # type: ignore[valid-type]
    recording: RecordingTable | None = None
    rdt: RdtTable | None = None
    pose: PoseTable | None = Field(
        default=None, discriminator="kind", description="constant, udp, trail or case"
    )
    calibration: CalibrationTable | None = None
    tolerances: TolerancesTable | None = None  # type: ignore[valid-type]

    def build(self, site: Site) -> Setup:
        """Return the setup."""
        given = self.arguments(site)
        return Setup(surface=given.pop("object", None), **given)


def load_setup(path: str | Path, *, progress: Progress | None = None) -> Setup:
    """Read a setup from TOML: tables [rod], [sensor] and, optionally, [object], [recording], [rdt],
    [pose], [tolerances] and, if it was calibrated, [calibration]. `progress` is as for `Mesh`.

    Raises
    ------
    InputError
        If the file cannot be read, or a key is unknown, missing or out of range.
    """
    return load(path, SetupFile, progress)
