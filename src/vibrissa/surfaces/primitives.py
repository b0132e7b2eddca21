"""Solids whose level is the exact signed distance, outside and inside.

Gradients have unit length, also on faces, edges and corners, where they belong to one of the faces
that meet. They vanish, wholly or in part, on the lines and points inside (on the torus's axis also
outside) from which the nearest point is not unique and no direction is distinguished. No derivative
is ever NaN.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array, positive, unit_vector
from vibrissa.numerics.norms import magnitude, norm, positive_part
from vibrissa.surfaces.base import ExactSurface

Point = Float[Array, "3"]
Scalar = Float[Array, ""]


class Box(ExactSurface):
    """Rectangular block with its edges along x, y, z; `placed` turns it. Centre (3,) and half of
    its extents (3,).
    """

    may_crease = False
    center: Float[np.ndarray | Array, "3"]
    half_extents: Float[np.ndarray | Array, "3"]

    def __init__(self, center: ArrayLike, half_extents: ArrayLike) -> None:
        self.center = finite_array(center, "center", last=3, ndim=1)
        self.half_extents = finite_array(half_extents, "half_extents", last=3, ndim=1)
        for index, extent in enumerate(self.half_extents):
            positive(float(extent), f"half_extents[{index}]")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        x, y, z = (magnitude(point[i] - self.center[i]) - self.half_extents[i] for i in range(3))
        # The largest on its own where a face is nearest: in the length its second derivatives would
        # cancel only but for rounding.
        face = _larger(_larger(x, y), z)
        edge = ((x > 0) & (y > 0)) | ((y > 0) & (z > 0)) | ((z > 0) & (x > 0))
        return jnp.where(edge, norm(positive_part(x), positive_part(y), positive_part(z)), face)


class Cylinder(ExactSurface):
    """Circular cylinder with flat ends: midpoint (3,) of its axis, direction (3,) of the axis,
    radius, and length from end to end.
    """

    may_crease = False
    center: Float[np.ndarray | Array, "3"]
    axis: Float[np.ndarray | Array, "3"]
    radius: float
    length: float

    def __init__(self, center: ArrayLike, axis: ArrayLike, radius: float, length: float) -> None:
        self.center, self.axis = (
            finite_array(center, "center", last=3, ndim=1),
            unit_vector(axis, "axis"),
        )
        self.radius, self.length = positive(radius, "radius"), positive(length, "length")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, across = _about(self.axis, self.center, point)
        side, end = norm(*across) - self.radius, magnitude(along) - self.length / 2
        return jnp.where(
            (side > 0) & (end > 0),
            norm(positive_part(side), positive_part(end)),
            _larger(side, end),
        )


class Capsule(ExactSurface):
    """Cylinder with hemispherical ends: midpoint (3,) and direction (3,) of its axis, radius, and
    length of the straight part, to which each end adds a radius.
    """

    may_crease = False
    center: Float[np.ndarray | Array, "3"]
    axis: Float[np.ndarray | Array, "3"]
    radius: float
    length: float

    def __init__(self, center: ArrayLike, axis: ArrayLike, radius: float, length: float) -> None:
        self.center, self.axis = (
            finite_array(center, "center", last=3, ndim=1),
            unit_vector(axis, "axis"),
        )
        self.radius, self.length = positive(radius, "radius"), positive(length, "length")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, (x, y, z) = _about(self.axis, self.center, point)
        beyond = positive_part(magnitude(along) - self.length / 2)
        # Across plus beyond along the axis: with both in one length, second derivatives are right
        # on the axis in front of an end.
        return (
            norm(x + beyond * self.axis[0], y + beyond * self.axis[1], z + beyond * self.axis[2])
            - self.radius
        )


class Cone(ExactSurface):
    """Circular cone: centre (3,) of its base, direction (3,) of its axis from there to the apex,
    radius of the base, and height.
    """

    may_crease = False
    center: Float[np.ndarray | Array, "3"]
    axis: Float[np.ndarray | Array, "3"]
    radius: float
    height: float

    def __init__(self, center: ArrayLike, axis: ArrayLike, radius: float, height: float) -> None:
        self.center, self.axis = (
            finite_array(center, "center", last=3, ndim=1),
            unit_vector(axis, "axis"),
        )
        self.radius, self.height = positive(radius, "radius"), positive(height, "height")

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, (x, y, z) = _about(self.axis, self.center, point)
        outwards = norm(x, y, z) - self.radius
        slant = jnp.sqrt(jnp.asarray(self.radius) ** 2 + jnp.asarray(self.height) ** 2)
        side = (self.height * outwards + self.radius * along) / slant
        # Along the side, from the rim (0) to the apex (slant).
        up = (self.height * along - self.radius * outwards) / slant
        face = _larger(side, -along)
        beyond_rim = jnp.where(side > 0, up < 0, (along < 0) & (outwards > 0))
        rim = norm(jnp.where(beyond_rim, outwards, 1.0), jnp.where(beyond_rim, along, 1.0))
        above = along - self.height
        apex = norm(x + above * self.axis[0], y + above * self.axis[1], z + above * self.axis[2])
        return jnp.where((side > 0) & (up > slant), apex, jnp.where(beyond_rim, rim, face))


class Torus(ExactSurface):
    """Ring: centre (3,), direction (3,) of the axis about which it is round, radius of the circle
    inside the tube, and radius of the tube, which is less.
    """

    may_crease = False
    center: Float[np.ndarray | Array, "3"]
    axis: Float[np.ndarray | Array, "3"]
    major_radius: float
    minor_radius: float

    def __init__(
        self, center: ArrayLike, axis: ArrayLike, major_radius: float, minor_radius: float
    ) -> None:
        self.center, self.axis = (
            finite_array(center, "center", last=3, ndim=1),
            unit_vector(axis, "axis"),
        )
        self.major_radius, self.minor_radius = (
            positive(major_radius, "major_radius"),
            positive(minor_radius, "minor_radius"),
        )
        if not self.minor_radius < self.major_radius:
            raise ValueError(
                f"minor_radius = {minor_radius!r}; allowed is less than major_radius = {major_radius!r}"
            )

    def level(self, point: Point) -> Scalar:
        """Signed distance."""
        along, across = _about(self.axis, self.center, point)
        return norm(norm(*across) - self.major_radius, along) - self.minor_radius


def _about(
    axis: Float[np.ndarray | Array, "3"], center: Float[np.ndarray | Array, "3"], point: Point
) -> tuple[Scalar, tuple[Scalar, Scalar, Scalar]]:
    """Part of a point's offset along a unit axis through `center`, and the components of the rest,
    which is across.
    """
    x, y, z = (point[i] - center[i] for i in range(3))
    along = axis[0] * x + axis[1] * y + axis[2] * z
    return along, (x - along * axis[0], y - along * axis[1], z - along * axis[2])


def _larger(first: Scalar, second: Scalar) -> Scalar:
    """The larger, with the derivatives of the first where they are equal."""
    return jnp.where(first < second, second, first)
