"""An object as the centre line of a rod of finite radius meets it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jax import Array
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import positive
from vibrissa.surfaces.base import Derived, ExactSurface, Point, Scalar, Surface


class Offset(Derived, ExactSurface):
    """A solid grown by `radius` on all sides: its surface is where the centre line of a rod of that
    radius runs when the rod touches. Convex edges become round.
    """

    surface: Surface
    radius: float

    def __init__(self, surface: Surface, radius: float) -> None:
        if not isinstance(surface, Surface):
            raise ValueError(f"surface = {surface!r}; allowed is a surface")
        self.surface, self.radius = surface, positive(radius, "radius")

    @property
    def sources(self) -> Sequence[Surface]:
        """The object."""
        return (self.surface,)

    def level(self, point: Point) -> Scalar:
        """Signed distance from the object, less the radius."""
        return self.surface.distance(point) - self.radius

    def part_levels(self, point: Point) -> Float[Array, "parts"]:
        """Distances from the object's parts, less the radius."""
        return self.surface.part_distances(point) - self.radius

    def foot(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Points of the object itself, not of the grown one, that are closest to points (…, 3) of
        the centre line: where the rod's skin touches.
        """
        return self.surface.nearest(points)
