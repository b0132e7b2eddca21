"""Poses of the sensor by the frames of /tf: the chain from a fixed frame, each link with stamps of
its own.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.files import InputError
from vibrissa.io.recordings.resample import interpolated
from vibrissa.io.recordings.streams import Stream

Pair = tuple[str, str]
_SMALLEST = 0.5


@dataclass(frozen=True)
class Edges:
    """Poses of frames in their parents, by (parent, child): streams of `POSE`, or one pose (7,) for
    all times.
    """

    moving: dict[Pair, Stream]
    fixed: dict[Pair, Float[np.ndarray, "7"]]


def chained(path: Path, edges: Edges, fixed_frame: str | None, sensor_frame: str) -> Stream:
    """Poses of `sensor_frame` in `fixed_frame`, at every stamp of a link where all links are known;
    no link is extrapolated.

    Parameters
    ----------
    path
        For messages.
    edges
        The links.
    fixed_frame
        World; None for the frame that the sensor's chain begins with.
    sensor_frame
        Frame that carries the sensor.

    Raises
    ------
    InputError
        If no chain leads from one to the other, or nothing on it moves.
    """
    chain = _chain(path, edges, fixed_frame, sensor_frame.lstrip("/"))
    moving = [edges.moving[pair] for pair in chain if pair in edges.moving]
    if not moving:
        raise InputError(
            f"{path}: no frame between {chain[0][0]!r} and {sensor_frame!r} is on /tf, all are static; allowed is a moving sensor"
        )
    for pair in chain:
        _check_rotations(
            path,
            pair,
            edges.moving[pair].values if pair in edges.moving else edges.fixed[pair][None],
        )
    first, last = max(link.time[0] for link in moving), min(link.time[-1] for link in moving)
    stamps = np.unique(np.concatenate([link.time for link in moving]))
    time = stamps[(stamps >= first) & (stamps <= last)]
    position, turn = np.zeros((len(time), 3)), Rotation.identity(len(time))
    for pair in chain:
        link = (
            interpolated(edges.moving[pair], time, np.inf)
            if pair in edges.moving
            else np.tile(edges.fixed[pair], (len(time), 1))
        )
        position = position + turn.apply(link[:, :3]) if len(time) else position
        turn = turn * Rotation.from_quat(link[:, 3:])
    return Stream(time, np.hstack([position, np.asarray(turn.as_quat()).reshape(-1, 4)]))


def _check_rotations(path: Path, pair: Pair, link: Float[np.ndarray, "n 7"]) -> None:
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(link[:, 3:], axis=1)
    if not np.all((norm > _SMALLEST) & (norm < 1 / _SMALLEST) & np.isfinite(link).all(axis=1)):
        raise InputError(
            f"{path}: frame {pair[1]!r} in {pair[0]!r} is not finite, or its quaternion has no norm; allowed is the norm 1"
        )


def _chain(path: Path, edges: Edges, fixed_frame: str | None, sensor_frame: str) -> list[Pair]:
    """Links from the fixed frame to the sensor's, by going up from child to parent."""
    parents = {child: parent for parent, child in [*edges.fixed, *edges.moving]}
    top = fixed_frame.lstrip("/") if fixed_frame is not None else None
    chain: list[Pair] = []
    here = sensor_frame
    while here != top and here in parents and len(chain) <= len(parents):
        chain.append((parents[here], here))
        here = parents[here]
    if not chain or (top is not None and here != top) or len(chain) > len(parents):
        known = sorted({frame for pair in [*edges.fixed, *edges.moving] for frame in pair})
        raise InputError(
            f"{path}: no chain of frames from fixed_frame = {fixed_frame!r} to sensor_frame = {sensor_frame!r}; the bag holds {', '.join(known)[:300]}"
        )
    return chain[::-1]
