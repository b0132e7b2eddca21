"""Surfaces of second degree."""

from __future__ import annotations

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array, unit_vector
from vibrissa.surfaces import fields
from vibrissa.surfaces.base import ExactSurface, Point, Scalar, Surface, Vector2, Vector3


class EllipticParaboloid(Surface):
    """The solid z > a x² + b y² + h (paper, section II, with a = 0.5, b = 1, h = 0.4)."""

    may_crease = False
    a: float = fields.number("a")
    b: float = fields.number("b")
    h: float = fields.number("h")

    def level(self, point: Point) -> Scalar:
        """C(x, y) − z."""
        return self.a * point[0] ** 2 + self.b * point[1] ** 2 + self.h - point[2]


class Sphere(ExactSurface):
    """A ball, given by its centre (3,) and radius."""

    may_crease = False
    center: Vector3 = fields.place("center")
    radius: float = fields.size("radius")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        return jnp.sqrt(jnp.sum((point - jnp.asarray(self.center)) ** 2)) - self.radius


class Ellipsoid(Surface):
    """Ellipsoid with its axes along x, y, z; `placed` turns it. Centre (3,) and semi-axes (3,)."""

    may_crease = False
    center: Vector3 = fields.place("center")
    semi_axes: Vector3 = fields.sizes("semi_axes")

    def level(self, point: Point) -> Scalar:
        """(ρ − 1) times the smallest semi-axis, ρ the point's norm in units of the semi-axes."""
        return _scaled(
            (point - jnp.asarray(self.center)) / jnp.asarray(self.semi_axes), self.semi_axes
        )


class EllipticCylinder(Surface):
    """Cylinder without ends along the y axis through `center` (3,), with semi-axes (2,) along x and
    z; `placed` turns it.
    """

    may_crease = False
    center: Vector3 = fields.place("center")
    semi_axes: Vector2 = fields.sizes("semi_axes", 2)

    def level(self, point: Point) -> Scalar:
        """As for the ellipsoid, in the cross-section."""
        return _scaled(
            (point - jnp.asarray(self.center))[::2] / jnp.asarray(self.semi_axes), self.semi_axes
        )


class Plane(ExactSurface):
    """Half space behind the plane through `point` (3,) with the outward `normal` (3,), of any
    length but zero.
    """

    may_crease = False
    point: Vector3
    outward: Vector3

    def __init__(self, point: Vector3, normal: Vector3) -> None:
        self.point = finite_array(point, "point", last=3, ndim=1)
        self.outward = unit_vector(normal, "normal")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        return jnp.dot(jnp.asarray(self.outward), point - jnp.asarray(self.point))


def _scaled(place: Float[Array, "n"], semi_axes: ArrayLike) -> Scalar:
    return (jnp.sqrt(jnp.sum(place**2)) - 1) * jnp.min(jnp.asarray(semi_axes))
