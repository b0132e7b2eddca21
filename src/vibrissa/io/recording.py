"""Logs of a force/torque sensor and a robot's poses, as CSV."""

from pathlib import Path

import numpy as np

from vibrissa.files import read_table
from vibrissa.io.errors import InputError, writable
from vibrissa.io.setup import Setup
from vibrissa.reactions import Reactions
from vibrissa.sensor import Inspection, RawRecording, inspect_raw

COLUMNS = ("time", "px", "py", "pz", "qx", "qy", "qz", "qw", "fx", "fy", "fz", "tx", "ty", "tz")
"""Time [s]; pose of the sensor frame in the world [m], quaternion x, y, z, w; force [N] and torque [N m] as the setup says."""

_QUATERNION_TOLERANCE = 1e-3


def read_recording(path: str | Path, setup: Setup) -> Reactions:
    """Read a recording and return support reactions on the rod about the clamp, world axes, tare removed, with covariance where the noise is known.

    Rows that are not usable (numbers missing, a stuck or saturated channel, a stamp that is there already) hold NaN; `inspect_recording` says what they are.

    Parameters
    ----------
    path
        CSV with the header `time,px,py,pz,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz`, SI units.
    setup
        Mount, sign, frame and noise.

    Raises
    ------
    InputError
        If columns differ from those, a row is short or cut off, time runs backwards, a quaternion has no unit norm, the tare window does not fit or no rest is
        found, or the numbers cannot be in metres, newtons and newton metres.
    """
    file = Path(path)
    raw = read_raw(file)
    _check_rows(file, raw)
    inspection = _inspected(file, raw, setup)
    if inspection.unusable:
        raise InputError(f"{file}: {inspection.unusable[0].text}")
    return setup.sensor.reactions(inspection.cleaned, inspection.tare)


def inspect_recording(path: str | Path, setup: Setup) -> Inspection:
    """Read a recording and return its faults, with what its rest tells of the sensor.

    Raises
    ------
    InputError
        If columns differ, a row is short or cut off, or no row has a stamp or a pose.
    """
    file = Path(path)
    return _inspected(file, read_raw(file), setup)


def read_raw(path: str | Path) -> RawRecording:
    """Read a recording's numbers as they are; a cell that holds `nan` is missing.

    Raises
    ------
    InputError
        If columns differ, or a row is short or cut off.
    """
    table = np.column_stack(list(read_table(Path(path), COLUMNS, missing=True).values()))
    return RawRecording(table[:, 0], table[:, 1:4], table[:, 4:8], table[:, 8:11], table[:, 11:])


def _inspected(file: Path, raw: RawRecording, setup: Setup) -> Inspection:
    try:
        return inspect_raw(raw, setup.sensor, setup.rod)
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error


def _check_rows(file: Path, raw: RawRecording) -> None:
    """What makes a file unusable and has a line: a stamp before the one above it, which leaves open which of them is right, and a quaternion of another norm."""
    falling = np.flatnonzero(np.diff(raw.time) < 0)
    if falling.size:
        row = falling[0]
        raise InputError(
            f"{file}, line {row + 3}: time = {raw.time[row + 1]} after {raw.time[row]} ({len(falling)} such); allowed are increasing times"
        )
    norm = np.linalg.norm(raw.orientation, axis=1)
    wrong = np.flatnonzero(np.abs(norm - 1) > _QUATERNION_TOLERANCE)
    if wrong.size:
        row = wrong[0]
        raise InputError(
            f"{file}, line {row + 2}: qx,qy,qz,qw = {raw.orientation[row].tolist()} has the norm {norm[row]:.3g} ({len(wrong)} such); allowed is 1"
        )


_FORMATS = ("%.4f", *["%.6f"] * 3, *["%.9f"] * 4, *["%.5f"] * 3, *["%.7f"] * 3)


def write_recording(path: str | Path, raw: RawRecording) -> Path:
    """Write a recording as `read_recording` reads it: to 0.1 ms, 1 µm, 10 µN and 0.1 µN m.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    file = writable(Path(path))
    table = np.column_stack([raw.time, raw.position, raw.orientation, raw.force, raw.torque])
    np.savetxt(file, table, fmt=_FORMATS, delimiter=",", header=",".join(COLUMNS), comments="")
    return file
