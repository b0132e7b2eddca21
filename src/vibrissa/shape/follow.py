"""Following a girth or a contour unaided: each sweep is planned from what the last ones told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.spatial import KDTree

from vibrissa.contacts import Status
from vibrissa.geometry.checks import finite_array, positive, unit_vector, whole_number
from vibrissa.inverse import Reconstruction
from vibrissa.rod import Rod
from vibrissa.shape.fit import fit_shape
from vibrissa.shape.plan import next_sweep
from vibrissa.shape.shape import Shape
from vibrissa.trail import Trail

_MISSED, _POINTS = 60, 30
"""Rods of a sweep that missed, and points of each, that the fit is told of."""
_STEP = 1 / 150
"""Distance between points of the girth, relative to the extent of the contacts."""
_LONGEST = 12.0
"""Length of a curve that closes or ends, relative to that extent."""
_STANDS = 24
"""Directions in the plane from which sweeps are tried, both ways each."""
_DEPTHS = (0.2, 0.35, 0.5)
"""How far tips reach beyond the side of the object that is next to the clamp [L]."""
_BESIDE = (0.0, -0.05, 0.05)
"""Distances of sweeps from the plane [L]: where the object leans, rods slide out of it. Seven
girths of an ellipsoid took 16 sweeps on average with those in it alone, 8 with these, and 11 with
twice the distance.
"""
_BEFORE, _AFTER = 0.15, 0.6
"""How far beyond the object sweeps start and stop [L]: a bent rod comes off late."""
_POSITIONS = 120
"""Of a sweep."""
_TOLERANCE = 2e-3
"""Within which a curve is to be known [L]: contacts of a steel wire of 50 mm on a common sensor are
within that.
"""
_SHARE, _WIDE = 0.95, 1.96
"""Share of the curve whose 95 % interval is to be within the tolerance, and deviations to its ends.
"""


@dataclass(frozen=True, eq=False)
class Followed:
    """A girth or a contour that was followed.

    Attributes
    ----------
    point
        (k, 3) along the curve in which the plane cuts the surface, evenly spaced.
    deviation
        (k,) standard deviation of the surface there.
    closed
        Whether a girth comes back to where it began and is known to the tolerance; False for a
        contour between two ends.
    complete
        Whether the curve is known to the tolerance: a girth closed, a contour from one end to the
        other.
    shape
        The surface behind it.
    trails
        What was driven, in order.
    """

    point: Float[np.ndarray, "k 3"]
    deviation: Float[np.ndarray, "k"]
    closed: bool
    complete: bool
    shape: Shape
    trails: list[Trail]

    def __repr__(self) -> str:
        """Return one line."""
        length = np.linalg.norm(np.diff(self.point, axis=0), axis=1).sum()
        state = "closed" if self.closed else "complete" if self.complete else "not complete"
        return (
            f"Followed: curve of {length:.4g}, {state} after {len(self.trails)} sweeps, largest "
            f"deviation {self.deviation.max():.2g}"
        )


def follow(
    sweep: Callable[[Trail], Reconstruction],
    rod: Rod,
    start: Trail,
    *,
    point: ArrayLike | None = None,
    normal: ArrayLike | None = None,
    ends: ArrayLike | None = None,
    tolerance: float | None = None,
    clearance: float = 0.0,
    friction: float = 0.0,
    most: int = 30,
) -> Followed:
    """Follow the curve in which a plane cuts an object until it is known all round, or from one end
    to another.

    Parameters
    ----------
    sweep
        Called with the clamp poses to drive next, it returns what was felt: the smoothed
        reconstruction of the recording. A robot's program goes here, or a `SimulatedArm`.
    rod
        The rod that is swept, in units of the trails.
    start
        A first trail that touches the object.
    point, normal
        (3,) each, of the plane; by default that of the first trail's clamp axis and motion.
    ends
        (2, 3) places near the object between which it is followed, the way round that the first
        trail touches; by default all round.
    tolerance
        Distance within which the curve is to be known: the standard deviation everywhere, and the
        95 % interval of 95 % of it. By default a five-hundredth of the rod's length.
    clearance, friction
        As for `next_sweep`.
    most
        Sweeps after which to give up.

    Raises
    ------
    ValueError
        If the first sweep touches too little to fit a surface to, the first trail does not
        determine a plane, an end is not finite, or an argument is not positive.
    """
    limit = _TOLERANCE * rod.length if tolerance is None else positive(tolerance, "tolerance")
    cut = _Plane.of(start, point, normal)
    between = None if ends is None else finite_array(ends, "ends", last=3, ndim=2)
    if between is not None and len(between) != 2:
        raise ValueError(f"ends has shape {between.shape}; allowed is (2, 3)")
    felt: list[Reconstruction] = []
    trails, driven = [start], set[int]()
    for number in range(whole_number(most, "most")):
        felt.append(sweep(trails[-1]))
        shape = fit_shape([each.contacts for each in felt], swept=[_missed(each) for each in felt])
        curve, whole = _traced(shape, cut, between, felt[0].point[felt[0].in_contact])
        deviation = shape.deviation(curve)
        open_ = deviation > limit
        if not np.any(open_) and np.quantile(deviation, _SHARE) > limit / _WIDE:
            open_ = deviation > limit / _WIDE
        complete = whole and not np.any(open_)
        if complete or number == most - 1:
            break
        # A stand that did not reach what it was expected to will not do so now.
        stands = cut.stands(rod, curve)
        new = [row for row in range(stands.shape[0]) if row not in driven]
        if not new:
            break
        planned = next_sweep(
            shape,
            rod,
            Trail(stands.position[new], stands.orientation[new]),
            clearance=clearance,
            friction=friction,
            places=curve[open_] if np.any(open_) else curve,
        )
        best = int(planned.order[0])
        if planned.gain[best] <= 0:
            break
        driven.add(new[best])
        trails.append(planned.candidates[best])
    return Followed(curve, deviation, complete and between is None, complete, shape, trails)


def _missed(found: Reconstruction) -> Float[np.ndarray, "k m 3"]:
    """Rods without contact."""
    free = np.flatnonzero(~found.in_contact & (found.status == Status.OK))
    return found.elastic_lines(free[:: -(-len(free) // _MISSED) or 1], _POINTS)


class _Plane(NamedTuple):
    """A plane by a point, its normal, and two axes in it."""

    point: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "2 3"]

    @classmethod
    def of(cls, trail: Trail, point: ArrayLike | None, normal: ArrayLike | None) -> "_Plane":
        """From a point and a normal; by default those of a clamp's axis and motion."""
        moved = trail.position[-1] - trail.position[0]
        if normal is None:
            normal = np.cross(trail.axis[0], moved)
            if np.linalg.norm(normal) <= _PARALLEL * np.linalg.norm(moved):
                raise ValueError(
                    "start moves along its rod, which determines no plane; allowed is a sweep "
                    "across, or `normal=`"
                )
        through = trail.position[0] if point is None else point
        across = unit_vector(normal, "normal")
        first = np.cross(across, np.eye(3)[np.argmin(np.abs(across))])
        first /= np.linalg.norm(first)
        axes = np.stack([first, np.cross(across, first)])
        return cls(finite_array(through, "point", last=3, ndim=1), across, axes)

    def within(self, vectors: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
        """Their parts in the plane."""
        return vectors - (vectors @ self.normal)[..., None] * self.normal

    def stands(self, rod: Rod, girth: Float[np.ndarray, "k 3"]) -> Trail:
        """Straight sweeps along the plane, from all sides and both ways."""
        middle = (girth.min(axis=0) + girth.max(axis=0)) / 2
        middle = self.point + self.within(middle - self.point)
        apart, trails = girth - middle, []
        for angle in 2 * np.pi * np.arange(_STANDS) / _STANDS:
            inward = np.array([np.cos(angle), np.sin(angle)]) @ self.axes
            near = middle + np.min(apart @ inward) * inward
            for along in (np.cross(self.normal, inward), -np.cross(self.normal, inward)):
                low, high = np.min(apart @ along), np.max(apart @ along)
                ends = low - _BEFORE * rod.length, high + _AFTER * rod.length
                for depth, beside in product(_DEPTHS, _BESIDE):
                    clamp = near - (1 - depth) * rod.length * inward
                    clamp += beside * rod.length * self.normal
                    trails.append(
                        Trail.line(
                            start=clamp + ends[0] * along,
                            stop=clamp + ends[1] * along,
                            count=_POSITIONS,
                            axis=inward,
                        )
                    )
        return Trail.stack(trails)


def _traced(
    shape: Shape,
    cut: _Plane,
    ends: Float[np.ndarray, "2 3"] | None,
    touched: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "k 3"], bool]:
    """Points along the curve, and whether it closes or goes from end to end: all round from a
    contact near the plane on, or between the ends the way round that comes nearer to what was
    touched.
    """
    if ends is None:
        contacts = shape.sites.touched
        near = contacts[np.argmin(np.abs((contacts - cut.point) @ cut.normal))]
        begin, _ = _onto(shape, cut, cut.point + cut.within(near - cut.point))
        return _walked(shape, cut, begin, begin, 1.0)
    begin, goal = (_onto(shape, cut, each)[0] for each in cut.point + cut.within(ends - cut.point))
    ways = [_walked(shape, cut, begin, goal, way) for way in (1.0, -1.0)]
    return min(ways, key=lambda way: (not way[1], KDTree(way[0]).query(touched)[0].mean()))


def _walked(
    shape: Shape, cut: _Plane, begin: np.ndarray, goal: np.ndarray, way: float
) -> tuple[Float[np.ndarray, "k 3"], bool]:
    """Points along the curve one way, and whether it comes to its goal."""
    step, points = _STEP * shape.extent, [begin]
    here, slope = _onto(shape, cut, begin)
    for number in range(round(_LONGEST / _STEP)):
        along = way * np.cross(cut.normal, slope)
        here, slope = _onto(shape, cut, here + step * along / np.linalg.norm(along))
        if number > 2 and np.linalg.norm(here - goal) < step:
            return np.array([*points, goal]), True
        points.append(here)
    return np.array(points), False


def _onto(
    shape: Shape, cut: _Plane, point: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """The place of the surface in the plane next to a point of the plane, and the part of its
    normal in the plane.
    """
    longest = 2 * _STEP * shape.extent
    for _ in range(_ROUNDS):
        feet = shape.level.feet(point[None], shape.extent)
        slope = cut.within(feet.normal[0])
        move = -feet.distance[0] * slope / max(float(slope @ slope), _FLAT)
        size = float(np.linalg.norm(move))
        point = point + move * min(1.0, longest / max(size, 1e-300))
        if size < _SETTLED * shape.extent:
            break
    return point, slope


_PARALLEL = 1e-6
"""Sine of an angle that is none."""
_ROUNDS, _SETTLED = 20, 3e-4
"""Steps of Newton's method, and the last one, relative to the extent: the next would be a hundredth
of it or less.
"""
_FLAT = 0.01
"""Least squared slope within the plane that is divided by."""
