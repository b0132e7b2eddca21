"""One experiment: rod, sensor and, where it is known, the object (`setup.toml`)."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import Field, PlainValidator

from vibrissa.io.calibration import CalibrationTable
from vibrissa.io.config import (
    ORIGIN,
    Finite,
    NotNegative,
    Positive,
    Quaternion,
    RodTable,
    Table,
    Vector,
    load_table,
)
from vibrissa.io.errors import InputError
from vibrissa.io.live_setup import PoseTable, RdtTable
from vibrissa.io.objects import ObjectTable, built
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.rod import Rod
from vibrissa.sensor import LowPass, Mount, Sensor
from vibrissa.sensor.mount import STANDARD_GRAVITY
from vibrissa.sensor.presets import PRESETS, preset_figures
from vibrissa.surfaces import Surface
from vibrissa.tolerances import Tolerances

Gain = Annotated[
    tuple[Positive, Positive, Positive, Positive, Positive, Positive],
    Field(description="six numbers greater than 0, forces and torques"),
]


@dataclass(frozen=True)
class Setup:
    """What a recording needs to be read.

    Attributes
    ----------
    rod
        The rod, SI units.
    sensor
        Mount, sign, frame and noise of the wrench.
    surface
        The object that was scanned, or None.
    recording
        How its recordings are laid out, or None for CSV as `write_recording` writes it, and for the
        names of that header elsewhere.
    rdt, pose
        Of a live sensor, or None: how it counts and sends, and where its pose comes from.
    calibration
        What is known of the numbers of a calibrated setup, or None.
    tolerances
        How well the other numbers are known, or None where the setup does not say.
    """

    rod: Rod
    sensor: Sensor
    surface: Surface | None = None
    recording: RecordingTable | None = None
    rdt: RdtTable | None = None
    pose: PoseTable | None = None
    calibration: CalibrationTable | None = None
    tolerances: Tolerances | None = None

    @property
    def parameter_covariance(self) -> Float[np.ndarray, "15 15"] | None:
        """Of the errors of `vibrissa.tolerances.PARAMETERS`: what a calibration determined with its
        joint covariance, the rest as stated; None where neither is there.
        """
        if self.calibration is None:
            return None if self.tolerances is None else self.tolerances.covariance
        return self.calibration.parameter_covariance((self.tolerances or Tolerances()).covariance)


Interval = Annotated[
    tuple[NotNegative, NotNegative], Field(description="a pair (start, stop) of seconds")
]
Row = Annotated[
    tuple[Finite, Finite, Finite, Finite, Finite, Finite],
    Field(description="six rows of six finite numbers, fx, fy, fz, tx, ty, tz each"),
]


def _one_or_more(value: object, least: float, most: int) -> tuple[float, ...]:
    """One finite number for all axes or channels, or one for each."""
    numbers = value if isinstance(value, list | tuple) else [value]
    if len(numbers) not in (1, most) or (len(numbers) == 1 and numbers is value):
        raise ValueError(f"allowed is one number, or {most}")
    if any(
        isinstance(number, bool)
        or not isinstance(number, int | float)
        or not least <= number < math.inf
        for number in numbers
    ):
        raise ValueError("allowed are finite numbers")
    return tuple(map(float, numbers))


def _by_axis(value: object, least: float) -> float | tuple[float, float, float]:
    first, *others = _one_or_more(value, least, 3)
    return (first, others[0], others[1]) if others else first


def _positive_by_axis(value: object) -> float | tuple[float, float, float]:
    return _by_axis(value, math.ulp(0.0))


def _not_negative_by_axis(value: object) -> float | tuple[float, float, float]:
    return _by_axis(value, 0.0)


Figure = Annotated[
    float | tuple[float, float, float],
    PlainValidator(_not_negative_by_axis),
    Field(description="a number of at least 0, or three, one for each axis"),
]
Noise = Annotated[
    float | tuple[float, float, float],
    PlainValidator(_positive_by_axis),
    Field(description="a number greater than 0, or three, one for each axis"),
]
Deviations = Annotated[
    tuple[float, ...],
    PlainValidator(lambda value: _one_or_more(value, 0.0, 6)),
    Field(description="a number of at least 0, or six, one for each channel"),
]
Ranges = Annotated[
    tuple[Positive, Positive, Positive], Field(description="three numbers greater than 0")
]


class MountTable(Table):
    """Fields of `vibrissa.sensor.Mount`; SI units."""

    mass: NotNegative = 0.0
    center: Vector = ORIGIN
    gravity: Vector = STANDARD_GRAVITY
    estimated: Annotated[bool, Field(strict=True, description="true or false")] = False

    def build(self) -> Mount:
        """Return the mount."""
        return Mount(self.mass, self.center, self.gravity, self.estimated)


class LowPassTable(Table):
    """Fields of `vibrissa.sensor.LowPass`; SI units."""

    cutoff: Positive | None = None
    order: Annotated[Literal[1, 2], Field(description="1 or 2")] = 1
    delay: NotNegative = 0.0

    def build(self) -> LowPass:
        """Return the filter."""
        return LowPass(math.inf if self.cutoff is None else self.cutoff, self.order, self.delay)


class SensorTable(Table):
    """Fields of `vibrissa.sensor.Sensor`; SI units. What is left out comes from the preset, if one
    is named.
    """

    clamp_position: Vector
    clamp_orientation: Quaternion
    wrench: Annotated[
        Literal["on_sensor", "on_rod"],
        Field(
            description="'on_sensor' (exerted by the rod on the sensor) or 'on_rod' (the support reaction)"
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
    force_range: Ranges | None = None
    torque_range: Ranges | None = None
    position_noise: NotNegative = 0.0
    orientation_noise: NotNegative = 0.0
    force_drift: Vector = ORIGIN
    torque_drift: Vector = ORIGIN
    estimate_drift: Annotated[bool, Field(strict=True, description="true or false")] = False
    cross_talk: (
        Annotated[
            tuple[Row, Row, Row, Row, Row, Row], Field(description="six rows of six finite numbers")
        ]
        | None
    ) = None
    low_pass: LowPassTable | None = None
    mount: MountTable | None = None
    gain: Gain = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)

    def build(self) -> Sensor:
        """Return the sensor."""
        own = {name: getattr(self, name) for name in self.model_fields_set - _PARTS}
        return Sensor(
            np.array(self.clamp_position),
            np.array(self.clamp_orientation),
            cross_talk=None if self.cross_talk is None else np.array(self.cross_talk),
            low_pass=None if self.low_pass is None else self.low_pass.build(),
            mount=None if self.mount is None else self.mount.build(),
            **({"tare_seconds": None} | preset_figures(self.preset) | own),
        )


class TolerancesTable(Table):
    """Fields of `vibrissa.Tolerances`: standard deviations of what the setup states."""

    youngs_modulus: NotNegative = 0.0
    radius: NotNegative = 0.0
    length: NotNegative = 0.0
    clamp_position: Figure = 0.0
    clamp_orientation: Figure = 0.0
    gain: Deviations = (0.0,)
    pose_delay: NotNegative = 0.0
    object_scale: NotNegative = 0.0
    object_position: Figure = 0.0

    def build(self) -> Tolerances:
        """Return the tolerances."""
        return Tolerances(**(self.model_dump() | {"gain": np.broadcast_to(self.gain, 6)}))


_PARTS = {"clamp_position", "clamp_orientation", "preset", "cross_talk", "low_pass", "mount"}


class SetupFile(Table):
    """The whole file."""

    rod: RodTable
    sensor: SensorTable
    object: ObjectTable | None = None
    recording: RecordingTable | None = None
    rdt: RdtTable | None = None
    pose: PoseTable | None = None
    calibration: CalibrationTable | None = None
    tolerances: TolerancesTable | None = None


def load_setup(path: str | Path) -> Setup:
    """Read a setup from TOML: tables [rod], [sensor] and, optionally, [object], [recording], [rdt],
    [pose], [tolerances] and, where it was calibrated, [calibration].

    Raises
    ------
    InputError
        If the file cannot be read, or a key is missing, unknown or out of range.
    """
    file = Path(path)
    table = load_table(file, SetupFile)
    try:
        surface = None if table.object is None else built(table.object, file.parent)
        if table.calibration is not None:
            table.calibration.check()
        tolerances = None if table.tolerances is None else table.tolerances.build()
        return Setup(
            table.rod.build(),
            table.sensor.build(),
            surface,
            table.recording,
            table.rdt,
            table.pose,
            table.calibration,
            tolerances,
        )
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error
