"""Levels from the mesh itself, and which triangles may be nearest within cells of a grid."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import Array, lax
from jaxtyping import Float, Int, Shaped

from vibrissa.numerics.lanes import lanes
from vibrissa.numerics.progress import Guess
from vibrissa.surfaces.mesh.creases import Sheets
from vibrissa.surfaces.mesh.field import CORNERS
from vibrissa.surfaces.mesh.libraries import library
from vibrissa.surfaces.mesh.patches import Patch, nearest, refined_level, slopes

# Distance from the surface [spacings] up to which the sign is that of the smooth surface, not that
# of the triangles.
_NEAR = 1.5
# Longest edge [spacings] of the pieces that long triangles are cut into, so that their bounding
# spheres hold little else.
_LONGEST = 6.0
_PIECES = 1 << 11
# Most triangles that a walk over the mesh crosses: a grid cell spans a few.
_MOST_STEPS = 40
# Barycentric coordinate below which a point lies beyond an edge, not on it.
_BEYOND = -1e-9
_WIDER = 1 + 1e-9
"""Margin for rounding."""


class Grid(NamedTuple):
    """Nodes (i, j, k) at `origin` + `spacing` (i, j, k)."""

    origin: Float[np.ndarray, "3"]
    spacing: float
    size: tuple[int, int, int]

    def points(self, nodes: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
        """Positions of nodes, given by number."""
        return self.origin + self.spacing * np.column_stack(np.unravel_index(nodes, self.size))


def padded(rows: np.ndarray, least: int, factor: int = 4) -> Array:
    """Rows padded with zeros to `least`, or to that times a power of `factor`, so that meshes of
    about the same size share compiled code.
    """
    capacity = least
    while capacity < len(rows):
        capacity *= factor
    return jnp.asarray(np.pad(rows, [(0, capacity - len(rows)), *[(0, 0)] * (rows.ndim - 1)]))


def mesh_levels(
    sheet: Sheets, points: Float[np.ndarray, "n 3"], triangles: Shaped[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Levels at points, each seen from the triangle given for it or, across smooth edges, from the
    one whose normals point at it.
    """
    mesh = jax.tree.map(lambda rows: padded(rows, 1 << 10, 2), (sheet.patches, sheet.neighbours))
    return np.asarray(_walked(mesh, points, triangles))


@lanes(width=1, blocks=1 << 15)
def _walked(
    mesh: tuple[Patch, Int[Array, "f 3"]], point: Float[Array, "3"], triangle: Int[Array, ""]
) -> Float[Array, ""]:
    patches, neighbours = mesh
    State = tuple[Array, Array, Array]

    def unfinished(state: State) -> Array:
        return (state[0] >= 0) & (state[2] < _MOST_STEPS)

    def step(state: State) -> State:
        here, _, steps = state
        level, weights = refined_level(point, jax.tree.map(lambda part: part[here], patches))
        lowest = jnp.argmin(weights)
        across = jnp.where(weights[lowest] < _BEYOND, neighbours[here, lowest], -1)
        return across, level, steps + 1

    return lax.while_loop(unfinished, step, (triangle, jnp.zeros(()), jnp.array(0)))[1]


def node_levels(
    grid: Grid, sheet: Sheets, reach: float, steps: Guess
) -> Float[np.ndarray, "nodes"]:
    """Level at each node; farther than `reach` from the surface, the distance from roughly the
    nearest triangle.
    """
    igl = library("igl")
    points = grid.points(np.arange(np.prod(grid.size)))
    level, triangle, *_ = igl.signed_distance(
        points, sheet.vertices, sheet.faces, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL, -reach, reach
    )
    steps.step()
    far = ~np.isfinite(level)
    seed = scipy.ndimage.distance_transform_edt(
        far.reshape(grid.size), return_distances=False, return_indices=True
    )
    seed = np.ravel_multi_index(tuple(seed), grid.size).ravel()[far]
    corners = sheet.vertices[sheet.faces[triangle[seed]]]
    level[far] = np.copysign(_distances(corners, points[far, None])[:, 0], level[seed])
    steps.step()
    walked = mesh_levels(sheet, points[~far], triangle[~far])
    steps.step()
    outer = np.abs(level[~far]) > _NEAR * grid.spacing
    level[~far] = np.where(outer, np.copysign(walked, level[~far]), walked)
    return level


def candidates(
    grid: Grid, sheet: Sheets, cells: Int[np.ndarray, "c"], steps: Guess
) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
    """Pairs of a cell and a triangle that may be nearest to a point in it, sorted by cell.

    A triangle can be nearest somewhere in an eighth of a cell only if its distance from the
    eighth's middle is at most that of the nearest triangle there plus the eighth's diagonal.
    """
    middles = grid.points(cells) + grid.spacing / 2
    eighths = middles[:, None] + grid.spacing / 2 * (CORNERS - 0.5)
    squared = library("igl").point_mesh_squared_distance(
        eighths.reshape(-1, 3), sheet.vertices, sheet.faces
    )[0]
    diagonal = np.sqrt(3) / 2 * grid.spacing * _WIDER
    reach = np.sqrt(squared).reshape(-1, 8) + diagonal
    # From the middle of the cell.
    bound = reach.max(axis=1) + diagonal / 2
    vertices, faces, owner = library("trimesh.remesh").subdivide_to_size(
        sheet.vertices, sheet.faces, _LONGEST * grid.spacing, max_iter=64, return_index=True
    )
    corners, tree = vertices[faces], scipy.spatial.cKDTree(middles)
    center = corners.mean(axis=1)
    size = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1)
    pairs, parts = [], range(0, len(faces), _PIECES)
    steps.expect(len(parts))
    for first in parts:
        rows = slice(first, first + _PIECES)
        found = tree.query_ball_point(center[rows], size[rows] + bound.max())
        piece = first + np.repeat(np.arange(len(found)), [len(cells) for cells in found])
        cell = np.concatenate(found).astype(np.int64)
        near = np.linalg.norm(middles[cell] - center[piece], axis=1) <= size[piece] + bound[cell]
        piece, cell = piece[near], cell[near]
        distance = _distances(corners[piece], eighths[cell])
        close = (distance <= reach[cell]).any(axis=1)
        pairs.append(cell[close] * len(sheet.faces) + owner[piece[close]])
        steps.step()
    # Sorting integers takes a tenth of the time of `np.unique`, which hashes them.
    both = np.sort(np.concatenate(pairs))
    return np.divmod(both[np.diff(both, prepend=-1) > 0], len(sheet.faces))


def _distances(
    corners: Float[np.ndarray, "n 3 3"], points: Float[np.ndarray, "n k 3"]
) -> Float[np.ndarray, "n k"]:
    """Distances of points from flat triangles."""
    return np.sqrt(_squared(None, corners, slopes(corners), points))


@lanes(width=1, blocks=1 << 15)
def _squared(
    _: None, corners: Float[Array, "3 3"], slope: Float[Array, "3 3"], points: Float[Array, "k 3"]
) -> Float[Array, "k"]:
    return jax.vmap(lambda point: nearest(point, corners, slope).squared)(points)
