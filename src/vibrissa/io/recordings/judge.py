"""What makes a recording unusable and has a place in its file; `vibrissa.sensor.inspect_raw` judges
the rest. Reading alone refuses none of this.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.io.errors import InputError
from vibrissa.io.recordings.streams import Stream, Streams
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.stamps import stamp_faults
from vibrissa.sensor.units import wrong_norms


def check(file: Path, streams: Streams) -> None:
    """Refuse streams whose stamps run backwards, which leaves open which of them are right, and
    rotations that are none.

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
    wrong = np.flatnonzero(wrong_norms(quaternion))
    if wrong.size:
        row = int(wrong[0])
        with np.errstate(over="ignore"):
            norm = np.linalg.norm(quaternion, axis=1)
        raise InputError(
            f"{file}, {pose.place(row)}: qx,qy,qz,qw = {quaternion[row].tolist()} has the norm {norm[row]:.3g} ({len(wrong)} such); allowed is 1"
        )


def pose_faults(pose: Stream) -> list[Fault]:
    """Faults of poses that have stamps of their own, which bringing them to the stamps of the
    wrenches would hide.

    Parameters
    ----------
    pose
        As recorded, on the clock of the wrenches.
    """
    if not np.isfinite(pose.time).any():
        return []
    channels = ("position", "orientation")
    found = [
        replace(fault, channels=channels, text=f"stamps of the poses: {fault.text}")
        for fault in stamp_faults(pose.time)
    ]
    quaternion = pose.values[:, 3:]
    whole = np.isfinite(pose.values).all(axis=1) & np.isfinite(pose.time)
    wrong = wrong_norms(quaternion)
    if wrong.any():
        text = f"{np.count_nonzero(wrong)} of {len(wrong)} quaternions of the poses have another norm than 1; allowed is 1"
        found.append(_spanning(FaultKind.UNITS, ("orientation",), pose, wrong, text, unusable=True))
    if not whole.all():
        text = f"{np.count_nonzero(~whole)} poses without a number, which are passed over"
        found.append(_spanning(FaultKind.DROP_OUT, channels, pose, ~whole, text))
    return found


def _spanning(
    kind: FaultKind,
    channels: tuple[str, ...],
    pose: Stream,
    rows: Bool[np.ndarray, "n"],
    text: str,
    *,
    unusable: bool = False,
) -> Fault:
    known = np.isfinite(pose.time)
    stamps = pose.time[rows & known] if np.any(rows & known) else pose.time[known]
    return Fault(
        kind,
        channels,
        float(stamps.min()),
        float(stamps.max()),
        int(np.count_nonzero(rows)),
        text,
        unusable,
    )
