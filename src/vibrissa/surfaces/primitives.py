"""Solids whose level is the exact signed distance, outside and inside.

Gradients have unit length, also on faces, edges and corners, where they belong to one of the faces
that meet. They vanish, wholly or in part, on the lines and points inside (on the torus's axis also
outside) from which the nearest point is not unique and no direction is distinguished. No derivative
is ever NaN.
"""

from __future__ import annotations

import jax.numpy as jnp

from vibrissa.numerics.norms import magnitude, norm, positive_part
from vibrissa.surfaces import fields
from vibrissa.surfaces.base import ExactSurface, Point, Scalar, Vector3


class Box(ExactSurface):
    """Rectangular block with its edges along x, y, z; `placed` turns it. Centre (3,) and half of
    its extents (3,).
    """

    may_crease = False
    center: Vector3 = fields.place("center")
    half_extents: Vector3 = fields.sizes("half_extents")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        x, y, z = magnitude(point - jnp.asarray(self.center)) - jnp.asarray(self.half_extents)
        # The largest on its own where a face is nearest: in the length its second derivatives would
        # cancel only but for rounding.
        face = _larger(_larger(x, y), z)
        edge = ((x > 0) & (y > 0)) | ((y > 0) & (z > 0)) | ((z > 0) & (x > 0))
        return jnp.where(edge, norm(positive_part(x), positive_part(y), positive_part(z)), face)


class _Axial(ExactSurface):
    """A solid about a point and an axis through it."""

    may_crease = False
    center: Vector3 = fields.place("center")
    axis: Vector3 = fields.direction("axis")

    def _about(self, point: Point) -> tuple[Scalar, Point]:
        """A point's offset from the centre: part along the axis, and the rest, which is across."""
        x, y, z = offset = point - jnp.asarray(self.center)
        axis = jnp.asarray(self.axis)
        along = axis[0] * x + axis[1] * y + axis[2] * z
        return along, offset - along * axis


class Cylinder(_Axial):
    """Circular cylinder with flat ends: midpoint (3,) of its axis, direction (3,) of the axis,
    radius, and length from end to end.
    """

    radius: float = fields.size("radius")
    length: float = fields.size("length")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, across = self._about(point)
        side, end = norm(*across) - self.radius, magnitude(along) - self.length / 2
        edge = norm(positive_part(side), positive_part(end))
        return jnp.where((side > 0) & (end > 0), edge, _larger(side, end))


class Capsule(_Axial):
    """Cylinder with hemispherical ends: midpoint (3,) and direction (3,) of its axis, radius, and
    length of the straight part, to which each end adds a radius.
    """

    radius: float = fields.size("radius")
    length: float = fields.size("length")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, _ = self._about(point)
        half = self.length / 2
        foot = jnp.where(along > half, half, jnp.where(along < -half, -half, along))
        # From the nearest point of the axis, in one step: with the parts across and along in one
        # length, second derivatives are right on the axis in front of an end.
        nearest = jnp.asarray(self.center) + foot * jnp.asarray(self.axis)
        return norm(*(point - nearest)) - self.radius


class Cone(_Axial):
    """Circular cone: centre (3,) of its base, direction (3,) of its axis from there to the apex,
    radius of the base, and height.
    """

    radius: float = fields.size("radius")
    height: float = fields.size("height")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, across = self._about(point)
        outwards = norm(*across) - self.radius
        slant = jnp.sqrt(jnp.asarray(self.radius) ** 2 + jnp.asarray(self.height) ** 2)
        side = (self.height * outwards + self.radius * along) / slant
        # Along the side, from the rim (0) to the apex (slant).
        up = (self.height * along - self.radius * outwards) / slant
        face = _larger(side, -along)
        beyond_rim = jnp.where(side > 0, up < 0, (along < 0) & (outwards > 0))
        rim = norm(jnp.where(beyond_rim, outwards, 1.0), jnp.where(beyond_rim, along, 1.0))
        apex = norm(*(across + (along - self.height) * jnp.asarray(self.axis)))
        return jnp.where((side > 0) & (up > slant), apex, jnp.where(beyond_rim, rim, face))


class Torus(_Axial):
    """Ring: centre (3,), direction (3,) of the axis about which it is round, radius of the circle
    inside the tube, and radius of the tube, which is less.
    """

    major_radius: float = fields.size("major_radius")
    minor_radius: float = fields.size("minor_radius")

    def __check_init__(self) -> None:
        """Refuse a tube that closes the hole."""
        if not self.minor_radius < self.major_radius:
            raise ValueError(
                f"minor_radius = {self.minor_radius!r}; allowed is less than "
                f"major_radius = {self.major_radius!r}"
            )

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, across = self._about(point)
        return norm(norm(*across) - self.major_radius, along) - self.minor_radius


def _larger(first: Scalar, second: Scalar) -> Scalar:
    """The larger, with the derivatives of the first where they are equal."""
    return jnp.where(first < second, second, first)
