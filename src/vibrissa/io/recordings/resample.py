"""Poses at the stamps of the wrenches: positions linearly, orientations along the shortest
rotation, nothing beyond the ends.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from vibrissa.io.recordings.streams import Stream


def usable(pose: Stream) -> Stream:
    """Poses that can be interpolated: finite, with a rotation, in the order of their stamps, the
    first of those that share one.
    """
    sound = np.isfinite(pose.time) & np.all(np.isfinite(pose.values), axis=1)
    sound[sound] &= np.linalg.norm(pose.values[sound, 3:], axis=1) > 0
    rows = pose.rows(sound)
    _, first = np.unique(rows.time, return_index=True)
    return rows.rows(first)


def interpolated(
    pose: Stream, time: Float[np.ndarray, "n"], longest_gap: float
) -> Float[np.ndarray, "n 7"]:
    """Poses (n, 7) at the stamps `time`; NaN before the first and after the last pose, and between
    two that are further apart than `longest_gap`.

    Parameters
    ----------
    pose
        At least one pose; stamps increase.
    time
        Stamps [s], in any order, also NaN.
    longest_gap
        [s].
    """
    values = np.full((len(time), 7), np.nan)
    inside = within(pose, time)
    before = np.clip(
        np.searchsorted(pose.time, time[inside], side="right") - 1, 0, max(len(pose.time) - 2, 0)
    )
    after = np.minimum(before + 1, len(pose.time) - 1)
    step = pose.time[after] - pose.time[before]
    share = np.divide(
        time[inside] - pose.time[before], step, out=np.zeros_like(step), where=step > 0
    )[:, None]
    first, last = pose.values[before], pose.values[after]
    position = first[:, :3] + share * (last[:, :3] - first[:, :3])
    turn = Rotation.from_quat(first[:, 3:]) if len(first) else None
    found = np.empty((len(first), 7))
    if turn is not None:
        turned = turn * Rotation.from_rotvec(
            share * (turn.inv() * Rotation.from_quat(last[:, 3:])).as_rotvec()
        )
        found = np.hstack([position, turned.as_quat()])
    # Next to a gap's ends the pose is known all the same.
    found[(step > longest_gap) & (share[:, 0] > 0) & (share[:, 0] < 1)] = np.nan
    values[inside] = found
    return values


def within(pose: Stream, time: Float[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Whether stamps lie between the first and the last pose."""
    return np.asarray((time >= pose.time[0]) & (time <= pose.time[-1]))
