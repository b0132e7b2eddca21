"""What a surface's distance is stated to be uncertain by, from the variance of its level."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from vibrissa.numerics.lanes import in_threads
from vibrissa.shape.departures import Departures
from vibrissa.shape.kernel import blocks, squares
from vibrissa.shape.level import STEEP, Feet, Level

_UNSURE = 0.005
"""Deviation that an angle between faces adds, relative to the level's: this, times the power 3/2 of
curvature and extent. Directions of the first surface are taken as known, and are not at edges. With
as much in proportion to the curvature as a block's rounded edges need, 95 % intervals held 70 to
78 % at a box's sharp ones. With the square, they held 1 % less where one side was touched.
"""
_LOCAL = 2.0
"""What the level's variance is uncertain by in any one place (standard deviation of its logarithm):
it is the same all over, but what turns at an edge is rougher than the faces beside it. On those of
cylinders and cones surfaces were 0.03 to 0.06 mm too far out, 1.5 to 2 deviations, up to 4 mm from
round rims. With 1.5, 2 and 2.5 hardly more or fewer objects had intervals that hold 93 to 97 %.
"""
_UNSEEN = 0.5
"""Deviation that the distance from contacts adds where none are on the other side, relative to the
extent, its relative power 3/2: beyond them the surface may turn anywhere, so that its slope is a
random walk. Of surfaces from 1 to 10 sweeps, 95 % intervals held 0.88 to 0.90 of the points 1 to
10 mm from a contact without (rounded block, torus, ellipsoid, blob, superquadric).
"""
_DEPARTED = 1.9
"""What departures beyond contacts count, so that edges that are touched are expected elsewhere too.
Of 24 fits of a rounded block to 3 to 42 sweeps, 95 % intervals held 0.87, 0.79 and 0.86 of the
points 3 to 6, 6 to 10 and 10 to 15 mm from a contact without, and 0.96, 0.96 and 0.99 with 1.7 and
contacts as they were; at the height at which they are used now, surfaces depart by less.
"""
_BETWEEN, _BEYOND = 0.1, 0.25
"""Distances of the nearest contact on the other side, relative to the extent, up to which a point
is between contacts, and from which it is beyond them.
"""
_NEAR = 0.05
"""Distance from contacts within which deviations are as wrong as at contacts, relative to the
extent: 3 mm on an object of 40 mm.
"""
_ACROSS = 0.5
"""Cosine of the angle to the opposite direction up to which a contact is on the other side."""


class Stated(NamedTuple):
    """How deviations at some points follow from the level's variance there."""

    points: Float[np.ndarray, "n 3"]
    feet: Feet
    """Places of the object closest to them."""
    factor: Float[np.ndarray, "n"]
    drawn: Float[np.ndarray, "n"]
    """Deviations that are added where the mean level is drawn towards what is assumed of it."""
    away: Float[np.ndarray, "n"]
    """Distances of the points from the nearest contact."""
    aside: Float[np.ndarray, "n"]
    """1 where the place of the surface is beyond contacts, 0 between them."""
    departures: Departures
    extent: float

    @classmethod
    def at(
        cls,
        level: Level,
        points: Float[np.ndarray, "n 3"],
        contacts: Float[np.ndarray, "k 3"],
        extent: float,
    ) -> "Stated":
        """At points of a surface whose contacts extend so far."""
        feet = level.feet(points, extent)
        first = level.folds.first if level.folds else level.total
        bent = first.curvature(feet.raised) + level.ball.curvature(feet.raised)
        sharp = _UNSURE * (np.linalg.norm(bent, axis=(1, 2)) * extent) ** 1.5
        away = _nearest(contacts, points)
        known = np.exp(-((away / (_NEAR * extent)) ** 4))
        factor = level.doubt * (1 - (1 - level.agreement) * known)
        steepness = np.maximum(feet.steepness, STEEP)
        factor *= np.hypot(1.0, sharp) / steepness
        drawn = _LOCAL * level.drawn(feet.raised) / steepness
        beyond = _aside(feet.place, contacts, extent)
        return cls(points, feet, factor, drawn, away, beyond, level.departures, extent)

    def touched(
        self, contacts: Float[np.ndarray, "k 3"], added: Float[np.ndarray, "j 3"]
    ) -> "Stated":
        """With some contacts more: they are nearer, and fewer places are beyond contacts."""
        near = _nearest(added, self.feet.place) < _BEYOND * self.extent
        rows = np.flatnonzero(near & (self.aside > 0))
        found = _aside(self.feet.place[rows], np.concatenate([contacts, added]), self.extent)
        beyond = self.aside.copy()
        beyond[rows] = np.minimum(beyond[rows], found)
        away = np.minimum(self.away, _nearest(added, self.points))
        return self._replace(away=away, aside=beyond)

    def deviations(self, variance: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Deviations of distances for variances of the level above these places."""
        unseen = _UNSEEN * self.extent * (self.away / self.extent) ** 1.5
        open_ = self.aside * np.hypot(unseen, _DEPARTED * self.departures.at(self.away))
        return np.hypot(np.hypot(self.by_level(variance), self.drawn), open_)

    def by_level(self, variance: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """The same without what more contacts do not take away: edges that were not touched, and
        how far the mean is drawn.
        """
        return np.sqrt(variance) * self.factor


def _nearest(
    contacts: Float[np.ndarray, "k 3"], points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n"]:
    """Distances of points from the nearest contact."""
    return np.asarray(KDTree(contacts).query(points)[0])


def _aside(
    points: Float[np.ndarray, "n 3"], contacts: Float[np.ndarray, "k 3"], extent: float
) -> Float[np.ndarray, "n"]:
    """By the distance of the nearest contact that is not on the side of the nearest of all."""
    away, nearest = KDTree(contacts).query(points)
    towards = (contacts[nearest] - points) / np.maximum(away, _TINY)[:, None]

    def across(rows: slice) -> np.ndarray:
        apart = np.sqrt(squares(points[rows], contacts))
        along = towards[rows] @ contacts.T - np.sum(towards[rows] * points[rows], axis=1)[:, None]
        return np.min(apart, axis=1, where=along < -_ACROSS * apart, initial=_BEYOND * extent)

    found = np.concatenate(in_threads(across, blocks(len(points), len(contacts))))
    return np.clip((found / extent - _BETWEEN) / (_BEYOND - _BETWEEN), 0.0, 1.0)


def farthest(deviation: float, extent: float) -> float:
    """Distance from all contacts within which a surface can be known this well."""
    return extent * max(_BEYOND, (deviation / extent / _UNSEEN) ** (2 / 3))


_TINY = 1e-12
"""Distance that is none, in any unit."""
