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
from jax import Array
from jaxtyping import Float, Int

Vector = Float[Array, "3"]
Scalar = Float[Array, ""]
Triangle = Float[Array, "3 3"]

COLUMNS = 60
"""Numbers that describe one patch, in the order of the fields of `Patch`."""

INTERIOR, EDGE, CORNER = 0, 1, 4
"""Nearest feature of a triangle: 0 its interior, 1 to 3 the edge opposite that corner, 4 to 6 the
corner.
"""

_TINY = 1e-300
_REFINEMENTS = 4
_LEAVES = 4.0


class Patch(NamedTuple):
    """What the level over one triangle depends on."""

    vertices: Triangle
    normals: Triangle
    """Of the corners, each on this triangle's side of a crease."""
    beyond: Float[Array, "3 2 3"]
    """Normals on the other side of each crease edge, at its two ends: edge k runs from corner k + 1
    to corner k + 2.
    """
    around: Triangle
    """Normals on the other side of the crease through each corner."""
    pseudo: Triangle
    """Angle-weighted normals of all triangles about each corner (Bærentzen & Aanæs 2005): they tell
    inside from outside.
    """
    edges: Vector
    """0 a smooth edge, 1 a convex crease, −1 a concave one."""
    corners: Vector
    """0 a smooth corner, ±1 one on a convex or concave crease that runs through it, 2 one where
    creases meet.
    """


def unpacked(row: Float[Array, "60"]) -> Patch:
    """Patch from one row of numbers."""
    return Patch(
        row[:9].reshape(3, 3), row[9:18].reshape(3, 3), row[18:36].reshape(3, 2, 3), row[36:45].reshape(3, 3),
        row[45:54].reshape(3, 3), row[54:57], row[57:60],
    )  # fmt: skip


class Nearest(NamedTuple):
    """Nearest point of a flat triangle."""

    squared: Scalar
    """Squared distance."""
    weights: Vector
    """Barycentric coordinates."""
    feature: Int[Array, ""]


def dot(a: Vector, b: Vector) -> Scalar:
    """Written out, so that lanes stay innermost."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def nearest(point: Vector, corners: Triangle) -> Nearest:
    """Nearest point of a triangle (3, 3) that is not degenerate."""
    a, b, c = corners[0], corners[1], corners[2]
    ab, ac, ap = b - a, c - a, point - a
    d1, d2 = dot(ab, ap), dot(ac, ap)
    aa, cc, ac_ab = dot(ab, ab), dot(ac, ac), dot(ab, ac)
    determinant = aa * cc - ac_ab * ac_ab
    v, w = (cc * d1 - ac_ab * d2) / determinant, (aa * d2 - ac_ab * d1) / determinant
    inside = (v >= 0) & (w >= 0) & (v + w <= 1)
    flat = dot(ap - v * ab - w * ac, ap - v * ab - w * ac)
    bc, bp = c - b, point - b
    # Along the edges opposite a, b and c.
    shares = [
        jnp.clip(share, 0.0, 1.0) for share in (dot(bc, bp) / dot(bc, bc), 1 - d2 / cc, d1 / aa)
    ]
    zero = jnp.zeros_like(v)
    bary = [
        jnp.stack([zero, 1 - shares[0], shares[0]]),
        jnp.stack([shares[1], zero, 1 - shares[1]]),
        jnp.stack([1 - shares[2], shares[2], zero]),
    ]
    best = jnp.where(inside, flat, jnp.inf)
    weights, feature = jnp.stack([1 - v - w, v, w]), jnp.zeros_like(v, dtype=jnp.int64)
    for k, (share, candidate) in enumerate(zip(shares, bary, strict=True)):
        offset = ap - candidate[1] * ab - candidate[2] * ac
        squared = dot(offset, offset)
        at = jnp.where(
            share <= 0, CORNER + (k + 1) % 3, jnp.where(share >= 1, CORNER + (k + 2) % 3, EDGE + k)
        )
        closer = ~inside & (squared < best)
        best, weights, feature = (
            jnp.where(closer, squared, best),
            jnp.where(closer, candidate, weights),
            jnp.where(closer, at, feature),
        )
    return Nearest(best, weights, feature)


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
    edge, corner = jnp.clip(feature - EDGE, 0, 2), jnp.clip(feature - CORNER, 0, 2)
    at_corner, at_edge = feature >= CORNER, (feature >= EDGE) & (feature < CORNER)
    code = jnp.where(at_corner, patch.corners[corner], jnp.where(at_edge, patch.edges[edge], 0.0))
    index = jnp.arange(3)
    first, second = (index == (edge + 1) % 3)[:, None], (index == (edge + 2) % 3)[:, None]
    beyond = jnp.where(
        first, patch.beyond[edge, 0], jnp.where(second, patch.beyond[edge, 1], patch.normals)
    )
    apex = patch.vertices[corner]
    sign = jnp.where(dot(point - apex, patch.pseudo[corner]) >= 0, 1.0, -1.0)
    along = patch.vertices[(edge + 2) % 3] - patch.vertices[(edge + 1) % 3]
    along = along / dot(along, along)
    on_edge = jnp.where(second, along, jnp.where(first, -along, 0.0))
    slopes = jnp.where(at_corner, 0.0, jnp.where(at_edge, on_edge, _slopes(patch.vertices)))
    return Frozen(
        point, weights, slopes, code, apex, sign, jnp.where(at_corner, patch.around, beyond)
    )


def _slopes(vertices: Triangle) -> Triangle:
    """Gradients of the barycentric coordinates in the triangle's plane."""
    ab, ac = vertices[1] - vertices[0], vertices[2] - vertices[0]
    normal = jnp.cross(ab, ac)
    b, c = jnp.cross(ac, normal) / dot(normal, normal), jnp.cross(normal, ab) / dot(normal, normal)
    return jnp.stack([-b - c, b, c])


def patch_level(point: Vector, patch: Patch, nearby: Frozen) -> Scalar:
    """Signed distance from the surface over the triangle, given what is nearest to about this
    point.
    """
    moved = point - nearby.point
    weights = nearby.weights + jnp.stack([dot(slope, moved) for slope in nearby.slopes])
    sides = jnp.stack([patch.normals, nearby.beyond])
    level, normal = jax.vmap(_sheet, in_axes=(None, None, 0, None))(
        point, patch.vertices, sides, weights
    )
    here = level[0]
    ridge = nearby.code * _outside_both(
        nearby.code * here, nearby.code * level[1], dot(normal[0], normal[1])
    )
    apex = point - nearby.corner
    # Squared length, kept from zero so that the derivative stays finite.
    squared = dot(apex, apex)
    tip = nearby.sign * jnp.sqrt(jnp.where(squared > _TINY, squared, _TINY))
    return jnp.where(nearby.code == 0, here, jnp.where(nearby.code == 2, tip, ridge))


def refined_level(point: Vector, patch: Patch) -> tuple[Scalar, Vector]:
    """The same seen along the interpolated normals, and the barycentric coordinates where the line
    of sight meets the triangle's plane.

    They may lie outside the triangle: the neighbour there sees the point better.
    """
    near = frozen(point, patch)
    seen, trusted = _line_of_sight(point, patch, near.weights)
    # Far away, the direction over the triangle's plane is all that is asked for.
    slopes, offset = _slopes(patch.vertices), point - patch.vertices[0]
    flat = jnp.stack([dot(slope, offset) for slope in slopes]) + jnp.array([1.0, 0.0, 0.0])
    seen = jnp.where(trusted, seen, flat)
    # At a crease the line of sight ends; beyond it the coordinates of the nearest point stay.
    stopped = (near.code != 0) | jnp.any((patch.edges != 0) & (seen < 0))
    weights = jnp.where(stopped, near.weights, seen)
    level = patch_level(
        point, patch, near._replace(weights=jnp.where(trusted, weights, near.weights))
    )
    return level, weights


def _sheet(
    point: Vector, vertices: Triangle, normals: Triangle, weights: Vector
) -> tuple[Scalar, Vector]:
    """Level over a triangle at given barycentric coordinates, and the normal there."""
    total = _mixed(weights, normals)
    length = jnp.sqrt(dot(total, total))
    m = total / length
    lever = [dot(normals[i], vertices[i]) for i in range(3)]
    value = (
        dot(total, point)
        - dot(weights, jnp.stack(lever))
        + dot(m, point - _mixed(weights, vertices))
    )
    return value / (1 + length), m


def _mixed(weights: Vector, rows: Triangle) -> Vector:
    return weights[0] * rows[0] + weights[1] * rows[1] + weights[2] * rows[2]


def _outside_both(first: Scalar, second: Scalar, cosine: Scalar) -> Scalar:
    """Distance from the corner between two half spaces, given the distances from both and the
    cosine between their normals.
    """
    sine2 = jnp.maximum(1 - cosine * cosine, 1e-6)
    along_first, along_second = (first - cosine * second) / sine2, (second - cosine * first) / sine2
    squared = along_first * first + along_second * second
    radius = jnp.sqrt(jnp.where(squared > _TINY, squared, _TINY))
    outside = jnp.where(along_first <= 0, second, jnp.where(along_second <= 0, first, radius))
    return jnp.where((first <= 0) & (second <= 0), jnp.maximum(first, second), outside)


def _line_of_sight(point: Vector, patch: Patch, weights: Vector) -> tuple[Vector, Array]:
    """Barycentric coordinates b at which p − Σ b_i v_i is parallel to Σ b_i n_i, by Newton's
    method, and whether it arrived near the triangle.
    """
    v, n = patch.vertices, patch.normals
    m = _mixed(weights, n)
    height = dot(point - _mixed(weights, v), m) / jnp.maximum(dot(m, m), _TINY)
    b1, b2 = weights[1], weights[2]
    for _ in range(_REFINEMENTS):
        q = [v[i] + height * n[i] for i in range(3)]
        m = n[0] + b1 * (n[1] - n[0]) + b2 * (n[2] - n[0])
        rest = point - q[0] - b1 * (q[1] - q[0]) - b2 * (q[2] - q[0])
        x, y = q[1] - q[0], q[2] - q[0]
        across = jnp.cross(x, y)
        volume = dot(across, m)
        safe = jnp.where(jnp.abs(volume) > _TINY, volume, 1.0)
        b1 = b1 + dot(jnp.cross(rest, y), m) / safe
        b2 = b2 + dot(jnp.cross(x, rest), m) / safe
        height = height + dot(across, rest) / safe
    seen = jnp.stack([1 - b1 - b2, b1, b2])
    trusted = jnp.all(jnp.isfinite(seen)) & jnp.all(jnp.abs(seen - weights) < _LEAVES)
    return seen, trusted
