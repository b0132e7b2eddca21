"""Triangles of a level function's zero, by marching cubes in the cells near it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from vibrissa.libraries import extra_library
from vibrissa.shape.level import Level
from vibrissa.shape.occupancy import lattice_points

_library = partial(extra_library, extra="mesh", need="meshes of shapes need it")
_COARSE = 4
"""Cells to an edge of those that are looked at first."""
_STEEPEST = 3.0
"""Largest gradient of a level between contacts: it may exceed a distance's where contacts disagree.
With 1.6, closed meshes of a sharp block had holes.
"""
_MARGIN, _WIDER, _WIDEST = 0.12, 0.35, 3
"""Free space around the contacts, relative to the extent, by how much the box grows where the
surface leaves it, and how often.
"""
_AROUND = 3.0
"""Spacings of a lattice from the surface within which its values are distances, not only levels."""
_MOST = 50_000_000
"""Nodes of a lattice: half a gigabyte of values."""


@dataclass(frozen=True, eq=False)
class ShapeMesh:
    """Triangles of a fitted surface.

    Attributes
    ----------
    vertices, faces
        (v, 3) places, and (f, 3) corners of triangles, counterclockwise seen from outside.
    normal
        (v, 3) outward unit normals, from the level's gradient.
    deviation
        (v,) standard deviation of the surface there.
    seen
        (v,) whether contacts, or rods that missed, say where it is.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normal: Float[np.ndarray, "v 3"]
    deviation: Float[np.ndarray, "v"]
    seen: Bool[np.ndarray, "v"]

    def __repr__(self) -> str:
        """Return one line."""
        share = self.seen.mean() if len(self.seen) else 0.0
        return (
            f"ShapeMesh: {len(self.vertices)} vertices, {len(self.faces)} faces, "
            f"{100 * share:.0f} % of the vertices seen"
        )

    def part(self, faces: Bool[np.ndarray, "f"]) -> "ShapeMesh":
        """Some of the triangles, and the vertices they need."""
        kept, corners = np.unique(self.faces[faces], return_inverse=True)
        return ShapeMesh(
            self.vertices[kept],
            corners.reshape(-1, 3),
            self.normal[kept],
            self.deviation[kept],
            self.seen[kept],
        )

    def seen_part(self) -> "ShapeMesh":
        """Triangles all of whose corners are seen."""
        return self.part(self.seen[self.faces].all(axis=1))

    def to_trimesh(self) -> Any:
        """The same as `trimesh.Trimesh`, with `deviation` and `seen` as vertex attributes."""
        trimesh = _library("trimesh")
        return trimesh.Trimesh(
            self.vertices,
            self.faces,
            vertex_normals=self.normal,
            vertex_attributes={"deviation": self.deviation, "seen": self.seen},
            process=False,
        )


def box_of(
    level: Level, contacts: Float[np.ndarray, "n 3"], step: float, extent: float
) -> tuple[Float[np.ndarray, "3"], Int[np.ndarray, "3"]]:
    """Lowest corner and numbers of nodes of a lattice that holds the surface, if any not much
    larger than the contacts' box does.

    Raises
    ------
    ValueError
        If the lattice would have too many nodes.
    """
    low, high = contacts.min(axis=0), contacts.max(axis=0)
    low, high = low - _MARGIN * extent, high + _MARGIN * extent
    for _ in range(_WIDEST):
        leaves = [
            np.any(level.values(_face(low, high, axis, end)) <= 0)
            for axis in range(3)
            for end in (low, high)
        ]
        if not any(leaves):
            break
        out = np.reshape(leaves, (3, 2))
        low, high = low - _WIDER * extent * out[:, 0], high + _WIDER * extent * out[:, 1]
    counts = np.ceil((high - low) / (_COARSE * step)).astype(int) * _COARSE + 1
    if np.prod(counts.astype(float)) > _MOST:
        raise ValueError(
            f"resolution = {step:.3g}: {' x '.join(map(str, counts))} cells; allowed are "
            f"{_MOST} in all"
        )
    return low, counts


def _face(low: np.ndarray, high: np.ndarray, axis: int, end: np.ndarray) -> np.ndarray:
    """Points of a face of a box."""
    sides = [np.linspace(low[i], high[i], 12) for i in range(3)]
    sides[axis] = end[axis : axis + 1]
    return np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)


def lattice_of(
    level: Level, contacts: Float[np.ndarray, "n 3"], step: float, extent: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "x y z"]]:
    """Lowest corner and distances, far from the surface only levels, at the nodes of a lattice."""
    low, counts = box_of(level, contacts, step, extent)
    points = lattice_points(low, step, counts)
    return low, level.distances(points, _AROUND * step, extent).reshape(counts)


def extracted(
    level: Level,
    contacts: Float[np.ndarray, "n 3"],
    step: float,
    extent: float,
    deviations: Callable[[np.ndarray], np.ndarray],
    known: float,
    within: float,
) -> ShapeMesh:
    """The zero of a level function, at least within some distance of contacts, cut into triangles,
    its vertices moved onto it; parts that are not the closest to any contact are not seen.
    """
    low, counts = box_of(level, contacts, step, extent)
    cells = _near(level, low, counts, step, contacts, within)
    corners = cells[:, None] + _CORNERS
    nodes, index = np.unique(corners.reshape(-1, 3) @ _strides(counts), return_inverse=True)
    places = low + step * np.stack(np.unravel_index(nodes, counts), axis=-1)
    values = level.values(places)
    vertices, faces, _ = _library("igl").marching_cubes(values, places, index.reshape(-1, 8), 0.0)
    if not len(faces):
        return ShapeMesh(
            np.zeros((0, 3)),
            np.zeros((0, 3), dtype=np.int64),
            np.zeros((0, 3)),
            np.zeros(0),
            np.zeros(0, dtype=bool),
        )
    feet = level.feet(vertices, extent)
    vertices, normal = feet.place, feet.normal
    faces = _outwards(vertices, faces.astype(np.int64), normal)
    deviation = deviations(vertices)
    touched = _touched(vertices, faces, contacts)
    return ShapeMesh(vertices, faces, normal, deviation, (deviation <= known) & touched)


_CORNERS = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]]
)
"""Of a cell, in the order that marching cubes expects."""


def _strides(counts: Int[np.ndarray, "3"]) -> Int[np.ndarray, "3"]:
    """How a node's number follows from its place in the lattice."""
    return np.array([counts[1] * counts[2], counts[2], 1])


def _near(
    level: Level,
    low: Float[np.ndarray, "3"],
    counts: Int[np.ndarray, "3"],
    step: float,
    contacts: Float[np.ndarray, "n 3"],
    within: float,
) -> Int[np.ndarray, "cells 3"]:
    """Cells within some distance of contacts that the zero may cross: those of larger cells at
    whose middle the level is small.
    """
    ranges = [np.arange(0, n - 1, _COARSE) for n in counts]
    cells = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 3)
    size = _COARSE
    apart, _ = KDTree(contacts).query(low + step * (cells + 0.5 * size))
    cells = cells[apart <= within + 0.5 * np.sqrt(3) * size * step]
    while size > 1:
        reach = _STEEPEST * 0.5 * np.sqrt(3) * size * step
        cells = cells[np.abs(level.values(low + step * (cells + 0.5 * size))) < reach]
        size //= 2
        cells = (cells[:, None] + size * _CORNERS).reshape(-1, 3)
    return cells


def _outwards(vertices: np.ndarray, faces: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Triangles counterclockwise seen from where the level is positive."""
    first, second, third = (vertices[faces[:, i]] for i in range(3))
    facing = np.cross(second - first, third - first)
    wrong = np.einsum("ni,ni->n", facing, normal[faces].mean(axis=1)) < 0
    return np.where(wrong.mean() > 0.5, faces[:, ::-1], faces)


def _touched(
    vertices: np.ndarray, faces: np.ndarray, contacts: np.ndarray
) -> Bool[np.ndarray, "v"]:
    """Vertices of connected parts that are the closest to a contact: a void in a solid is not."""
    from scipy.sparse import coo_array  # noqa: PLC0415
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(len(vertices),) * 2)
    count, label = connected_components(edges, directed=False)
    closest = label[KDTree(vertices).query(contacts)[1]]
    return np.bincount(closest, minlength=count)[label] > 0
