"""Rows of a recording as they were logged, tare included."""

from pathlib import Path

import numpy as np

from vibrissa.files import check_increasing, read_table
from vibrissa.io.errors import InputError
from vibrissa.io.recording import COLUMNS
from vibrissa.sensor import RawRecording

_QUATERNION_TOLERANCE = 1e-3


def read_raw(path: str | Path) -> RawRecording:
    """Rows of a CSV recording, for a replay.

    Raises
    ------
    InputError
        If the file cannot be read, columns differ, a number is missing or not finite, time does not increase, or a quaternion has no unit norm.
    """
    file = Path(path)
    table = np.column_stack(list(read_table(file, COLUMNS).values()))
    check_increasing(file, table[:, 0])
    norm = np.linalg.norm(table[:, 4:8], axis=1)
    wrong = np.flatnonzero(np.abs(norm - 1) > _QUATERNION_TOLERANCE)
    if wrong.size:
        raise InputError(f"{file}, line {wrong[0] + 2}: qx,qy,qz,qw has the norm {norm[wrong[0]]:.3g} ({len(wrong)} such); allowed is 1")
    return RawRecording(table[:, 0], table[:, 1:4], table[:, 4:8] / norm[:, None], table[:, 8:11], table[:, 11:])
