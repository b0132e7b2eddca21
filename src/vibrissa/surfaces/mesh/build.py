"""From the sheets of a mesh to the arrays of its level."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import Array
from jaxtyping import Float, Int

from vibrissa.surfaces.mesh.creases import Sheets
from vibrissa.surfaces.mesh.field import Field, Triangles, field_level
from vibrissa.surfaces.mesh.libraries import library
from vibrissa.surfaces.mesh.sampling import Grid, Surveyor, candidates, chunked, node_levels

# Nodes beyond the reach: the spline takes one more on either side, the quasi-interpolation another.
_MARGIN = 5
# A node takes 8 bytes and about 5 µs to build; benchmarks/mesh_convergence.py shows what a finer
# grid gains.
_MANY_NODES, _MOST_NODES = 1 << 20, 1 << 22
_FINE = 0.6
_FEWEST = 48
# Reach [spacings] that the spline's support needs at least, and how far nodes are wanted beyond it.
_BAND, _STENCIL = 2.5, 5.0
# Share of the chordal error that the spline may blur, and of the spacing where that is zero.
_BLUR, _ROUNDING = 0.05, 1e-9
_CORNERS = np.array(list(np.ndindex(2, 2, 2)))

_levels = jax.jit(jax.vmap(field_level, in_axes=(None, 0)))


class _Cells(NamedTuple):
    """Cells of the grid that hold a point within reach of the surface."""

    node: Int[np.ndarray, "c"]
    """Number of the lowest corner."""
    squared: Float[np.ndarray, "c"]
    """Squared distance of the middle from the mesh."""
    blurred: np.ndarray
    """Whether the spline errs there."""


def build(sheet: Sheets, reach: float) -> Field:
    """Sample the mesh on a grid; keep its triangles where the spline errs by more than a twentieth
    of their chordal error within `reach` of the surface.
    """
    grid = _grid(sheet, reach)
    reach = max(reach, _BAND * grid.spacing)
    surveyor = Surveyor(sheet)
    level = node_levels(grid, sheet, surveyor, reach + _STENCIL * grid.spacing)
    coefficients = level.reshape(grid.size)
    for axis in range(3):
        # Quasi-interpolation: exact for cubics, and what happens at a crease stays within two nodes
        # of it.
        weights = np.array([-1.0, 8.0, -1.0]) / 6
        coefficients = scipy.ndimage.correlate1d(coefficients, weights, axis=axis, mode="nearest")
    plain = Field(
        jnp.asarray(grid.origin),
        jnp.asarray(grid.spacing),
        jnp.asarray(grid.size),
        _padded(coefficients.ravel(), 1 << 18),
        None,
    )
    cells = _cells(grid, sheet, surveyor, level, plain, reach)
    if not cells.blurred.any():
        return plain
    return plain._replace(triangles=_triangles(grid, sheet, cells))


def _grid(sheet: Sheets, reach: float) -> Grid:
    """About one node an edge, finer where that takes no more than a million, coarser where it would
    take more than four; at least 48 along the diagonal.
    """
    low, high = sheet.vertices.min(axis=0), sheet.vertices.max(axis=0)
    # Side of an equilateral triangle of the mean area.
    area = library("igl").doublearea(sheet.vertices, sheet.faces).mean() / 2
    edge = np.sqrt(area * 4 / np.sqrt(3))

    def nodes(spacing: float) -> float:
        return float(np.prod((high - low + 2 * reach) / spacing + 2 * _MARGIN + 1))

    spacing = float(min(_FINE * edge, np.linalg.norm(high - low) / _FEWEST))
    while nodes(spacing) > _MOST_NODES or (nodes(spacing) > _MANY_NODES and spacing < edge):
        spacing *= 1.02
    margin = reach + _MARGIN * spacing
    size = np.ceil((high - low + 2 * margin) / spacing).astype(int) + 1
    # Not aligned with the mesh, so that planes of symmetry do not fall on nodes.
    origin = low - margin - 0.31 * spacing * np.array([0.1, 0.2, 0.3])
    return Grid(origin, spacing, tuple(size.tolist()))


def _padded(rows: np.ndarray, least: int) -> Array:
    """Rows and zeros: a quarter, 1, 4, 16 … times as many as `least`."""
    capacity = least
    while capacity < len(rows):
        capacity *= 4
    return jnp.asarray(np.pad(rows, [(0, capacity - len(rows)), *[(0, 0)] * (rows.ndim - 1)]))


def _cells(
    grid: Grid,
    sheet: Sheets,
    surveyor: Surveyor,
    level: Float[np.ndarray, "nodes"],
    plain: Field,
    reach: float,
) -> _Cells:
    # A cell within reach has its lowest corner within reach and a diagonal.
    close = np.abs(level.reshape(grid.size)) <= reach + 2 * grid.spacing
    inner = np.zeros(grid.size, dtype=bool)
    inner[1:-2, 1:-2, 1:-2] = close[1:-2, 1:-2, 1:-2]
    nodes = np.flatnonzero(inner)
    middles = grid.points(nodes) + grid.spacing / 2
    squared, triangle, _ = library("igl").point_mesh_squared_distance(
        middles, sheet.vertices, sheet.faces
    )
    kept = np.sqrt(squared) <= reach + np.sqrt(3) / 2 * grid.spacing
    nodes, middles, squared = nodes[kept], middles[kept], squared[kept]
    triangle = triangle[kept].astype(np.int64)
    error = chunked(lambda p: _levels(plain, p), middles) - surveyor.levels(middles, triangle)
    # A share of the largest chordal error about the triangle.
    at_fan = np.zeros(sheet.fans.max() + 1)
    np.maximum.at(at_fan, sheet.fans, sheet.sag()[:, None])
    allowed = _BLUR * at_fan[sheet.fans].max(axis=1) + _ROUNDING * grid.spacing
    return _Cells(nodes, squared, np.abs(error) > allowed[triangle])


def _triangles(grid: Grid, sheet: Sheets, cells: _Cells) -> Triangles:
    """Triangles of the cells with a sharp corner: one that a blurred cell has."""
    nodes = int(np.prod(grid.size))
    corners = cells.node[:, None] + np.ravel_multi_index(_CORNERS.T, grid.size)
    sharp = np.zeros(nodes, dtype=bool)
    sharp[corners[cells.blurred]] = True
    marks = sharp[corners] @ (1 << np.arange(8))
    used = marks > 0
    cell, triangle = candidates(grid, sheet, cells.node[used], cells.squared[used])
    count = np.bincount(cell, minlength=used.sum())
    chosen, local = np.unique(triangle, return_inverse=True)
    rows = np.zeros(nodes, dtype=np.int32)
    rows[cells.node[used]] = np.arange(1, used.sum() + 1)

    def numbered(values: Int[np.ndarray, "rows"]) -> Array:
        # The first row is that of all other cells.
        return _padded(np.append(0, values).astype(np.int32), 1 << 12)

    return Triangles(
        _padded(rows, 1 << 18),
        numbered(marks[used]),
        numbered(np.cumsum(count) - count),
        numbered(count),
        _padded(local.astype(np.int32), 1 << 14),
        jax.tree.map(lambda part: _padded(part[chosen], 1 << 10), sheet.patches),
    )
