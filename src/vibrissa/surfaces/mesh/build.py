"""From the sheets of a mesh to the arrays of its level."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from scipy.ndimage import correlate1d

from vibrissa.surfaces.mesh.creases import Sheets, patch_rows
from vibrissa.surfaces.mesh.field import Field, Triangles, spline_level
from vibrissa.surfaces.mesh.nodes import (
    Grid,
    Surveyor,
    Tracked,
    chunked,
    sharp_neighbourhoods,
    track,
)

_MARGIN = 5
_MANY_NODES = 1 << 20
_MOST_NODES = 1 << 22
_FINE = 0.6
_FEWEST = 48
_BAND = 2.5
_STENCIL = 5.0
_BLUR = 0.05
_ROUNDING = 1e-9
_CORNERS = tuple(np.ndindex(2, 2, 2))


def build(sheet: Sheets, reach: float) -> Field:
    """Sample the mesh on a grid; keep its triangles where the spline errs by more than a twentieth
    of their chordal error within `reach` of the surface.
    """
    grid = _grid(sheet, reach)
    reach = max(reach, _BAND * grid.spacing)
    surveyor = Surveyor(sheet)
    tracked = track(grid, sheet, surveyor, reach + _STENCIL * grid.spacing)
    level = tracked.level.reshape(grid.size)
    coefficients = level
    for axis in range(3):
        # Quasi-interpolation: exact for cubics, and what happens at a crease stays within two nodes
        # of it.
        coefficients = correlate1d(
            coefficients, np.array([-1.0, 8.0, -1.0]) / 6, axis=axis, mode="nearest"
        )
    plain = _field(grid, coefficients.ravel())
    blurred, bound, cells = _blurred(grid, sheet, surveyor, tracked, plain, reach)
    if not blurred.any():
        return plain
    return _with_triangles(grid, sheet, surveyor, plain, cells, bound, blurred)


def _grid(sheet: Sheets, reach: float) -> Grid:
    """About one node an edge, finer where that takes no more than a million, coarser where it would
    take more than four; at least 48 along the diagonal.
    """
    low, high = sheet.vertices.min(axis=0), sheet.vertices.max(axis=0)
    corners = sheet.vertices[sheet.faces]
    area = (
        np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        )
        / 2
    )
    edge = np.sqrt(area.sum() / len(area) * 4 / np.sqrt(3))

    def nodes(spacing: float) -> float:
        return float(np.prod((high - low + 2 * reach) / spacing + 2 * _MARGIN + 1))

    spacing = float(min(_FINE * edge, np.linalg.norm(high - low) / _FEWEST))
    while nodes(spacing) > _MOST_NODES or (nodes(spacing) > _MANY_NODES and spacing < edge):
        spacing *= 1.02
    margin = reach + _MARGIN * spacing
    size = np.ceil((high - low + 2 * margin) / spacing).astype(int) + 1
    # Not aligned with the mesh, so that planes of symmetry do not fall on nodes.
    return Grid(
        low - margin - 0.31 * spacing * np.array([0.1, 0.2, 0.3]), spacing, tuple(size.tolist())
    )


def _capacity(count: int, least: int, factor: int) -> int:
    while least < count:
        least *= factor
    return least


def _padded(rows: np.ndarray, least: int, factor: int = 4) -> Array:
    missing = _capacity(len(rows), least, factor) - len(rows)
    return jnp.asarray(
        np.concatenate([rows, np.zeros((missing, *rows.shape[1:]), dtype=rows.dtype)])
    )


def _field(grid: Grid, coefficients: Float[np.ndarray, "nodes"]) -> Field:
    return Field(
        jnp.asarray(grid.origin),
        jnp.asarray(grid.spacing),
        jnp.asarray(np.array(grid.size, dtype=np.int64)),
        _padded(coefficients, 1 << 18),
        None,
    )


_splines = jax.jit(jax.vmap(spline_level, in_axes=(None, 0)))


def _blurred(
    grid: Grid, sheet: Sheets, surveyor: Surveyor, tracked: Tracked, plain: Field, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the cells within reach: whether the spline errs at their middles, the distance of those
    from the mesh, and their numbers.
    """
    shape = grid.size
    close = np.abs(tracked.level.reshape(shape)) <= reach + 2 * grid.spacing
    inner = np.zeros(shape, dtype=bool)
    inner[1:-2, 1:-2, 1:-2] = True
    inner[:-1, :-1, :-1] &= np.logical_or.reduce([_shifted(close, corner) for corner in _CORNERS])
    cells = np.flatnonzero(inner)
    middles = grid.points(cells) + grid.spacing / 2
    index = np.unravel_index(cells, shape)
    best, triangle = np.full(len(cells), np.inf), np.zeros(len(cells), dtype=np.int64)
    for corner in _CORNERS:
        candidate = tracked.triangle[
            np.ravel_multi_index(tuple(i + c for i, c in zip(index, corner, strict=True)), shape)
        ]
        rows = (
            np.flatnonzero(candidate != triangle)
            if np.isfinite(best).all()
            else np.arange(len(cells))
        )
        found = surveyor.squared(middles[rows], candidate[rows])
        closer = found < best[rows]
        best[rows[closer]], triangle[rows[closer]] = found[closer], candidate[rows[closer]]
    distance = np.sqrt(best)
    # Every cell that holds a point within reach.
    kept = distance <= reach + np.sqrt(3) / 2 * grid.spacing
    cells, middles, triangle, distance = cells[kept], middles[kept], triangle[kept], distance[kept]
    error = np.abs(
        chunked(lambda p: _splines(plain, p), middles) - surveyor.levels(middles, triangle)
    )
    return error > _allowed(grid, sheet)[triangle], distance, cells


def _allowed(grid: Grid, sheet: Sheets) -> Float[np.ndarray, "f"]:
    """Error allowed to the spline near each triangle: a share of the largest chordal error about
    it.
    """
    sag = sheet.sag()
    at_fan = np.zeros(len(sheet.normals))
    for k in range(3):
        np.maximum.at(at_fan, sheet.fans[:, k], sag)
    return _BLUR * at_fan[sheet.fans].max(axis=1) + _ROUNDING * grid.spacing


def _shifted(array: np.ndarray, by: tuple[int, ...]) -> np.ndarray:
    return array[tuple(slice(step, n - 1 + step) for step, n in zip(by, array.shape, strict=True))]


def _with_triangles(
    grid: Grid,
    sheet: Sheets,
    surveyor: Surveyor,
    plain: Field,
    cells: Int[np.ndarray, "c"],
    bound: np.ndarray,
    blurred: np.ndarray,
) -> Field:
    shape = grid.size
    sharp = np.zeros(shape, dtype=bool)
    index = np.unravel_index(cells[blurred], shape)
    for corner in _CORNERS:
        sharp[tuple(i + c for i, c in zip(index, corner, strict=True))] = True
    mask = np.zeros(len(cells), dtype=np.int32)
    index = np.unravel_index(cells, shape)
    for bit, corner in enumerate(_CORNERS):
        mask |= (
            sharp[tuple(i + c for i, c in zip(index, corner, strict=True))].astype(np.int32) << bit
        )
    used = mask > 0
    cells, bound, mask = cells[used], bound[used], mask[used]
    first, count, triangle = sharp_neighbourhoods(grid, sheet, surveyor, cells, bound)
    chosen, local = np.unique(triangle, return_inverse=True)
    rows = np.concatenate(
        [np.zeros((1, 3), dtype=np.int64), np.column_stack([mask, first, count])]
    ).astype(np.int32)
    numbers = np.zeros(int(np.prod(shape)), dtype=np.int32)
    numbers[cells] = np.arange(1, len(cells) + 1)
    triangles = Triangles(
        _padded(numbers, 1 << 18),
        _padded(rows, 1 << 12),
        _padded(local.astype(np.int32), 1 << 14),
        _padded(patch_rows(sheet, chosen), 1 << 10),
    )
    return plain._replace(triangles=triangles)
