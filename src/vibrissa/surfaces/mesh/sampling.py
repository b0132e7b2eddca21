"""Levels of a grid's nodes by the mesh itself, and which triangles may be nearest in its cells."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.numerics.compiled import compiled
from vibrissa.surfaces.mesh.creases import Sheets
from vibrissa.surfaces.mesh.libraries import library
from vibrissa.surfaces.mesh.patches import Patch, nearest, refined_level

# Distance from the surface [spacings] up to which the sign is that of the smooth surface, not that
# of the triangles.
_NEAR = 1.5
# Points handed to compiled code at once.
_CHUNK = 1 << 15
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


class Grid(NamedTuple):
    """Nodes (i, j, k) at `origin` + `spacing` (i, j, k)."""

    origin: Float[np.ndarray, "3"]
    spacing: float
    size: tuple[int, int, int]

    def points(self, nodes: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
        """Places of nodes, given by their number."""
        return self.origin + self.spacing * np.column_stack(np.unravel_index(nodes, self.size))


def chunked(kernel: Callable[..., Array], *columns: np.ndarray) -> np.ndarray:
    """Apply a kernel to rows in chunks of one length, since each length compiles anew."""
    parts = [np.zeros(0)]
    for first in range(0, len(columns[0]), _CHUNK):
        rows = [column[first : first + _CHUNK] for column in columns]
        count = len(rows[0])
        filled = (np.concatenate([row, np.repeat(row[:1], _CHUNK - count, axis=0)]) for row in rows)
        parts.append(np.asarray(kernel(*filled))[:count])
    return np.concatenate(parts)


@compiled
def _squared_distances(
    points: Float[Array, "n 3"], triangles: Float[Array, "n 3 3"]
) -> Float[Array, "n"]:
    return jax.vmap(lambda point, corners: nearest(point, corners).squared)(points, triangles)


def _distances(
    points: Float[np.ndarray, "n 3"], triangles: Float[np.ndarray, "n 3 3"]
) -> Float[np.ndarray, "n"]:
    """Distances of points from flat triangles, one each."""
    return np.sqrt(chunked(_squared_distances, points, triangles))


class Surveyor:
    """Levels of points by the mesh itself, given a triangle near each."""

    def __init__(self, sheet: Sheets) -> None:
        # Rounded up, so that meshes of about the same size share compiled code.
        missing = (1 << (len(sheet.faces) - 1).bit_length()) - len(sheet.faces)
        self._patches, self._neighbours = jax.tree.map(
            lambda part: jnp.asarray(np.concatenate([part, np.repeat(part[:1], missing, axis=0)])),
            (sheet.patches, sheet.neighbours),
        )

    def levels(
        self, points: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        """Levels, seen from the triangle given or, across smooth edges, from the one whose normals
        point at the point.
        """
        return chunked(
            lambda p, t: _walked(p, t, self._patches, self._neighbours), points, triangles
        )


@compiled
def _walked(
    points: Float[Array, "n 3"],
    triangles: Int[Array, "n"],
    patches: Patch,
    neighbours: Int[Array, "k 3"],
) -> Float[Array, "n"]:
    State = tuple[Array, Array, Array, Array]

    def one(point: Float[Array, "3"], triangle: Int[Array, ""]) -> Float[Array, ""]:
        def unfinished(state: State) -> Array:
            return (state[0] >= 0) & (state[3] < _MOST_STEPS)

        def step(state: State) -> State:
            here, _, _, steps = state
            level, weights = refined_level(point, jax.tree.map(lambda part: part[here], patches))
            lowest = jnp.argmin(weights)
            beyond = weights[lowest] < _BEYOND
            return jnp.where(beyond, neighbours[here, lowest], -1), level, here, steps + 1

        start = (triangle, jnp.zeros(()), triangle, jnp.zeros((), dtype=int))
        return lax.while_loop(unfinished, step, start)[1]

    return jax.vmap(one)(points, triangles)


def node_levels(
    grid: Grid, sheet: Sheets, surveyor: Surveyor, reach: float
) -> Float[np.ndarray, "nodes"]:
    """Level of each node; away from the surface by more than `reach`, the distance from about the
    nearest triangle.
    """
    igl = library("igl")
    points = grid.points(np.arange(np.prod(grid.size)))
    level, triangle, _, _ = igl.signed_distance(
        points, sheet.vertices, sheet.faces, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL, -reach, reach
    )
    triangle = triangle.astype(np.int64)
    far = ~np.isfinite(level)
    seed = scipy.ndimage.distance_transform_edt(
        far.reshape(grid.size), return_distances=False, return_indices=True
    )
    seed = np.ravel_multi_index(tuple(seed), grid.size).ravel()[far]
    distance = _distances(points[far], sheet.vertices[sheet.faces[triangle[seed]]])
    level[far] = np.copysign(distance, level[seed])
    within = np.flatnonzero(~far)
    walked = surveyor.levels(points[within], triangle[within])
    outer = np.abs(level[within]) > _NEAR * grid.spacing
    level[within] = np.where(outer, np.copysign(walked, level[within]), walked)
    return level


def candidates(
    grid: Grid, sheet: Sheets, cells: Int[np.ndarray, "c"], squared: Float[np.ndarray, "c"]
) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
    """Cells and triangles that may be nearest to one of their points, in pairs by cell.

    A triangle can be nearest somewhere in a cell only if it is nearer to the cell's middle than the
    nearest one there (`squared`) and the cell's diagonal together; the same holds of each eighth of
    the cell.
    """
    middles = grid.points(cells) + grid.spacing / 2
    diagonal = np.sqrt(3) * grid.spacing * _WIDER
    bound = np.sqrt(squared) + diagonal
    vertices, faces, owner = library("trimesh.remesh").subdivide_to_size(
        sheet.vertices, sheet.faces, _LONGEST * grid.spacing, max_iter=64, return_index=True
    )
    corners, tree = vertices[faces], scipy.spatial.cKDTree(middles)
    center = corners.mean(axis=1)
    size = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1)
    pairs = []
    for first in range(0, len(faces), _PIECES):
        rows = slice(first, first + _PIECES)
        found = tree.query_ball_point(center[rows], size[rows] + bound.max())
        piece = first + np.repeat(np.arange(len(found)), [len(cells) for cells in found])
        cell = np.concatenate(found).astype(np.int64)
        near = np.linalg.norm(middles[cell] - center[piece], axis=1) <= size[piece] + bound[cell]
        piece, cell = piece[near], cell[near]
        close = _distances(middles[cell], corners[piece]) <= bound[cell]
        pairs.append(cell[close] * len(sheet.faces) + owner[piece[close]])
    cell, triangle = np.divmod(np.unique(np.concatenate(pairs)), len(sheet.faces))
    needed = np.zeros(len(cell), dtype=bool)
    starts = np.searchsorted(cell, np.arange(len(cells)))
    for corner in np.ndindex(2, 2, 2):
        eighth = middles + (np.array(corner) - 0.5) * grid.spacing / 2
        distance = _distances(eighth[cell], sheet.vertices[sheet.faces[triangle]])
        needed |= distance <= np.minimum.reduceat(distance, starts)[cell] + diagonal / 2
    return cell[needed], triangle[needed]
