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

from vibrissa.numerics.linear import solve_3x3
from vibrissa.numerics.norms import norm
from vibrissa.numerics.vectors import dot

Vector = Float[Array, "3"]
Scalar = Float[Array, ""]
AnyArray = Array | np.ndarray
Triangle = Float[AnyArray, "3 3"]

# Corners at which the edge opposite each corner starts and ends.
_START, _STOP = np.array([1, 2, 0]), np.array([2, 0, 1])
_CORNERS = np.eye(3)
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
    beyond: Float[AnyArray, "*f 3 3 3"]
    """Normals on the other side of each crease edge, by corner; that of the corner opposite the
    edge has no weight.
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
    edge: Int[Array, ""]
    """Number of the corner opposite the edge that it lies on; −1 within the triangle."""


def mixed(weights: Float[Array, "*n 3"], rows: Triangle) -> Float[Array, "*n 3"]:
    """Rows weighted by barycentric coordinates."""
    return jnp.sum(weights[..., None] * rows, axis=-2)


def nearest(point: Vector, vertices: Triangle) -> Nearest:
    """Nearest point of a triangle that is not degenerate: the one below, or the nearest of those on
    the three edges.
    """
    along = _along(vertices)
    share = jnp.clip(dot(along, point - vertices[_START]) / dot(along, along), 0, 1)[:, None]
    on_edges = (1 - share) * _CORNERS[_START] + share * _CORNERS[_STOP]
    weights = jnp.concatenate([on_edges, _planar(vertices, point)[None]])
    offset = point - mixed(weights, vertices)
    squared = dot(offset, offset)
    edge = jnp.where(jnp.all(weights[-1] >= 0), -1, jnp.argmin(squared[:3]))
    return Nearest(squared[edge], weights[edge], edge)


def _along(vertices: Triangle) -> Triangle:
    """Vectors along the edges, each opposite its corner."""
    return vertices[_STOP] - vertices[_START]


def _slopes(vertices: Triangle) -> Triangle:
    """Gradients of the barycentric coordinates in the triangle's plane, one a row."""
    along = _along(vertices)
    normal = jnp.cross(along[0], along[1])
    return jnp.cross(normal, along) / dot(normal, normal)


def _planar(vertices: Triangle, point: Vector) -> Vector:
    """Barycentric coordinates of the point below in the triangle's plane."""
    return dot(_slopes(vertices), point - vertices[0]) + _CORNERS[0]


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
    _, weights, edge = nearest(point, patch.vertices)
    corner = jnp.argmax(weights)
    within, at_corner = edge < 0, (edge >= 0) & (weights[corner] == 1)
    along = _along(patch.vertices)[edge]
    turn = jnp.asarray(_CORNERS[_STOP] - _CORNERS[_START])[edge]
    on_edge = turn[:, None] * along / dot(along, along)
    slopes = jnp.where(within, _slopes(patch.vertices), on_edge)
    code = jnp.where(at_corner, patch.corners[corner], patch.edges[edge])
    apex = patch.vertices[corner]
    return Frozen(
        point,
        weights,
        slopes=jnp.where(at_corner, 0.0, slopes),
        code=jnp.where(within, 0.0, code),
        corner=apex,
        sign=jnp.where(dot(point - apex, patch.pseudo[corner]) >= 0, 1.0, -1.0),
        beyond=jnp.where(at_corner, patch.around, patch.beyond[edge]),
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
    tip = nearby.sign * norm(*(point - nearby.corner))
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
    first, second = distances
    sine = jnp.sqrt(jnp.maximum(1 - cosine * cosine, _FLATTEST))
    outside = norm(first, (second - cosine * first) / sine)
    outside = jnp.where(second <= cosine * first, first, outside)
    outside = jnp.where(first <= cosine * second, second, outside)
    return jnp.where((first <= 0) & (second <= 0), jnp.maximum(first, second), outside)


def _line_of_sight(point: Vector, patch: Patch, weights: Vector) -> tuple[Vector, Array]:
    """Barycentric coordinates b at which p − Σ b_i v_i is parallel to Σ b_i n_i, by Newton's
    method, and whether it arrived near the triangle.
    """

    def coordinates(unknown: Vector) -> Vector:
        return jnp.append(1 - unknown[0] - unknown[1], unknown[:2])

    def missed(unknown: Vector) -> Vector:
        """By the point with the last two coordinates given, and the height."""
        return point - mixed(coordinates(unknown), patch.vertices + unknown[2] * patch.normals)

    def refine(_: int | Array, unknown: Vector) -> Vector:
        return unknown - solve_3x3(jax.jacfwd(missed)(unknown), missed(unknown))

    m = mixed(weights, patch.normals)
    height = dot(point - mixed(weights, patch.vertices), m) / dot(m, m)
    seen = coordinates(lax.fori_loop(0, _REFINEMENTS, refine, jnp.append(weights[1:], height)))
    return seen, jnp.all(jnp.isfinite(seen)) & jnp.all(jnp.abs(seen - weights) < _LEAVES)
