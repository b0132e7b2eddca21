"""What the package needs to know of an object: a level function that JAX can differentiate."""

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
from vibrissa.numerics.lanes import FEW, lanes
from vibrissa.numerics.vectors import dot
from vibrissa.surfaces import closest

Point: TypeAlias = Float[Array, "3"]
Scalar: TypeAlias = Float[Array, ""]
Function: TypeAlias = Callable[[Point], Scalar]
"""A method of a surface; JAX traces the surface's arrays."""


class Surface(eqx.Module):
    """A solid object, given by a level function.

    Implement `level`. It must be traceable by JAX and twice differentiable near the surface. Its
    gradient must not vanish on the surface; a gradient of about unit length (a distance, at least
    near the surface) keeps tolerances meaningful. Lengths are in the units of the rod.
    """

    may_crease: ClassVar[bool] = True
    """Whether a rod may touch this kind of solid a second time close to a contact, at concave edges
    or in narrow gaps, so that the neighbourhood is checked closely; False if it is convex, or
    rounded on the scale of its own dimensions.
    """
    heavy: ClassVar[bool] = False
    """Whether the level takes so much code that compiled loops should contain it once rather than
    once per point.
    """
    branching: ClassVar[bool] = False
    """Whether points take such different branches through that code that evaluating them one by one
    is faster than side by side.
    """

    @abstractmethod
    def level(self, point: Point) -> Scalar:
        """g(p): zero on the surface, positive outside, negative in the solid."""

    def distance(self, point: Point) -> Scalar:
        """Signed Euclidean distance from the surface, with correct first and second derivatives;
        for points outside and near the surface.

        Newton's method finds the closest point: reliably within a third of the radius of curvature,
        and far away too if outside a convex solid of moderate shape. Where it does not converge,
        g/‖∇g‖ is returned.
        """
        return closest.distance(self.level, point)

    @property
    def solids(self) -> list[Surface]:
        """The solids it is made of; itself if it is not made of others."""
        parts = jax.tree.leaves(self, is_leaf=_is_solid)
        return [part for part in parts if _is_solid(part)]

    def part_levels(self, point: Point, *, exact: bool = False) -> Float[Array, "parts"]:
        """Levels of the solids, the least of which is the level; signed distances if `exact`."""
        return (self.distance if exact else self.level)(point)[None]

    def normal(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Outward unit normals ∇g/‖∇g‖ at points (…, 3)."""
        _, gradient = _at(points, _values_and_slopes, self.level)
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)

    def levels(self, points: ArrayLike) -> Float[np.ndarray, "*batch"]:
        """Levels at points (…, 3)."""
        return np.asarray(_at(points, _values, self.level))

    def distances(self, points: ArrayLike) -> Float[np.ndarray, "*batch"]:
        """Signed distances from the surface at points (…, 3)."""
        return np.asarray(_at(points, _values_and_slopes, self.distance)[0])

    def nearest(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Points p − d ∇d of the surface closest to points (…, 3), which lie outside or near the
        surface.
        """
        distance, gradient = _at(points, _values_and_slopes, self.distance)
        return np.asarray(points) - distance[..., None] * gradient

    def placed(
        self,
        rotation: Orientation = (0.0, 0.0, 0.0, 1.0),
        translation: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Placed:
        """Return the object rotated about the origin (quaternion x, y, z, w, or a SciPy
        `Rotation`), then translated.

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
    """A surface made of others; its level is the least of `part_levels`."""

    @abstractmethod
    def part_levels(self, point: Point, *, exact: bool = False) -> Float[Array, "parts"]:
        """Levels of the solids; signed distances if `exact`."""

    def level(self, point: Point) -> Scalar:
        """The least level of the solids."""
        return reduce(_smaller, self.part_levels(point))

    def distance(self, point: Point) -> Scalar:
        """The least distance from the solids."""
        return reduce(_smaller, self.part_levels(point, exact=True))


class Placed(Derived):
    """A surface rotated by a rotation matrix, then translated."""

    surface: Surface
    rotation: Float[np.ndarray | Array, "3 3"]
    translation: Float[np.ndarray | Array, "3"]

    def part_levels(self, point: Point, *, exact: bool = False) -> Float[Array, "parts"]:
        """Levels at the point, expressed in the object's own axes."""
        own = dot(self.rotation.T, point - self.translation)
        return self.surface.part_levels(own, exact=exact)


def _is_solid(part: object) -> bool:
    return isinstance(part, Surface) and not isinstance(part, Derived)


def _smaller(first: Scalar, second: Scalar) -> Scalar:
    return jnp.where(second < first, second, first)


@lanes(alone=FEW)
def _values(function: Function, point: Point) -> Scalar:
    return function(point)


@lanes(alone=FEW)
def _values_and_slopes(function: Function, point: Point) -> tuple[Scalar, Float[Array, "3"]]:
    return jax.value_and_grad(function)(point)


def _at(points: ArrayLike, evaluate: Callable[..., Any], function: Function) -> Any:
    """Check the points and evaluate a function at them."""
    array = finite_array(points, "points", last=3)
    found = evaluate(function, array.reshape(-1, 3))
    return jax.tree.map(
        lambda part: np.asarray(part).reshape(array.shape[:-1] + part.shape[1:]), found
    )
