"""A surface given by its level at the nodes of a regular lattice."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array
from vibrissa.surfaces.base import Point, Scalar, Surface

_LEAST = 4
"""Nodes that a cubic takes."""


class Lattice(Surface):
    """The level interpolated between nodes by cubic splines, twice continuously differentiable;
    around the lattice, the level of its nearest point plus the distance from there.
    """

    heavy = True
    origin: Float[np.ndarray | Array, "3"]
    spacing: Float[np.ndarray | Array, "3"]
    coefficients: Float[np.ndarray | Array, "x y z"]

    def __init__(self, origin: ArrayLike, spacing: ArrayLike, values: ArrayLike) -> None:
        from scipy.ndimage import spline_filter  # noqa: PLC0415

        self.origin = finite_array(origin, "origin", last=3, ndim=1)
        steps = finite_array(spacing, "spacing")
        if steps.shape not in ((), (3,)) or np.any(steps <= 0):
            raise ValueError(
                f"spacing = {steps.tolist()}; allowed is a number greater than 0, or one for each "
                "axis"
            )
        self.spacing = np.broadcast_to(steps, 3).copy()
        nodes = np.asarray(values, dtype=np.float64)
        if nodes.ndim != 3 or min(nodes.shape) < _LEAST or not np.isfinite(nodes).all():
            raise ValueError(
                f"values has shape {nodes.shape}; allowed are finite ones (x, y, z) at {_LEAST} "
                "nodes or more along each axis"
            )
        # One node more on each side, so that the support of every point is inside.
        padded = np.pad(nodes, 1, mode="reflect", reflect_type="odd")
        self.coefficients = spline_filter(padded, order=3, mode="mirror")

    def level(self, point: Point) -> Scalar:
        """The spline's value."""
        last = np.array(self.coefficients.shape) - 3
        place = (point - self.origin) / self.spacing
        inside = jnp.clip(place, 0.0, last)
        first = jnp.clip(jnp.floor(inside), 0, last - 1)
        weights = [_weights(inside[i] - first[i]) for i in range(3)]
        cell = first.astype(int)
        near = [cell[i] + jnp.arange(4) for i in range(3)]
        block = self.coefficients[near[0][:, None, None], near[1][:, None], near[2]]
        level = jnp.einsum("i,j,k,ijk->", *weights, block)
        beyond = self.spacing * (place - inside)
        return level + jnp.sqrt(jnp.sum(beyond**2) + _TINY) - _TINY**0.5


_TINY = 1e-30
"""Under the root, which has no derivative at zero."""


def _weights(t: Scalar) -> Float[Array, "4"]:
    """Uniform cubic B-splines at a place between two nodes."""
    s = 1 - t
    return jnp.stack([s**3, 3 * t**3 - 6 * t**2 + 4, 3 * s**3 - 6 * s**2 + 4, t**3]) / 6
