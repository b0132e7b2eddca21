"""The surface over one triangle: curved between smooth corners, rounded off outside a crease.

With barycentric coordinates b_i, corners v_i and corner normals n_i, and with N = Σ b_i n_i and m =
N/‖N‖, the distance of a point p from it is

    Σ b_i (n_i + m)·(p − v_i) / (1 + ‖N‖).

For the normals of a sphere this is exactly the distance from the sphere, wherever Σ b_i v_i lies on
the line from p to the centre; in general its error is of third derivatives of the surface. Where
the nearest point lies on a crease, the planes of its two sides give the distance from the corner
between them.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, UInt

from vibrissa.numerics.linear import solve_3x3
from vibrissa.numerics.rows import row_of
from vibrissa.numerics.vectors import dot
from vibrissa.surfaces.mesh.jets import (
    Jet,
    Linear,
    added,
    mixed,
    over,
    picked,
    product,
    root,
    scaled,
    times,
)

Vector = Float[Array, "3"]
Scalar = Float[Array, ""]
AnyArray = Array | np.ndarray
Triangle = Float[AnyArray, "3 3"]

_CORNERS = np.eye(3)
# Barycentric coordinates where the edge opposite each corner starts, and from there to its end.
_START = np.roll(_CORNERS, -1, axis=0)
_ONWARD = np.roll(_CORNERS, -2, axis=0) - _START
# Newton's method for the line of sight squares its error at each step: from a tenth to 1e-16.
_REFINEMENTS = 4
# Barycentric coordinates further than this from the nearest point's are not near the triangle.
_LEAVES = 4.0
# Least sin² of the angle between the planes of a crease, which bends more than any smooth edge.
_FLATTEST = 1e-6


class Patch(NamedTuple):
    """What the level over one triangle depends on; with a leading axis, over many."""

    vertices: Float[AnyArray, "*f 3 3"]
    slopes: Float[AnyArray, "*f 3 3"]
    """Gradients of the barycentric coordinates in the triangle's plane, one a row."""
    normals: Float[AnyArray, "*f 3 3"]
    """Corner normals, each on this triangle's side of a crease."""
    beyond: Float[AnyArray, "*f 3 3 3"]
    """Corner normals on the other side of each crease edge; that of the corner opposite the edge
    has no weight.
    """
    around: Float[AnyArray, "*f 3 3"]
    """Corner normals on the other side of the crease through each corner."""
    pseudo: Float[AnyArray, "*f 3 3"]
    """Angle-weighted normals of all triangles around each corner (Bærentzen & Aanæs 2005): they
    tell inside from outside.
    """
    edges: Float[AnyArray, "*f 3"]
    """0 for a smooth edge, 1 for a convex crease, −1 for a concave one."""
    corners: Float[AnyArray, "*f 3"]
    """0 for a smooth corner, ±1 for one that a convex or concave crease runs through, 2 for one
    where creases meet.
    """


class Nearest(NamedTuple):
    """Nearest point of a flat triangle."""

    squared: Scalar
    """Squared distance."""
    weights: Vector
    """Barycentric coordinates."""
    within: Bool[Array, ""]
    """Whether it lies inside the triangle rather than on an edge."""
    edge: UInt[Array, ""]
    """If on an edge: number of the corner opposite it."""


def slopes(vertices: Float[np.ndarray, "*f 3 3"]) -> Float[np.ndarray, "*f 3 3"]:
    """Gradients of the barycentric coordinates of triangles, as in `Patch`."""
    along = _ONWARD @ vertices
    normal = np.cross(along[..., [0], :], along[..., [1], :])
    return np.asarray(np.cross(normal, along) / np.sum(normal**2, axis=-1, keepdims=True))


def nearest(point: Vector, vertices: Triangle, slopes: Triangle) -> Nearest:
    """Nearest point of a non-degenerate triangle: the point's projection, or the nearest of those
    on the three edges.
    """
    offset = point - vertices
    below = dot(slopes, offset[0]) + _CORNERS[0]
    along, start = mixed(_ONWARD, vertices), mixed(_START, offset)
    share = jnp.clip(dot(along, start) / dot(along, along), 0, 1)[:, None]
    aside = start - share * along
    squared = dot(aside, aside)
    edge = lax.argmin(squared, 0, jnp.uint32)
    within = jnp.all(below >= 0)
    weights = jnp.where(within, below, row_of(_START + share * _ONWARD, edge))
    height = mixed(below, offset)
    return Nearest(jnp.where(within, dot(height, height), jnp.min(squared)), weights, within, edge)


class Frozen(NamedTuple):
    """A point's nearest feature, held fixed: what is left depends smoothly on the point."""

    point: Vector
    weights: Vector
    """Barycentric coordinates of the nearest point."""
    slopes: Triangle
    """Their gradients, one a row."""
    code: Scalar
    """As in `Patch.edges` and `Patch.corners`: 0 smooth, ±1 a crease, 2 where creases meet."""
    corner: Vector
    """Where creases meet: the corner, with the sign of the level from its `pseudo` normal."""
    sign: Scalar
    beyond: Triangle
    """Corner normals on the other side of the crease."""


def frozen(point: Vector, patch: Patch) -> Frozen:
    """Fix the feature of the triangle that is nearest to a point."""
    _, weights, within, edge = nearest(point, patch.vertices, patch.slopes)
    corner = lax.argmax(weights, 0, jnp.uint32)
    at_corner = ~within & (row_of(weights, corner) == 1)
    turn = row_of(_ONWARD, edge)
    along = mixed(turn, patch.vertices)
    on_edge = turn[:, None] * along / dot(along, along)
    kept = jnp.where(within, patch.slopes, jnp.where(at_corner, 0.0, on_edge))
    code = jnp.where(at_corner, row_of(patch.corners, corner), row_of(patch.edges, edge))
    apex = row_of(patch.vertices, corner)
    outside = dot(point - apex, row_of(patch.pseudo, corner)) >= 0
    return Frozen(
        point,
        weights,
        slopes=kept,
        code=jnp.where(within, 0.0, code),
        corner=apex,
        sign=jnp.where(outside, 1.0, -1.0),
        beyond=jnp.where(at_corner, patch.around, row_of(patch.beyond, edge)),
    )


def patch_jet(point: Vector, patch: Patch, nearby: Frozen, order: int) -> Jet:
    """Signed distance from the surface over the triangle, given the feature nearest to the point,
    and its derivatives up to an order.
    """
    weights = nearby.weights + dot(nearby.slopes, point - nearby.point)

    def side(normals: Triangle) -> _Sheet:
        return _sheet(point, patch.vertices, normals, weights, nearby.slopes, order)

    both = jax.vmap(side)(jnp.stack([patch.normals, nearby.beyond]))
    first, second = (jax.tree.map(lambda part, k=k: part[k], both) for k in (0, 1))
    turned = product(first.total, second.total, order)
    cosine = over(turned, times(first.length, second.length))
    code = nearby.code
    outside = _outside_both(scaled(code, first.level), scaled(code, second.level), cosine)
    offset = point - nearby.corner, jnp.eye(3)
    tip = scaled(nearby.sign, root(product(offset, offset, order)))
    return picked(code == 0, first.level, picked(code == 2, tip, scaled(code, outside)))


def refined_level(point: Vector, patch: Patch) -> tuple[Scalar, Vector]:
    """The level seen along the interpolated normals, and the barycentric coordinates where the line
    of sight meets the triangle's plane.

    These may lie outside the triangle: then the neighbour on that side sees the point better.
    """
    near = frozen(point, patch)
    seen, trusted = _line_of_sight(point, patch, near.weights)
    # Far away, only the direction along the triangle's plane matters.
    below = dot(patch.slopes, point - patch.vertices[0]) + _CORNERS[0]
    seen = jnp.where(trusted, seen, below)
    # The line of sight ends at a crease; beyond it, keep the coordinates of the nearest point.
    stopped = (near.code != 0) | jnp.any((patch.edges != 0) & (seen < 0))
    weights = jnp.where(stopped, near.weights, seen)
    here = jnp.where(trusted, weights, near.weights)
    near = near._replace(weights=here)
    return patch_jet(point, patch, near, 0)[0], weights


class _Sheet(NamedTuple):
    level: Jet
    total: Linear
    """N and its Jacobian."""
    length: Jet
    """‖N‖."""


def _sheet(
    point: Vector,
    vertices: Triangle,
    normals: Triangle,
    weights: Vector,
    slopes: Triangle,
    order: int,
) -> _Sheet:
    """Level over a triangle at given barycentric coordinates, whose gradients are given too."""
    total = mixed(weights, normals), mixed(normals.T, slopes)
    offset = point - mixed(weights, vertices), jnp.eye(3) - mixed(vertices.T, slopes)
    heights = product((weights, slopes), (dot(normals, point - vertices), normals), order)
    length = root(product(total, total, order))
    along = over(product(total, offset, order), length)
    beside = (1 + length[0], *length[1:])
    return _Sheet(over(added(heights, along), beside), total, length)


def _outside_both(first: Jet, second: Jet, cosine: Jet) -> Jet:
    """Distance from the corner between two half spaces, given the distances from both and the
    cosine between their normals.
    """
    squared, *bends = scaled(-1.0, times(cosine, cosine))
    steep = 1 + squared > _FLATTEST
    flattest = jnp.asarray(_FLATTEST), *(jnp.zeros_like(part) for part in bends)
    sine = root(picked(steep, (1 + squared, *bends), flattest))
    aside = over(added(second, scaled(-1.0, times(cosine, first))), sine)
    outside = root(added(times(first, first), times(aside, aside)))
    outside = picked(second[0] <= cosine[0] * first[0], first, outside)
    outside = picked(first[0] <= cosine[0] * second[0], second, outside)
    larger = picked(first[0] < second[0], second, first)
    return picked((first[0] <= 0) & (second[0] <= 0), larger, outside)


def _line_of_sight(point: Vector, patch: Patch, weights: Vector) -> tuple[Vector, Array]:
    """Barycentric coordinates b at which p − Σ b_i v_i is parallel to Σ b_i n_i, by Newton's
    method, and whether it ended near the triangle.
    """

    def coordinates(unknown: Vector) -> Vector:
        return jnp.append(1 - unknown[0] - unknown[1], unknown[:2])

    def missed(unknown: Vector) -> Vector:
        """Residual; the unknowns are the last two coordinates and the height."""
        return point - mixed(coordinates(unknown), patch.vertices + unknown[2] * patch.normals)

    def refine(_: int | Array, unknown: Vector) -> Vector:
        return unknown - solve_3x3(jax.jacfwd(missed)(unknown), missed(unknown))

    m = mixed(weights, patch.normals)
    height = dot(point - mixed(weights, patch.vertices), m) / dot(m, m)
    seen = coordinates(lax.fori_loop(0, _REFINEMENTS, refine, jnp.append(weights[1:], height)))
    return seen, jnp.all(jnp.isfinite(seen)) & jnp.all(jnp.abs(seen - weights) < _LEAVES)
