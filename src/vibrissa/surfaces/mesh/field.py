"""The level of a mesh as JAX evaluates it: a cubic spline on a grid, and single triangles where the
spline would blur.

Grid cells whose corners are all plain hold the spline alone: four cubic B-splines an axis, twice
continuously differentiable. Each corner that is marked sharp, near a crease or where triangles are
finer than the grid, brings in the triangles that may be nearest (`patches`), with a weight that is
continuously differentiable over the cells. Value, gradient and Hessian are one evaluation each, so
that Newton's method pays for what it asks.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.numerics.norms import norm
from vibrissa.surfaces.mesh.patches import AnyArray, Patch, dot, nearest, surface_near

Vector = Float[Array, "3"]
Scalar = Float[Array, ""]
Jet = tuple[Array, ...]
"""Value (), gradient (3,) and Hessian (3, 3), as far as asked for."""


class Triangles(NamedTuple):
    """Which triangles may be nearest, cell by cell."""

    rows: Int[AnyArray, "nodes"]
    """Where the cell stands in the two arrays below; 0 where the spline is all."""
    sharp: Int[AnyArray, "rows"]
    """Which corners are sharp, a bit each."""
    first: Int[AnyArray, "rows"]
    """First entry in `nearby`; the entries end where those of the next row begin."""
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
# Guide to Splines, 1978); and of 3t² − 2t³, the step from one corner to the next, and its rest.
_SPLINES = np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6
_STEPS = np.array([[1.0, 0, -3, 2], [0, 0, 3, -2]])
_UNIT = np.eye(3, dtype=int)


def _differentiable(jet: Callable[[Any, Vector, int], Jet]) -> Callable[[Any, Vector], Scalar]:
    """A function of data and a point whose derivatives by the point `jet` gives, up to an order."""

    @jax.custom_jvp
    def value(data: Any, point: Vector) -> Any:
        return jet(data, point, 0)[0]

    @jax.custom_jvp
    def slope(data: Any, point: Vector) -> Jet:
        return jet(data, point, 1)

    @value.defjvp
    def _of_value(primals: Any, tangents: Any) -> tuple[Scalar, Scalar]:
        level, gradient = slope(*primals)
        return level, jnp.sum(gradient * tangents[1])

    @slope.defjvp
    def _of_slope(primals: Any, tangents: Any) -> tuple[Jet, Jet]:
        level, gradient, hessian = jet(*primals, 2)  # type: ignore[call-arg]
        moved = tangents[1]
        return (level, gradient), (jnp.sum(gradient * moved), jnp.sum(hessian * moved, axis=1))

    return value


def field_level(field: Field, point: Vector) -> Scalar:
    """Level at a point; outside the grid, that of the grid's nearest point, and the distance from
    there. Differentiable twice.
    """
    low, high = field.origin + field.spacing, field.origin + field.spacing * (field.size - 2)
    held = jnp.where(point < low, low, jnp.where(point > high, high, point))
    place = (held - field.origin) / field.spacing
    cell = jnp.clip(jnp.floor(place).astype(int), 1, field.size - 3)
    share = place - cell
    strides = jnp.stack([field.size[1] * field.size[2], field.size[2], jnp.ones_like(cell[0])])
    node, steps = jnp.sum(cell * strides), jnp.arange(-1, 3)
    # The 4³ nodes about the cell, of which four lie side by side.
    rows = node - 1 + steps[:, None] * strides[0] + steps * strides[1]
    cut = jax.vmap(jax.vmap(lambda row: lax.dynamic_slice(field.coefficients, (row,), (4,))))
    level = _spline(cut(rows), share)  # type: ignore[no-untyped-call]
    if field.triangles is not None:
        row = field.triangles.rows[node]
        marks = (field.triangles.sharp[row] >> np.arange(8).reshape(2, 2, 2) & 1).astype(float)
        exact = _by_triangles((field.triangles, row), held)
        level += _step(marks, share) * (exact - level)
    return level + norm(*(point - held))


def _cubics(
    basis: Float[np.ndarray, "n 4"], block: Float[Array, "n n n"], share: Vector, order: int
) -> Jet:
    """Σ cᵢⱼₖ Bᵢ(x) Bⱼ(y) Bₖ(z) of a block of coefficients, the cubics given by theirs."""
    bases = [basis]
    for _ in range(order):
        bases.append(np.roll(bases[-1] * np.arange(4), -1, axis=1))
    c = np.stack(bases)[..., None]
    functions = ((c[:, :, 3] * share + c[:, :, 2]) * share + c[:, :, 1]) * share + c[:, :, 0]
    sums = block
    for axis in (2, 1, 0):
        # Term by term: a third of the time of the library's contractions, whose lanes lie outside.
        function = functions[..., axis, None, None]
        sums = sum(function[:, k] * sums[..., k] for k in range(len(basis)))
    indices = (np.zeros(3, dtype=int), _UNIT, _UNIT[:, None] + _UNIT)[: order + 1]
    return tuple(sums[tuple(np.moveaxis(index, -1, 0))] for index in indices)


_spline, _step = (_differentiable(partial(_cubics, basis)) for basis in (_SPLINES, _STEPS))


@_differentiable
def _by_triangles(data: tuple[Triangles, Array], point: Vector, order: int) -> Jet:
    """Level by the triangle nearest to the point, of those that its row of `Triangles` lists; 0
    where that is empty.

    A loop of no or one turn: lanes that run together skip the work unless one of them needs it,
    which a condition would not let them do. The point is turned about on the way, lest XLA find
    that the work is the same in every turn and move it out of the loop.
    """
    triangles, row = data
    first, stop = triangles.first[row], triangles.first[row + 1]

    def closer(index: Array, found: tuple[Array, Array], point: Vector) -> tuple[Array, Array]:
        candidate = triangles.nearby[index]
        squared = nearest(point, triangles.patches.vertices[candidate]).squared
        better = squared < found[0]
        return jnp.where(better, squared, found[0]), jnp.where(better, candidate, found[1])

    def evaluate(state: tuple[Array, Vector, Jet]) -> tuple[Array, Vector, Jet]:
        _, point, _ = state
        none = jnp.asarray(jnp.inf), triangles.nearby[0]
        _, chosen = lax.fori_loop(first, stop, lambda i, found: closer(i, found, point), none)
        patch = jax.tree.map(lambda part: part[chosen], triangles.patches)
        level, weights, slopes, _ = surface_near(point, patch)
        seen = lambda q: level(q, weights + dot(slopes, q - point))  # noqa: E731
        return jnp.zeros((), bool), -point, _derivatives(seen, point, order)

    nothing = tuple(jnp.zeros((3,) * n) for n in range(order + 1))
    return lax.while_loop(lambda state: state[0], evaluate, (stop > first, point, nothing))[2]


def _derivatives(function: Callable[[Vector], Scalar], point: Vector, order: int) -> Jet:
    if order == 0:
        return (function(point),)
    jet = jax.value_and_grad(function)(point)
    if order == 1:
        return jet
    # One direction after the other: a third of the code.
    slope = jax.grad(function)
    return *jet, lax.map(lambda along: jax.jvp(slope, (point,), (along,))[1], jnp.eye(3))
