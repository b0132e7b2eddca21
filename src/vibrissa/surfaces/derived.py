"""Surfaces made of others: several as one, or one as the centre line of a rod meets it."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import positive
from vibrissa.surfaces.base import Derived, Point, Surface


class Union(Derived):
    """All points of one or more solids, apart or overlapping.

    The crease where two of them meet is concave: a rod that lies in it touches both, which is no
    single contact. Inside, where solids overlap, `distance` is that from the nearest surface of the
    solid that the point lies deepest in.
    """

    parts: tuple[Surface, ...]

    def __init__(self, parts: Sequence[Surface]) -> None:
        if not isinstance(parts, Sequence) or not parts:
            raise ValueError(f"parts = {parts!r}; allowed is a list of at least one surface")
        self.parts = tuple(_surface(part, f"parts[{i}]") for i, part in enumerate(parts))

    def part_levels(self, point: Point, *, exact: bool = False) -> Float[Array, "parts"]:
        """Levels of all parts, and of their parts."""
        return jnp.concatenate([part.part_levels(point, exact=exact) for part in self.parts])


class Offset(Derived):
    """A solid grown by `radius` on all sides: its surface is where the centre line of a rod of that
    radius runs when the rod touches. Convex edges become round.
    """

    surface: Surface
    radius: float

    def __init__(self, surface: Surface, radius: float) -> None:
        self.surface, self.radius = _surface(surface, "surface"), positive(radius, "radius")

    def part_levels(self, point: Point, *, exact: bool = False) -> Float[Array, "parts"]:  # noqa: ARG002
        """Distances from the object, less the radius; they are levels as well."""
        return self.surface.part_levels(point, exact=True) - self.radius

    def foot(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Points of the object itself, not of the grown one, that are closest to points (…, 3) of
        the centre line: where the rod's skin touches.
        """
        return self.surface.nearest(points)


def _surface(value: Surface, name: str) -> Surface:
    if not isinstance(value, Surface):
        raise ValueError(f"{name} = {value!r}; allowed is a surface")
    return value
