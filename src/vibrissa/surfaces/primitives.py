"""Solids whose level is the exact signed distance, outside and inside.

Gradients have unit length, including on faces, edges and corners, where they belong to one of the
faces that meet. They vanish, wholly or in part, at lines and points inside (on the torus's axis,
outside too) where the nearest point is not unique and no direction is preferred. No derivative is
ever NaN.
"""

from __future__ import annotations

from functools import reduce

import jax.numpy as jnp
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array, unit_vector
from vibrissa.numerics.norms import magnitude, norm, positive_part
from vibrissa.numerics.vectors import dot
from vibrissa.surfaces.base import ExactSurface, Point, Scalar
from vibrissa.surfaces.figures import Direction, Figured, Positive, Positive3, Vector3


class Plane(ExactSurface):
    """Half space behind the plane through `point` (3,) with the outward `normal` (3,), of any
    non-zero length.
    """

    may_crease = False
    point: Vector3
    outward: Direction

    def __init__(self, point: ArrayLike, normal: ArrayLike) -> None:
        self.point = finite_array(point, "point", last=3, ndim=1)
        self.outward = unit_vector(normal, "normal")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        return dot(self.outward, point - self.point)


class Sphere(Figured, ExactSurface):
    """A ball, given by its centre (3,) and radius."""

    center: Vector3
    radius: Positive

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        return jnp.sqrt(jnp.sum((point - self.center) ** 2)) - self.radius


class Box(Figured, ExactSurface):
    """Rectangular block with its edges along x, y, z; `placed` rotates it. Centre (3,) and half
    extents (3,).
    """

    center: Vector3
    half_extents: Positive3

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        return _within(*(magnitude(point - self.center) - self.half_extents))


class _Axial(Figured, ExactSurface):
    """A solid of revolution about an axis through a point."""

    center: Vector3
    axis: Direction

    def _about(self, point: Point) -> tuple[Scalar, Point]:
        """A point's offset from the centre: component along the axis, and the rest, across it."""
        offset = point - self.center
        along = dot(self.axis, offset)
        return along, offset - along * self.axis


class Cylinder(_Axial):
    """Circular cylinder with flat ends: midpoint (3,) of its axis, direction (3,) of the axis,
    radius, and length from end to end.
    """

    radius: Positive
    length: Positive

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, across = self._about(point)
        return _within(norm(*across) - self.radius, magnitude(along) - self.length / 2)


class Capsule(_Axial):
    """Cylinder with hemispherical ends: midpoint (3,) and direction (3,) of its axis, radius, and
    length of the straight part, to which each end adds a radius.
    """

    radius: Positive
    length: Positive

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, _ = self._about(point)
        foot = jnp.clip(along, -self.length / 2, self.length / 2)
        # One norm of the whole offset from the axis's nearest point, not one of its parts across
        # and along: so second derivatives are right on the axis in front of an end.
        return norm(*(point - self.center - foot * self.axis)) - self.radius


class Cone(_Axial):
    """Circular cone: centre (3,) of its base, direction (3,) of its axis from there to the apex,
    radius of the base, and height.
    """

    radius: Positive
    height: Positive

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, across = self._about(point)
        outwards = norm(*across) - self.radius
        slant = jnp.sqrt(self.radius**2 + self.height**2)
        side = (self.height * outwards + self.radius * along) / slant
        # Along the side, from the rim (0) to the apex (slant).
        up = (self.height * along - self.radius * outwards) / slant
        beyond_rim = jnp.where(side > 0, up < 0, (along < 0) & (outwards > 0))
        rim = norm(jnp.where(beyond_rim, outwards, 1.0), jnp.where(beyond_rim, along, 1.0))
        apex = norm(*(across + (along - self.height) * self.axis))
        face = jnp.where(beyond_rim, rim, _larger(side, -along))
        return jnp.where((side > 0) & (up > slant), apex, face)


class Torus(_Axial):
    """Ring: centre (3,), direction (3,) of its axis of symmetry, radius of the tube's centre line,
    and radius of the tube, which is smaller.
    """

    major_radius: Positive
    minor_radius: Positive

    def __check_init__(self) -> None:
        """Reject a tube that closes the hole."""
        if not self.minor_radius < self.major_radius:
            raise ValueError(
                f"minor_radius = {self.minor_radius!r}; allowed is less than "
                f"major_radius = {self.major_radius!r}"
            )

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, across = self._about(point)
        return norm(norm(*across) - self.major_radius, along) - self.minor_radius


def _within(*faces: Scalar) -> Scalar:
    """Signed distance from what lies behind perpendicular faces, given that from each.

    Where a face is nearest, the largest alone: in the norm its second derivatives would cancel only
    up to rounding.
    """
    edge = sum(face > 0 for face in faces) > 1
    return jnp.where(edge, norm(*map(positive_part, faces)), reduce(_larger, faces))


def _larger(first: Scalar, second: Scalar) -> Scalar:
    """The larger, with the derivatives of the first where both are equal."""
    return jnp.where(first < second, second, first)
