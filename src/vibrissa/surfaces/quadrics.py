"""Quadrics, and superquadrics: blocks with rounded edges, octahedra."""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax

from vibrissa.numerics.norms import TINY, magnitude, power
from vibrissa.surfaces.base import Point, Scalar
from vibrissa.surfaces.figures import Figured, Number, Positive2, Positive3, Vector3


class EllipticParaboloid(Figured):
    """The solid z > a x² + b y² + h (paper, section II, with a = 0.5, b = 1, h = 0.4)."""

    a: Number
    b: Number
    h: Number

    def level(self, point: Point) -> Scalar:
        """C(x, y) − z."""
        return self.a * point[0] ** 2 + self.b * point[1] ** 2 + self.h - point[2]


class Ellipsoid(Figured):
    """Ellipsoid with its axes along x, y, z; `placed` rotates it. Centre (3,), semi-axes (3,)."""

    center: Vector3
    semi_axes: Positive3

    def level(self, point: Point) -> Scalar:
        """(ρ − 1) times the smallest semi-axis; ρ is the point's norm in units of the semi-axes."""
        place = (point - self.center) / self.semi_axes
        return (jnp.sqrt(jnp.sum(place**2)) - 1) * jnp.min(self.semi_axes)


class EllipticCylinder(Figured):
    """Infinite cylinder along y through `center` (3,), with semi-axes (2,) along x and z; `placed`
    rotates it.
    """

    center: Vector3
    semi_axes: Positive2

    def level(self, point: Point) -> Scalar:
        """As for the ellipsoid, in the cross-section."""
        place = (point - self.center)[::2] / self.semi_axes
        return (jnp.sqrt(jnp.sum(place**2)) - 1) * jnp.min(self.semi_axes)


class Superquadric(Figured):
    r"""Superellipsoid about `center` (3,), with semi-axes (a, b, c) along x, y, z; `placed` rotates
    it.

    The solid is :math:`(|x/a|^{2/ε_2} + |y/b|^{2/ε_2})^{ε_2/ε_1} + |z/c|^{2/ε_1} < 1`.

    The exponents (ε₁, ε₂), each above 0 and at most 2, shape the profile along z and the
    cross-section: towards 0 they give flat faces, 1 is round, 2 gives straight bevels. The solid is
    convex. Above 1 the curvature grows without bound towards the symmetry planes, so for a rod in
    contact there use an `Offset`.

    Source: A. H. Barr, Superquadrics and angle-preserving transformations, IEEE Computer Graphics
    and Applications 1 (1981).
    """

    center: Vector3
    semi_axes: Positive3
    exponents: Positive2

    def __check_init__(self) -> None:
        """Reject exponents above 2: the solid would not be convex."""
        if max(self.exponents) > 2:
            raise ValueError(f"exponents = {self.exponents.tolist()}; allowed are at most 2")

    def level(self, point: Point) -> Scalar:
        """(ρ − 1) times the smallest semi-axis; ρ is the factor by which the solid grows to reach
        the point. Convex, with slope 1 on that axis.
        """
        u, v, w = magnitude(point - self.center) / self.semi_axes
        along, across = 2 / self.exponents
        # ρ is homogeneous of degree 1 in the point: scaling by constants, which are not
        # differentiated, keeps powers from over- or underflowing.
        wider = lax.stop_gradient(jnp.maximum(u, v))
        largest = _or_else(jnp.maximum(wider, lax.stop_gradient(w)), 1.0)
        widest = _or_else(wider, largest)
        section = power(power(u / widest, across) + power(v / widest, across), along / across)
        total = section * jnp.power(widest / largest, along) + power(w / largest, along)
        return (largest * power(total, 1 / along) - 1) * jnp.min(self.semi_axes)


def _or_else(size: Scalar, other: Scalar | float) -> Scalar:
    return jnp.where(size > TINY, size, other)
