"""Data as logged by sensor and robot, and what may be wrong with them."""

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.brief import brief

CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")
"""The six channels of a wrench, in the order of arrays (…, 6)."""
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

# No clock has steps below a nanosecond; this keeps the rate finite.
_LEAST_STEP = 1e-9


@dataclass(frozen=True, eq=False)
class RawRecording:
    """Rows of a log, as written by sensor and robot. Missing numbers are NaN.

    Attributes
    ----------
    time
        (n,) [s], increasing.
    position, orientation
        Pose of the sensor frame in the world: (n, 3) [m] and quaternions x, y, z, w (n, 4).
    force, torque
        (n, 3) [N], [N m], tare included: sign, frame and reference point as in `Sensor`.
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

    __repr__ = brief

    @cached_property
    def rate(self) -> float:
        """Sampling rate [Hz], from the median time step; NaN with fewer than two rows."""
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
    """The names (k,) that a mask selects."""
    return tuple(np.array(names)[mask].tolist())


class FaultKind(StrEnum):
    """What can be wrong with a recording.

    `SATURATION`: readings at the range limit, or flat-topped. `DROP_OUT`: rows with missing
    numbers, or of zeros between other readings. `STUCK`: a channel that repeats its value for
    longer than noise and resolution allow. `GAP`: samples missing between two stamps. `DUPLICATE`,
    `BACKWARD`: a stamp equal to an earlier one, or before it. `UNITS`: numbers that cannot be in
    metres, newtons, newton metres or seconds, or are not unit quaternions. `NOISE`: larger or
    smaller at rest than stated. `DRIFT`: the offset drifts more than stated. `POSE_JUMP`: the
    robot's pose jumps. `REST`: no rest for the tare. `TARE`: forces and moments that fit no single
    contact. `HELD`: rows that repeat the reading above them in all channels. `MOUNT`: a sign, clamp
    or reference point in the setup that the readings contradict. `HUM`: a line in the spectrum at
    rest. `POSE_NOISE`: poses scatter by more than stated.
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
        First and last stamp affected [s], on the recording's clock.
    count
        Rows affected; for a gap, samples missing.
    text
        One sentence with the figures.
    unusable
        Whether the recording cannot be used at all.
    quiet
        Whether an inspection lists it without warning of it or marking rows.
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
        """A finding from the first to the last of these stamps (n,), affecting n rows unless
        `count` says otherwise. `flags` are `unusable` and `quiet`.
        """
        rows = len(stamps) if count is None else int(count)
        return cls(kind, channels, float(stamps[0]), float(stamps[-1]), rows, text, **flags)
