"""What makes a recording unusable and has a place in its file; `vibrissa.sensor.inspect_raw` judges the rest. Reading alone refuses none of this."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from vibrissa.io.errors import InputError
from vibrissa.io.recordings.streams import Stream, Streams

_QUATERNION_TOLERANCE = 1e-3


def check(file: Path, streams: Streams) -> None:
    """Refuse streams whose stamps run backwards, which leaves open which of them are right, and rotations that are none.

    Raises
    ------
    InputError
        If a stamp is before the one above it, or a quaternion has no unit norm.
    """
    _check_quaternions(file, streams.pose)
    for stream in (streams.wrench, streams.pose):
        _check_stamps(file, stream)


def _check_stamps(file: Path, stream: Stream) -> None:
    falling = np.flatnonzero(np.diff(stream.time) < 0)
    if falling.size:
        row = int(falling[0]) + 1
        raise InputError(
            f"{file}, {stream.place(row)}: time = {stream.time[row]} after {stream.time[row - 1]} ({len(falling)} such); allowed are increasing times"
        )


def _check_quaternions(file: Path, pose: Stream) -> None:
    quaternion: Float[np.ndarray, "n 4"] = pose.values[:, 3:]
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(quaternion, axis=1)
    wrong = np.flatnonzero(np.abs(norm - 1) > _QUATERNION_TOLERANCE)
    if wrong.size:
        row = int(wrong[0])
        raise InputError(
            f"{file}, {pose.place(row)}: qx,qy,qz,qw = {quaternion[row].tolist()} has the norm {norm[row]:.3g} ({len(wrong)} such); allowed is 1"
        )
