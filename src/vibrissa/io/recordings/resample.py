"""Poses at the stamps of the wrenches: positions linearly, orientations along the shortest
rotation, nothing beyond the ends.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from vibrissa.io.recordings.streams import Poses


def usable(pose: Poses) -> Poses:
    """Poses that can be interpolated: finite, with a rotation, in the order of their stamps, the
    first of those that share one.
    """
    rows = pose.rows(pose.finite)
    rows = rows.rows(np.any(rows.orientation != 0, axis=1))
    return rows.rows(np.unique(rows.time, return_index=True)[1])


def interpolated(pose: Poses, time: Float[np.ndarray, "n"], longest_gap: float = np.inf) -> Poses:
    """Poses at the stamps `time`; NaN before the first and after the last pose, and between two
    that are further apart than `longest_gap`.

    Parameters
    ----------
    pose
        At least one pose; stamps increase.
    time
        Stamps [s], in any order, also NaN.
    longest_gap
        [s].
    """
    inside = within(pose, time)
    position, orientation = np.full((len(time), 3), np.nan), np.full((len(time), 4), np.nan)
    found = Poses(time, position, orientation)
    if not inside.any():
        return found
    wanted, last_one = time[inside], len(pose.time) - 1
    after = np.minimum(np.searchsorted(pose.time, wanted, side="right"), last_one)
    first, last = pose.rows(np.maximum(after - 1, 0)), pose.rows(after)
    step = last.time - first.time
    share = np.divide(wanted - first.time, step, out=np.zeros_like(step), where=step > 0)[:, None]
    turn = Rotation.from_quat(first.orientation)
    way = (turn.inv() * Rotation.from_quat(last.orientation)).as_rotvec()
    position[inside] = first.position + share * (last.position - first.position)
    orientation[inside] = (turn * Rotation.from_rotvec(share * way)).as_quat()
    # At a gap's ends the pose is known all the same.
    gap = np.flatnonzero(inside)[(step > longest_gap) & (share[:, 0] > 0) & (share[:, 0] < 1)]
    position[gap] = orientation[gap] = np.nan
    return found


def within(pose: Poses, time: Float[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Whether stamps lie between the first and the last pose."""
    return np.asarray((time >= pose.time[0]) & (time <= pose.time[-1]))
