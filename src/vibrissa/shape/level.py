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
_RATE = 0.7
"""Of a step along the tangent plane, at first."""
_TURNED = 0.5
"""Cosine of the angle to the step before, below which a step is too long."""
_STEPS, _SETTLED = 30, 1e-5
"""Steps towards the closest point, and the last one, relative to the extent."""


class Level(NamedTuple):
    """Mean level of the ball, coordinates, and what the contacts say besides; the factor by which
    deviations are too small, as sweeps that are left out show, and that by which they are too large
    at contacts, as halves of the sweeps do; and how far the surface departs from where its
    curvatures lead.
    """

    ball: Ball
    folds: Folds | None
    found: Posterior
    total: Sum
    doubt: float = 1.0
    agreement: float = 1.0
    departures: Departures = NONE

    @classmethod
    def of(cls, ball: Ball, folds: Folds | None, found: Posterior) -> "Level":
        """With the weights of its sites."""
        total = Sum(found.basis.kernel, found.basis.sites, found.weights)
        return cls(ball, folds, found, total)

    def knowing(self, found: Posterior) -> "Level":
        """The same where something else is known of its unknowns."""
        level = Level.of(self.ball, self.folds, found)
        return self._replace(found=found, total=level.total)

    def places(self, points: Points) -> Coordinates:
        """Coordinates of points."""
        return places_of(self.folds, points)

    def jets(self, points: Points) -> Float[np.ndarray, "n 4"]:
        """Mean value and gradient at points."""
        return np.column_stack(self.total.at(self.places(points))) + self.ball.at(points)

    def values(self, points: Points) -> Values:
        """Mean value at points."""
        return self.jets(points)[:, 0]

    def variance(self, points: Points) -> Values:
        """Of the value at points."""
        return self.found.variance(self.places(points))

    def feet(self, points: Points, extent: float) -> Points:
        """Places of the surface closest to points: steps onto the tangent plane of the level
        surface through the last place, and along it to where the point's perpendicular meets it.
        """
        feet, going = self._nearby(points, extent), np.arange(len(points))
        longest = 0.1 * extent
        rate, before = np.full(len(points), _RATE), np.zeros_like(points)
        for _ in range(_STEPS):
            here = feet[going]
            jets = self.jets(here)
            length = np.maximum(np.linalg.norm(jets[:, 1:], axis=1), STEEP)
            normal = jets[:, 1:] / length[:, None]
            apart = points[going] - here
            along = apart - np.einsum("ni,ni->n", apart, normal)[:, None] * normal
            onto = np.clip(jets[:, 0] / length, -longest, longest)
            size = np.linalg.norm(along, axis=1)
            shorter = np.minimum(1.0, longest / np.maximum(size, 1e-300))
            # Seen from far outside, a place moves less than the point: steps that turn are halved.
            ahead = np.einsum("ni,ni->n", along, before[going])
            turned = ahead < _TURNED * size * np.linalg.norm(before[going], axis=1)
            rate[going] *= np.where(turned, 0.5, 1.0)
            before[going] = along
            moved = (rate[going] * shorter)[:, None] * along - onto[:, None] * normal
            feet[going] = here + moved
            going = going[np.linalg.norm(moved, axis=1) > _SETTLED * extent]
            if not len(going):
                break
        return feet

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
