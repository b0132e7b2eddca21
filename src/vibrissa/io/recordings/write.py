"""Writing recordings, as CSV."""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float

from vibrissa.files import writable
from vibrissa.sensor import RawRecording

COLUMNS = ("time", "px", "py", "pz", "qx", "qy", "qz", "qw", "fx", "fy", "fz", "tx", "ty", "tz")
"""Time [s]; pose of the sensor frame in the world [m], quaternion x, y, z, w; force [N] and torque
[N m] with sign and frame as in the setup.
"""

_TIME, _POSE = ["%.4f"], ["%.6f"] * 3 + ["%.9f"] * 4
_DIGITS, _FORCE, _TORQUE = 5, 5, 7
"""Digits of the largest change that are kept at least, and decimals of forces and torques."""


def write_recording(path: str | Path, raw: RawRecording) -> Path:
    """Write a recording as `read_recording` reads it, rounded to 0.1 ms, 1 µm, 10 µN and 0.1 µN m;
    weaker readings to five digits of their largest change.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    file = writable(Path(path))
    table = np.column_stack([raw.time, raw.position, raw.orientation, raw.force, raw.torque])
    wrench = [*_decimals(raw.force, _FORCE), *_decimals(raw.torque, _TORQUE)]
    formats = _TIME + _POSE + wrench
    np.savetxt(file, table, fmt=formats, delimiter=",", header=",".join(COLUMNS), comments="")
    return file


def _decimals(readings: Float[np.ndarray, "n 3"], usual: int) -> list[str]:
    """Formats of three columns; a sensor's zero does not count."""
    known = readings[np.isfinite(readings).all(axis=1)]
    change = float(np.ptp(known, axis=0).max()) if len(known) else 0.0
    first = math.floor(math.log10(change)) if change > 0 else 0
    return [f"%.{max(usual, _DIGITS - 1 - first)}f"] * 3
