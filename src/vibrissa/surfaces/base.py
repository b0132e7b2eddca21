"""The seam between objects and the rest: a level function, differentiable by JAX."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any, ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from vibrissa.geometry.checks import finite, finite_array, positive, unit_vector
from vibrissa.geometry.rotation import rotation_matrices, unit_quaternions
from vibrissa.numerics.lanes import Lanes, lanes
from vibrissa.surfaces import closest

Point: TypeAlias = Float[Array, "3"]
Scalar: TypeAlias = Float[Array, ""]
Vector3: TypeAlias = Any
"""Three numbers, as a list, tuple or array; kept as an array (3,)."""
Vector2: TypeAlias = Any
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
    much_code: ClassVar[bool] = False
    """Whether the level of this kind of solid takes long to compile."""

    @property
    def shapes(self) -> tuple[Surface, ...]:
        """The surfaces that this one is made of, before they were placed, united or grown."""
        return (self,)

    @property
    def creased(self) -> bool:
        """Whether a rod in contact may touch the solid a second time close by, so that the search
        for second contacts is fine there. Where the parts of a union meet, `part_levels` tell.
        """
        return any(shape.may_crease for shape in self.shapes)

    @property
    def heavy(self) -> bool:
        """Whether evaluating the level takes so much code that compiled loops should hold it once
        rather than once for each point.
        """
        return any(shape.much_code for shape in self.shapes)

    @abstractmethod
    def level(self, point: Point) -> Scalar:
        """g(p): zero on the surface, positive outside, negative in the solid."""

    def distance(self, point: Point) -> Scalar:
        """Signed Euclidean distance from the surface, outside and near it, with correct first and
        second derivatives.

        By Newton's method for the closest point. It converges within a third of the radius of
        curvature, and outside a convex solid of moderate shape also from far away; elsewhere the
        result is g/‖∇g‖.
        """
        return closest.distance(self, point)

    @property
    def solids(self) -> tuple[Surface, ...]:
        """The solids of which this one is the union: itself alone unless it is a `Union`."""
        return (self,)

    def part_levels(self, point: Point) -> Float[Array, "parts"]:
        """Levels of the `solids`, in any order, the same for all points; the least is the level."""
        return _of_each(self.solids, lambda solid: solid.level(point))

    def normal(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Outward unit normals ∇g/‖∇g‖ at points (…, 3)."""
        gradient = _at(_gradient, self, points)
        return gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)

    def levels(self, points: ArrayLike) -> Float[np.ndarray, "*batch"]:
        """Values of the level at points (…, 3)."""
        return _at(_level, self, points)

    def distances(self, points: ArrayLike) -> Float[np.ndarray, "*batch"]:
        """Signed distances from the surface at points (…, 3)."""
        return _at(_distance, self, points)

    def nearest(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Points p − d ∇d of the surface that are closest to points (…, 3), outside and near it."""
        return _at(_foot, self, points)

    def placed(
        self,
        rotation: ArrayLike | Rotation = (0.0, 0.0, 0.0, 1.0),
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
        shift = finite_array(translation, "translation", last=3, ndim=1)
        return Placed(self, rotation_matrices(quaternion), shift)


class ExactSurface(Surface):
    """A surface whose level is the signed distance itself."""

    def distance(self, point: Point) -> Scalar:
        """The level, which is the signed Euclidean distance."""
        return self.level(point)


class Checked(Surface):
    """A surface whose fields are checked and converted when it is built, by what `field` says."""

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            # Derivatives by the object put traced figures in their place.
            if not isinstance(value, jax.core.Tracer):
                setattr(self, each.name, each.metadata["check"](value, each.name))


def field(check: Callable[[Any, str], Any], **options: Any) -> Any:
    """Field of a `Checked` surface, given what returns the value to keep, or raises ValueError."""
    return eqx.field(metadata={"check": check}, **options)


def _surface(value: object, name: str) -> Surface:
    if not isinstance(value, Surface):
        raise ValueError(f"{name} = {value!r}; allowed is a surface")
    return value


def _surfaces(value: object, name: str) -> tuple[Surface, ...]:
    if isinstance(value, Surface) or not isinstance(value, Sequence) or not value:
        raise ValueError(f"{name} = {value!r}; allowed is a list of at least one surface")
    return tuple(_surface(part, f"{name}[{index}]") for index, part in enumerate(value))


def _all_positive(value: ArrayLike, name: str, count: int) -> Float[np.ndarray, "n"]:
    array = finite_array(value, name, last=count, ndim=1)
    return np.array([positive(x, f"{name}[{index}]") for index, x in enumerate(array.tolist())])


number = partial(field, finite)
size = partial(field, positive)
direction = partial(field, unit_vector)
vector = partial(field, partial(finite_array, last=3, ndim=1))
sizes = partial(field, partial(_all_positive, count=3))
two_sizes = partial(field, partial(_all_positive, count=2))


class _OfOne(Surface):
    surface: eqx.AbstractVar[Surface]

    @property
    def shapes(self) -> tuple[Surface, ...]:
        """Of the surface itself."""
        return self.surface.shapes

    @property
    def solids(self) -> tuple[Surface, ...]:
        """The surface's own, each treated likewise."""
        return tuple(replace(self, surface=solid) for solid in self.surface.solids)


class Placed(_OfOne):
    """A surface turned by a rotation matrix, then moved by a translation."""

    surface: Surface
    rotation: Float[np.ndarray | Array, "3 3"]
    translation: Float[np.ndarray | Array, "3"]

    def level(self, point: Point) -> Scalar:
        """Level of the object at the point seen from the object's own axes."""
        return self.surface.level(self._own(point))

    def distance(self, point: Point) -> Scalar:
        """Signed distance from the object at the point seen from the object's own axes."""
        return self.surface.distance(self._own(point))

    def _own(self, point: Point) -> Point:
        x, y, z = point - self.translation
        return self.rotation[0] * x + self.rotation[1] * y + self.rotation[2] * z


class Offset(_OfOne, Checked, ExactSurface):
    """A solid grown by `radius` on all sides: its surface is where the centre line of a rod of that
    radius runs when the rod touches. Convex edges become round.
    """

    surface: Surface = field(_surface)
    radius: float = size()

    def level(self, point: Point) -> Scalar:
        """Signed distance from the object, less the radius."""
        return self.surface.distance(point) - self.radius

    def foot(self, points: ArrayLike) -> Float[np.ndarray, "*batch 3"]:
        """Points of the object itself, not of the grown one, that are closest to points (…, 3) of
        the centre line: where the rod's skin touches.
        """
        return self.surface.nearest(points)


class Union(Checked):
    """All points of one or more solids, apart or overlapping.

    The crease where two of them meet is concave: a rod that lies in it touches both, which is no
    single contact. Inside, where solids overlap, `distance` is that from the nearest surface of the
    solid that the point lies deepest in.
    """

    parts: Sequence[Surface] = field(_surfaces)

    @property
    def shapes(self) -> tuple[Surface, ...]:
        """Of all parts."""
        return tuple(shape for part in self.parts for shape in part.shapes)

    @property
    def solids(self) -> tuple[Surface, ...]:
        """All parts, and their parts."""
        return tuple(solid for part in self.parts for solid in part.solids)

    def level(self, point: Point) -> Scalar:
        """The least of the parts' levels."""
        return _least(self.part_levels(point))

    def distance(self, point: Point) -> Scalar:
        """The least of the distances from the parts."""
        return _least(_of_each(self.solids, lambda solid: solid.distance(point)))


def _of_each(
    solids: Sequence[Surface], measure: Callable[[Surface], Scalar]
) -> Float[Array, "parts"]:
    """A measure of each solid: those of one kind are one array, and so one piece of code."""
    kinds: dict[object, list[Surface]] = {}
    for solid in solids:
        leaves, tree = jax.tree.flatten(solid)
        kinds.setdefault((tree, *(np.shape(leaf) for leaf in leaves)), []).append(solid)
    return jnp.concatenate(
        [
            jax.vmap(measure)(jax.tree.map(lambda *leaves: jnp.stack(leaves), *same))
            if len(same) > 1 and jax.tree.leaves(same[0])
            else jnp.stack([measure(solid) for solid in same])
            for same in kinds.values()
        ]
    )


def _least(values: Float[Array, "n"]) -> Scalar:
    """The least, with the derivatives of the first of those that are equal."""
    first = jnp.arange(len(values)) == jnp.argmin(values)
    return jnp.sum(jnp.where(first, values, 0.0))


@lanes()
def _level(surface: Surface, point: Point) -> Scalar:
    return surface.level(point)


@lanes()
def _gradient(surface: Surface, point: Point) -> Point:
    return jax.grad(surface.level)(point)


@lanes()
def _distance(surface: Surface, point: Point) -> Scalar:
    return surface.distance(point)


@lanes()
def _foot(surface: Surface, point: Point) -> Point:
    distance, gradient = jax.value_and_grad(surface.distance)(point)
    return point - distance * gradient


def _at(function: Lanes[Surface, Any], surface: Surface, points: ArrayLike) -> np.ndarray:
    """What a function of a surface and a point gives at each of the points."""
    array = finite_array(points, "points", last=3)
    found = function(surface, array.reshape(-1, 3))
    return np.asarray(found.reshape(array.shape[:-1] + found.shape[1:]))
