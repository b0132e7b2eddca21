"""Writing recordings, as CSV."""

from pathlib import Path

import numpy as np

from vibrissa.files import writable
from vibrissa.sensor import RawRecording

COLUMNS = ("time", "px", "py", "pz", "qx", "qy", "qz", "qw", "fx", "fy", "fz", "tx", "ty", "tz")
"""Time [s]; pose of the sensor frame in the world [m], quaternion x, y, z, w; force [N] and torque
[N m] with sign and frame as in the setup.
"""

_FORMATS = ("%.6f", *["%.9g"] * 13)
"""A converter of 24 bits has 7.2 digits."""


def write_recording(path: str | Path, raw: RawRecording) -> Path:
    """Write a recording as `read_recording` reads it, with stamps rounded to 1 µs and all
    else to nine digits.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    file = writable(Path(path))
    table = np.column_stack([raw.time, raw.position, raw.orientation, raw.force, raw.torque])
    np.savetxt(file, table, fmt=_FORMATS, delimiter=",", header=",".join(COLUMNS), comments="")
    return file
