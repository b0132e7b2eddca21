"""One experiment: rod, sensor and, where it is known, the object (`setup.toml`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from vibrissa.io.calibration import CalibrationTable
from vibrissa.io.config import ORIGIN, NotNegative, Positive, Quaternion, RodTable, Table, Vector, load_table
from vibrissa.io.errors import InputError
from vibrissa.io.objects import ObjectTable, built
from vibrissa.rod import Rod
from vibrissa.sensor import Sensor
from vibrissa.surfaces import Surface

Gain = Annotated[
    tuple[Positive, Positive, Positive, Positive, Positive, Positive], Field(description="six numbers greater than 0, forces and torques")
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
    calibration
        What is known of the numbers of a calibrated setup, or None.
    """

    rod: Rod
    sensor: Sensor
    surface: Surface | None = None
    calibration: CalibrationTable | None = None


class SensorTable(Table):
    """Fields of `vibrissa.sensor.Sensor`; SI units."""

    clamp_position: Vector
    clamp_orientation: Quaternion
    wrench: Annotated[
        Literal["on_sensor", "on_rod"],
        Field(description="'on_sensor' (exerted by the rod on the sensor) or 'on_rod' (the support reaction)"),
    ]
    wrench_frame: Annotated[Literal["sensor", "world"], Field(description="'sensor' or 'world'")] = "sensor"
    wrench_point: Vector = ORIGIN
    tare_seconds: NotNegative = 0.0
    force_noise: Positive | None = None
    torque_noise: Positive | None = None
    force_resolution: NotNegative = 0.0
    torque_resolution: NotNegative = 0.0
    position_noise: NotNegative = 0.0
    gain: Gain = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0)

    def build(self) -> Sensor:
        """Return the sensor."""
        return Sensor(
            np.array(self.clamp_position),
            np.array(self.clamp_orientation),
            self.wrench,
            self.wrench_frame,
            self.wrench_point,
            self.tare_seconds,
            self.force_noise,
            self.torque_noise,
            self.force_resolution,
            self.torque_resolution,
            self.position_noise,
            self.gain,
        )


class SetupFile(Table):
    """The whole file."""

    rod: RodTable
    sensor: SensorTable
    object: ObjectTable | None = None
    calibration: CalibrationTable | None = None


def load_setup(path: str | Path) -> Setup:
    """Read a setup from TOML: tables [rod], [sensor] and, optionally, [object]; [calibration], where it was calibrated.

    Raises
    ------
    InputError
        If the file cannot be read, or a key is missing, unknown or out of range.
    """
    file = Path(path)
    table = load_table(file, SetupFile)
    try:
        surface = None if table.object is None else built(table.object, file.parent)
        return Setup(table.rod.build(), table.sensor.build(), surface, table.calibration)
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error
