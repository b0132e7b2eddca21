"""The common form of all formats: wrenches and poses, each with its own stamps, in SI units; and
interpolation of poses.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, Int

from vibrissa.sensor.raw import Quaternions, Rows, Times, Vectors
from vibrissa.trail import Trail, between

Lines = Int[np.ndarray, "n"]
Kind = TypeVar("Kind", bound="Stamped")

# The largest entry of a usable quaternion lies between the inverse of this and this.
_DAMAGED = 1e12


@dataclass(frozen=True, eq=False)
class Stamped:
    """Rows as recorded, unchecked: stamps may repeat or decrease, numbers may be NaN.

    Attributes
    ----------
    time
        (n,) [s].
    line
        Line numbers (n,) of the rows in a text file, from 1; None for other formats.
    """

    time: Times
    line: Lines | None = field(default=None, kw_only=True)

    def place(self, row: int) -> str:
        """Where a row is in its file, in words."""
        return f"row {row}" if self.line is None else f"line {self.line[row]}"

    def rows(self: Kind, chosen: Any) -> Kind:
        """Some of the rows, by mask, indices or slice."""
        parts = {part.name: getattr(self, part.name) for part in fields(self)}
        known = {name: part[chosen] for name, part in parts.items() if part is not None}
        return replace(self, **known)


@dataclass(frozen=True, eq=False)
class Wrenches(Stamped):
    """Stamped wrenches.

    Attributes
    ----------
    force, torque
        (n, 3) [N], [N m].
    """

    force: Vectors
    torque: Vectors

    @property
    def channels(self) -> Float[np.ndarray, "n 6"]:
        """Force, then torque."""
        return np.hstack([self.force, self.torque])


@dataclass(frozen=True, eq=False)
class Poses(Stamped):
    """Stamped poses of the sensor frame.

    Attributes
    ----------
    position
        (n, 3) [m].
    orientation
        (n, 4) quaternions x, y, z, w.
    """

    position: Vectors
    orientation: Quaternions

    @property
    def finite(self) -> Rows:
        """Whether all numbers of a row are finite."""
        numbers = np.column_stack([self.time, self.position, self.orientation])
        return np.isfinite(numbers).all(axis=1)


@dataclass(frozen=True, eq=False)
class Streams:
    """A recording before its poses are interpolated at the stamps of its wrenches.

    Attributes
    ----------
    wrench, pose
        The two streams.
    together
        Whether row i of both is the same row of the file, so that no interpolation is needed.
    notes
        What was left out or recovered, one sentence each.
    """

    wrench: Wrenches
    pose: Poses
    together: bool = False
    notes: tuple[str, ...] = ()


def usable(pose: Poses) -> Poses:
    """Poses that can be interpolated: finite, with a valid rotation, sorted by stamp; of those that
    share a stamp, only the first.
    """
    size = np.abs(pose.orientation).max(axis=1)
    rows = pose.rows(pose.finite & (size > 1 / _DAMAGED) & (size < _DAMAGED))
    return rows.rows(np.unique(rows.time, return_index=True)[1])


def within(pose: Poses, time: Times) -> Rows:
    """Whether stamps lie between the first and the last pose; there is at least one."""
    return (time >= pose.time[0]) & (time <= pose.time[-1])


def interpolated(pose: Poses, time: Times) -> Poses:
    """Poses at the stamps `time` [s], in any order and possibly NaN: linear motion and uniform
    rotation between neighbours; NaN before the first and after the last pose. There is at least one
    pose, and the stamps of poses increase.
    """
    known = between(pose.time, Trail(pose.position, pose.orientation), np.nan_to_num(time))
    inside = within(pose, time)[:, None]
    position, orientation = (
        np.where(inside, part, np.nan) for part in (known.position, known.orientation)
    )
    return Poses(time, position, orientation)


def in_gap(pose: Poses, time: Times, longest: float) -> Rows:
    """Whether stamps lie strictly between two poses more than `longest` [s] apart; at the ends of a
    gap the pose is known.
    """
    after = np.clip(np.searchsorted(pose.time, time), 1, len(pose.time) - 1)
    first, last = pose.time[after - 1], pose.time[after]
    return (last - first > longest) & (first < time) & (time < last)
