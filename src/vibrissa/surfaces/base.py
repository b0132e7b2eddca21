"""The seam between objects and the rest: a level function, differentiable by JAX."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import reduce
from typing import Any, ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import Orientation, rotation_matrices, unit_quaternions
from vibrissa.numerics.lanes import lanes
from vibrissa.numerics.vectors import dot
from vibrissa.surfaces import closest

Point: TypeAlias = Float[Array, "3"]
Scalar: TypeAlias = Float[Array, ""]
Function: TypeAlias = Callable[[Point], Scalar]
"""A method of a surface, whose arrays JAX sees."""


class Surface(eqx.Module):
    """A solid object, given by a level function.

    Implement `level`. It must be traceable by JAX and twice differentiable near the surface. Its
    gradient must not vanish on the surface; a gradient of about unit length (a distance, at least
    near the surface) keeps tolerances meaningful. Lengths are in the units of the rod.
    """

    may_crease: ClassVar[bool] = True
    """Whether a rod may touch this kind of solid a second time close to a contact, at concave edges
    or narrow gaps, so that it is looked at closely there; False where it is convex, or round on the
    scale of its own sizes.
    """
    heavy: ClassVar[bool] = False
    """Whether evaluating the level takes so much code that compiled loops should hold it once
    rather than once for each point.
    """
    branching: ClassVar[bool] = False
    """Whether points go such different ways through that code that one by one is quicker than side
    by side.
    """

    @abstractmethod
    def level(self, point: Point) -> Scalar:
        """g(p): zero on the surface, positive outside, negative in the solid."""

    def distance(self, point: Point) -> Scalar:
        """Signed Euclidean distance from the surface, with right first and second derivatives:
        outside and near the surface.

        By Newton's method for the closest point: sure within a third of the radius of curvature,
        from outside a convex solid of moderate shape also far away. Where it does not arrive,
        g/‖∇g‖.
        """
        return closest.distance(self.level, point)

    @property
    def solids(self) -> list[Surface]:
        """Those that it is made of; itself where it is made of none."""
        parts = jax.tree.leaves(self, is_leaf=_is_solid)
        return [part for part in parts if _is_solid(part)]

    def part_levels(self, point: Point, *, exact: bool = False) -> Float[Array, "parts"]:
        """Levels of the solids, whose least is the level; `exact` ones are signed distances."""
        return (self.distance if exact else self.level)(point)[None]

    def normal(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Outward unit normals ∇g/‖∇g‖ at points (…, 3)."""
        _, gradient = _at(points, _values_and_slopes, self.level)
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)

    def levels(self, points: ArrayLike) -> Float[np.ndarray, "*batch"]:
        """Values of the level at points (…, 3)."""
        return np.asarray(_at(points, _values, self.level))

    def distances(self, points: ArrayLike) -> Float[np.ndarray, "*batch"]:
        """Signed distances from the surface at points (…, 3)."""
        return np.asarray(_at(points, _values_and_slopes, self.distance)[0])

    def nearest(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Points p − d ∇d of the surface that are closest to points (…, 3): outside and near the
        surface.
        """
        distance, gradient = _at(points, _values_and_slopes, self.distance)
        return np.asarray(points) - distance[..., None] * gradient

    def placed(
        self,
        rotation: Orientation = (0.0, 0.0, 0.0, 1.0),
        translation: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Placed:
        """Return the object turned about the origin (quaternion x, y, z, w, or a SciPy `Rotation`),
        then moved.

        Raises
        ------
        ValueError
            If the quaternion has zero norm or an entry is not finite.
        """
        quaternion = unit_quaternions(rotation, "rotation")
        if quaternion.shape != (4,):
            raise ValueError(
                f"rotation has shape {quaternion.shape}; allowed is one quaternion (4,)"
            )
        return Placed(
            self,
            rotation_matrices(quaternion),
            finite_array(translation, "translation", last=3, ndim=1),
        )


class ExactSurface(Surface):
    """A surface whose level is the signed distance itself."""

    def distance(self, point: Point) -> Scalar:
        """The level, which is the signed Euclidean distance."""
        return self.level(point)


class Derived(Surface):
    """A surface made of others: the least of `part_levels`."""

    @abstractmethod
    def part_levels(self, point: Point, *, exact: bool = False) -> Float[Array, "parts"]:
        """Levels of the solids; `exact` ones are signed distances."""

    def level(self, point: Point) -> Scalar:
        """The least level of the solids."""
        return reduce(_smaller, self.part_levels(point))

    def distance(self, point: Point) -> Scalar:
        """The least distance from the solids."""
        return reduce(_smaller, self.part_levels(point, exact=True))


class Placed(Derived):
    """A surface turned by a rotation matrix, then moved by a translation."""

    surface: Surface
    rotation: Float[np.ndarray | Array, "3 3"]
    translation: Float[np.ndarray | Array, "3"]

    def part_levels(self, point: Point, *, exact: bool = False) -> Float[Array, "parts"]:
        """Levels at the point seen from the object's own axes."""
        own = dot(self.rotation.T, point - self.translation)
        return self.surface.part_levels(own, exact=exact)


def _is_solid(part: object) -> bool:
    return isinstance(part, Surface) and not isinstance(part, Derived)


def _smaller(first: Scalar, second: Scalar) -> Scalar:
    return jnp.where(second < first, second, first)


@lanes()
def _values(function: Function, point: Point) -> Scalar:
    return function(point)


@lanes()
def _values_and_slopes(function: Function, point: Point) -> tuple[Scalar, Float[Array, "3"]]:
    return jax.value_and_grad(function)(point)


def _at(points: ArrayLike, evaluate: Callable[..., Any], function: Function) -> Any:
    """What a function gives at points that are checked."""
    array = finite_array(points, "points", last=3)
    found = evaluate(function, array.reshape(-1, 3))
    return jax.tree.map(
        lambda part: np.asarray(part).reshape(array.shape[:-1] + part.shape[1:]), found
    )
