"""Superquadrics: from blocks with rounded edges over ellipsoids to octahedra."""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax

from vibrissa.numerics.norms import TINY, magnitude, power
from vibrissa.surfaces import fields
from vibrissa.surfaces.base import Point, Scalar, Surface, Vector2, Vector3


class Superquadric(Surface):
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

    may_crease = False
    center: Vector3 = fields.place("center")
    semi_axes: Vector3 = fields.sizes("semi_axes")
    exponents: Vector2 = fields.sizes("exponents", 2, most=2)

    def level(self, point: Point) -> Scalar:
        """(ρ − 1) times the smallest semi-axis, ρ the factor by which the solid grows to reach the
        point: convex, and of slope 1 on that axis.
        """
        u, v, w = magnitude(point - jnp.asarray(self.center)) / jnp.asarray(self.semi_axes)
        along, across = 2 / jnp.asarray(self.exponents)
        # ρ is of first degree in the point: scaled by constants, which take no part in
        # differentiation, no power over- or underflows.
        wider = lax.stop_gradient(jnp.maximum(u, v))
        largest = _or_else(jnp.maximum(wider, lax.stop_gradient(w)), 1.0)
        widest = _or_else(wider, largest)
        section = power(power(u / widest, across) + power(v / widest, across), along / across)
        total = section * jnp.power(widest / largest, along) + power(w / largest, along)
        return (largest * power(total, 1 / along) - 1) * jnp.min(jnp.asarray(self.semi_axes))


def _or_else(size: Scalar, other: Scalar | float) -> Scalar:
    return jnp.where(size > TINY, size, other)
