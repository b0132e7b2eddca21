"""Logs of a force/torque sensor and a robot's poses, as CSV."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from vibrissa.files import check_increasing, read_table
from vibrissa.io.errors import InputError, writable
from vibrissa.io.setup import Setup
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor import RawRecording

COLUMNS = ("time", "px", "py", "pz", "qx", "qy", "qz", "qw", "fx", "fy", "fz", "tx", "ty", "tz")
"""Time [s]; pose of the sensor frame in the world [m], quaternion x, y, z, w; force [N] and torque [N m] as the setup says."""

_QUATERNION_TOLERANCE = 1e-3
_LONGEST_SWEEP = 200.0
_LOADED = 20.0
_SHORTEST_ARM = 1e-2
_LONGEST_ARM = 5.0
_LARGEST_FORCE = 500.0


def read_recording(path: str | Path, setup: Setup) -> Reactions:
    """Read a recording and return support reactions on the rod about the clamp, world axes, tare removed, with covariance where the noise is known.

    Parameters
    ----------
    path
        CSV with the header `time,px,py,pz,qx,qy,qz,qw,fx,fy,fz,tx,ty,tz`, SI units.
    setup
        Mount, sign, frame and noise.

    Raises
    ------
    InputError
        If columns differ from those, a row is short, a number is missing, not finite, or cut off, time does not increase, a quaternion has no unit norm, the
        tare window does not fit, or the numbers cannot be in metres, newtons and newton metres.
    """
    file = Path(path)
    table = np.column_stack(list(read_table(file, COLUMNS).values()))
    raw = RawRecording(table[:, 0], table[:, 1:4], _unit_quaternions(file, table[:, 4:8]), table[:, 8:11], table[:, 11:])
    check_increasing(file, raw.time)
    try:
        reactions = setup.sensor.reactions(raw)
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error
    _check_scale(file, raw, reactions, setup.rod)
    return reactions


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


def _unit_quaternions(file: Path, quaternion: Float[np.ndarray, "n 4"]) -> Float[np.ndarray, "n 4"]:
    norm = np.linalg.norm(quaternion, axis=1)
    wrong = np.flatnonzero(np.abs(norm - 1) > _QUATERNION_TOLERANCE)
    if wrong.size:
        row = wrong[0]
        raise InputError(
            f"{file}, line {row + 2}: qx,qy,qz,qw = {quaternion[row].tolist()} has the norm {norm[row]:.3g} ({len(wrong)} such); allowed is 1"
        )
    return quaternion / norm[:, None]


def _check_scale(file: Path, raw: RawRecording, reactions: Reactions, rod: Rod) -> None:
    """Tell millimetres, millinewtons and newton millimetres from SI: the contact lies on the rod, so the lever arm is of its length."""
    extent = float(np.ptp(raw.position, axis=0).max())
    if extent > _LONGEST_SWEEP * rod.length:
        raise InputError(f"{file}: px,py,pz extend over {extent:.3g} with a rod of {rod.length:g} m; allowed are metres")
    force, moment = (np.linalg.norm(part, axis=1) for part in (reactions.force, reactions.moment))
    loaded = force > max(_LOADED * np.median(force[: max(2, len(force) // 50)]), 1e-12)
    if np.count_nonzero(loaded) < 10:
        return
    arm = float(np.median(moment[loaded] / force[loaded])) / rod.length
    if not _SHORTEST_ARM < arm < _LONGEST_ARM:
        raise InputError(
            f"{file}: torque over force is {arm:.3g} rod lengths in the median, so tx,ty,tz or fx,fy,fz are mis-scaled; allowed are N and N m"
        )
    typical = float(np.median(force[loaded])) / rod.force_scale
    if typical > _LARGEST_FORCE or typical < 1 / _LARGEST_FORCE:
        raise InputError(
            f"{file}: force is {typical:.3g} EI/L² in the median of the loaded samples, so wrench or rod are mis-scaled; allowed are N, m, Pa"
        )
