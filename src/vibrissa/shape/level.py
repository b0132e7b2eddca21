"""A random level function given contacts: mean, gradient and variance anywhere."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.shape.kernel import Coordinates, Points, Sum, Values
from vibrissa.shape.posterior import Posterior
from vibrissa.shape.prior import Ball, Folds

_STEP = 0.04
"""Step of numerical second derivatives, in lengths over which directions count: the coordinates
change little over it.
"""


class Level(NamedTuple):
    """Mean level of the ball, coordinates, and what the contacts say besides."""

    ball: Ball
    folds: Folds | None
    found: Posterior
    total: Sum

    @classmethod
    def of(cls, ball: Ball, folds: Folds | None, found: Posterior) -> "Level":
        """With the weights of its sites."""
        return cls(ball, folds, found, Sum(found.basis.kernel, found.basis.sites, found.weights))

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
