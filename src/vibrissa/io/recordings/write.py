"""Writing recordings, as CSV."""

from pathlib import Path

import numpy as np

from vibrissa.files import writable
from vibrissa.sensor import RawRecording

COLUMNS = ("time", "px", "py", "pz", "qx", "qy", "qz", "qw", "fx", "fy", "fz", "tx", "ty", "tz")
"""Time [s]; pose of the sensor frame in the world [m], quaternion x, y, z, w; force [N] and torque
[N m] with sign and frame as in the setup.
"""

_FORMATS = ("%.4f", *["%.6f"] * 3, *["%.9f"] * 4, *["%.5f"] * 3, *["%.7f"] * 3)


def write_recording(path: str | Path, raw: RawRecording) -> Path:
    """Write a recording as `read_recording` reads it, rounded to 0.1 ms, 1 µm, 10 µN and 0.1 µN m.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    file = writable(Path(path))
    table = np.column_stack([raw.time, raw.position, raw.orientation, raw.force, raw.torque])
    np.savetxt(file, table, fmt=_FORMATS, delimiter=",", header=",".join(COLUMNS), comments="")
    return file
