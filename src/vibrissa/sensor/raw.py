"""What a sensor and a robot log, before anything is made of it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

CHANNELS = ("fx", "fy", "fz", "tx", "ty", "tz")
"""The six numbers of a wrench, in their order in arrays (…, 6)."""
CHANNEL_UNITS = ("N", "N", "N", "N m", "N m", "N m")
"""Their units."""

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

    time: Float[np.ndarray, "n"]
    position: Float[np.ndarray, "n 3"]
    orientation: Float[np.ndarray, "n 4"]
    force: Float[np.ndarray, "n 3"]
    torque: Float[np.ndarray, "n 3"]

    @property
    def wrench(self) -> Float[np.ndarray, "n 6"]:
        """Force and torque side by side (n, 6), in the order of `CHANNELS`."""
        return np.concatenate([self.force, self.torque], axis=1)

    @cached_property
    def rate(self) -> float:
        """Samples a second [Hz], by the median step of the time; NaN with fewer than two rows."""
        steps = np.diff(self.time)
        steps = steps[np.isfinite(steps) & (steps > 0)]
        return float(1 / max(float(np.median(steps)), _LEAST_STEP)) if len(steps) else float("nan")
