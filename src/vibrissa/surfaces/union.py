"""Several objects as one."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from vibrissa.surfaces.base import Derived, Point, Scalar, Surface


class Union(Derived):
    """All points of one or more solids, apart or overlapping.

    The crease where two of them meet is concave: a rod that lies in it touches both, which is no
    single contact. Inside, where solids overlap, `distance` is that from the nearest surface of the
    solid that the point lies deepest in.
    """

    parts: tuple[Surface, ...]

    def __init__(self, parts: Sequence[Surface]) -> None:
        if isinstance(parts, Surface) or not isinstance(parts, Sequence) or not parts:
            raise ValueError(f"parts = {parts!r}; allowed is a list of at least one surface")
        for index, part in enumerate(parts):
            if not isinstance(part, Surface):
                raise ValueError(f"parts[{index}] = {part!r}; allowed is a surface")
        self.parts = tuple(parts)

    @property
    def sources(self) -> Sequence[Surface]:
        """The parts."""
        return self.parts

    def level(self, point: Point) -> Scalar:
        """The least of the parts' levels."""
        return reduce(_smaller, [part.level(point) for part in self.parts])

    def distance(self, point: Point) -> Scalar:
        """The least of the distances from the parts."""
        return reduce(_smaller, [part.distance(point) for part in self.parts])

    def part_levels(self, point: Point) -> Float[Array, "parts"]:
        """Levels of all parts, and of their parts."""
        return jnp.concatenate([part.part_levels(point) for part in self.parts])

    def part_distances(self, point: Point) -> Float[Array, "parts"]:
        """Distances from all parts, and from their parts."""
        return jnp.concatenate([part.part_distances(point) for part in self.parts])


def _smaller(first: Scalar, second: Scalar) -> Scalar:
    return jnp.where(second < first, second, first)
