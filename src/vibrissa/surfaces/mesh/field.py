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

from vibrissa.surfaces.mesh.patches import AnyArray, Patch, frozen, nearest, patch_level

Vector = Float[Array, "3"]
Scalar = Float[Array, ""]
Held = TypeVar("Held")
Jet = tuple[Array, ...]
"""Value (), gradient (3,) and Hessian (3, 3), as far as asked for."""


class Triangles(NamedTuple):
    """Which triangles may be nearest, cell by cell."""

    rows: Int[AnyArray, "nodes"]
    """Where the cell stands in the three arrays below; 0 where the spline is all."""
    sharp: Int[AnyArray, "rows"]
    """Which corners are sharp, a bit each."""
    first: Int[AnyArray, "rows"]
    number: Int[AnyArray, "rows"]
    """First entry in `nearby`, and number of entries."""
    nearby: Int[AnyArray, "entries"]
    """Numbers of patches."""
    patches: Patch


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


# Coefficients of 1, t, t², t³ of the four cubic B-splines that meet in a cell (de Boor, A Practical
# Guide to Splines, 1978), and of their first and second derivatives.
_SPLINES = np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6
_SPLINE_JET = np.stack(
    [
        _SPLINES,
        np.pad(_SPLINES[:, 1:] * [1, 2, 3], ((0, 0), (0, 1))),
        np.pad(_SPLINES[:, 2:] * [2, 6], ((0, 0), (0, 2))),
    ]
)
# The step 3t² − 2t³ from one corner to the next, and what is left of it there.
_STEP_JET = np.array(
    [
        [[1, 0, -3, 2], [0, 0, 3, -2]],
        [[0, -6, 6, 0], [0, 6, -6, 0]],
        [[-6, 12, 0, 0], [6, -12, 0, 0]],
    ],
    dtype=float,
)
_UNIT = np.eye(3, dtype=int)
_SECOND = _UNIT[:, None] + _UNIT


@jax.custom_jvp
def field_level(field: Field, point: Vector) -> Scalar:
    """Level at a point; differentiable twice."""
    return _jet(field, point, 0)[0]


@jax.custom_jvp
def _level_and_gradient(field: Field, point: Vector) -> Jet:
    return _jet(field, point, 1)


@field_level.defjvp
def _level_jvp(
    primals: tuple[Field, Vector], tangents: tuple[Field, Vector]
) -> tuple[Scalar, Scalar]:
    value, gradient = _level_and_gradient(*primals)
    return value, jnp.sum(gradient * tangents[1])


@_level_and_gradient.defjvp
def _gradient_jvp(primals: tuple[Field, Vector], tangents: tuple[Field, Vector]) -> tuple[Jet, Jet]:
    value, gradient, hessian = _jet(*primals, 2)
    moved = tangents[1]
    return (value, gradient), (jnp.sum(gradient * moved), jnp.sum(hessian * moved, axis=1))


def _jet(field: Field, point: Vector, order: int) -> Jet:
    """The level inside the grid; outside, that of the nearest point of the grid, and the distance
    from there.
    """
    low = field.origin + field.spacing
    held = jnp.clip(point, low, field.origin + field.spacing * (field.size - 2))
    place = (held - field.origin) / field.spacing
    cell = jnp.clip(jnp.floor(place).astype(int), 1, field.size - 3)
    strides = jnp.stack([field.size[1] * field.size[2], field.size[2], jnp.ones_like(cell[0])])
    inner = _spline(field, jnp.sum((cell - 1) * strides), strides, place - cell, order)
    if field.triangles is not None:
        node = jnp.sum(cell * strides)
        inner = _with_triangles(field, field.triangles, node, cell, held, inner, order)
    return _extended(inner, point - held)


def _spline(field: Field, first: Array, strides: Array, share: Vector, order: int) -> Jet:
    """Value and derivatives of Σ cᵢⱼₖ Bᵢ(x) Bⱼ(y) Bₖ(z) over the 4³ nodes from `first` on."""
    steps = jnp.arange(4)
    rows = first + steps[:, None] * strides[0] + steps * strides[1]

    def cut(row: Array) -> Array:
        return lax.dynamic_slice(field.coefficients, (row,), (4,))

    block = jax.vmap(jax.vmap(cut))(rows)
    return _product(block, _SPLINE_JET, share, field.spacing, order)


def _product(
    block: Float[Array, "n n n"],
    basis: Float[np.ndarray, "orders n 4"],
    share: Vector,
    spacing: Scalar | np.ndarray,
    order: int,
) -> Jet:
    """Value and derivatives of a sum of products of one function of each coordinate, cubics in the
    share of a cell.
    """
    c = basis[: order + 1, ..., None]
    functions = ((c[:, :, 3] * share + c[:, :, 2]) * share + c[:, :, 1]) * share + c[:, :, 0]
    sums = block
    for axis in (2, 1, 0):
        # Term by term: a third of the time of the library's contractions, whose lanes lie outside.
        function = functions[..., axis, None, None]
        sums = sum(function[:, k] * sums[..., k] for k in range(len(block)))
    indices = (np.zeros(3, dtype=int), _UNIT, _SECOND)[: order + 1]
    return tuple(
        sums[tuple(np.moveaxis(index, -1, 0))] / spacing**n for n, index in enumerate(indices)
    )


def _with_triangles(
    field: Field,
    triangles: Triangles,
    node: Array,
    cell: Int[Array, "3"],
    point: Vector,
    smooth: Jet,
    order: int,
) -> Jet:
    """Blend in the triangles where a corner of the cell is sharp.

    A loop of no or one turn: lanes that run together skip the work unless one of them needs it,
    which a condition would not let them do. The point is turned about on the way, lest XLA find
    that the work is the same in every turn and move it out of the loop.
    """
    row = triangles.rows[node]
    corner = field.origin + field.spacing * cell
    marks = (triangles.sharp[row] >> np.arange(8).reshape(2, 2, 2) & 1).astype(float)

    def unfinished(state: tuple[Array, Vector, Jet]) -> Array:
        return state[0]

    def blend(state: tuple[Array, Vector, Jet]) -> tuple[Array, Vector, Jet]:
        needed, point, smooth = state
        share = (point - corner) / field.spacing
        weight = _product(marks, _STEP_JET, share, field.spacing, order)
        chosen = _nearest_patch(triangles, row, point)
        # Barriers, lest XLA work out the whole again for each of its parts.
        patch = _apart(jax.tree.map(lambda part: part[chosen], triangles.patches))
        near = _apart(frozen(point, patch))
        exact = _apart(_derivatives(lambda q: patch_level(q, patch, near), point, order))
        blended = _weighted(weight, tuple(e - s for e, s in zip(exact, smooth, strict=True)))
        found = tuple(jnp.where(needed, s + b, s) for s, b in zip(smooth, blended, strict=True))
        return jnp.zeros_like(needed), -point, found

    return lax.while_loop(unfinished, blend, (triangles.number[row] > 0, point, smooth))[2]


def _weighted(weight: Jet, gap: Jet) -> Jet:
    """Product of two functions, and its derivatives."""
    products = [weight[0] * gap[0]]
    if len(gap) > 1:
        products.append(weight[0] * gap[1] + weight[1] * gap[0])
    if len(gap) > 2:
        both = weight[1][:, None] * gap[1]
        products.append(weight[0] * gap[2] + both + both.T + weight[2] * gap[0])
    return tuple(products)


def _derivatives(function: Callable[[Vector], Scalar], point: Vector, order: int) -> Jet:
    if order == 0:
        return (function(point),)
    jet = jax.value_and_grad(function)(point)
    if order == 1:
        return jet
    # One direction after the other: a third of the code.
    slope = jax.grad(function)
    return *jet, lax.map(lambda along: jax.jvp(slope, (point,), (along,))[1], jnp.eye(3))


def _nearest_patch(triangles: Triangles, row: Array, point: Vector) -> Array:
    first, count = triangles.first[row], triangles.number[row]

    def unfinished(state: tuple[Array, Array, Array]) -> Array:
        return state[0] < count

    def look(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        index, best, chosen = state
        candidate = triangles.nearby[first + index]
        squared = nearest(point, triangles.patches.vertices[candidate]).squared
        closer = squared < best
        return index + 1, jnp.where(closer, squared, best), jnp.where(closer, candidate, chosen)

    start = (jnp.zeros_like(count), jnp.asarray(jnp.inf), jnp.zeros_like(triangles.nearby[0]))
    return lax.while_loop(unfinished, look, start)[2]


def _extended(inner: Jet, outside: Vector) -> Jet:
    """Add the distance from the grid, along which the inner level is constant."""
    squared = jnp.sum(outside * outside)
    beyond = squared > 0
    distance = jnp.sqrt(jnp.where(beyond, squared, 1.0))
    free, away = (outside == 0).astype(float), outside / distance
    extended = [inner[0] + jnp.where(beyond, distance, 0.0)]
    if len(inner) > 1:
        extended.append(free * inner[1] + away)
    if len(inner) > 2:
        curved = (jnp.diag(1 - free) - away[:, None] * away) / distance
        extended.append(free[:, None] * free * inner[2] + jnp.where(beyond, curved, 0.0))
    return tuple(extended)


def _apart(values: Held) -> Held:
    """Keep XLA from evaluating the values again for each of their uses."""
    held: Held = lax.optimization_barrier(values)  # type: ignore[no-untyped-call]
    return held
