"""What every format is read to: wrenches and poses, each with stamps of its own, SI units; and poses
at other stamps.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float, Int

from vibrissa.sensor.raw import Quaternions, Rows, Times, Vectors
from vibrissa.trail import Trail, between

Lines = Int[np.ndarray, "n"]
Kind = TypeVar("Kind", bound="Stamped")

# The largest entry of a quaternion with a rotation lies between the inverse and this.
_DAMAGED = 1e12


@dataclass(frozen=True, eq=False)
class Stamped:
    """Rows as they were recorded, not judged: stamps may stand or fall, numbers may be NaN.

    Attributes
    ----------
    time
        (n,) [s].
    line
        (n,) lines of the text that the rows stand in, from 1; None for other formats.
    """

    time: Times
    line: Lines | None = field(default=None, kw_only=True)

    def place(self, row: int) -> str:
        """Say where a row is in its file."""
        return f"row {row}" if self.line is None else f"line {self.line[row]}"

    def rows(self: Kind, chosen: Any) -> Kind:
        """Some of the rows, by a mask, numbers or a slice."""
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
        """Whether all numbers of a row are there."""
        numbers = np.column_stack([self.time, self.position, self.orientation])
        return np.isfinite(numbers).all(axis=1)


@dataclass(frozen=True, eq=False)
class Streams:
    """A recording before its poses are brought to the stamps of its wrenches.

    Attributes
    ----------
    wrench, pose
        The two streams.
    together
        Whether row i of both is one and the same row of the file, so that nothing needs to be
        interpolated.
    notes
        What was left out or recovered, a sentence each.
    """

    wrench: Wrenches
    pose: Poses
    together: bool = False
    notes: tuple[str, ...] = ()


def usable(pose: Poses) -> Poses:
    """Poses that can be interpolated: finite, with a rotation, in the order of their stamps, the
    first where several share one.
    """
    size = np.abs(pose.orientation).max(axis=1)
    rows = pose.rows(pose.finite & (size > 1 / _DAMAGED) & (size < _DAMAGED))
    return rows.rows(np.unique(rows.time, return_index=True)[1])


def within(pose: Poses, time: Times) -> Rows:
    """Whether stamps lie between the first and the last of at least one pose."""
    return (time >= pose.time[0]) & (time <= pose.time[-1])


def interpolated(pose: Poses, time: Times) -> Poses:
    """Poses at the stamps `time` [s], in any order, also NaN: straight and evenly turned between
    their neighbours; NaN before the first and after the last pose. There is at least one pose, and
    their stamps increase.
    """
    known = between(pose.time, Trail(pose.position, pose.orientation), np.nan_to_num(time))
    inside = within(pose, time)[:, None]
    position, orientation = (
        np.where(inside, part, np.nan) for part in (known.position, known.orientation)
    )
    return Poses(time, position, orientation)


def in_gap(pose: Poses, time: Times, longest: float) -> Rows:
    """Whether stamps lie between two poses that are further apart than `longest` [s]; at the ends
    of a gap the pose is known.
    """
    after = np.clip(np.searchsorted(pose.time, time), 1, len(pose.time) - 1)
    first, last = pose.time[after - 1], pose.time[after]
    return (last - first > longest) & (first < time) & (time < last)
