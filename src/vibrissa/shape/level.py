"""A random level function given contacts: mean, gradient and variance anywhere."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.shape.departures import NONE, Departures
from vibrissa.shape.kernel import Coordinates, Points, Sum, Values
from vibrissa.shape.posterior import Posterior
from vibrissa.shape.prior import Ball, Folds

_STEP = 0.04
"""Step of numerical second derivatives, in lengths over which directions count: the coordinates
change little over it.
"""
STEEP = 0.3
"""Least gradient that levels are divided by: inside, where faces are equally far, it vanishes."""
_TURNED = 0.5
"""Cosine of the angle to the step before, below which a step is too long."""
_STEPS, _SETTLED = 30, (1e-5, 5e-5)
"""Steps towards the closest point, and the last one, relative to the extent: across the surface,
and along it, where distances change with its square only.
"""


class Feet(NamedTuple):
    """Places of the object closest to points."""

    place: Float[np.ndarray, "n 3"]
    raised: Float[np.ndarray, "n 3"]
    """Above them, at the contacts' height."""
    normal: Float[np.ndarray, "n 3"]
    steepness: Float[np.ndarray, "n"]
    """Of the level there."""
    distance: Float[np.ndarray, "n"]
    """Signed, of the points from the object."""


class Level(NamedTuple):
    """Mean level of the ball, coordinates, and what the contacts say besides; the factor by which
    deviations are too small, as sweeps that are left out show, and that by which they are wrong
    near contacts, as halves of the sweeps do; and how far the surface departs from where its
    curvatures lead.

    Contacts tell the level at a height above the object. There it is a distance; closer, where none
    of them are, it grows by less than it should: by 0.9 of it, 2 mm under a block's contacts.
    Hence places of the object are found from those of the surface at that height.
    """

    ball: Ball
    folds: Folds | None
    found: Posterior
    total: Sum
    above: float = 0.0
    """Height of the contacts above the object."""
    doubt: float = 1.0
    agreement: float = 1.0
    departures: Departures = NONE

    @classmethod
    def of(cls, ball: Ball, folds: Folds | None, found: Posterior, above: float) -> "Level":
        """With the weights of its sites."""
        total = Sum(found.basis.kernel, found.basis.sites, found.weights)
        return cls(ball, folds, found, total, above)

    def drawn(self, points: Points) -> Values:
        """How far the mean value at points is drawn towards the ball's: its derivative by the
        logarithm of the variance that is assumed.
        """
        basis = self.found.basis
        return Sum(basis.kernel, basis.sites, self.found.drawn).at(self.places(points))[0]

    def knowing(self, found: Posterior) -> "Level":
        """The same where something else is known of its unknowns."""
        level = Level.of(self.ball, self.folds, found, self.above)
        return self._replace(found=found, total=level.total)

    def places(self, points: Points) -> Coordinates:
        """Coordinates of points."""
        return places_of(self.folds, points)

    def jets(self, points: Points) -> Float[np.ndarray, "n 4"]:
        """Mean value and gradient at points."""
        jets = np.column_stack(self.total.at(self.places(points))) + self.ball.at(points)
        jets[:, 0] += self.above
        return jets

    def values(self, points: Points) -> Values:
        """Mean value at points."""
        return self.jets(points)[:, 0]

    def variance(self, points: Points) -> Values:
        """Of the value at points."""
        return self.found.variance(self.places(points))

    def feet(self, points: Points, extent: float) -> Feet:
        """Places of the object closest to points."""
        raised = self._raised(points, extent)
        gradient = self.jets(raised)[:, 1:]
        steepness = np.linalg.norm(gradient, axis=1)
        normal = gradient / steepness[:, None]
        apart = points - raised
        side = np.einsum("ni,ni->n", apart, normal)
        distance = np.copysign(np.linalg.norm(apart, axis=1), side) + self.above
        return Feet(raised - self.above * normal, raised, normal, steepness, distance)

    def _raised(self, points: Points, extent: float) -> Points:
        """Places at the contacts' height closest to points: steps onto the tangent plane of the
        level surface through the last place, and along it to where the point's perpendicular meets
        it.
        """
        feet, going = self._nearby(points, extent), np.arange(len(points))
        longest = 0.1 * extent
        rate, before = np.ones(len(points)), np.zeros_like(points)
        for _ in range(_STEPS):
            here = feet[going]
            jets = self.jets(here)
            length = np.maximum(np.linalg.norm(jets[:, 1:], axis=1), STEEP)
            normal = jets[:, 1:] / length[:, None]
            apart = points[going] - here
            along = apart - np.einsum("ni,ni->n", apart, normal)[:, None] * normal
            onto = np.clip((jets[:, 0] - self.above) / length, -longest, longest)
            size = np.linalg.norm(along, axis=1)
            shorter = np.minimum(1.0, longest / np.maximum(size, 1e-300))
            # Seen from far outside, a place moves less than the point: steps that turn are halved.
            ahead = np.einsum("ni,ni->n", along, before[going])
            turned = ahead < _TURNED * size * np.linalg.norm(before[going], axis=1)
            rate[going] *= np.where(turned, 0.5, 1.0)
            before[going] = along
            shorter *= rate[going]
            feet[going] = here + shorter[:, None] * along - onto[:, None] * normal
            across, aside = (settled * extent for settled in _SETTLED)
            going = going[(np.abs(onto) > across) | (shorter * size > aside)]
            if not len(going):
                break
        return feet

    def distances(self, points: Points, near: float, extent: float) -> Values:
        """Signed distances of points from the object; of those further than that, roughly."""
        jets = self.jets(points)
        found = jets[:, 0] / np.maximum(np.linalg.norm(jets[:, 1:], axis=1), STEEP)
        rows = np.flatnonzero(np.abs(found) < near)
        found[rows] = self.feet(points[rows], extent).distance
        return found

    def _nearby(self, points: Points, extent: float) -> Points:
        """Points, or, of those further from the ball's centre than half the extent, places on the
        way there.
        """
        apart = points - self.ball.center
        length = np.linalg.norm(apart, axis=1, keepdims=True)
        return self.ball.center + apart * np.minimum(1.0, 0.5 * extent / np.maximum(length, 1e-300))

    def curvature(self, points: Points) -> Float[np.ndarray, "n 3 3"]:
        """Second derivatives of the mean."""
        if self.folds is None:
            return self.total.curvature(points) + self.ball.curvature(points)
        step = _STEP * self.folds.fold
        moved = [
            self.jets(points + step * axis)[:, 1:] - self.jets(points - step * axis)[:, 1:]
            for axis in np.eye(3)
        ]
        return np.stack(moved, axis=-1) / (2 * step)


def places_of(folds: Folds | None, points: Points) -> Coordinates:
    """Coordinates of points: the points themselves where no directions are known yet."""
    return Coordinates.of(points) if folds is None else folds.at(points)
