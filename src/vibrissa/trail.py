"""Paths of the clamp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.brief import point
from vibrissa.files import InputError, check_increasing, read_table, writable
from vibrissa.geometry.checks import finite, finite_array, unit_vector, whole_number
from vibrissa.geometry.motion import arm_of, equal_angles, matrix_parts
from vibrissa.geometry.rotation import (
    Orientation,
    Turn,
    rotation_matrices,
    rotation_vectors,
    turning_axis_to,
    unit_quaternions,
)

COLUMNS = ("x", "y", "z", "qx", "qy", "qz", "qw")
"""Columns of a pose file: clamp point [units of the rod], quaternion x, y, z, w."""

Index = int | np.integer | slice | Sequence[int] | Sequence[bool] | np.ndarray
"""What picks rows along one axis."""

_NO_NORM = 1e-12


@dataclass(frozen=True, eq=False)
class Trail:
    """Clamp poses along one path (n, …), or along several of equal length (m, n, …).

    Between two positions the clamp moves in a straight line and turns about a fixed axis.

    Attributes
    ----------
    position
        Clamp points (n, 3) or (m, n, 3), world axes, in units of the rod.
    orientation
        Quaternions x, y, z, w (n, 4) or (m, n, 4), or one for all (4,): they map clamp axes onto
        world axes. The rod leaves along clamp +z.

    Raises
    ------
    ValueError
        If a trail has no position, shapes do not match, an entry is not finite, or a quaternion has
        zero norm.
    """

    position: Float[np.ndarray, "*trail n 3"]
    orientation: Float[np.ndarray, "*trail n 4"] = field(
        default_factory=lambda: np.array([0.0, 0.0, 0.0, 1.0])
    )

    def __init__(
        self, position: ArrayLike, orientation: Orientation = (0.0, 0.0, 0.0, 1.0)
    ) -> None:
        points = finite_array(position, "position", last=3)
        if points.ndim not in (2, 3):
            raise ValueError(
                f"position has shape {points.shape}; allowed is (n, 3) for one trail or (m, "
                "n, 3) for several"
            )
        if points.size == 0:
            raise ValueError(
                f"position has shape {points.shape}: an empty trail; allowed is at least one "
                "position"
            )
        turns = unit_quaternions(orientation, "orientation")
        try:
            turns = np.array(np.broadcast_to(turns, (*points.shape[:-1], 4)))
        except ValueError as error:
            raise ValueError(
                f"orientation has shape {turns.shape}; allowed is (4,) or "
                f"{(*points.shape[:-1], 4)}, as position has"
            ) from error
        object.__setattr__(self, "position", points)
        object.__setattr__(self, "orientation", turns)

    def __repr__(self) -> str:
        """Return one line: how many poses, from where to where."""
        poses = "pose" if self.position.size == 3 else "poses"
        ends = self.position.reshape(-1, 3)[[0, -1]]
        return (
            f"Trail of {self.position.size // 3} {poses} {self.shape} from "
            f"{' to '.join(map(point, ends))}"
        )

    @classmethod
    def line(
        cls, *, start: ArrayLike, stop: ArrayLike, count: int, axis: ArrayLike = (0.0, 0.0, 1.0)
    ) -> Trail:
        """`count` equally spaced positions from `start` to `stop` (3,), the rod leaving along
        `axis` (3,).

        Raises
        ------
        ValueError
            If an entry is not finite, `axis` is zero, or `count` is less than 1.
        """
        first, last = _point(start, "start"), _point(stop, "stop")
        return cls(
            np.linspace(first, last, whole_number(count, "count")),
            turning_axis_to(unit_vector(axis, "axis")),
        )

    @classmethod
    def raster(
        cls,
        *,
        start: ArrayLike,
        stop: ArrayLike,
        count: int,
        step: ArrayLike,
        trails: int,
        axis: ArrayLike = (0.0, 0.0, 1.0),
    ) -> Trail:
        """Parallel lines: `trails` copies of the line from `start` to `stop`, each shifted by
        `step` (3,). Shape (trails, count, …).

        Raises
        ------
        ValueError
            As for `line`, and if `trails` is less than 1.
        """
        line = cls.line(start=start, stop=stop, count=count, axis=axis)
        number = np.arange(whole_number(trails, "trails"))[:, None, None]
        return cls(line.position + number * _point(step, "step"), line.orientation)

    @classmethod
    def arc(
        cls,
        *,
        center: ArrayLike,
        axis: ArrayLike,
        start: ArrayLike,
        angle: float,
        count: int,
        orientation: Orientation | None = None,
        rod_axis: ArrayLike | None = None,
        turning: bool = False,
    ) -> Trail:
        """`count` clamp points equally spaced on a circular arc.

        Parameters
        ----------
        center, axis
            A point (3,) and the direction (3,) of the line about which the clamp point moves,
            right-handed.
        start
            First clamp point (3,), off that line.
        angle
            Of the whole arc [rad]; negative for the opposite direction.
        orientation, rod_axis
            Of the clamp at `start`: a quaternion x, y, z, w or a SciPy `Rotation`, or instead the
            direction (3,) in which the rod leaves. By default the rod leaves along +z.
        turning
            Whether the clamp turns with the arc, or keeps its orientation.

        Raises
        ------
        ValueError
            If an entry is not finite, an axis is zero, `start` lies on the line, both `orientation`
            and `rod_axis` are given, `count` is less than 1, or a step is half a turn or more.
        """
        first, middle = _point(start, "start"), _point(center, "center")
        if not np.any(arm_of(first, middle, unit_vector(axis, "axis"))):
            raise ValueError(
                f"start = {first.tolist()} lies on the line through center along axis; allowed is "
                "a point off it"
            )
        turned = cls.whisk(
            pivot=middle,
            axis=axis,
            position=first,
            start_angle=0.0,
            stop_angle=finite(angle, "angle"),
            count=count,
            orientation=orientation,
            rod_axis=rod_axis,
        )
        return turned if turning else cls(turned.position, _clamp_turn(orientation, rod_axis))

    @classmethod
    def whisk(
        cls,
        *,
        pivot: ArrayLike,
        axis: ArrayLike,
        position: ArrayLike,
        start_angle: float,
        stop_angle: float,
        count: int,
        orientation: Orientation | None = None,
        rod_axis: ArrayLike | None = None,
    ) -> Trail:
        """`count` poses of a clamp that turns as one body about a pivot axis, as a rat's whisker
        does, at equal steps of the angle.

        Parameters
        ----------
        pivot, axis
            A point (3,) and the direction (3,) of the axis, right-handed.
        position
            Clamp point (3,) at angle 0; if it lies on the axis, the clamp only turns.
        start_angle, stop_angle
            First and last angle [rad].
        orientation, rod_axis
            Of the clamp at angle 0: a quaternion x, y, z, w or a SciPy `Rotation`, or instead the
            direction (3,) in which the rod leaves. By default the rod leaves along +z.

        Raises
        ------
        ValueError
            If an entry is not finite, an axis is zero, both `orientation` and `rod_axis` are given,
            `count` is less than 1, or a step is half a turn or more.
        """
        about = unit_vector(axis, "axis")
        angles = equal_angles(
            finite(start_angle, "start_angle"),
            finite(stop_angle, "stop_angle"),
            whole_number(count, "count"),
        )
        point, turns = (
            _point(position, "position"),
            scipy.spatial.transform.Rotation.from_rotvec(angles[:, None] * about),
        )
        arm = arm_of(point, _point(pivot, "pivot"), about)
        orientations = turns * scipy.spatial.transform.Rotation.from_quat(
            _clamp_turn(orientation, rod_axis)
        )
        return cls(point - arm + turns.apply(arm), orientations)

    @classmethod
    def spline(
        cls,
        points: ArrayLike,
        count: int,
        *,
        orientations: Orientation | None = None,
        rod_axis: ArrayLike | None = None,
    ) -> Trail:
        """`count` poses on a smooth curve through way-points, equally spaced in arc length from the
        first to the last.

        Parameters
        ----------
        points
            Way-points (k, 3), at least two, through which a cubic spline runs, parametrised by
            chord length.
        count
            Number of positions; inner way-points are passed through, but are not positions
            themselves.
        orientations, rod_axis
            Of the clamp: one quaternion x, y, z, w for all (4,) or one at each way-point (k, 4), as
            arrays or a SciPy `Rotation`; or instead one direction (3,) in which the rod leaves.
            Between way-points the angular velocity is continuous. By default the rod leaves along
            +z.

        Raises
        ------
        ValueError
            If there are fewer than two points, successive ones coincide, shapes do not match, an
            entry is not finite, a quaternion has zero norm, both `orientations` and `rod_axis` are
            given, or `count` is less than 1.
        """
        from vibrissa.geometry.spline import along_spline  # noqa: PLC0415

        through = finite_array(points, "points", last=3, ndim=2)
        turns = _one_of(orientations, rod_axis, "orientations")
        if turns.shape not in ((4,), (len(through), 4)):
            raise ValueError(
                f"orientations has shape {turns.shape}; allowed is (4,) or "
                f"{(len(through), 4)}, as points has"
            )
        each = np.broadcast_to(turns, (len(through), 4))
        return cls(*along_spline(through, each, whole_number(count, "count")))

    @classmethod
    def from_poses(cls, poses: Orientation, *, position: ArrayLike | None = None) -> Trail:
        """Clamp poses as robots give them.

        Parameters
        ----------
        poses
            Homogeneous matrices (n, 4, 4), or (m, n, 4, 4) for several trails, that map clamp
            coordinates onto world coordinates: columns are the clamp's axes and its point. Or a
            SciPy `Rotation`, together with `position`.
        position
            Clamp points (n, 3) or (m, n, 3) that go with a `Rotation`.

        Raises
        ------
        ValueError
            If shapes do not match, an entry is not finite, a matrix is not a rotation and
            translation to 1e-3, or a `Rotation` is given without positions.
        """
        if isinstance(poses, Turn):
            if position is None:
                raise ValueError(
                    "position = None; allowed are clamp points (n, 3) beside a Rotation"
                )
            return cls(position, poses)
        if position is not None:
            raise ValueError(
                "position: the matrices hold it; allowed is a position beside a Rotation only"
            )
        return cls(*matrix_parts(poses, "poses"))

    @classmethod
    def from_csv(cls, path: str | Path) -> Trail:
        """One trail from a CSV file with a header: the columns `x,y,z,qx,qy,qz,qw` in any order, in
        units of the rod.

        A column `time` is optional. It must increase, and is not kept: a sweep is quasi-static.

        Raises
        ------
        InputError
            If the file cannot be read, a column is missing or unknown, a row is short or cut off, a
            number is not finite, time does not increase, or a quaternion has zero norm; the message
            is one line that names file, line and column.
        """
        table = read_table(Path(path), COLUMNS, optional=("time",))
        if "time" in table:
            check_increasing(Path(path), table["time"])
        pose = np.column_stack([table[name] for name in COLUMNS])
        zero = np.flatnonzero(np.linalg.norm(pose[:, 3:], axis=1) < _NO_NORM)
        if zero.size:
            raise InputError(
                f"{path}, line {zero[0] + 2}: qx,qy,qz,qw = {pose[zero[0], 3:].tolist()} has zero "
                f"norm ({zero.size} such); allowed is any quaternion x, y, z, w of non-zero norm"
            )
        return cls(pose[:, :3], pose[:, 3:])

    @classmethod
    def stack(cls, trails: Sequence[Trail]) -> Trail:
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
        count = lengths.pop()
        return cls(
            np.concatenate([trail.position.reshape(-1, count, 3) for trail in trails]),
            np.concatenate([trail.orientation.reshape(-1, count, 4) for trail in trails]),
        )

    def placed(
        self, rotation: Orientation = (0.0, 0.0, 0.0, 1.0), translation: ArrayLike = (0, 0, 0)
    ) -> Trail:
        """The same poses turned about the origin, then moved.

        Parameters
        ----------
        rotation
            Quaternion x, y, z, w, or a SciPy Rotation.
        translation
            (3,) in units of the rod.

        Raises
        ------
        ValueError
            If the quaternion has zero norm, or an entry is not finite.
        """
        from_quat = scipy.spatial.transform.Rotation.from_quat
        turn = from_quat(unit_quaternions(rotation, "rotation"))
        moved = turn.apply(self.position.reshape(-1, 3)) + _point(translation, "translation")
        turned = turn * from_quat(self.orientation.reshape(-1, 4))
        return Trail(
            moved.reshape(self.position.shape), turned.as_quat().reshape(self.orientation.shape)
        )

    def to_csv(self, path: str | Path) -> None:
        """Write the poses of a single trail with the columns that `from_csv` reads.

        Raises
        ------
        ValueError
            If there are several trails.
        InputError
            If the file cannot be written.
        """
        if len(self.shape) > 1:
            raise ValueError(
                f"trail has shape {self.shape}; allowed is a single trail, as trail[i]"
            )
        rows = np.column_stack([self.position, self.orientation])
        header = ",".join(COLUMNS)
        np.savetxt(writable(Path(path)), rows, "%.17g", ",", header=header, comments="")

    def __getitem__(self, index: Index) -> Trail:
        """Some positions of one trail, or some of several trails: a slice, a mask or an array of
        numbers keeps the first axis, a number gives a trail of one position, or one of several
        trails.

        Raises
        ------
        IndexError
            If the index is out of range, or has more than one axis.
        ValueError
            If nothing is left.
        """
        rows = first_axis(index, self.shape)
        return Trail(self.position[rows], self.orientation[rows])

    @property
    def count(self) -> int:
        """Positions on each trail."""
        return int(self.position.shape[-2])

    @property
    def shape(self) -> tuple[int, ...]:
        """Batch shape: (n,) or (m, n)."""
        return self.position.shape[:-1]

    @cached_property
    def rotation(self) -> Float[np.ndarray, "*trail n 3 3"]:
        """Matrices that take clamp axes to world axes."""
        return rotation_matrices(self.orientation)

    @property
    def axis(self) -> Float[np.ndarray, "*trail n 3"]:
        """Unit vectors along which the rod leaves the clamp."""
        return self.rotation[..., 2]

    @property
    def steps(self) -> Float[np.ndarray, "*trail steps 6"]:
        """Displacement, and rotation vector [rad], of the clamp from each position to the next."""
        before, after = self.orientation[..., :-1, :], self.orientation[..., 1:, :]
        ways = np.diff(self.position, axis=-2)
        return np.concatenate([ways, rotation_vectors(before, after)], axis=-1)

    @property
    def parameter(self) -> Float[np.ndarray, "*trail n"]:
        """0 to 1 along each trail: the fraction of the clamp's path length, or of the number of
        steps if the clamp stands still or only turns on one of them.
        """
        steps = np.linalg.norm(np.diff(self.position, axis=-2), axis=-1)
        steps = np.where(np.all(steps > 0, axis=-1, keepdims=True), steps, 1.0)
        gone = np.cumsum(np.insert(steps, 0, 0.0, axis=-1), axis=-1)
        return gone / np.where(self.count > 1, gone[..., -1:], 1.0)


def between(time: Float[np.ndarray, "k"], motion: Trail, moment: Float[np.ndarray, "n"]) -> Trail:
    """Poses at these times of a motion with poses (k, …) at `time`: between neighbours, on a
    straight line and turning evenly; beyond the ends, the outermost ones.
    """
    row = np.interp(moment, time, np.arange(len(time)))
    before, after = (motion.orientation[end(row).astype(int)] for end in (np.floor, np.ceil))
    turn = scipy.spatial.transform.Rotation.from_rotvec(
        (row % 1)[:, None] * rotation_vectors(before, after)
    )
    return Trail(
        linear(time, motion.position, moment),
        turn * scipy.spatial.transform.Rotation.from_quat(before),
    )


def linear(
    time: Float[np.ndarray, "k"], values: Float[np.ndarray, "k c"], moment: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n c"]:
    """Values at these times: interpolated linearly, and beyond the ends the outermost ones."""
    return np.stack([np.interp(moment, time, column) for column in values.T], axis=1)


def first_axis(index: Index, shape: tuple[int, ...]) -> slice | np.ndarray:
    """An index into the first of these axes that leaves at least one axis.

    Raises
    ------
    IndexError
        If it is out of range, or has more than one axis.
    """
    if isinstance(index, slice):
        return index
    rows = np.asarray(index)
    if isinstance(index, tuple) or rows.ndim > 1:
        raise IndexError(
            f"index = {index!r}; allowed is a number, a slice, a mask (n,) or an array of numbers"
        )
    return np.atleast_1d(rows) if len(shape) == 1 else rows


def _point(value: ArrayLike, name: str) -> Float[np.ndarray, "3"]:
    return finite_array(value, name, last=3, ndim=1)


def _one_of(
    orientation: Orientation | None, rod_axis: ArrayLike | None, name: str
) -> Float[np.ndarray, "*batch 4"]:
    if rod_axis is None:
        return unit_quaternions((0.0, 0.0, 0.0, 1.0) if orientation is None else orientation, name)
    if orientation is not None:
        raise ValueError(f"rod_axis = {rod_axis!r} beside {name}; allowed is one of the two")
    return turning_axis_to(unit_vector(rod_axis, "rod_axis"))


def _clamp_turn(
    orientation: Orientation | None, rod_axis: ArrayLike | None
) -> Float[np.ndarray, "4"]:
    turn = _one_of(orientation, rod_axis, "orientation")
    if turn.shape != (4,):
        raise ValueError(f"orientation has shape {turn.shape}; allowed is one quaternion (4,)")
    return turn
