"""What touches what, and what is solved for."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array, lax
from jaxtyping import Float

from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.model import RodModel
from vibrissa.numerics.vectors import joined
from vibrissa.surfaces import Offset, Surface

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]


class Skin(Offset):
    """An object as the centre line of a rod sees it: grown by the rod's radius at its clamp."""


class Scene(NamedTuple):
    """The object, the rod's length, which converts its units to the model's, the coefficient of
    friction between the two, and the rod.
    """

    surface: Surface
    length: Scalar | float
    friction: Scalar | float = 0.0
    rod: RodModel = Elastica()

    @property
    def alone(self) -> "Scene":
        """The same with a rod that takes no part: points of an object go by far more at a time than
        spatial rods.
        """
        return self._replace(rod=Elastica())

    def level(self, point: Vector) -> Scalar:
        """Level function of the object in model units."""
        return self.surface.level(point * self.length) / self.length

    def part_levels(self, point: Vector) -> Float[Array, "parts"]:
        """Level functions of the object's parts in model units."""
        return self.surface.part_levels(point * self.length) / self.length

    @property
    def slims(self) -> bool:
        """Whether the skin of a rod touches whose radius is not the same everywhere."""
        return isinstance(self.surface, Skin) and not self.rod.uniform

    def slack(self, s: Scalar) -> Scalar:
        """How much thinner the rod is at an arc length than the object's offset takes it to be
        [L].
        """
        return self.rod.slimmer(s) * (self.surface.radius / self.length)  # type: ignore[attr-defined]

    @property
    def branching(self) -> bool:
        """Whether poses are better taken one after another than side by side."""
        return any(solid.branching for solid in self.surface.solids)

    def each(self, function: Callable[[Vector], Any], points: Float[Array, "n 3"]) -> Any:
        """Apply the function to several points: side by side, or one by one where that would take
        long to compile.
        """
        heavy = any(solid.heavy for solid in self.surface.solids)
        return lax.map(function, points) if heavy else jax.vmap(function)(points)


class State(NamedTuple):
    """What is solved for: contact point [L], magnitude of the contact force [EI/L²], and what the
    law and the rod add.
    """

    point: Vector
    force: Scalar
    lean: Float[Any, "lean"]
    own: Float[Any, "own"] = np.zeros(0)
    """The rod's own unknowns (`RodModel`)."""

    @property
    def flat(self) -> Float[Array, "unknowns"]:
        """As one vector, for Newton's method."""
        return joined(self.point, self.force, self.lean, self.own)

    @property
    def flat_rows(self) -> Float[np.ndarray, "n unknowns"]:
        """The same for many states, one per row."""
        return np.column_stack([self.point, self.force, self.lean, self.own])

    @classmethod
    def of(cls, flat: Float[Array, "unknowns"], own: int = 0) -> "State":
        """Undo `flat`, given how many unknowns are the rod's own."""
        last = len(flat) - own
        return cls(flat[:3], flat[3], flat[4:last], flat[last:])


class Reached(NamedTuple):
    """What one position passes on to the next."""

    state: State
    arc_length: Scalar
    """Of the contact [L]."""
    tangent: Vector
    """Of the rod at the contact."""
