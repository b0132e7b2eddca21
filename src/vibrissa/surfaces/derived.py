"""Surfaces made of others: several as one, or one as it is met by a rod's centre line."""

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
    """The union of one or more solids, separate or overlapping.

    The crease where two of them meet is concave: a rod lying in it touches both, which is not a
    single contact. Inside, where solids overlap, `distance` is that from the nearest surface of the
    solid in which the point lies deepest.
    """

    parts: tuple[Surface, ...]

    def __init__(self, parts: Sequence[Surface]) -> None:
        if not isinstance(parts, Sequence) or not parts:
            raise ValueError(f"parts = {parts!r}; allowed is a list of at least one surface")
        self.parts = tuple(_surface(part, f"parts[{i}]") for i, part in enumerate(parts))

    def part_levels(self, point: Point, *, exact: bool = False) -> Float[Array, "parts"]:
        """Levels of all parts, and of the parts of those."""
        return jnp.concatenate([part.part_levels(point, exact=exact) for part in self.parts])


class Offset(Derived):
    """A solid grown by `radius` on all sides: when a rod of that radius touches, its centre line
    touches this surface. Convex edges become rounded.
    """

    surface: Surface
    radius: float

    def __init__(self, surface: Surface, radius: float) -> None:
        self.surface, self.radius = _surface(surface, "surface"), positive(radius, "radius")

    def part_levels(self, point: Point, *, exact: bool = False) -> Float[Array, "parts"]:  # noqa: ARG002
        """Distances from the object, less the radius; they also serve as levels."""
        return self.surface.part_levels(point, exact=True) - self.radius

    def foot(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Points of the object itself, not of the grown one, closest to points (…, 3) of the centre
        line: where the rod's surface touches.
        """
        return self.surface.nearest(points)


def _surface(value: Surface, name: str) -> Surface:
    if not isinstance(value, Surface):
        raise ValueError(f"{name} = {value!r}; allowed is a surface")
    return value
