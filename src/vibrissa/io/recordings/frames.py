"""Poses of the sensor by the frames of /tf: the chain from a fixed frame, each link with stamps of
its own.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from vibrissa.files import InputError
from vibrissa.io.recordings.resample import interpolated
from vibrissa.io.recordings.streams import Poses

Pair = tuple[str, str]
"""Parent and child."""
# Quaternions of a broadcaster are normalised to single precision at worst; less is damage.
_SMALLEST_NORM, _LARGEST_NORM = 0.5, 2.0


class Link(NamedTuple):
    """Poses of a frame in its parent; a fixed one has a single pose, which holds for all times."""

    poses: Poses
    is_fixed: bool


def chained(
    path: Path, links: Mapping[Pair, Link], fixed_frame: str | None, sensor_frame: str
) -> Poses:
    """Poses of `sensor_frame` in `fixed_frame`, at every stamp of a link where all links are known;
    no link is extrapolated.

    Parameters
    ----------
    path
        For messages.
    links
        By parent and child.
    fixed_frame
        World; None for the frame that the sensor's chain begins with.
    sensor_frame
        Frame that carries the sensor.

    Raises
    ------
    InputError
        If no chain leads from one to the other, nothing on it moves, or its links have no time in
        common.
    """
    chain = _chain(path, links, fixed_frame, sensor_frame.lstrip("/"))
    moving = [links[pair].poses.time for pair in chain if not links[pair].is_fixed]
    ends = f"between {chain[0][0]!r} and {sensor_frame!r}"
    if not moving:
        raise InputError(
            f"{path}: no frame {ends} is on /tf, all are static; allowed is a moving sensor"
        )
    for parent, child in chain:
        _check_rotations(path, parent, child, links[parent, child].poses)
    first, last = max(time[0] for time in moving), min(time[-1] for time in moving)
    stamps = np.unique(np.concatenate(moving))
    time = stamps[(stamps >= first) & (stamps <= last)]
    if not len(time):
        raise InputError(
            f"{path}: the frames {ends} have no time in common; allowed are links that overlap"
        )
    position, turn = np.zeros((len(time), 3)), Rotation.identity(len(time))
    for pair in chain:
        poses, is_fixed = links[pair]
        link = poses if is_fixed else interpolated(poses, time)
        position = position + turn.apply(link.position)
        turn = turn * Rotation.from_quat(link.orientation)
    return Poses(time, position, turn.as_quat())


def _check_rotations(path: Path, parent: str, child: str, poses: Poses) -> None:
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(poses.orientation, axis=1)
    if not np.all((norm > _SMALLEST_NORM) & (norm < _LARGEST_NORM) & poses.finite):
        raise InputError(
            f"{path}: frame {child!r} in {parent!r} is not finite, or its quaternion has no norm; "
            "allowed is the norm 1"
        )


def _chain(
    path: Path, links: Mapping[Pair, Link], fixed_frame: str | None, sensor_frame: str
) -> list[Pair]:
    """Links from the fixed frame to the sensor's, by going up from child to parent."""
    parents = {child: parent for parent, child in links}
    top = None if fixed_frame is None else fixed_frame.lstrip("/")
    chain: list[Pair] = []
    here = sensor_frame
    while here != top and here in parents and len(chain) <= len(parents):
        chain.insert(0, (parents[here], here))
        here = parents[here]
    if not chain or top not in {None, here} or len(chain) > len(parents):
        known = sorted({frame for pair in links for frame in pair})
        raise InputError(
            f"{path}: no chain of frames from fixed_frame = {fixed_frame!r} to sensor_frame = "
            f"{sensor_frame!r}; the bag holds {', '.join(known)[:300]}"
        )
    return chain
