"""Nearest triangles of the nodes of a grid: rasterised near the surface, handed on from node to
node away from it.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt

from vibrissa.numerics.compiled import compiled
from vibrissa.surfaces.mesh.creases import Sheets, patch_rows
from vibrissa.surfaces.mesh.patches import nearest, refined_level, unpacked

NEAR = 1.5
"""Distance from the surface [spacings] up to which nodes find their triangle by looking at all."""

_CHUNK = 1 << 18
_LONGEST = 6.0
_MOST_STEPS = 40
_NEIGHBOURS = ((-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0), (0, 0, -1), (0, 0, 1))


class Grid(NamedTuple):
    """Nodes (i, j, k) at `origin` + `spacing` (i, j, k)."""

    origin: Float[np.ndarray, "3"]
    spacing: float
    size: tuple[int, int, int]

    def points(self, nodes: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n 3"]:
        """Places of nodes, given by their number."""
        return self.origin + self.spacing * np.column_stack(np.unravel_index(nodes, self.size))


class Pieces(NamedTuple):
    """Triangles, the long ones cut up, so that their boxes hold little but themselves."""

    corners: Float[np.ndarray, "p 3 3"]
    triangle: Int[np.ndarray, "p"]


def pieces(corners: Float[np.ndarray, "f 3 3"], longest: float) -> Pieces:
    """Halve triangles at their longest edge until none is longer."""
    done: list[Pieces] = []
    triangle = np.arange(len(corners))
    while len(corners):
        lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        small = lengths.max(axis=1) <= longest
        done.append(Pieces(corners[small], triangle[small]))
        corners, triangle = corners[~small], triangle[~small]
        first = np.argmax(lengths[~small], axis=1)
        row = np.arange(len(corners))
        a, b, c = (corners[row, (first + k) % 3] for k in range(3))
        middle = (a + b) / 2
        corners = np.concatenate(
            [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        )
        triangle = np.concatenate([triangle, triangle])
    return Pieces(
        np.concatenate([part.corners for part in done]),
        np.concatenate([part.triangle for part in done]),
    )


def boxes(
    grid: Grid, cut: Pieces, reach: float
) -> tuple[Int[np.ndarray, "p 3"], Int[np.ndarray, "p 3"]]:
    """First node and number of nodes of each piece's box, grown by `reach`."""
    low = np.ceil((cut.corners.min(axis=1) - reach - grid.origin) / grid.spacing).astype(np.int64)
    high = np.floor((cut.corners.max(axis=1) + reach - grid.origin) / grid.spacing).astype(np.int64)
    low, high = np.maximum(low, 0), np.minimum(high, np.array(grid.size) - 1)
    return low, np.maximum(high - low + 1, 0)


def pairs(
    grid: Grid, low: Int[np.ndarray, "p 3"], count: Int[np.ndarray, "p 3"]
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pieces and the nodes in their boxes, in chunks."""
    total = count.prod(axis=1)
    ends = np.cumsum(total)
    first = 0
    while first < len(total):
        done = ends[first - 1] if first else 0
        last = max(int(np.searchsorted(ends, done + _CHUNK, side="right")), first + 1)
        size = total[first:last]
        piece = np.repeat(np.arange(first, last), size)
        local = np.arange(len(piece)) - np.repeat(np.cumsum(size) - size, size)
        ny, nz = count[piece, 1], count[piece, 2]
        i, rest = np.divmod(local, ny * nz)
        j, k = np.divmod(rest, nz)
        node = (
            ((low[piece, 0] + i) * grid.size[1] + low[piece, 1] + j) * grid.size[2]
            + low[piece, 2]
            + k
        )
        if len(piece):
            yield piece, node
        first = last


@compiled
def _squared(
    points: Float[Array, "n 3"], triangles: Int[Array, "n"], corners: Float[Array, "k 3 3"]
) -> Float[Array, "n"]:
    return jax.vmap(lambda point, triangle: nearest(point, corners[triangle]).squared)(
        points, triangles
    )


def squared_distances(
    points: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "n"],
    corners: Float[Array, "k 3 3"],
) -> Float[np.ndarray, "n"]:
    """Squared distances of points from triangles, one each."""
    return chunked(lambda p, t: _squared(p, t, corners), points, triangles)


def chunked(kernel: Callable[..., Array], *columns: np.ndarray) -> np.ndarray:
    """Apply a kernel to rows in chunks of few different lengths, since each compiles anew."""
    count, parts, first = len(columns[0]), [], 0
    while first < count:
        left = count - first
        size = next((s for s in (1 << 12, 1 << 15) if s >= left), _CHUNK)
        rows = [part[first : first + size] for part in columns]
        missing = size - len(rows[0])
        filled = [
            np.concatenate([row, np.repeat(row[-1:], missing, axis=0)]) if missing else row
            for row in rows
        ]
        parts.append(np.asarray(kernel(*filled))[: min(left, size)])
        first += size
    return np.concatenate(parts) if parts else np.zeros(0)


class Tracked(NamedTuple):
    """What is known of each node."""

    triangle: Int[np.ndarray, "nodes"]
    level: Float[np.ndarray, "nodes"]


class Surveyor:
    """Levels of points by the mesh itself, given a triangle near each."""

    def __init__(self, sheet: Sheets) -> None:
        count = 1 << (len(sheet.faces) - 1).bit_length()
        rows = patch_rows(sheet, np.arange(len(sheet.faces)))
        neighbours = np.where(sheet.creases == 0, sheet.neighbours, -1)
        # Rounded up, so that meshes of about the same size share compiled code.
        self._rows = jnp.asarray(
            np.concatenate([rows, np.repeat(rows[:1], count - len(rows), axis=0)])
        )
        self._neighbours = jnp.asarray(
            np.concatenate([neighbours, np.full((count - len(rows), 3), -1)])
        )
        corners = self._rows[:, :9].reshape(-1, 3, 3)
        self.corners = corners

    def squared(
        self, points: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        """Squared distances from the flat triangles."""
        return squared_distances(points, triangles, self.corners)

    def levels(
        self, points: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "n"]
    ) -> Float[np.ndarray, "n"]:
        """Levels, seen from the triangle given or, across smooth edges, from the one whose normals
        point at the point.
        """
        return chunked(lambda p, t: _walked(p, t, self._rows, self._neighbours), points, triangles)


@compiled
def _walked(
    points: Float[Array, "n 3"],
    triangles: Int[Array, "n"],
    rows: Float[Array, "k 60"],
    neighbours: Int[Array, "k 3"],
) -> Float[Array, "n"]:
    def one(point: Float[Array, "3"], triangle: Int[Array, ""]) -> Float[Array, ""]:
        def unfinished(state: tuple[Array, Array, Array, Array]) -> Array:
            return state[2] & (state[3] < _MOST_STEPS)

        def step(state: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
            here, _, _, steps = state
            level, weights = refined_level(point, unpacked(rows[here]))
            lowest = jnp.argmin(weights)
            following = neighbours[here, lowest]
            moving = (weights[lowest] < -1e-9) & (following >= 0)
            return jnp.where(moving, following, here), level, moving, steps + 1

        start = (triangle, jnp.zeros(()), jnp.asarray(True), jnp.zeros((), dtype=int))  # noqa: FBT003
        return lax.while_loop(unfinished, step, start)[1]

    return jax.vmap(one)(points, triangles)


def track(grid: Grid, sheet: Sheets, surveyor: Surveyor, reach: float) -> Tracked:
    """Nearest triangle and level of each node; away from the surface by more than `reach`, the
    level is the distance from about the nearest triangle.
    """
    nodes = int(np.prod(grid.size))
    squared, triangle = np.full(nodes, np.inf), np.full(nodes, -1, dtype=np.int64)
    corners = sheet.vertices[sheet.faces]
    cut = pieces(corners, _LONGEST * grid.spacing)
    cut_corners = _rounded_up(cut.corners)
    for piece, node in pairs(grid, *boxes(grid, cut, NEAR * grid.spacing)):
        found = chunked(lambda p, t: _squared(p, t, cut_corners), grid.points(node), piece)
        np.minimum.at(squared, node, found)
        won = found <= squared[node]
        triangle[node[won]] = cut.triangle[piece[won]]
    near = squared <= (NEAR * grid.spacing) ** 2
    seed = distance_transform_edt(
        ~near.reshape(grid.size), return_distances=False, return_indices=True
    )
    seed = np.ravel_multi_index(tuple(seed), grid.size).ravel()
    far = np.flatnonzero(~near)
    triangle[far] = triangle[seed[far]]
    squared[far] = surveyor.squared(grid.points(far), triangle[far])
    for _ in range(2):
        _hand_on(grid, surveyor, squared, triangle, np.flatnonzero(squared <= reach**2))
    level = np.sqrt(squared)
    near_nodes = np.flatnonzero(near)
    level[near_nodes] = surveyor.levels(grid.points(near_nodes), triangle[near_nodes])
    inside = level[seed] < 0
    between = np.flatnonzero(~near & (squared <= reach**2))
    level[between] = np.abs(surveyor.levels(grid.points(between), triangle[between]))
    level[far] = np.where(inside[far], -level[far], level[far])
    return Tracked(triangle, level)


def _hand_on(
    grid: Grid,
    surveyor: Surveyor,
    squared: Float[np.ndarray, "nodes"],
    triangle: Int[np.ndarray, "nodes"],
    nodes: Int[np.ndarray, "n"],
) -> None:
    """Let nodes take over the triangle of a neighbour that is nearer."""
    index = np.column_stack(np.unravel_index(nodes, grid.size))
    points = grid.points(nodes)
    before = triangle.copy()
    for step in _NEIGHBOURS:
        beside = np.ravel_multi_index(
            tuple(np.clip(index + step, 0, np.array(grid.size) - 1).T), grid.size
        )
        other = np.flatnonzero(before[beside] != triangle[nodes])
        found = surveyor.squared(points[other], before[beside[other]])
        closer = found < squared[nodes[other]]
        changed = nodes[other[closer]]
        squared[changed], triangle[changed] = found[closer], before[beside[other[closer]]]


def _rounded_up(corners: Float[np.ndarray, "p 3 3"]) -> Float[Array, "k 3 3"]:
    count = 1 << (len(corners) - 1).bit_length()
    return jnp.asarray(
        np.concatenate([corners, np.repeat(corners[:1], count - len(corners), axis=0)])
    )


def sharp_neighbourhoods(
    grid: Grid,
    sheet: Sheets,
    surveyor: Surveyor,
    cells: Int[np.ndarray, "c"],
    bound: Float[np.ndarray, "c"],
) -> tuple[Int[np.ndarray, "c"], Int[np.ndarray, "c"], Int[np.ndarray, "entries"]]:
    """Triangles that may be nearest to a point of each cell: first entry and number of entries for
    each, and the entries.

    A triangle can be nearest somewhere in a cell only if it is nearer to the cell's middle than the
    nearest one there (`bound`) and the cell's diagonal together; the same holds of each eighth of
    the cell.
    """
    half = np.sqrt(3) / 2 * grid.spacing
    allowed = np.full(int(np.prod(grid.size)), -1.0)
    allowed[cells] = bound + 2 * half * (1 + 1e-9)
    # Cells as nodes of a grid of their middles.
    middles = Grid(grid.origin + grid.spacing / 2, grid.spacing, grid.size)
    wanted = _box_counts((allowed >= 0).reshape(grid.size))
    cut = pieces(sheet.vertices[sheet.faces], _LONGEST * grid.spacing)
    cut_corners = _rounded_up(cut.corners)
    low, count = boxes(middles, cut, float(allowed.max()))
    high = low + count
    held = wanted(low, high)
    keep = (held > 0) & (count.prod(axis=1) > 0)
    order = np.flatnonzero(keep)
    owner, triangle = [], []
    for piece, node in pairs(middles, low[order], count[order]):
        chosen = allowed[node] >= 0
        piece, node = order[piece[chosen]], node[chosen]  # noqa: PLW2901
        found = chunked(lambda p, t: _squared(p, t, cut_corners), middles.points(node), piece)
        close = found <= allowed[node] ** 2
        owner.append(node[close])
        triangle.append(cut.triangle[piece[close]])
    faces = len(sheet.faces)
    both = np.unique(np.concatenate(owner) * faces + np.concatenate(triangle))
    owner_all, triangle_all = both // faces, both % faces
    needed = _needed_in_eighths(middles, surveyor, owner_all, triangle_all, half)
    owner_all, triangle_all = owner_all[needed], triangle_all[needed]
    first = np.searchsorted(owner_all, cells)
    return first, np.searchsorted(owner_all, cells, side="right") - first, triangle_all


def _needed_in_eighths(
    middles: Grid,
    surveyor: Surveyor,
    owner: Int[np.ndarray, "n"],
    triangle: Int[np.ndarray, "n"],
    half: float,
) -> Bool[np.ndarray, "n"]:
    points = middles.points(owner)
    needed = np.zeros(len(owner), dtype=bool)
    starts = np.flatnonzero(np.r_[True, owner[1:] != owner[:-1]])
    group = np.cumsum(np.r_[False, owner[1:] != owner[:-1]])
    for corner in np.ndindex(2, 2, 2):
        shift = (np.array(corner) - 0.5) * middles.spacing / 2
        found = np.sqrt(surveyor.squared(points + shift, triangle))
        needed |= found <= np.minimum.reduceat(found, starts)[group] + half * (1 + 1e-9)
    return needed


def _box_counts(
    marked: Bool[np.ndarray, "nx ny nz"],
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Number of marked nodes in boxes from `low` up to, without, `high`."""
    total = np.zeros(tuple(n + 1 for n in marked.shape), dtype=np.int64)
    total[1:, 1:, 1:] = marked.cumsum(0).cumsum(1).cumsum(2)

    def count(low: Int[np.ndarray, "p 3"], high: Int[np.ndarray, "p 3"]) -> Int[np.ndarray, "p"]:
        found = np.zeros(len(low), dtype=np.int64)
        for corner in np.ndindex(2, 2, 2):
            index = [np.where(side, high[:, a], low[:, a]) for a, side in enumerate(corner)]
            index = [np.clip(part, 0, marked.shape[a]) for a, part in enumerate(index)]
            found += (-1) ** (3 - sum(corner)) * total[tuple(index)]
        return found

    return count
