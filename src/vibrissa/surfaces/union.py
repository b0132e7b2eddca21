"""Several objects as one."""

from collections.abc import Sequence
from functools import reduce

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from vibrissa.surfaces.base import Surface

Point = Float[Array, "3"]
Scalar = Float[Array, ""]


class Union(Surface):
    """All points of one or more solids, apart or overlapping.

    The crease where two of them meet is concave: a rod that lies in it touches both, which is no single contact. Inside, where solids overlap, `distance` is that from
    the nearest surface of the solid that the point lies deepest in.
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
    def heavy(self) -> bool:
        """As of any part."""
        return any(part.heavy for part in self.parts)

    @property
    def creased(self) -> bool:
        """As of any part; where parts meet, `level_elsewhere` tells."""
        return any(part.creased for part in self.parts)

    @property
    def in_parts(self) -> bool:
        """Where there are several, or the only one has several."""
        return len(self.parts) > 1 or self.parts[0].in_parts

    def level(self, point: Point) -> Scalar:
        """The least of the parts' levels."""
        return reduce(_smaller, [part.level(point) for part in self.parts])

    def level_elsewhere(self, point: Point, contact: Point) -> Scalar:
        """The least of the levels of the parts that the contact is not on, and of what is elsewhere on its own."""
        at_contact = jnp.stack([part.level(contact) for part in self.parts])
        touched = jnp.argmin(at_contact)
        elsewhere = [
            jnp.where(touched == index, part.level_elsewhere(point, contact), part.level(point)) for index, part in enumerate(self.parts)
        ]
        return reduce(_smaller, elsewhere)

    def distance(self, point: Point) -> Scalar:
        """The least of the distances from the parts."""
        return reduce(_smaller, [part.distance(point) for part in self.parts])


def _smaller(first: Scalar, second: Scalar) -> Scalar:
    return jnp.where(second < first, second, first)
