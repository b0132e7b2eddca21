"""Solids in closed form. The level is the exact signed distance, outside and inside, of `Plane`,
`Sphere`, `Box`, `Cylinder`, `Capsule`, `Cone` and `Torus`.

Their gradients have unit length, also on faces, edges and corners, where they belong to one of the
faces that meet. They vanish, wholly or in part, on the lines and points inside (on the torus's axis
also outside) from which the nearest point is not unique and no direction is distinguished. No
derivative is ever NaN.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array, unit_vector
from vibrissa.numerics.norms import TINY, magnitude, norm, positive_part, power
from vibrissa.surfaces.base import (
    Checked,
    ExactSurface,
    Point,
    Scalar,
    Vector2,
    Vector3,
    direction,
    field,
    number,
    size,
    sizes,
    two_sizes,
    vector,
)


def _exponents(value: ArrayLike, name: str) -> Float[np.ndarray, "2"]:
    array = finite_array(value, name, last=2, ndim=1)
    for index, entry in enumerate(array.tolist()):
        if not 0 < entry <= 2:
            raise ValueError(
                f"{name}[{index}] = {entry!r}; allowed is a number greater than 0 and at most 2"
            )
    return array


class _Primitive(Checked):
    may_crease = False


class _Centred(_Primitive):
    center: Vector3 = vector()


class EllipticParaboloid(_Primitive):
    """The solid z > a x² + b y² + h (paper, section II, with a = 0.5, b = 1, h = 0.4)."""

    a: float = number()
    b: float = number()
    h: float = number()

    def level(self, point: Point) -> Scalar:
        """C(x, y) − z."""
        return self.a * point[0] ** 2 + self.b * point[1] ** 2 + self.h - point[2]


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
        return jnp.dot(self.outward, point - self.point)


class Sphere(_Centred, ExactSurface):
    """A ball, given by its centre (3,) and radius."""

    radius: float = size()

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        return jnp.sqrt(jnp.sum((point - self.center) ** 2)) - self.radius


class Ellipsoid(_Centred):
    """Ellipsoid with its axes along x, y, z; `placed` turns it. Centre (3,) and semi-axes (3,)."""

    semi_axes: Vector3 = sizes()

    def level(self, point: Point) -> Scalar:
        """(ρ − 1) times the smallest semi-axis, ρ the point's norm in units of the semi-axes."""
        return _scaled(point - self.center, self.semi_axes)


class EllipticCylinder(_Centred):
    """Cylinder without ends along the y axis through `center` (3,), with semi-axes (2,) along x and
    z; `placed` turns it.
    """

    semi_axes: Vector2 = two_sizes()

    def level(self, point: Point) -> Scalar:
        """As for the ellipsoid, in the cross-section."""
        return _scaled((point - self.center)[::2], self.semi_axes)


class Superquadric(_Centred):
    r"""Superellipsoid about `center` (3,), with semi-axes (a, b, c) along x, y, z; `placed` turns
    it.

    The solid is :math:`(|x/a|^{2/ε_2} + |y/b|^{2/ε_2})^{ε_2/ε_1} + |z/c|^{2/ε_1} < 1`.

    The exponents (ε₁, ε₂), each above 0 and at most 2, shape the profile along z and the section
    across: towards 0 they give flat faces, 1 is round, 2 gives straight bevels. The solid is
    convex. Above 1 the curvature grows without limit towards the symmetry planes, so that a rod in
    contact there wants an `Offset`.

    Source: A. H. Barr, Superquadrics and angle-preserving transformations, IEEE Computer Graphics
    and Applications 1 (1981).
    """

    semi_axes: Vector3 = sizes()
    exponents: Vector2 = field(_exponents)

    def level(self, point: Point) -> Scalar:
        """(ρ − 1) times the smallest semi-axis, ρ the factor by which the solid grows to reach the
        point: convex, and of slope 1 on that axis.
        """
        u, v, w = magnitude(point - self.center) / self.semi_axes
        along, across = 2 / self.exponents
        # ρ is of first degree in the point: scaled by constants, which take no part in
        # differentiation, no power over- or underflows.
        wider = lax.stop_gradient(jnp.maximum(u, v))
        largest = _or_else(jnp.maximum(wider, lax.stop_gradient(w)), 1.0)
        widest = _or_else(wider, largest)
        section = power(power(u / widest, across) + power(v / widest, across), along / across)
        total = section * jnp.power(widest / largest, along) + power(w / largest, along)
        return (largest * power(total, 1 / along) - 1) * jnp.min(self.semi_axes)


class Box(_Centred, ExactSurface):
    """Rectangular block with its edges along x, y, z; `placed` turns it. Centre (3,) and half of
    its extents (3,).
    """

    half_extents: Vector3 = sizes()

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        x, y, z = magnitude(point - self.center) - self.half_extents
        # The largest on its own where a face is nearest: in the length its second derivatives would
        # cancel only but for rounding.
        face = _larger(_larger(x, y), z)
        edge = ((x > 0) & (y > 0)) | ((y > 0) & (z > 0)) | ((z > 0) & (x > 0))
        return jnp.where(edge, norm(positive_part(x), positive_part(y), positive_part(z)), face)


class _Axial(_Centred, ExactSurface):
    """A solid about a point and an axis through it."""

    axis: Vector3 = direction()

    def _about(self, point: Point) -> tuple[Scalar, Point]:
        """A point's offset from the centre: part along the axis, and the rest, which is across."""
        x, y, z = offset = point - self.center
        along = self.axis[0] * x + self.axis[1] * y + self.axis[2] * z
        return along, offset - along * self.axis


class Cylinder(_Axial):
    """Circular cylinder with flat ends: midpoint (3,) of its axis, direction (3,) of the axis,
    radius, and length from end to end.
    """

    radius: float = size()
    length: float = size()

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

    radius: float = size()
    length: float = size()

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, across = self._about(point)
        beyond = positive_part(magnitude(along) - self.length / 2)
        # Across plus beyond along the axis: with both in one length, second derivatives are right
        # on the axis in front of an end.
        return norm(*(across + beyond * self.axis)) - self.radius


class Cone(_Axial):
    """Circular cone: centre (3,) of its base, direction (3,) of its axis from there to the apex,
    radius of the base, and height.
    """

    radius: float = size()
    height: float = size()

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, across = self._about(point)
        outwards = norm(*across) - self.radius
        slant = jnp.hypot(self.radius, self.height)
        side = (self.height * outwards + self.radius * along) / slant
        # Along the side, from the rim (0) to the apex (slant).
        up = (self.height * along - self.radius * outwards) / slant
        face = _larger(side, -along)
        beyond_rim = jnp.where(side > 0, up < 0, (along < 0) & (outwards > 0))
        rim = norm(jnp.where(beyond_rim, outwards, 1.0), jnp.where(beyond_rim, along, 1.0))
        apex = norm(*(across + (along - self.height) * self.axis))
        return jnp.where((side > 0) & (up > slant), apex, jnp.where(beyond_rim, rim, face))


class Torus(_Axial):
    """Ring: centre (3,), direction (3,) of the axis about which it is round, radius of the circle
    inside the tube, and radius of the tube, which is less.
    """

    major_radius: float = size()
    minor_radius: float = size()

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


def _scaled(offset: Float[Array, "n"], semi_axes: Any) -> Scalar:
    return (jnp.sqrt(jnp.sum((offset / semi_axes) ** 2)) - 1) * jnp.min(semi_axes)


def _or_else(size: Scalar, other: Scalar | float) -> Scalar:
    return jnp.where(size > TINY, size, other)
