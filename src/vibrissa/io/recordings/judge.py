"""What makes a recording unusable and has a place in its file; `vibrissa.sensor.inspect_raw` judges
the rest. Reading alone refuses none of this.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from vibrissa.io.errors import InputError
from vibrissa.io.recordings.streams import Poses, Streams
from vibrissa.sensor.raw import Fault, FaultKind
from vibrissa.sensor.stamps import stamp_faults
from vibrissa.sensor.units import wrong_norms


def check(file: Path, streams: Streams) -> None:
    """Refuse streams whose stamps run backwards, which leaves open which of them are right, and
    orientations that are no rotations.

    Raises
    ------
    InputError
        If a stamp is before the one above it, or a quaternion has no unit norm.
    """
    pose = streams.pose
    wrong = np.flatnonzero(wrong_norms(pose.orientation))
    if wrong.size:
        row = int(wrong[0])
        quaternion = pose.orientation[row]
        with np.errstate(over="ignore"):
            norm = np.linalg.norm(quaternion)
        raise InputError(
            f"{file}, {pose.place(row)}: qx,qy,qz,qw = {quaternion.tolist()} has the norm "
            f"{norm:.3g} ({len(wrong)} such); allowed is 1"
        )
    for stream in (streams.wrench, pose):
        falling = np.flatnonzero(np.diff(stream.time) < 0)
        if falling.size:
            row = int(falling[0]) + 1
            raise InputError(
                f"{file}, {stream.place(row)}: time = {stream.time[row]} after "
                f"{stream.time[row - 1]} ({len(falling)} such); allowed are increasing times"
            )


def pose_faults(pose: Poses) -> list[Fault]:
    """Faults of poses that have stamps of their own, which bringing them to the stamps of the
    wrenches would hide.

    Parameters
    ----------
    pose
        As recorded, on the clock of the wrenches.
    """
    known = np.isfinite(pose.time)
    if not known.any():
        return []
    channels = ("position", "orientation")
    found = [
        replace(fault, channels=channels, text=f"stamps of the poses: {fault.text}")
        for fault in stamp_faults(pose.time)
    ]
    wrong, lost = wrong_norms(pose.orientation), ~pose.finite
    kinds = (
        (
            wrong,
            FaultKind.UNITS,
            channels[1:],
            f"of {len(wrong)} quaternions of the poses have another norm than 1; allowed is 1",
        ),
        (lost, FaultKind.DROP_OUT, channels, "poses without a number, which are passed over"),
    )
    for rows, kind, concerned, text in kinds:
        count = int(np.count_nonzero(rows))
        if count:
            stamps = pose.time[rows & known] if np.any(rows & known) else pose.time[known]
            first, last = float(stamps.min()), float(stamps.max())
            unusable = kind is FaultKind.UNITS
            found.append(Fault(kind, concerned, first, last, count, f"{count} {text}", unusable))
    return found
