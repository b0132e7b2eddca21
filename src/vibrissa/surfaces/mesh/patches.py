"""The surface over one triangle: curved between smooth corners, rounded off outside a crease.

With barycentric coordinates b_i, corners v_i and corner normals n_i, and with N = Σ b_i n_i and m =
N/‖N‖, a point p is

    Σ b_i (n_i + m)·(p − v_i) / (1 + ‖N‖)

away from it. For the normals of a sphere this is the distance from the sphere, exactly, wherever Σ
b_i v_i lies on the line from p to the centre; in general it errs by third derivatives of the
surface. Where the nearest point lies on a crease, the planes of its two sides give the distance
from their corner.
"""

from collections.abc import Callable
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

EDGE, CORNER = 1, 4
"""Nearest feature of a triangle: 0 its interior, 1 to 3 the edge opposite that corner, 4 to 6 the
corner.
"""
# Edge k runs from corner k + 1 to corner k + 2: their barycentric coordinates, a row an edge.
_START, _STOP = np.roll(np.eye(3), 1, axis=1), np.roll(np.eye(3), 2, axis=1)

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
    beyond: Float[AnyArray, "*f 4 3 3"]
    """The same on the other side of the crease along each edge, and through each corner."""
    pseudo: Float[AnyArray, "*f 3 3"]
    """Angle-weighted normals of all triangles about each corner (Bærentzen & Aanæs 2005): they tell
    inside from outside.
    """
    codes: Float[AnyArray, "*f 7"]
    """Of each feature: 0 where the surface is smooth, 1 on a convex crease, −1 on a concave one, 2
    at a corner where creases meet.
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
    start = jnp.roll(vertices, -1, axis=0)
    along = jnp.roll(vertices, -2, axis=0) - start
    share = jnp.clip(dot(along, point - start) / dot(along, along), 0.0, 1.0)
    offset = point - start - share[:, None] * along
    squared = dot(offset, offset)
    edge = jnp.argmin(squared)
    t = share[edge]
    ends = jnp.stack([EDGE + edge, CORNER + (edge + 1) % 3, CORNER + (edge + 2) % 3])
    below = point - mixed(weights, vertices)
    return Nearest(
        jnp.where(inside, dot(below, below), squared[edge]),
        jnp.where(
            inside, weights, (1 - t) * jnp.asarray(_START)[edge] + t * jnp.asarray(_STOP)[edge]
        ),
        jnp.where(inside, 0, ends[jnp.where(t <= 0, 1, jnp.where(t >= 1, 2, 0))]),
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


Sight = Callable[[Vector, Vector], Scalar]
"""Level of a point over the triangle, given its barycentric coordinates; smooth in both."""


def surface_near(point: Vector, patch: Patch) -> tuple[Sight, Vector, Triangle, Scalar]:
    """What a point sees of the surface over the triangle, its nearest feature held fast: the level
    about there, the barycentric coordinates of the nearest point, their gradients, one a row, and
    the feature's code.
    """
    _, weights, feature = nearest(point, patch.vertices)
    edge, corner = jnp.clip(feature - EDGE, 0, 2), jnp.clip(feature - CORNER, 0, 2)
    along = patch.vertices[(edge + 2) % 3] - patch.vertices[(edge + 1) % 3]
    on_edge = jnp.asarray(_STOP - _START)[edge][:, None] * (along / dot(along, along))
    at_vertex, inside = feature >= CORNER, feature < EDGE
    slopes = jnp.where(at_vertex, 0.0, jnp.where(inside, _slopes(patch.vertices), on_edge))
    apex = patch.vertices[corner]
    sign = jnp.where(dot(point - apex, patch.pseudo[corner]) >= 0, 1.0, -1.0)
    sides = jnp.stack([patch.normals, patch.beyond[jnp.clip(feature - EDGE, 0, 3)]])
    # A barrier, lest XLA work it out again for each of its uses.
    held = lax.optimization_barrier(  # type: ignore[no-untyped-call]
        (weights, slopes, patch.codes[feature], apex, sign, sides, patch.vertices)
    )
    weights, slopes, code, apex, sign, sides, vertices = held

    def level(point: Vector, weights: Vector) -> Scalar:
        levels, normals = jax.vmap(_sheet, in_axes=(None, None, 0, None))(
            point, vertices, sides, weights
        )
        ridge = code * _outside_both(code * levels, dot(normals[0], normals[1]))
        # Kept from zero, so that the derivative of the length stays finite.
        offset = point - apex
        tip = sign * jnp.sqrt(jnp.maximum(dot(offset, offset), _TINY))
        return jnp.where(code == 0, levels[0], jnp.where(code == 2, tip, ridge))

    return level, weights, slopes, code


def refined_level(point: Vector, patch: Patch) -> tuple[Scalar, Vector]:
    """Level seen along the interpolated normals, and the barycentric coordinates where the line of
    sight meets the triangle's plane.

    They may lie outside the triangle: the neighbour there sees the point better.
    """
    level, nearest_weights, _, code = surface_near(point, patch)
    seen, trusted = _line_of_sight(point, patch, nearest_weights)
    # Far away, the direction over the triangle's plane is all that is asked for.
    seen = jnp.where(trusted, seen, _planar(patch.vertices, point))
    # At a crease the line of sight ends; beyond it the coordinates of the nearest point stay.
    creases = patch.codes[EDGE:CORNER] != 0
    stopped = (code != 0) | jnp.any(creases & (seen < 0))
    weights = jnp.where(stopped, nearest_weights, seen)
    return level(point, jnp.where(trusted, weights, nearest_weights)), weights


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
