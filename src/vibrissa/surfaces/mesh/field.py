"""The level of a mesh as JAX evaluates it: a cubic spline on a grid, and single triangles where the
spline would blur.

Grid cells whose corners are all plain use the spline alone: four cubic B-splines per axis, twice
continuously differentiable. Each corner marked sharp, near a crease or where triangles are finer
than the grid, blends in the triangles that may be nearest (`patches`), with a weight that is
continuously differentiable across cells. Value, gradient and Hessian are one evaluation each, so
Newton's method pays only for what it asks for.
"""

from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, UInt

from vibrissa.numerics.norms import norm
from vibrissa.numerics.rows import row_of
from vibrissa.numerics.vectors import dot
from vibrissa.surfaces.mesh.jets import Jet, added, scaled, times
from vibrissa.surfaces.mesh.patches import AnyArray, Patch, frozen, nearest, patch_jet

Vector = Float[Array, "3"]
Scalar = Float[Array, ""]
Held = TypeVar("Held")

CORNERS = np.array(list(np.ndindex(2, 2, 2)))
"""Corners of a cell."""


class Triangles(NamedTuple):
    """Which triangles may be nearest, cell by cell."""

    sharp: Bool[AnyArray, "nodes"]
    first: UInt[AnyArray, "nodes"]
    """First entry in `nearby` of the cell whose lowest corner is this node; the entries end where
    the next node's begin.
    """
    nearby: UInt[AnyArray, "entries"]
    """Numbers of patches."""
    patches: Patch


class Field(NamedTuple):
    """Arrays of the level; their lengths are rounded up, so that meshes of about the same size
    share compiled code.
    """

    origin: Float[AnyArray, "3"]
    spacing: Float[AnyArray, ""]
    size: UInt[AnyArray, "3"]
    """Nodes along each axis, unsigned; node (i, j, k) lies at `origin` + `spacing` (i, j, k)."""
    coefficients: Float[AnyArray, "nodes"]
    triangles: Triangles | None
    """None if the spline is enough everywhere: the code for triangles is then left out."""


# Coefficients of 1, t, t², t³ of the four cubic B-splines that meet in a cell (de Boor, A Practical
# Guide to Splines, 1978), and of their first and second derivatives.
_SPLINES = np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6
_DERIVATIVE = np.diag([1, 2, 3], -1)
_SPLINE_JET = np.stack([_SPLINES, _SPLINES @ _DERIVATIVE, _SPLINES @ _DERIVATIVE @ _DERIVATIVE])
_UNIT = np.eye(3, dtype=int)
_ORDERS = np.zeros(3, dtype=int), _UNIT, _UNIT[:, None] + _UNIT
"""How often each entry of a jet is differentiated along each axis."""


def field_level(field: Field, point: Vector) -> Scalar:
    """Level at a point, twice differentiable; outside the grid, the level at the grid's nearest
    point plus the distance from there.
    """
    low = field.origin + field.spacing
    held = jnp.clip(point, low, field.origin + field.spacing * (field.size - 2))
    return _jet(field, held, 0)[0] + norm(*(point - held))


@partial(jax.custom_jvp, nondiff_argnums=(2,))
def _jet(field: Field, point: Vector, order: int) -> Jet:
    """Level inside the grid, and its derivatives up to an order."""
    place = (point - field.origin) / field.spacing
    cell = jnp.clip(jnp.floor(place), 1.0, field.size - 3.0).astype(field.size.dtype)
    strides = jnp.stack([field.size[1] * field.size[2], field.size[2], jnp.ones_like(cell[0])])
    node = jnp.sum(cell * strides)
    smooth = _spline(field, node - jnp.sum(strides), strides, place - cell, order)
    if field.triangles is None:
        return smooth
    corners = node + jnp.sum(CORNERS.astype(strides.dtype) * strides, axis=1)
    marked = jnp.asarray(field.triangles.sharp)
    sharp = marked.at[corners].get(mode="promise_in_bounds")
    weight = _weight(sharp.reshape(2, 2, 2).astype(float), place - cell, field.spacing, order)
    return _with_triangles(field.triangles, node, weight, point, smooth)


def _weight(
    marks: Float[Array, "2 2 2"], share: Vector, spacing: Float[AnyArray, ""], order: int
) -> Jet:
    """From 0 at plain corners to 1 at sharp ones, by the smoothstep 3t² − 2t³ along each axis."""
    step = (3 - 2 * share) * share * share, 6 * share * (1 - share), 6 - 12 * share
    functions = [jnp.stack([float(n == 0) - part, part]) for n, part in enumerate(step)]
    return _summed(jnp.stack(functions[: order + 1]), marks, spacing)


@_jet.defjvp
def _jet_jvp(
    order: int, primals: tuple[Field, Vector], tangents: tuple[Field, Vector]
) -> tuple[Jet, Jet]:
    jet = _jet(*primals, order + 1)
    return jet[:-1], tuple(dot(derivative, tangents[1]) for derivative in jet[1:])


def _spline(field: Field, first: Array, strides: Array, share: Vector, order: int) -> Jet:
    """Value and derivatives of Σ cᵢⱼₖ Bᵢ(x) Bⱼ(y) Bₖ(z) over the 4³ nodes from `first` on."""
    steps = np.arange(4, dtype=strides.dtype)
    rows = first + steps[:, None] * strides[0] + steps * strides[1]

    def cut(row: Array) -> Array:
        return lax.dynamic_slice(field.coefficients, (row,), (4,))

    sums: Any = jax.vmap(jax.vmap(cut))(rows)
    c = _SPLINE_JET[: order + 1, ..., None]
    functions = ((c[:, :, 3] * share + c[:, :, 2]) * share + c[:, :, 1]) * share + c[:, :, 0]
    return _summed(functions, sums, field.spacing)


def _summed(
    functions: Float[AnyArray, "orders k 3"],
    values: Float[Array, "k k k"],
    spacing: Float[AnyArray, ""],
) -> Jet:
    """Jet of Σ vᵢⱼₖ fᵢ(x) fⱼ(y) fₖ(z), from the functions and their derivatives along each axis."""
    for axis in (2, 1, 0):
        # Term by term: a third of the time of the library's contractions, with lanes outermost.
        function = functions[..., axis, None, None]
        terms = (function[:, k] * values[..., k] for k in range(functions.shape[1]))
        values = jnp.asarray(sum(terms))
    return tuple(
        values[tuple(np.moveaxis(orders, -1, 0))] / spacing**n
        for n, orders in enumerate(_ORDERS[: functions.shape[0]])
    )


def _with_triangles(
    triangles: Triangles,
    node: Array,
    weight: Jet,
    point: Vector,
    smooth: Jet,
) -> Jet:
    """Blend in the triangles where a corner of the cell is sharp.

    A loop of zero or one iterations: lanes that run together skip the work unless one of them needs
    it, which a conditional would not let them do. The loop negates the point so that XLA does not
    take the work to be loop-invariant and hoist it.
    """

    def unfinished(state: tuple[Array, Vector, Jet]) -> Array:
        return state[0]

    def blend(state: tuple[Array, Vector, Jet]) -> tuple[Array, Vector, Jet]:
        needed, point, smooth = state
        chosen = _nearest_patch(triangles, node, point)
        # Barriers, so that XLA does not recompute the whole for each of its parts.
        patch = _apart(row_of(triangles.patches, chosen))
        near = _apart(frozen(point, patch))

        beside = added(patch_jet(point, patch, near, len(smooth) - 1), scaled(-1.0, smooth))
        return jnp.zeros_like(needed), -point, added(smooth, times(weight, beside))

    needed = row_of(triangles.first, node) < row_of(triangles.first, node + 1)
    return lax.while_loop(unfinished, blend, (needed, point, smooth))[2]


def _nearest_patch(triangles: Triangles, node: Array, point: Vector) -> Array:
    vertices, slopes = triangles.patches.vertices, triangles.patches.slopes

    def look(index: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        best, chosen = state
        candidate = row_of(triangles.nearby, index)
        squared = nearest(point, row_of(vertices, candidate), row_of(slopes, candidate)).squared
        closer = squared < best
        return jnp.where(closer, squared, best), jnp.where(closer, candidate, chosen)

    start = jnp.asarray(jnp.inf), jnp.zeros_like(triangles.nearby[0])
    first, stop = (row_of(triangles.first, at) for at in (node, node + 1))
    return lax.fori_loop(first, stop, look, start)[1]


def _apart(values: Held) -> Held:
    """Keep XLA from recomputing the values for each of their uses."""
    held: Held = lax.optimization_barrier(values)  # type: ignore[no-untyped-call]
    return held
