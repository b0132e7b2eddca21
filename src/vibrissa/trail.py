"""Paths of the clamp."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from vibrissa.geometry.checks import finite_array, unit_vector
from vibrissa.geometry.rotation import third_axis, turning_axis_to, unit_quaternions


@dataclass(frozen=True, eq=False)
class Trail:
    """Clamp poses along one path (n, …), or along several of equal length (m, n, …).

    Between two positions the clamp moves straight and turns about a fixed axis.

    Attributes
    ----------
    position
        Clamp points (n, 3) or (m, n, 3), world axes, in units of the rod.
    orientation
        Quaternions x, y, z, w (n, 4) or (m, n, 4), or one for all (4,): they map clamp axes onto world axes. The rod leaves along clamp +z.

    Raises
    ------
    ValueError
        If a trail has no position, shapes do not fit, an entry is not finite, or a quaternion has zero norm.
    """

    position: Float[np.ndarray, "*trail n 3"]
    orientation: Float[np.ndarray, "*trail n 4"] = field(default_factory=lambda: np.array([0.0, 0.0, 0.0, 1.0]))

    def __init__(self, position: ArrayLike, orientation: "ArrayLike | Rotation" = (0.0, 0.0, 0.0, 1.0)) -> None:
        points = finite_array(position, "position", last=3)
        if points.ndim not in (2, 3):
            raise ValueError(f"position has shape {points.shape}; allowed is (n, 3) for one trail or (m, n, 3) for several")
        if points.size == 0:
            raise ValueError(f"position has shape {points.shape}: an empty trail; allowed is at least one position")
        turns = unit_quaternions(orientation, "orientation")
        try:
            turns = np.array(np.broadcast_to(turns, (*points.shape[:-1], 4)))
        except ValueError as error:
            raise ValueError(
                f"orientation has shape {turns.shape}; allowed is (4,) or {(*points.shape[:-1], 4)}, as position has"
            ) from error
        object.__setattr__(self, "position", points)
        object.__setattr__(self, "orientation", turns)

    @classmethod
    def line(cls, *, start: ArrayLike, stop: ArrayLike, count: int, axis: ArrayLike = (0.0, 0.0, 1.0)) -> "Trail":
        """`count` equally spaced positions from `start` to `stop` (3,), the rod leaving along `axis` (3,).

        Raises
        ------
        ValueError
            If an entry is not finite, `axis` is zero, or `count` is less than 1.
        """
        first, last = finite_array(start, "start", last=3, ndim=1), finite_array(stop, "stop", last=3, ndim=1)
        return cls(np.linspace(first, last, _count(count, "count")), turning_axis_to(unit_vector(axis, "axis")))

    @classmethod
    def raster(
        cls, *, start: ArrayLike, stop: ArrayLike, count: int, step: ArrayLike, trails: int, axis: ArrayLike = (0.0, 0.0, 1.0)
    ) -> "Trail":
        """Parallel lines: `trails` copies of the line from `start` to `stop`, each moved on by `step` (3,). Shape (trails, count, …).

        Raises
        ------
        ValueError
            As for `line`, and if `trails` is less than 1.
        """
        line = cls.line(start=start, stop=stop, count=count, axis=axis)
        offset = np.arange(_count(trails, "trails"))[:, None, None] * finite_array(step, "step", last=3, ndim=1)
        return cls(line.position + offset, line.orientation)

    @classmethod
    def stack(cls, trails: "Sequence[Trail]") -> "Trail":
        """Several trails of equal length as one, (m, n, …).

        Raises
        ------
        ValueError
            If there is none, or their lengths differ.
        """
        if not trails:
            raise ValueError("trails is empty; allowed is at least one trail")
        lengths = {trail.count for trail in trails}
        if len(lengths) > 1:
            raise ValueError(f"trails have {sorted(lengths)} positions; allowed are equal lengths")
        position = np.concatenate([trail.position.reshape(-1, trail.count, 3) for trail in trails])
        orientation = np.concatenate([trail.orientation.reshape(-1, trail.count, 4) for trail in trails])
        return cls(position, orientation)

    @property
    def count(self) -> int:
        """Positions on each trail."""
        return int(self.position.shape[-2])

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape: (n,) or (m, n)."""
        return self.position.shape[:-1]

    @property
    def axis(self) -> Float[np.ndarray, "*trail n 3"]:
        """Unit vectors along which the rod leaves the clamp."""
        return third_axis(self.orientation)

    @property
    def parameter(self) -> Float[np.ndarray, "*trail n"]:
        """0 to 1 along each trail: the share of the clamp's path length, or of the positions where the clamp only turns."""
        steps = np.linalg.norm(np.diff(self.position, axis=-2), axis=-1)
        total = steps.sum(axis=-1, keepdims=True)
        share = np.where(total > 0, np.cumsum(steps, axis=-1) / np.where(total > 0, total, 1), np.linspace(0, 1, self.count)[1:])
        return np.concatenate([np.zeros((*self.shape[:-1], 1)), share], axis=-1)


def _count(value: int, name: str) -> int:
    if not math.isfinite(value) or int(value) != value or value < 1:
        raise ValueError(f"{name} = {value!r}; allowed is a whole number of at least 1")
    return int(value)
