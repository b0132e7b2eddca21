"""How far a surface departs from where its tangent plane and curvatures lead, by distance."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

_FROM = 300
"""Places that are looked from; all of them change departures by 4 % at most (torus, blob, block).
"""
_EDGES = np.geomspace(0.05, 0.8, 9)
"""Limits of the distances within which departures are averaged, relative to the extent: nearer,
surfaces are touched; further, they have turned away.
"""


class Departures(NamedTuple):
    """Root-mean-square departures of a surface from its osculating paraboloids, by distance.

    They tell edges from round surfaces: 5 mm from a contact, 1 mm on a rounded block, 0.04 mm on an
    ellipsoid, both of some 50 mm.
    """

    far: Float[np.ndarray, "k"]
    size: Float[np.ndarray, "k"]

    @classmethod
    def of(
        cls,
        point: Float[np.ndarray, "n 3"],
        jets: Float[np.ndarray, "n 4"],
        curvature: Float[np.ndarray, "n 3 3"],
        extent: float,
    ) -> "Departures":
        """Of a level with these values, gradients and second derivatives at points close to its
        surface: from each point to those that face the same side.
        """
        squared = np.maximum(np.sum(jets[:, 1:] ** 2, axis=1), _TINY)[:, None]
        point = point - jets[:, :1] / squared * jets[:, 1:]
        normal = jets[:, 1:] / np.sqrt(squared)
        rows = np.arange(len(point))[:: -(-len(point) // _FROM)]
        apart = point - point[rows, None]
        far = np.linalg.norm(apart, axis=2)
        along = np.einsum("mni,mi->mn", apart, normal[rows])
        tangent = apart - along[..., None] * normal[rows, None]
        bent = np.einsum("mni,mij,mnj->mn", tangent, curvature[rows], tangent)
        off = np.minimum(np.abs(along + 0.5 * bent / np.sqrt(squared[rows])), far)
        same = normal[rows] @ normal.T > 0
        cell = np.digitize(far, _EDGES * extent)
        middle, size = [], []
        for number in range(1, len(_EDGES)):
            here = same & (cell == number)
            if np.any(here):
                middle.append(np.mean(far[here]))
                size.append(np.sqrt(np.mean(off[here] ** 2)))
        return cls(np.asarray(middle), np.maximum.accumulate(np.asarray(size)))

    def at(self, far: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """At distances: with the square below those that were averaged, in proportion above."""
        if not len(self.far):
            return np.zeros_like(far)
        found = np.interp(far, self.far, self.size)
        found *= np.minimum(far / self.far[0], 1.0) ** 2 * np.maximum(far / self.far[-1], 1.0)
        return found


_TINY = 1e-12
"""Squared gradient that is none."""
NONE = Departures(np.zeros(0), np.zeros(0))
"""Of a surface whose contacts say nothing about them."""
