"""Surfaces of second degree."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite, finite_array, positive, unit_vector
from vibrissa.surfaces.base import ExactSurface, Surface

Point = Float[Array, "3"]
Scalar = Float[Array, ""]


def _center(value: ArrayLike) -> Float[np.ndarray, "3"]:
    return finite_array(value, "center", last=3, ndim=1)


def _semi_axes(value: ArrayLike, count: int) -> Float[np.ndarray, "n"]:
    axes = finite_array(value, "semi_axes", last=count, ndim=1)
    for index, axis in enumerate(axes):
        positive(float(axis), f"semi_axes[{index}]")
    return axes


class EllipticParaboloid(Surface):
    """The solid z > a x² + b y² + h (paper, section II, with a = 0.5, b = 1, h = 0.4)."""

    may_crease = False
    a: float = eqx.field(converter=lambda value: finite(value, "a"))
    b: float = eqx.field(converter=lambda value: finite(value, "b"))
    h: float = eqx.field(converter=lambda value: finite(value, "h"))

    def level(self, point: Point) -> Scalar:
        """C(x, y) − z."""
        return self.a * point[0] ** 2 + self.b * point[1] ** 2 + self.h - point[2]


class Sphere(ExactSurface):
    """A ball, given by its centre (3,) and radius."""

    may_crease = False
    center: Float[np.ndarray | Array, "3"]
    radius: float

    def __init__(self, center: ArrayLike, radius: float) -> None:
        self.center = _center(center)
        self.radius = positive(radius, "radius")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        return jnp.sqrt(jnp.sum((point - self.center) ** 2)) - self.radius


class Ellipsoid(Surface):
    """Ellipsoid with its axes along x, y, z; `placed` turns it. Centre (3,) and semi-axes (3,)."""

    may_crease = False
    center: Float[np.ndarray | Array, "3"]
    semi_axes: Float[np.ndarray | Array, "3"]

    def __init__(self, center: ArrayLike, semi_axes: ArrayLike) -> None:
        self.center = _center(center)
        self.semi_axes = _semi_axes(semi_axes, 3)

    def level(self, point: Point) -> Scalar:
        """(ρ − 1) times the smallest semi-axis, ρ the norm of the point in units of the semi-axes."""
        return (jnp.sqrt(jnp.sum(((point - self.center) / self.semi_axes) ** 2)) - 1) * jnp.min(
            jnp.asarray(self.semi_axes)
        )


class EllipticCylinder(Surface):
    """Cylinder without ends along the y axis through `center` (3,), with semi-axes (2,) along x and
    z; `placed` turns it.
    """

    may_crease = False
    center: Float[np.ndarray | Array, "3"]
    semi_axes: Float[np.ndarray | Array, "2"]

    def __init__(self, center: ArrayLike, semi_axes: ArrayLike) -> None:
        self.center = _center(center)
        self.semi_axes = _semi_axes(semi_axes, 2)

    def level(self, point: Point) -> Scalar:
        """As for the ellipsoid, in the cross-section."""
        x = (point[0] - self.center[0]) / self.semi_axes[0]
        z = (point[2] - self.center[2]) / self.semi_axes[1]
        return (jnp.sqrt(x * x + z * z) - 1) * jnp.min(jnp.asarray(self.semi_axes))


class Plane(ExactSurface):
    """Half space behind the plane through `point` (3,) with the outward `normal` (3,), of any
    length but zero.
    """

    may_crease = False
    point: Float[np.ndarray | Array, "3"]
    outward: Float[np.ndarray | Array, "3"]

    def __init__(self, point: ArrayLike, normal: ArrayLike) -> None:
        self.point = finite_array(point, "point", last=3, ndim=1)
        self.outward = unit_vector(normal, "normal")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        return jnp.dot(self.outward, point - self.point)
