"""From a mesh's smooth sheets to the arrays of its level."""

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import Array
from jaxtyping import Bool, Float, Int

from vibrissa.numerics.lanes import lanes
from vibrissa.numerics.progress import Guess
from vibrissa.surfaces.mesh.creases import Sheets
from vibrissa.surfaces.mesh.field import CORNERS, Field, Triangles, field_level
from vibrissa.surfaces.mesh.libraries import library
from vibrissa.surfaces.mesh.sampling import Grid, candidates, mesh_levels, node_levels, padded

# Nodes beyond the reach: the spline needs one more on either side, the quasi-interpolation another.
_MARGIN = 5
# A node takes 8 bytes and about 5 µs to build; benchmarks/mesh_convergence.py shows what a finer
# grid gains.
_MANY_NODES, _MOST_NODES = 1 << 20, 1 << 22
_FINE = 0.6
_FEWEST = 48
# Least reach [spacings], for the spline's support, and how far beyond the reach nodes are needed.
_BAND, _STENCIL = 2.5, 5.0
# Share of the chordal error by which the spline may blur, and of the spacing where that is zero.
_BLUR, _ROUNDING = 0.05, 1e-9


STEPS = 4
"""Steps counted for a mesh without creases."""


def build(sheet: Sheets, reach: float, steps: Guess) -> Field:
    """Sample the mesh on a grid; keep its triangles where, within `reach` of the surface, the
    spline is off by more than a twentieth of their chordal error.
    """
    grid = _grid(sheet, reach)
    reach = max(reach, _BAND * grid.spacing)
    level = node_levels(grid, sheet, reach + _STENCIL * grid.spacing, steps).reshape(grid.size)
    coefficients = level
    for axis in range(3):
        # Quasi-interpolation: exact for cubics, and the effect of a crease stays within two nodes
        # of it.
        weights = np.array([-1.0, 8.0, -1.0]) / 6
        coefficients = scipy.ndimage.correlate1d(coefficients, weights, axis=axis, mode="nearest")
    plain = Field(
        jnp.asarray(grid.origin),
        jnp.asarray(grid.spacing),
        jnp.asarray(grid.size, dtype=np.uint32),
        padded(coefficients.ravel(), 1 << 18),
        None,
    )
    # The lowest corner of a cell within reach is itself within reach plus a diagonal.
    inner = np.pad(np.ones(np.subtract(grid.size, 3), dtype=bool), (1, 2))
    cells = np.flatnonzero(inner & (np.abs(level) <= reach + 2 * grid.spacing))
    middles = grid.points(cells) + grid.spacing / 2
    squared, triangle, _ = library("igl").point_mesh_squared_distance(
        middles, sheet.vertices, sheet.faces
    )
    kept = np.sqrt(squared) <= reach + np.sqrt(3) / 2 * grid.spacing
    cells, middles, triangle = cells[kept], middles[kept], triangle[kept]
    error = _levels(plain, middles) - mesh_levels(sheet, middles, triangle)
    # A share of the largest chordal error around the triangle.
    at_fan = np.zeros(sheet.fans.max() + 1)
    np.maximum.at(at_fan, sheet.fans, sheet.sag()[:, None])
    allowed = _BLUR * at_fan[sheet.fans].max(axis=1) + _ROUNDING * grid.spacing
    blurred = np.abs(error) > allowed[triangle]
    steps.step()
    if not blurred.any():
        return plain
    return plain._replace(triangles=_triangles(grid, sheet, cells, blurred, steps))


@lanes(width=1, blocks=1 << 15)
def _levels(field: Field, point: Float[Array, "3"]) -> Float[Array, ""]:
    return field_level(field, point)


def _grid(sheet: Sheets, reach: float) -> Grid:
    """About one node per edge: finer if that takes no more than a million nodes, coarser if it
    would take more than four million; at least 48 along the diagonal.
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


def _triangles(
    grid: Grid,
    sheet: Sheets,
    cells: Int[np.ndarray, "c"],
    blurred: Bool[np.ndarray, "c"],
    steps: Guess,
) -> Triangles:
    """Triangles of the cells with a sharp corner, that is, a corner of a blurred cell."""
    nodes = np.prod(grid.size)
    corners = cells[:, None] + np.ravel_multi_index(CORNERS.T, grid.size)
    sharp = np.zeros(nodes, dtype=bool)
    sharp[corners[blurred]] = True
    used = cells[sharp[corners].any(axis=1)]
    cell, triangle = candidates(grid, sheet, used, steps)
    first = np.searchsorted(used[cell], np.arange(nodes + 1))
    chosen, nearby = np.unique(triangle, return_inverse=True)
    return Triangles(
        padded(sharp, 1 << 18),
        padded(first.astype(np.uint32), 1 << 18),
        padded(nearby.astype(np.uint32), 1 << 14),
        jax.tree.map(lambda part: padded(part[chosen], 1 << 10), sheet.patches),
    )
