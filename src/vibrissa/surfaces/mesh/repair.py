"""What may be wrong with a mesh: mended where there is no doubt how, an error that counts the
defects otherwise.
"""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Int
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array
from vibrissa.surfaces.mesh.libraries import Faces, Vertices, library

MOST_HOLE_EDGES = 8
"""Longest rim of a hole that is closed: larger ones are open meshes rather than lost triangles."""

# Of the diagonal, and of the longest side squared. Single precision, as in STL, rounds at 6e-8:
# what is closer than this was one point when it was written.
_SAME, _FLAT = 1e-9, 1e-9
# Flat triangles side by side are flipped one after the other: as many as lie along one edge.
_MOST_PASSES = 64


@dataclass(frozen=True)
class Repairs:
    """What was mended in a mesh, each a count; falsy where nothing was.

    Attributes
    ----------
    merged_vertices
        Vertices merged with another within 1e-9 of the diagonal.
    unreferenced_vertices
        Vertices of no triangle, dropped.
    degenerate_faces
        Triangles without area: dropped, or their long edge flipped.
    duplicate_faces
        Triangles on the same three vertices as another, dropped.
    flipped_faces
        Triangles reversed so that all are wound alike, and outwards.
    filled_holes
        Holes of at most 8 edges, closed with triangles about their middle.
    """

    merged_vertices: int = 0
    unreferenced_vertices: int = 0
    degenerate_faces: int = 0
    duplicate_faces: int = 0
    flipped_faces: int = 0
    filled_holes: int = 0

    def __bool__(self) -> bool:
        """Whether anything was mended."""
        return self != Repairs()

    def __str__(self) -> str:
        """Counts that are not zero, in words."""
        counts = {field.name.replace("_", " "): getattr(self, field.name) for field in fields(self)}
        return ", ".join(f"{count} {name}" for name, count in counts.items() if count) or "nothing"


def mended(vertices: ArrayLike, faces: ArrayLike) -> tuple[Vertices, Faces, Repairs]:
    """Vertices and faces of a closed mesh that is wound outwards, and what it took.

    Raises
    ------
    ValueError
        If there are no faces, indices out of range, vertices that are not finite, or defects that
        cannot be mended; their text counts each kind.
    ImportError
        If libigl is not installed.
    """
    v, given = _checked(vertices, faces)
    # Each corner on the first of all vertices at about the same place.
    place = np.round((v - v.min(axis=0)) / (_SAME * np.linalg.norm(np.ptp(v, axis=0)) or 1.0))
    _, first, same = np.unique(place, axis=0, return_index=True, return_inverse=True)
    f = first[same][given]
    merged = len(np.unique(given)) - len(np.unique(f))
    proper = f[(f != np.roll(f, 1, axis=1)).all(axis=1)]
    if not len(proper):
        raise ValueError(f"faces: all {len(f)} are degenerate; allowed is a closed mesh")
    distinct = np.unique(np.sort(proper, axis=1), axis=0, return_index=True)[1]
    f = proper[np.sort(distinct)]
    wound = np.asarray(library("igl").bfs_orient(f)[0], dtype=np.int64)
    turned = (wound != f).any(axis=1)
    v, f, filled = _filled(v, wound)
    _refuse_open(f)
    f, flat = _without_flat(v, f)
    reverse = _inside_out(v, f)
    flipped = np.sum(np.append(turned, np.zeros(len(f) - len(turned), dtype=bool)) ^ reverse)
    f = np.where(reverse[:, None], f[:, ::-1], f)
    found, crossing, _ = library("igl.predicates").find_self_intersections(v, f)
    if found:
        raise ValueError(
            f"mesh: {len(crossing)} pairs of triangles cross each other; allowed is a surface that "
            "does not intersect itself"
        )
    kept, f = np.unique(f, return_inverse=True)
    repairs = Repairs(
        merged_vertices=merged,
        unreferenced_vertices=len(v) - merged - len(kept),
        degenerate_faces=len(given) - len(proper) + flat,
        duplicate_faces=len(proper) - len(distinct),
        flipped_faces=int(flipped),
        filled_holes=filled,
    )
    return v[kept], f, repairs


def _checked(vertices: ArrayLike, faces: ArrayLike) -> tuple[Vertices, Faces]:
    v = finite_array(vertices, "vertices", last=3, ndim=2)
    given = finite_array(faces, "faces", last=3, ndim=2)
    f = given.astype(np.int64)
    if not f.size:
        raise ValueError(f"mesh: {len(v)} vertices and 0 faces; allowed is a closed mesh")
    wrong = np.sum((f != given) | (f < 0) | (f >= len(v)))
    if wrong:
        raise ValueError(
            f"faces: {wrong} entries are not whole numbers in 0 … {len(v) - 1}; allowed are "
            "indices of vertices"
        )
    return v, f


def _edges(f: Faces) -> tuple[Int[np.ndarray, "e 2"], Int[np.ndarray, "e"]]:
    """Edges of each triangle in turn, in its sense, and by how many triangles they are shared."""
    edges = f[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, which, count = np.unique(
        np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return edges, count[which]


def _refuse_open(f: Faces) -> None:
    """Raise ValueError for open edges and those with more than two triangles."""
    edges, count = _edges(f)
    many, rims = int(np.sum(1 / count[count > 2]) + 0.5), _rims(edges[count == 1])
    if many or rims:
        sizes = ", ".join(str(size) for size in sorted(map(len, rims))[:5])
        raise ValueError(
            f"mesh: {many} edges with more than two triangles; {np.sum(count == 1)} open edges in "
            f"{len(rims)} holes (edges of the smallest: {sizes or 'none'}); allowed is a closed "
            f"surface (holes of at most {MOST_HOLE_EDGES} edges are filled)"
        )


def _rims(boundary: Int[np.ndarray, "e 2"]) -> list[list[int]]:
    """Closed rims of the holes, vertices in order; those that meet in a vertex are told apart,
    which libigl's `boundary_loop_all` does not. Open where triangles are wound against each other.
    """
    following: dict[int, list[int]] = {}
    for start, stop in boundary.tolist():
        following.setdefault(start, []).append(stop)
    rims = []
    for first in following:
        way, here = list[int](), first
        while following.get(here):
            way.append(here)
            here = following[here].pop()
            if here in way:
                start = way.index(here)
                rims.append(way[start:])
                del way[start:]
        if way:
            rims.append(way)
    return rims


def _filled(v: Vertices, f: Faces) -> tuple[Vertices, Faces, int]:
    """Close small holes: one triangle for three edges, else one an edge about their middle."""
    edges, count = _edges(f)
    rims = [rim for rim in _rims(edges[count == 1]) if 3 <= len(rim) <= MOST_HOLE_EDGES]
    for rim in rims:
        if len(rim) == 3:
            f = np.vstack([f, rim[::-1]])
        else:
            f = np.vstack([f, np.column_stack([np.roll(rim, -1), rim, [len(v)] * len(rim)])])
            v = np.vstack([v, v[rim].mean(axis=0)])
    return v, f, len(rims)


def _without_flat(v: Vertices, f: Faces) -> tuple[Faces, int]:
    """Flip the longest edge of triangles whose corners lie on a line; how many were flipped."""
    igl = library("igl")
    flipped = 0
    for _ in range(_MOST_PASSES):
        # From corner k to corner k + 1.
        squared = np.roll(igl.squared_edge_lengths(v, f), 1, axis=1)
        flat = np.flatnonzero(igl.doublearea(v, f) <= _FLAT * squared.max(axis=1))
        if not len(flat):
            return f, flipped
        neighbours, edges = igl.triangle_triangle_adjacency(f)
        touched: set[np.integer] = set()
        f = f.copy()
        for row, k in zip(flat, np.argmax(squared[flat], axis=1), strict=True):
            other = neighbours[row, k]
            if not touched & {row, other}:
                a, b, middle = f[row, (k + np.arange(3)) % 3]
                apex = f[other, (edges[row, k] + 2) % 3]
                f[row], f[other] = (a, apex, middle), (apex, b, middle)
                touched |= {row, other}
                flipped += 1
    raise ValueError(
        f"faces: {len(flat)} degenerate triangles (three vertices on a line) that cannot be "
        "removed; allowed are triangles with area"
    )


def _inside_out(v: Vertices, f: Faces) -> np.ndarray:
    """Whether each triangle belongs to a part whose inside is outside. A part inside another one is
    a cavity.
    """
    igl = library("igl")
    count, part = igl.facet_components(f)
    shells = [f[part == number] for number in range(count)]
    corners = v[[shell[0, 0] for shell in shells]]
    wrong = np.array([np.linalg.det(v[shell] - v.mean(axis=0)).sum() < 0 for shell in shells])
    for number, shell in enumerate(shells):
        within = np.abs(igl.winding_number(v, shell, corners)) > 0.5
        within[number] = False
        wrong ^= within
    return wrong[part]
