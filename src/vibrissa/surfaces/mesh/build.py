"""From the sheets of a mesh to the arrays of its level."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Int
from scipy.ndimage import correlate1d, distance_transform_edt
from scipy.spatial import cKDTree

from vibrissa.numerics.lanes import lanes
from vibrissa.surfaces.mesh.creases import Sheets
from vibrissa.surfaces.mesh.field import Field, Triangles, field_level
from vibrissa.surfaces.mesh.libraries import library
from vibrissa.surfaces.mesh.patches import Patch, nearest, refined_level

# Nodes beyond the reach: the spline takes one more on either side, the quasi-interpolation another.
_MARGIN = 5
# A node takes 8 bytes and about 5 µs to build; benchmarks/mesh_convergence.py shows what a finer
# grid gains.
_MANY_NODES, _MOST_NODES = 1 << 20, 1 << 22
_FINE = 0.6
_FEWEST = 48
# Reach [spacings] that the spline's support needs at least, and how far nodes are wanted beyond it.
_BAND, _STENCIL = 2.5, 5.0
# Distance from the surface [spacings] up to which the sign is that of the smooth surface, not that
# of the triangles.
_NEAR = 1.5
# Share of the chordal error that the spline may blur, and of the spacing where that is zero.
_BLUR, _ROUNDING = 0.05, 1e-9
# Longest edge [spacings] of the pieces that long triangles are cut into, so that spheres about them
# hold little else.
_LONGEST = 6.0
_PIECES = 1 << 11
# Triangles that a walk over the mesh crosses at most: a grid cell spans a few.
_MOST_STEPS = 40
# Barycentric coordinate below which a point lies beyond an edge, not on it.
_BEYOND = -1e-9
_WIDER = 1 + 1e-9
"""For rounding."""
_CORNERS = np.array(list(np.ndindex(2, 2, 2)))


class Grid(NamedTuple):
    """Nodes (i, j, k) at `origin` + `spacing` (i, j, k)."""

    origin: Float[np.ndarray, "3"]
    spacing: float
    size: tuple[int, int, int]

    def points(self, nodes: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
        """Places of nodes, given by their number."""
        return self.origin + self.spacing * np.column_stack(np.unravel_index(nodes, self.size))


def build(sheet: Sheets, reach: float) -> Field:
    """Sample the mesh on a grid; keep its triangles where the spline errs by more than a twentieth
    of their chordal error within `reach` of the surface.
    """
    grid = _grid(sheet, reach)
    reach = max(reach, _BAND * grid.spacing)
    level = _node_levels(grid, sheet, reach + _STENCIL * grid.spacing)
    coefficients = level
    for axis in range(3):
        # Quasi-interpolation: exact for cubics, and what happens at a crease stays within two nodes
        # of it.
        coefficients = correlate1d(coefficients, np.array([-1, 8, -1]) / 6, axis, mode="nearest")
    plain = Field(
        jnp.asarray(grid.origin),
        jnp.asarray(grid.spacing),
        jnp.asarray(grid.size),
        _padded(coefficients.ravel(), 1 << 18),
        None,
    )
    # A cell within reach has its lowest corner within reach and a diagonal.
    inner = np.zeros(grid.size, dtype=bool)
    within = (slice(1, -2),) * 3
    inner[within] = np.abs(level[within]) <= reach + 2 * grid.spacing
    cells = np.flatnonzero(inner)
    middles = grid.points(cells) + grid.spacing / 2
    squared, triangle, _ = library("igl").point_mesh_squared_distance(
        middles, sheet.vertices, sheet.faces
    )
    near = np.sqrt(squared) <= reach + np.sqrt(3) / 2 * grid.spacing
    cells, middles, triangle = cells[near], middles[near], triangle[near]
    error = np.abs(_levels(plain, middles) - levels_by_triangles(sheet, middles, triangle))
    # A share of the largest chordal error about the triangle.
    at_fan = np.zeros(sheet.fans.max() + 1)
    np.maximum.at(at_fan, sheet.fans, sheet.sag()[:, None])
    allowed = _BLUR * at_fan[sheet.fans].max(axis=1) + _ROUNDING * grid.spacing
    blurred = error > allowed[triangle]
    if not blurred.any():
        return plain
    return plain._replace(triangles=_triangles(grid, sheet, cells, np.sqrt(squared[near]), blurred))


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


def _node_levels(grid: Grid, sheet: Sheets, reach: float) -> Float[np.ndarray, "i j k"]:
    """Level of each node; away from the surface by more than `reach`, the distance from about the
    nearest triangle.
    """
    igl = library("igl")
    points = grid.points(np.arange(np.prod(grid.size)))
    level, triangle, _, _ = igl.signed_distance(
        points, sheet.vertices, sheet.faces, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL, -reach, reach
    )
    far = ~np.isfinite(level)
    seed = distance_transform_edt(
        far.reshape(grid.size), return_distances=False, return_indices=True
    )
    seed = np.ravel_multi_index(tuple(seed), grid.size).ravel()[far]
    distance = _distances(points[far], sheet.vertices[sheet.faces[triangle[seed]]])
    level[far] = np.copysign(distance, level[seed])
    exact = levels_by_triangles(sheet, points[~far], triangle[~far])
    outer = np.abs(level[~far]) > _NEAR * grid.spacing
    level[~far] = np.where(outer, np.copysign(exact, level[~far]), exact)
    return level.reshape(grid.size)


def levels_by_triangles(
    sheet: Sheets, points: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Levels by the mesh itself, given a triangle near each point: seen from that one or, across
    smooth edges, from the one whose normals point at the point.
    """
    # Rounded up, so that meshes of about the same size share compiled code.
    missing = (1 << (len(sheet.faces) - 1).bit_length()) - len(sheet.faces)
    mesh = jax.tree.map(
        lambda part: jnp.asarray(np.concatenate([part, np.repeat(part[:1], missing, axis=0)])),
        (sheet.patches, sheet.neighbours),
    )
    return np.asarray(_walked(mesh, points, triangles))


@lanes(blocks=256)
def _walked(
    mesh: tuple[Patch, Int[Array, "k 3"]], point: Float[Array, "3"], triangle: Int[Array, ""]
) -> Float[Array, ""]:
    patches, neighbours = mesh

    def step(state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        here, _, steps = state
        level, weights = refined_level(point, jax.tree.map(lambda part: part[here], patches))
        lowest = jnp.argmin(weights)
        beyond = weights[lowest] < _BEYOND
        return jnp.where(beyond, neighbours[here, lowest], -1), level, steps + 1

    return lax.while_loop(
        lambda state: (state[0] >= 0) & (state[2] < _MOST_STEPS),
        step,
        (triangle.astype(int), jnp.zeros(()), jnp.zeros((), dtype=int)),
    )[1]


@lanes(blocks=256)
def _squared(_: None, point: Float[Array, "3"], corners: Float[Array, "3 3"]) -> Float[Array, ""]:
    return nearest(point, corners).squared


def _distances(
    points: Float[np.ndarray, "n 3"], triangles: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n"]:
    """Distances of points from flat triangles, one each."""
    return np.sqrt(_squared(None, points, triangles))


_levels = lanes(blocks=256)(field_level)


def _triangles(
    grid: Grid,
    sheet: Sheets,
    cells: Int[np.ndarray, "c"],
    distance: Float[np.ndarray, "c"],
    blurred: Bool[np.ndarray, "c"],
) -> Triangles:
    """Triangles of the cells with a sharp corner, one that a blurred cell has; `distance` is that
    of a cell's middle from the mesh.
    """
    nodes = int(np.prod(grid.size))
    corners = cells[:, None] + np.ravel_multi_index(_CORNERS.T, grid.size)
    sharp = np.zeros(nodes, dtype=bool)
    sharp[corners[blurred]] = True
    marks = sharp[corners] @ (1 << np.arange(8))
    used = marks > 0
    row, triangle = _candidates(grid, sheet, cells[used], distance[used])
    chosen, local = np.unique(triangle, return_inverse=True)
    rows = np.zeros(nodes)
    rows[cells[used]] = np.arange(1, used.sum() + 1)
    whole = partial(_padded, dtype=np.int32)
    # The first row is that of all other cells.
    return Triangles(
        whole(rows, 1 << 18),
        whole(np.append(0, marks[used]), 1 << 12),
        whole(np.append([0, 0], np.cumsum(np.bincount(row))), 1 << 12),
        whole(local, 1 << 14),
        jax.tree.map(lambda part: _padded(part[chosen], 1 << 10), sheet.patches),
    )


def _candidates(
    grid: Grid, sheet: Sheets, cells: Int[np.ndarray, "c"], distance: Float[np.ndarray, "c"]
) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
    """Cells, by their index, and triangles that may be nearest to one of their points, in pairs by
    cell.

    A triangle can be nearest somewhere in an eighth of a cell only if it is nearer to the eighth's
    middle than the nearest one there and the eighth's diagonal together.
    """
    middles = (grid.points(cells)[:, None] + grid.spacing * (_CORNERS / 2 + 0.25)).reshape(-1, 3)
    diagonal = np.sqrt(3) / 2 * grid.spacing * _WIDER
    # The middle of a cell is half of that away.
    bound = np.repeat(distance + 1.5 * diagonal, 8)
    vertices, faces, owner = library("trimesh.remesh").subdivide_to_size(
        sheet.vertices, sheet.faces, _LONGEST * grid.spacing, max_iter=64, return_index=True
    )
    corners, tree = vertices[faces], cKDTree(middles)
    center = corners.mean(axis=1)
    size = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1)
    found = []
    for first in range(0, len(faces), _PIECES):
        rows = slice(first, first + _PIECES)
        around = tree.query_ball_point(center[rows], size[rows] + bound.max())
        piece = first + np.repeat(np.arange(len(around)), [len(eighths) for eighths in around])
        eighth = np.concatenate(around).astype(np.int64)
        near = (
            np.linalg.norm(middles[eighth] - center[piece], axis=1) <= size[piece] + bound[eighth]
        )
        piece, eighth = piece[near], eighth[near]
        found.append((eighth, owner[piece], _distances(middles[eighth], corners[piece])))
    eighth, triangle, apart = map(np.concatenate, zip(*found, strict=True))
    least = np.full(len(middles), np.inf)
    np.minimum.at(least, eighth, apart)
    close = apart <= least[eighth] + diagonal
    pairs = np.unique(eighth[close] // 8 * len(sheet.faces) + triangle[close])
    return np.divmod(pairs, len(sheet.faces))


def _padded(rows: np.ndarray, least: int, dtype: type = np.float64) -> Array:
    """Rows and zeros: a quarter, 1, 4, 16 … times as many as `least`."""
    capacity = least
    while capacity < len(rows):
        capacity *= 4
    whole = np.zeros((capacity, *rows.shape[1:]), dtype)
    whole[: len(rows)] = rows
    return jnp.asarray(whole)
