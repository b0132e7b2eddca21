"""What a sensor and a robot log, before anything is made of it."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

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
Times = Float[np.ndarray, "n"]
Rows = Bool[np.ndarray, "n"]
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
    position: Float[np.ndarray, "n 3"]
    orientation: Quaternions
    force: Float[np.ndarray, "n 3"]
    torque: Float[np.ndarray, "n 3"]

    @property
    def wrench(self) -> Wrenches:
        """Force and torque side by side (n, 6), in the order of `CHANNELS`."""
        return np.concatenate([self.force, self.torque], axis=1)

    @cached_property
    def rate(self) -> float:
        """Samples a second [Hz], by the median step of the time; NaN with fewer than two rows."""
        steps = np.diff(self.time)
        steps = steps[np.isfinite(steps) & (steps > 0)]
        return float(1 / max(float(np.median(steps)), _LEAST_STEP)) if len(steps) else float("nan")

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


def runs(mask: Rows) -> list[tuple[int, int]]:
    """Stretches [start, stop) in which a mask holds."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False)).reshape(-1, 2)
    return [(start, stop) for start, stop in edges.tolist()]


def channel_names(mask: Iterable[object]) -> tuple[str, ...]:
    """Names of the channels that a mask (6,) picks."""
    return tuple(name for name, picked in zip(CHANNELS, mask, strict=True) if picked)
