"""What a sensor and a robot log, before anything is made of it, and what may be wrong with it."""

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")
"""The six numbers of a wrench, in their order in arrays (…, 6)."""
CHANNEL_UNITS = ("N", "N", "N", "N m", "N m", "N m")
"""Their units."""

Interval = tuple[float, float]
"""Start and stop [s] on the recording's clock."""
Wrench = Float[np.ndarray, "6"]
Wrenches = Float[np.ndarray, "n 6"]
Covariances = Float[np.ndarray, "n 6 6"]
Covariance = Float[np.ndarray, "... 6 6"]
"""One for all rows (6, 6), or one for each (n, 6, 6)."""
Times = Float[np.ndarray, "n"]
Rows = Bool[np.ndarray, "n"]
Vectors = Float[np.ndarray, "n 3"]
Quaternions = Float[np.ndarray, "n 4"]

# Steps below a nanosecond are those of no clock; a rate of zero steps stays finite.
_LEAST_STEP = 1e-9


@dataclass(frozen=True, eq=False)
class RawRecording:
    """Rows of a log, as the sensor and the robot wrote them. A row may hold NaN where a number is
    missing.

    Attributes
    ----------
    time
        (n,) [s], increasing.
    position, orientation
        Pose of the sensor frame in the world: (n, 3) [m] and quaternions x, y, z, w (n, 4).
    force, torque
        (n, 3) [N], [N m]: sign, frame and reference point are the sensor's (`Sensor`), tare
        included.
    """

    time: Times
    position: Vectors
    orientation: Quaternions
    force: Vectors
    torque: Vectors

    @property
    def wrench(self) -> Wrenches:
        """Force and torque side by side (n, 6), in the order of `CHANNELS`."""
        return np.concatenate([self.force, self.torque], axis=1)

    @cached_property
    def rate(self) -> float:
        """Samples a second [Hz], by the median step of the time; NaN with fewer than two rows."""
        steps = np.diff(self.time)
        steps = steps[steps > 0]
        return float(1 / max(np.median(steps), _LEAST_STEP)) if len(steps) else np.nan

    @cached_property
    def whole(self) -> Rows:
        """Rows with a stamp and all six readings."""
        return np.isfinite(self.wrench).all(axis=1) & np.isfinite(self.time)

    def during(self, interval: Interval) -> Rows:
        """Rows within an interval."""
        return (self.time >= interval[0]) & (self.time < interval[1])

    def with_wrench(self, wrench: Wrenches) -> "RawRecording":
        """Return the recording with other readings (n, 6)."""
        return replace(self, force=wrench[:, :3], torque=wrench[:, 3:])


def names_of(mask: Bool[np.ndarray, "k"], names: tuple[str, ...] = CHANNELS) -> tuple[str, ...]:
    """Those of the names (k,) that a mask picks."""
    return tuple(np.array(names)[mask].tolist())


class FaultKind(StrEnum):
    """What can be wrong with a recording.

    `SATURATION`: readings at the range, or flat-topped. `DROP_OUT`: rows without numbers, or of
    zeros between other readings. `STUCK`: a channel that repeats its value longer than noise and
    resolution allow. `GAP`: samples missing between two stamps. `DUPLICATE`, `BACKWARD`: a stamp
    equal to one before, or earlier. `UNITS`: numbers that cannot be in metres, newtons, newton
    metres, seconds, or no unit quaternions. `NOISE`: larger or smaller at rest than stated.
    `DRIFT`: the offset moves by more than stated. `POSE_JUMP`: the robot's pose jumps. `REST`: no
    rest for the tare. `TARE`: forces and moments that belong to no single contact. `HELD`: rows
    that repeat the reading above them in all channels. `MOUNT`: a sign, clamp or reference point of
    the setup that the readings contradict. `HUM`: a line in the spectrum at rest. `POSE_NOISE`:
    poses scatter by more than stated.
    """

    SATURATION = "saturation"
    DROP_OUT = "drop-out"
    STUCK = "stuck channel"
    GAP = "gap"
    DUPLICATE = "duplicate stamp"
    BACKWARD = "backward stamp"
    UNITS = "units"
    NOISE = "noise"
    DRIFT = "drift"
    POSE_JUMP = "pose jump"
    REST = "no rest"
    TARE = "no single contact"
    HELD = "held readings"
    MOUNT = "mount"
    HUM = "hum"
    POSE_NOISE = "pose noise"


@dataclass(frozen=True)
class Fault:
    """One finding over one interval.

    Attributes
    ----------
    kind
        What it is.
    channels
        Names of `vibrissa.sensor.CHANNELS`, and "position", "orientation", "time".
    start, stop
        First and last stamp concerned [s], on the recording's clock.
    count
        Rows concerned; of a gap, samples missing.
    text
        One sentence with the figures.
    unusable
        Whether the recording cannot be used at all.
    quiet
        Whether an inspection lists it without a warning, and marks no row.
    """

    kind: FaultKind
    channels: tuple[str, ...]
    start: float
    stop: float
    count: int
    text: str
    unusable: bool = False
    quiet: bool = False

    @classmethod
    def over(
        cls,
        channels: tuple[str, ...],
        kind: FaultKind,
        stamps: Times | Interval,
        text: str,
        count: int | np.integer[Any] | None = None,
        **flags: bool,
    ) -> "Fault":
        """A finding from the first to the last of these stamps (n,); it concerns n rows, unless
        `count` says otherwise. `flags` are `unusable` and `quiet`.
        """
        rows = len(stamps) if count is None else int(count)
        return cls(kind, channels, float(stamps[0]), float(stamps[-1]), rows, text, **flags)
