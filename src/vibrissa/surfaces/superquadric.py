"""Superquadrics: from blocks with rounded edges over ellipsoids to octahedra."""

import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array, positive
from vibrissa.numerics.norms import TINY, magnitude, power
from vibrissa.surfaces.base import Surface

_LARGEST_EXPONENT = 2.0

Scalar = Float[Array, ""]


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
    center: Float[np.ndarray | Array, "3"]
    semi_axes: Float[np.ndarray | Array, "3"]
    exponents: Float[np.ndarray | Array, "2"]

    def __init__(self, center: ArrayLike, semi_axes: ArrayLike, exponents: ArrayLike) -> None:
        self.center = finite_array(center, "center", last=3, ndim=1)
        self.semi_axes = finite_array(semi_axes, "semi_axes", last=3, ndim=1)
        self.exponents = finite_array(exponents, "exponents", last=2, ndim=1)
        for index, axis in enumerate(self.semi_axes):
            positive(float(axis), f"semi_axes[{index}]")
        for index, exponent in enumerate(self.exponents):
            if not 0 < exponent <= _LARGEST_EXPONENT:
                raise ValueError(
                    f"exponents[{index}] = {float(exponent)!r}; allowed is a number greater than 0 and at most 2"
                )

    def level(self, point: Float[Array, "3"]) -> Scalar:
        """(ρ − 1) times the smallest semi-axis, ρ the factor by which the solid grows to reach the
        point: convex, and of slope 1 on that axis.
        """
        u, v, w = (magnitude(point[i] - self.center[i]) / self.semi_axes[i] for i in range(3))
        along, across = 2 / self.exponents[0], 2 / self.exponents[1]
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
