"""The surface over one triangle: curved between smooth corners, rounded off outside a crease.

With barycentric coordinates b_i, corners v_i and corner normals n_i, and with N = Σ b_i n_i and m =
N/‖N‖, a point p is

    Σ b_i (n_i + m)·(p − v_i) / (1 + ‖N‖)

away from it. For the normals of a sphere this is the distance from the sphere, exactly, wherever Σ
b_i v_i lies on the line from p to the centre; in general it errs by third derivatives of the
surface. Where the nearest point lies on a crease, the planes of its two sides give the distance
from their corner.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

Vector = Float[Array, "3"]
Scalar = Float[Array, ""]
AnyArray = Array | np.ndarray
Triangle = Float[AnyArray, "3 3"]

INTERIOR, EDGE, CORNER = 0, 1, 4
"""Nearest feature of a triangle: 0 its interior, 1 to 3 the edge opposite that corner, 4 to 6 the
corner.
"""

# Squared lengths below it, and their roots' derivatives, would leave the range of the numbers.
_TINY = 1e-300
# Newton's method for the line of sight squares its error at each step: from a tenth to 1e-16.
_REFINEMENTS = 4
# Barycentric coordinates further than this from the nearest point's are not near the triangle.
_LEAVES = 4.0
# Least sin² between the planes of a crease, which bend by more than the angle of a smooth edge.
_FLATTEST = 1e-6


class Patch(NamedTuple):
    """What the level over one triangle depends on; with an axis in front, over many."""

    vertices: Float[AnyArray, "*f 3 3"]
    normals: Float[AnyArray, "*f 3 3"]
    """Of the corners, each on this triangle's side of a crease."""
    beyond: Float[AnyArray, "*f 3 2 3"]
    """Normals on the other side of each crease edge, at its two ends: edge k runs from corner k + 1
    to corner k + 2.
    """
    around: Float[AnyArray, "*f 3 3"]
    """Normals on the other side of the crease through each corner."""
    pseudo: Float[AnyArray, "*f 3 3"]
    """Angle-weighted normals of all triangles about each corner (Bærentzen & Aanæs 2005): they tell
    inside from outside.
    """
    edges: Float[AnyArray, "*f 3"]
    """0 a smooth edge, 1 a convex crease, −1 a concave one."""
    corners: Float[AnyArray, "*f 3"]
    """0 a smooth corner, ±1 one on a convex or concave crease that runs through it, 2 one where
    creases meet.
    """


class Nearest(NamedTuple):
    """Nearest point of a flat triangle."""

    squared: Scalar
    """Squared distance."""
    weights: Vector
    """Barycentric coordinates."""
    feature: Int[Array, ""]


def dot(a: Float[AnyArray, "*n 3"], b: Float[AnyArray, "... 3"]) -> Float[Array, "*n"]:
    """Along the last axis, written out: sums run over lanes, not over three numbers each."""
    product = jnp.asarray(a) * b
    return product[..., 0] + product[..., 1] + product[..., 2]


def mixed(weights: Vector, rows: Triangle) -> Vector:
    """Rows weighted by barycentric coordinates."""
    return weights[0] * rows[0] + weights[1] * rows[1] + weights[2] * rows[2]


def nearest(point: Vector, vertices: Triangle) -> Nearest:
    """Nearest point of a triangle that is not degenerate: the one below, or the nearest of those on
    the three edges.
    """
    weights = _planar(vertices, point)
    inside = jnp.all(weights >= 0)
    start, stop = jnp.roll(vertices, -1, axis=0), jnp.roll(vertices, -2, axis=0)
    along = stop - start
    share = jnp.clip(dot(along, point - start) / dot(along, along), 0.0, 1.0)
    offset = point - start - share[:, None] * along
    squared = dot(offset, offset)
    edge = jnp.argmin(squared)
    t, first, last = share[edge], (edge + 1) % 3, (edge + 2) % 3
    index = jnp.arange(3)
    on_edge = jnp.where(index == first, 1 - t, jnp.where(index == last, t, 0.0))
    feature = jnp.where(t <= 0, CORNER + first, jnp.where(t >= 1, CORNER + last, EDGE + edge))
    below = point - mixed(weights, vertices)
    return Nearest(
        jnp.where(inside, dot(below, below), squared[edge]),
        jnp.where(inside, weights, on_edge),
        jnp.where(inside, INTERIOR, feature),
    )


def _slopes(vertices: Triangle) -> Triangle:
    """Gradients of the barycentric coordinates in the triangle's plane, one a row."""
    ab, ac = vertices[1] - vertices[0], vertices[2] - vertices[0]
    normal = jnp.cross(ab, ac)
    b, c = jnp.cross(ac, normal) / dot(normal, normal), jnp.cross(normal, ab) / dot(normal, normal)
    return jnp.stack([-b - c, b, c])


def _planar(vertices: Triangle, point: Vector) -> Vector:
    """Barycentric coordinates of the point below in the triangle's plane."""
    return dot(_slopes(vertices), point - vertices[0]) + jnp.array([1.0, 0.0, 0.0])


class Frozen(NamedTuple):
    """A point's nearest feature, held fast: what is left depends on the point smoothly."""

    point: Vector
    weights: Vector
    """Barycentric coordinates of the nearest point."""
    slopes: Triangle
    """Their gradients, one a row."""
    code: Scalar
    """As in `Patch.edges` and `Patch.corners`: 0 smooth, ±1 a crease, 2 where creases meet."""
    corner: Vector
    """Where creases meet: the corner, with the sign of the level by its `pseudo` normal."""
    sign: Scalar
    beyond: Triangle
    """Corner normals on the other side of the crease."""


def frozen(point: Vector, patch: Patch) -> Frozen:
    """Hold fast what is nearest to a point over the triangle."""
    _, weights, feature = nearest(point, patch.vertices)
    at_corner, at_edge = feature >= CORNER, (feature >= EDGE) & (feature < CORNER)
    edge, corner = jnp.clip(feature - EDGE, 0, 2), jnp.clip(feature - CORNER, 0, 2)
    code = jnp.where(at_corner, patch.corners[corner], jnp.where(at_edge, patch.edges[edge], 0.0))
    index = jnp.arange(3)[:, None]
    first, last = index == (edge + 1) % 3, index == (edge + 2) % 3
    ends = patch.beyond[edge]
    across = jnp.where(first, ends[0], jnp.where(last, ends[1], patch.normals))
    apex = patch.vertices[corner]
    along = patch.vertices[(edge + 2) % 3] - patch.vertices[(edge + 1) % 3]
    along = along / dot(along, along)
    on_edge = jnp.where(last, along, jnp.where(first, -along, 0.0))
    return Frozen(
        point,
        weights,
        slopes=jnp.where(at_corner, 0.0, jnp.where(at_edge, on_edge, _slopes(patch.vertices))),
        code=code,
        corner=apex,
        sign=jnp.where(dot(point - apex, patch.pseudo[corner]) >= 0, 1.0, -1.0),
        beyond=jnp.where(at_corner, patch.around, across),
    )


def patch_level(point: Vector, patch: Patch, nearby: Frozen) -> Scalar:
    """Signed distance from the surface over the triangle, given what is nearest to about this
    point.
    """
    weights = nearby.weights + dot(nearby.slopes, point - nearby.point)
    sides = jnp.stack([patch.normals, nearby.beyond])
    level, normal = jax.vmap(_sheet, in_axes=(None, None, 0, None))(
        point, patch.vertices, sides, weights
    )
    ridge = nearby.code * _outside_both(nearby.code * level, dot(normal[0], normal[1]))
    tip = nearby.sign * _length(point - nearby.corner)
    return jnp.where(nearby.code == 0, level[0], jnp.where(nearby.code == 2, tip, ridge))


def refined_level(point: Vector, patch: Patch) -> tuple[Scalar, Vector]:
    """The same seen along the interpolated normals, and the barycentric coordinates where the line
    of sight meets the triangle's plane.

    They may lie outside the triangle: the neighbour there sees the point better.
    """
    near = frozen(point, patch)
    seen, trusted = _line_of_sight(point, patch, near.weights)
    # Far away, the direction over the triangle's plane is all that is asked for.
    seen = jnp.where(trusted, seen, _planar(patch.vertices, point))
    # At a crease the line of sight ends; beyond it the coordinates of the nearest point stay.
    stopped = (near.code != 0) | jnp.any((patch.edges != 0) & (seen < 0))
    weights = jnp.where(stopped, near.weights, seen)
    here = jnp.where(trusted, weights, near.weights)
    return patch_level(point, patch, near._replace(weights=here)), weights


def _sheet(
    point: Vector, vertices: Triangle, normals: Triangle, weights: Vector
) -> tuple[Scalar, Vector]:
    """Level over a triangle at given barycentric coordinates, and the normal there."""
    total = mixed(weights, normals)
    length = jnp.sqrt(dot(total, total))
    m = total / length
    lever = dot(normals, vertices)
    value = dot(total, point) - dot(weights, lever) + dot(m, point - mixed(weights, vertices))
    return value / (1 + length), m


def _outside_both(distances: Float[Array, "2"], cosine: Scalar) -> Scalar:
    """Distance from the corner between two half spaces, given the distances from both and the
    cosine between their normals.
    """
    along = (distances - cosine * distances[::-1]) / jnp.maximum(1 - cosine * cosine, _FLATTEST)
    squared = along[0] * distances[0] + along[1] * distances[1]
    radius = jnp.sqrt(jnp.where(squared > _TINY, squared, _TINY))
    outside = jnp.where(along[0] <= 0, distances[1], jnp.where(along[1] <= 0, distances[0], radius))
    return jnp.where(jnp.all(distances <= 0), jnp.maximum(distances[0], distances[1]), outside)


def _length(vector: Vector) -> Scalar:
    """Kept from zero, so that the derivative stays finite."""
    squared = dot(vector, vector)
    return jnp.sqrt(jnp.where(squared > _TINY, squared, _TINY))


def _line_of_sight(point: Vector, patch: Patch, weights: Vector) -> tuple[Vector, Array]:
    """Barycentric coordinates b at which p − Σ b_i v_i is parallel to Σ b_i n_i, by Newton's
    method, and whether it arrived near the triangle.
    """
    m = mixed(weights, patch.normals)
    height = dot(point - mixed(weights, patch.vertices), m) / jnp.maximum(dot(m, m), _TINY)

    def refine(_: int | Array, state: tuple[Vector, Scalar]) -> tuple[Vector, Scalar]:
        b, height = state
        q = patch.vertices + height * patch.normals
        m, rest, x, y = mixed(b, patch.normals), point - mixed(b, q), q[1] - q[0], q[2] - q[0]
        across = jnp.cross(x, y)
        volume = dot(across, m)
        safe = jnp.where(jnp.abs(volume) > _TINY, volume, 1.0)
        b1, b2 = dot(jnp.cross(rest, y), m) / safe, dot(jnp.cross(x, rest), m) / safe
        return b + jnp.stack([-b1 - b2, b1, b2]), height + dot(across, rest) / safe

    seen, _ = lax.fori_loop(0, _REFINEMENTS, refine, (weights, height))
    trusted = jnp.all(jnp.isfinite(seen)) & jnp.all(jnp.abs(seen - weights) < _LEAVES)
    return seen, trusted
