"""What a surface's distance is stated to be uncertain by, from the variance of its level."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from vibrissa.shape.level import Level

STEEP = 0.3
"""Least gradient that levels are divided by: inside, where faces are equally far, it vanishes."""
_UNSURE = 0.04
"""Deviation that an angle between faces adds, relative to the extent, per curvature: directions of
the first surface are taken as known, and are not at edges. Squared residuals at an edge between
sweeps (rounded block, 3 mm) were twice as large without.
"""
_AWAY = 3.0
"""Deviation that a distance from all contacts adds, both relative to the extent and the distance
cubed: curvatures of a part seen from one side are not those of the other (ellipsoid, blob).
"""


class Stated(NamedTuple):
    """How deviations at some points follow from the level's variance there."""

    points: Float[np.ndarray, "n 3"]
    factor: Float[np.ndarray, "n"]
    extent: float

    @classmethod
    def at(cls, level: Level, points: Float[np.ndarray, "n 3"], extent: float) -> "Stated":
        """At points of a surface whose contacts extend so far."""
        gradient = level.jets(points)[:, 1:]
        steepness = np.maximum(np.linalg.norm(gradient, axis=1), STEEP)
        first = level.folds.first if level.folds else level.total
        bent = first.curvature(points) + level.ball.curvature(points)
        sharp = np.linalg.norm(bent, axis=(1, 2)) * _UNSURE * extent
        return cls(points, np.hypot(1.0, sharp) / steepness, extent)

    def away(self, contacts: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "n"]:
        """Distances of the points from the nearest contact."""
        return np.asarray(KDTree(contacts).query(self.points)[0])

    def deviations(
        self, variance: Float[np.ndarray, "*rows n"], away: Float[np.ndarray, "*rows n"]
    ) -> Float[np.ndarray, "*rows n"]:
        """Deviations of distances for variances of the level and distances from contacts."""
        open_ = _AWAY * (away / self.extent) ** 3 * self.extent
        return np.hypot(np.sqrt(variance) * self.factor, open_)
