"""The seam between objects and the rest: a level function, differentiable by JAX."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from typing import ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import Orientation, rotation_matrices, unit_quaternions
from vibrissa.surfaces import closest

Point: TypeAlias = Float[Array, "3"]
Scalar: TypeAlias = Float[Array, ""]
Vector3: TypeAlias = ArrayLike
"""Three numbers, as a list, tuple or array; kept as an array (3,)."""
Vector2: TypeAlias = ArrayLike
"""Two numbers, likewise."""


class Surface(eqx.Module):
    """A solid object, given by a level function.

    Implement `level`. It must be traceable by JAX and twice differentiable near the surface. Its
    gradient must not vanish on the surface; a gradient of about unit length (a distance, at least
    near the surface) keeps tolerances meaningful. Lengths are in the units of the rod.
    """

    may_crease: ClassVar[bool] = True
    """Whether this kind of solid may have concave edges or narrow gaps; False where it is convex,
    or round on the scale of its own sizes.
    """

    @property
    def creased(self) -> bool:
        """Whether a rod may touch the solid a second time close to a contact, so that it is looked
        at closely there.
        """
        return self.may_crease

    @property
    def heavy(self) -> bool:
        """Whether evaluating the level takes so much code that compiled loops should hold it once
        rather than once for each point.
        """
        return False

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
        return closest.distance(self, point)

    def part_levels(self, point: Point) -> Float[Array, "parts"]:
        """Levels of the solids that a union is of, whose least is the level; of any other surface
        the level alone.
        """
        return self.level(point)[None]

    def part_distances(self, point: Point) -> Float[Array, "parts"]:
        """The same of the distances."""
        return self.distance(point)[None]

    @property
    def parts_count(self) -> int:
        """How many there are."""
        return 1

    def normal(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Outward unit normals ∇g/‖∇g‖ at points (…, 3)."""
        _, gradient = _at(points, self, _slope_of_level)
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)

    def levels(self, points: ArrayLike) -> Float[np.ndarray, "*batch"]:
        """Values of the level at points (…, 3)."""
        return _at(points, self, _level)[1]

    def distances(self, points: ArrayLike) -> Float[np.ndarray, "*batch"]:
        """Signed distances from the surface at points (…, 3)."""
        return _at(points, self, _distance_and_slope)[1]

    def nearest(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Points p − d ∇d of the surface that are closest to points (…, 3): outside and near the
        surface.
        """
        array, distance, gradient = _at(points, self, _distance_and_slope)
        return array - distance[..., None] * gradient

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
    """A surface made of others."""

    @property
    @abstractmethod
    def sources(self) -> Sequence[Surface]:
        """The others."""

    @property
    def heavy(self) -> bool:
        """As of any of them."""
        return any(surface.heavy for surface in self.sources)

    @property
    def creased(self) -> bool:
        """As of any of them; where they meet, `part_levels` tell."""
        return any(surface.creased for surface in self.sources)

    @property
    def parts_count(self) -> int:
        """Of all of them."""
        return sum(surface.parts_count for surface in self.sources)


class Placed(Derived):
    """A surface turned by a rotation matrix, then moved by a translation."""

    surface: Surface
    rotation: Float[np.ndarray | Array, "3 3"]
    translation: Float[np.ndarray | Array, "3"]

    @property
    def sources(self) -> Sequence[Surface]:
        """The surface itself."""
        return (self.surface,)

    def level(self, point: Point) -> Scalar:
        """Level of the object at the point seen from the object's own axes."""
        return self.surface.level(self._own(point))

    def distance(self, point: Point) -> Scalar:
        """Signed distance from the object at the point seen from the object's own axes."""
        return self.surface.distance(self._own(point))

    def part_levels(self, point: Point) -> Float[Array, "parts"]:
        """As of the surface itself."""
        return self.surface.part_levels(self._own(point))

    def part_distances(self, point: Point) -> Float[Array, "parts"]:
        """As of the surface itself."""
        return self.surface.part_distances(self._own(point))

    def _own(self, point: Point) -> Point:
        x, y, z = point - self.translation
        return self.rotation[0] * x + self.rotation[1] * y + self.rotation[2] * z


def _level(surface: Surface, point: Point) -> tuple[Scalar]:
    return (surface.level(point),)


def _slope_of_level(surface: Surface, point: Point) -> tuple[Point]:
    return (jax.grad(surface.level)(point),)


def _distance_and_slope(surface: Surface, point: Point) -> tuple[Scalar, Point]:
    return jax.value_and_grad(surface.distance)(point)


@partial(jax.jit, static_argnums=0)
def _over_points(
    function: Callable[[Surface, Point], tuple[Array, ...]],
    surface: Surface,
    points: Float[Array, "n 3"],
) -> tuple[Array, ...]:
    return jax.vmap(partial(function, surface))(points)


def _at(
    points: ArrayLike, surface: Surface, function: Callable[[Surface, Point], tuple[Array, ...]]
) -> tuple[np.ndarray, ...]:
    """Points checked, and what a function of a surface and a point gives at each."""
    array = finite_array(points, "points", last=3)
    found = _over_points(function, surface, jnp.asarray(array.reshape(-1, 3)))
    batch = array.shape[:-1]
    return array, *(np.asarray(part).reshape(batch + part.shape[1:]) for part in found)
