"""What is wrong with the numbers of a recording, whatever format they came in; reading alone refuses none of this."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from vibrissa.files import LARGEST
from vibrissa.io.errors import InputError
from vibrissa.io.recordings.streams import POSE, WRENCH, Stream, Streams
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor import RawRecording

_QUATERNION_TOLERANCE = 1e-3
_LONGEST_SWEEP = 200.0
_LOADED = 20.0
_SHORTEST_ARM = 1e-2
_LONGEST_ARM = 5.0
_LARGEST_FORCE = 500.0


def check(file: Path, streams: Streams) -> None:
    """Refuse streams that hold anything but sound numbers.

    Raises
    ------
    InputError
        If a number is NaN, infinite or beyond 1e12, a quaternion has no unit norm, or stamps do not increase.
    """
    both = ((streams.wrench, WRENCH), (streams.pose, POSE))
    for stream, names in both:
        _check_numbers(file, stream, ("time", *names))
    _check_quaternions(file, streams.pose)
    for stream, _ in both:
        check_increasing(file, stream)


def check_increasing(file: Path, stream: Stream) -> None:
    """Raise InputError unless each stamp is after the one above it."""
    falling = np.flatnonzero(np.diff(stream.time) <= 0)
    if falling.size:
        row = int(falling[0]) + 1
        raise InputError(
            f"{file}, {stream.place(row)}: time = {stream.time[row]} after {stream.time[row - 1]} ({len(falling)} such); allowed are increasing times"
        )


def _check_numbers(file: Path, stream: Stream, names: tuple[str, ...]) -> None:
    table = np.column_stack([stream.time, stream.values])
    bad = np.argwhere(~np.isfinite(table))
    if bad.size:
        row, column = map(int, bad[0])
        raise InputError(
            f"{file}, {stream.place(row)}: {names[column]} = {table[row, column]} ({len(np.unique(bad[:, 0]))} of {len(table)} rows hold such); "
            "allowed are finite numbers"
        )
    large = np.argwhere(np.abs(table) > LARGEST)
    if large.size:
        row, column = map(int, large[0])
        raise InputError(f"{file}, {stream.place(row)}: {names[column]} = {table[row, column]:g}; allowed are numbers up to {LARGEST:g}")


def _check_quaternions(file: Path, pose: Stream) -> None:
    quaternion: Float[np.ndarray, "n 4"] = pose.values[:, 3:]
    norm = np.linalg.norm(quaternion, axis=1)
    wrong = np.flatnonzero(np.abs(norm - 1) > _QUATERNION_TOLERANCE)
    if wrong.size:
        row = int(wrong[0])
        raise InputError(
            f"{file}, {pose.place(row)}: qx,qy,qz,qw = {quaternion[row].tolist()} has the norm {norm[row]:.3g} ({len(wrong)} such); allowed is 1"
        )


def check_scale(file: Path, raw: RawRecording, reactions: Reactions, rod: Rod) -> None:
    """Tell millimetres, millinewtons and newton millimetres from SI: the contact lies on the rod, so the lever arm is of its length.

    Raises
    ------
    InputError
        If poses extend too far, or forces and torques do not fit to each other or to the rod.
    """
    extent = float(np.ptp(raw.position, axis=0).max())
    if extent > _LONGEST_SWEEP * rod.length:
        raise InputError(f"{file}: px,py,pz extend over {extent:.3g} with a rod of {rod.length:g} m; allowed are metres")
    known = np.all(np.isfinite(reactions.force), axis=1)
    force, moment = (np.linalg.norm(part[known], axis=1) for part in (reactions.force, reactions.moment))
    if not len(force):
        return
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
