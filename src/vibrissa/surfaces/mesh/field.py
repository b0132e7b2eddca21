"""The level of a mesh as JAX evaluates it: a cubic spline on a grid, and single triangles where the
spline would blur.

Grid cells whose corners are all plain hold the spline alone: four cubic B-splines an axis, twice
continuously differentiable. Each corner that is marked sharp, near a crease or where triangles are
finer than the grid, brings in the triangles that may be nearest (`patches`), with a weight that is
continuously differentiable over the cells. Value, gradient and Hessian are one evaluation each, so
that Newton's method pays for what it asks.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.surfaces.mesh.patches import frozen, nearest, patch_level, unpacked

Vector = Float[Array, "3"]
Held = TypeVar("Held")
Scalar = Float[Array, ""]
AnyArray = Array | np.ndarray


class Triangles(NamedTuple):
    """Which triangles may be nearest, cell by cell."""

    cells: Int[AnyArray, "nodes"]
    """Row of `sharp` for each cell; 0 where the spline is all."""
    sharp: Int[AnyArray, "rows 3"]
    """Which corners are sharp (a bit each), first entry of `nearby`, and number of entries."""
    nearby: Int[AnyArray, "entries"]
    patches: Float[AnyArray, "patches 60"]


class Field(NamedTuple):
    """Arrays of the level; their lengths are rounded up, so that meshes of about the same size
    share compiled code.
    """

    origin: Float[AnyArray, "3"]
    spacing: Float[AnyArray, ""]
    size: Int[AnyArray, "3"]
    """Nodes along each axis; the node (i, j, k) lies at `origin` + `spacing` (i, j, k)."""
    coefficients: Float[AnyArray, "nodes"]
    triangles: Triangles | None
    """None where the spline is all: the code for the triangles is then left out."""


class Jet(NamedTuple):
    """Value, gradient, and Hessian as xx, xy, xz, yy, yz, zz; empty where not asked for."""

    value: Scalar
    gradient: list[Scalar]
    hessian: list[Scalar]


_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_TINY = 1e-300


@jax.custom_jvp
def field_level(field: Field, point: Vector) -> Scalar:
    """Level at a point; differentiable twice."""
    return _jet(field, point, 0).value


@jax.custom_jvp
def _level_and_gradient(field: Field, point: Vector) -> tuple[Scalar, Vector]:
    jet = _jet(field, point, 1)
    return jet.value, jnp.stack(jet.gradient)


@field_level.defjvp
def _level_jvp(
    primals: tuple[Field, Vector], tangents: tuple[Field, Vector]
) -> tuple[Scalar, Scalar]:
    value, gradient = _level_and_gradient(*primals)
    return value, _dot(gradient, tangents[1])


@_level_and_gradient.defjvp
def _gradient_jvp(
    primals: tuple[Field, Vector], tangents: tuple[Field, Vector]
) -> tuple[tuple[Scalar, Vector], tuple[Scalar, Vector]]:
    jet = _jet(*primals, 2)
    xx, xy, xz, yy, yz, zz = jet.hessian
    gradient, moved = jnp.stack(jet.gradient), tangents[1]
    turned = jnp.stack([_dot(row, moved) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))])
    return (jet.value, gradient), (_dot(gradient, moved), turned)


def _dot(a: Vector | tuple[Scalar, ...] | list[Scalar], b: Vector | list[Scalar]) -> Scalar:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def spline_level(field: Field, point: Vector) -> Scalar:
    """The spline alone, at a point inside the grid."""
    cell, share = _cell(field, [(point[a] - field.origin[a]) / field.spacing for a in range(3)])
    return _spline(field, cell, share, 0).value


def _jet(field: Field, point: Vector, order: int) -> Jet:
    """The level inside the grid; outside, that of the nearest point of the grid, and the distance
    from there.
    """
    low = [field.origin[a] + field.spacing for a in range(3)]
    high = [field.origin[a] + field.spacing * (field.size[a] - 2) for a in range(3)]
    held = [jnp.clip(point[a], low[a], high[a]) for a in range(3)]
    cell, share = _cell(field, [(held[a] - field.origin[a]) / field.spacing for a in range(3)])
    smooth = _spline(field, cell, share, order)
    inner = (
        smooth
        if field.triangles is None
        else _with_triangles(field, field.triangles, cell, jnp.stack(held), smooth, order)
    )
    return _extended(inner, [point[a] - held[a] for a in range(3)], order)


def _cell(field: Field, place: list[Scalar]) -> tuple[list[Array], list[Scalar]]:
    """Cell of a place in units of the spacing, and the share of the cell."""
    cell = [jnp.clip(jnp.floor(place[a]).astype(jnp.int64), 1, field.size[a] - 3) for a in range(3)]
    return cell, [place[a] - cell[a] for a in range(3)]


def _node(field: Field, cell: list[Array]) -> Array:
    return (cell[0] * field.size[1] + cell[1]) * field.size[2] + cell[2]


def _basis(t: Scalar) -> list[list[Scalar]]:
    """The four cubic B-splines that meet in a cell, with first and second derivatives."""
    s = 1 - t
    return [
        [
            s * s * s / 6,
            (4 - 6 * t * t + 3 * t * t * t) / 6,
            (4 - 6 * s * s + 3 * s * s * s) / 6,
            t * t * t / 6,
        ],
        [-s * s / 2, (3 * t * t - 4 * t) / 2, (4 * s - 3 * s * s) / 2, t * t / 2],
        [s, 3 * t - 2, 3 * s - 2, t],
    ]


def _spline(field: Field, cell: list[Array], share: list[Scalar], order: int) -> Jet:
    """Value and derivatives of Σ cᵢⱼₖ Bᵢ(x) Bⱼ(y) Bₖ(z), axis by axis."""
    base = _node(field, [index - 1 for index in cell])
    stride = [field.size[1] * field.size[2], field.size[2]]
    rows = [
        [
            lax.dynamic_slice(field.coefficients, (base + i * stride[0] + j * stride[1],), (4,))
            for j in range(4)
        ]
        for i in range(4)
    ]
    basis = [_basis(t) for t in share]
    along_z = [
        [[_dot4(basis[2][nz], rows[i][j]) for j in range(4)] for i in range(4)]
        for nz in range(order + 1)
    ]
    found: dict[tuple[int, int, int], Scalar] = {}
    for nz in range(order + 1):
        for ny in range(order + 1 - nz):
            along_y = [_dot4(basis[1][ny], along_z[nz][i]) for i in range(4)]
            for nx in range(order + 1 - nz - ny):
                found[nx, ny, nz] = _dot4(basis[0][nx], along_y) / field.spacing ** (nx + ny + nz)
    return Jet(found[0, 0, 0], *_parts(found, order))


def _parts(
    found: dict[tuple[int, int, int], Scalar], order: int
) -> tuple[list[Scalar], list[Scalar]]:
    unit = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    gradient = [found[axis] for axis in unit] if order > 0 else []
    sums = (tuple(p + q for p, q in zip(unit[a], unit[b], strict=True)) for a, b in _PAIRS)
    hessian = [found[two] for two in sums] if order > 1 else []  # type: ignore[index]
    return gradient, hessian


def _dot4(weights: list[Scalar], values: list[Scalar] | Float[Array, "4"]) -> Scalar:
    return (
        weights[0] * values[0]
        + weights[1] * values[1]
        + weights[2] * values[2]
        + weights[3] * values[3]
    )


def _with_triangles(
    field: Field, triangles: Triangles, cell: list[Array], point: Vector, smooth: Jet, order: int
) -> Jet:
    """Blend in the triangles where a corner of the cell is sharp.

    A loop of no or one turn: lanes that run together skip the work unless one of them needs it,
    which a condition would not let them do. The point is turned about on the way, lest XLA find
    that the work is the same in every turn and move it out of the loop.
    """
    row = triangles.sharp[triangles.cells[_node(field, cell)]]
    size = 1 + 3 * (order > 0) + 6 * (order > 1)

    def unfinished(state: tuple[Array, Vector, Array]) -> Array:
        return state[0]

    def evaluate(state: tuple[Array, Vector, Array]) -> tuple[Array, Vector, Array]:
        needed, point, flat = state
        low = [field.origin[a] + field.spacing * cell[a] for a in range(3)]
        share = [(point[a] - low[a]) / field.spacing for a in range(3)]
        return (
            jnp.zeros_like(needed),
            -point,
            _blended(triangles, row, share, field.spacing, point, flat, order),
        )

    _, _, flat = lax.while_loop(unfinished, evaluate, (row[2] > 0, point, _flat(smooth)))
    return Jet(
        flat[0], [flat[i] for i in range(1, min(size, 4))], [flat[i] for i in range(4, size)]
    )


def _flat(jet: Jet) -> Float[Array, "n"]:
    return jnp.stack([jet.value, *jet.gradient, *jet.hessian])


def _blended(
    triangles: Triangles,
    row: Int[Array, "3"],
    share: list[Scalar],
    spacing: Scalar | np.ndarray,
    point: Vector,
    smooth: Float[Array, "n"],
    order: int,
) -> Float[Array, "n"]:
    """(1 − w) spline + w triangle, and derivatives."""
    # Barriers, lest XLA work out the whole again for each of its parts.
    patch = unpacked(_apart(triangles.patches[_nearest_patch(triangles, row, point)]))

    def weight(offset: Vector) -> Scalar:
        return _sharpness(row[0], [share[a] + offset[a] / spacing for a in range(3)])

    w = _derivatives(weight, jnp.zeros(3), order)
    near = _apart(frozen(point, patch))
    exact = _apart(_derivatives(lambda q: patch_level(q, patch, near), point, order))
    w, gap = _apart(w), exact - smooth
    parts = [smooth[0] + w[0] * gap[0]]
    if order > 0:
        parts += [smooth[1 + a] + w[0] * gap[1 + a] + w[1 + a] * gap[0] for a in range(3)]
    if order > 1:
        parts += [
            smooth[k]
            + w[0] * gap[k]
            + w[1 + a] * gap[1 + b]
            + w[1 + b] * gap[1 + a]
            + w[k] * gap[0]
            for k, (a, b) in enumerate(_PAIRS, start=4)
        ]
    return jnp.where(row[2] > 0, jnp.stack(parts), smooth)


def _derivatives(
    function: Callable[[Vector], Scalar], point: Vector, order: int
) -> Float[Array, "n"]:
    if order == 0:
        return function(point)[None]
    value, gradient = jax.value_and_grad(function)(point)
    if order == 1:
        return jnp.concatenate([value[None], gradient])
    # One direction after the other: a third of the code.
    hessian = lax.map(
        lambda direction: jax.jvp(jax.grad(function), (point,), (direction,))[1], jnp.eye(3)
    )
    return jnp.concatenate([value[None], gradient, jnp.stack([hessian[a, b] for a, b in _PAIRS])])


def _nearest_patch(triangles: Triangles, row: Int[Array, "3"], point: Vector) -> Array:
    first, count = row[1], row[2]

    def unfinished(state: tuple[Array, Array, Array]) -> Array:
        return state[0] < count

    def look(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        index, best, chosen = state
        candidate = triangles.nearby[first + index]
        squared = nearest(
            point, jnp.asarray(triangles.patches[candidate, :9]).reshape(3, 3)
        ).squared
        closer = squared < best
        return index + 1, jnp.where(closer, squared, best), jnp.where(closer, candidate, chosen)

    start = (jnp.zeros_like(first), jnp.asarray(jnp.inf), jnp.zeros_like(triangles.nearby[0]))
    return lax.while_loop(unfinished, look, start)[2]


def _sharpness(bits: Array, share: list[Scalar]) -> Scalar:
    """Weight of the triangles: 1 at sharp corners, 0 at plain ones, with smooth steps between."""
    step = [t * t * (3 - 2 * t) for t in share]
    total = jnp.zeros_like(share[0])
    for corner in range(8):
        sides = (corner >> 2, corner >> 1 & 1, corner & 1)
        part = (bits >> corner & 1).astype(total.dtype)
        for side, s in zip(sides, step, strict=True):
            part = part * (s if side else 1 - s)
        total = total + part
    return total


def _extended(inner: Jet, outside: list[Scalar], order: int) -> Jet:
    """Add the distance from the grid, along which the inner level is constant."""
    squared = _dot(outside, outside)
    beyond = squared > 0
    distance = jnp.sqrt(jnp.where(beyond, squared, _TINY))
    gradient, hessian = inner.gradient, inner.hessian
    free = [(part == 0).astype(squared.dtype) for part in outside]
    away = [part / distance for part in outside]
    if order > 0:
        gradient = [free[a] * gradient[a] + away[a] for a in range(3)]
    if order > 1:
        hessian = [
            free[a] * free[b] * hessian[k]
            + jnp.where(beyond, ((1 - free[a]) * (a == b) - away[a] * away[b]) / distance, 0.0)
            for k, (a, b) in enumerate(_PAIRS)
        ]
    return Jet(inner.value + jnp.where(beyond, distance, 0.0), gradient, hessian)


def _apart(values: Held) -> Held:
    """Keep XLA from evaluating the values again for each of their uses."""
    held: Held = lax.optimization_barrier(values)  # type: ignore[no-untyped-call]
    return held
