"""Defects of a mesh: repaired where there is no doubt how, else an error that counts them."""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Shaped
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array
from vibrissa.surfaces.mesh.libraries import Faces, Vertices, library

MOST_HOLE_EDGES = 8
"""Longest rim of a hole that is filled: larger holes are open meshes, not lost triangles."""

# Shares of the diagonal, and of the longest side squared. Single precision, as in STL, rounds at
# 6e-8: points closer than this were one point when written.
_SAME, _FLAT = 1e-9, 1e-9
# Flat triangles next to each other are flipped one at a time: as many as lie along one edge.
_MOST_PASSES = 64


@dataclass(frozen=True)
class Repairs:
    """What was repaired in a mesh, as counts; falsy if nothing was.

    Attributes
    ----------
    merged_vertices
        Vertices merged with another within 1e-9 of the diagonal.
    unreferenced_vertices
        Vertices in no triangle, dropped.
    degenerate_faces
        Triangles without area: dropped, or their long edge flipped.
    duplicate_faces
        Triangles with the same three vertices as another, dropped.
    flipped_faces
        Triangles reversed so that all are wound outwards.
    filled_holes
        Holes of at most 8 edges, filled with triangles around their middle.
    """

    merged_vertices: int = 0
    unreferenced_vertices: int = 0
    degenerate_faces: int = 0
    duplicate_faces: int = 0
    flipped_faces: int = 0
    filled_holes: int = 0

    def __bool__(self) -> bool:
        """Whether anything was repaired."""
        return self != Repairs()

    def __str__(self) -> str:
        """The non-zero counts, in words."""
        counts = {field.name.replace("_", " "): getattr(self, field.name) for field in fields(self)}
        return ", ".join(f"{count} {name}" for name, count in counts.items() if count) or "nothing"


def mended(vertices: ArrayLike, faces: ArrayLike) -> tuple[Vertices, Faces, Repairs]:
    """Vertices and faces of a closed, outward-wound mesh, and what it took to get there.

    Raises
    ------
    ValueError
        If there are no faces, indices out of range, vertices that are not finite, or defects that
        cannot be repaired; the text counts each kind.
    ImportError
        If libigl is not installed.
    """
    igl = library("igl")
    v = finite_array(vertices, "vertices", last=3, ndim=2)
    given = _indices(faces, len(v))
    # Of all vertices at about the same place, the first.
    rounding = max(_SAME * np.linalg.norm(np.ptp(v, axis=0)), np.finfo(float).tiny)
    place = np.round((v - v.min(axis=0)) / rounding)
    _, first, same = np.unique(place, axis=0, return_index=True, return_inverse=True)
    f = first[same][given]
    merged = len(np.unique(given)) - len(np.unique(f))
    proper = f[(f != np.roll(f, 1, axis=1)).all(axis=1)]
    if not len(proper):
        raise ValueError(f"faces: all {len(f)} are degenerate; allowed is a closed mesh")
    distinct = np.unique(np.sort(proper, axis=1), axis=0, return_index=True)[1]
    f = proper[np.sort(distinct)]
    _refuse_open(f, closable=True)
    wound = np.asarray(igl.bfs_orient(f)[0], dtype=np.int64)
    turned = (wound != f).any(axis=1)
    v, f, filled = _filled(v, wound)
    _refuse_open(f, closable=False)
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
    return (
        v[kept],
        f,
        Repairs(
            merged_vertices=merged,
            unreferenced_vertices=len(v) - merged - len(kept),
            degenerate_faces=len(given) - len(proper) + flat,
            duplicate_faces=len(proper) - len(distinct),
            flipped_faces=int(flipped),
            filled_holes=filled,
        ),
    )


def _indices(faces: ArrayLike, count: int) -> Faces:
    f = finite_array(faces, "faces", last=3, ndim=2)
    beyond = np.sum((f < 0) | (f >= count) | (f % 1 != 0))
    if beyond or not len(f):
        raise ValueError(
            f"faces: {count} vertices and {len(f)} faces, of which {beyond} indices lie outside "
            f"0 … {count - 1} or are not whole numbers; allowed is a closed mesh"
        )
    return f.astype(np.int64)


def _boundary(f: Faces) -> tuple[Shaped[np.ndarray, "e 2"], np.integer]:
    """Edges with a single triangle, in its sense, and how many edges have more than two."""
    edges, _, number, *_ = library("igl").unique_edge_map(f)
    count = np.bincount(number)
    return edges[count[number] == 1], np.sum(count > 2)


def _refuse_open(f: Faces, *, closable: bool) -> None:
    """Raise ValueError for edges with more than two triangles and, unless they may still be closed,
    for open ones.
    """
    boundary, many = _boundary(f)
    if not many and (closable or not len(boundary)):
        return
    parts = [f"{many} edges with more than two triangles"] if many else []
    if len(boundary):
        rims = sorted(map(len, _rims(boundary)))
        sizes = ", ".join(map(str, rims[:5]))
        parts.append(
            f"{len(boundary)} open edges in {len(rims)} holes (edges of the smallest: {sizes})"
        )
    raise ValueError(
        f"mesh: {'; '.join(parts)}; allowed is a closed surface (holes of at most "
        f"{MOST_HOLE_EDGES} edges are filled)"
    )


def _rims(boundary: Shaped[np.ndarray, "e 2"]) -> list[list[int]]:
    """Closed rims of the holes, vertices in order; rims that meet at a vertex are kept apart, which
    libigl's `boundary_loop_all` does not do.
    """
    following: dict[int, list[int]] = {}
    for start, stop in boundary.tolist():
        following.setdefault(start, []).append(stop)
    rims = []
    for start in following:
        way: dict[int, int] = {}
        here = start
        while following.get(here):
            way[here] = here
            here = following[here].pop()
            if here in way:
                whole = list(way)
                rims.append(whole[whole.index(here) :])
                for vertex in rims[-1]:
                    del way[vertex]
        if way:
            # An open rim, where triangles are wound against each other.
            rims.append(list(way))
    return rims


def _filled(v: Vertices, f: Faces) -> tuple[Vertices, Faces, int]:
    """Fill small holes: one triangle for three edges, else one per edge around their middle."""
    rims = [rim for rim in _rims(_boundary(f)[0]) if 3 <= len(rim) <= MOST_HOLE_EDGES]
    for rim in rims:
        if len(rim) == 3:
            new = [rim[::-1]]
        else:
            new = [[b, a, len(v)] for a, b in zip(rim, rim[1:] + rim[:1], strict=True)]
            v = np.vstack([v, v[rim].mean(axis=0)])
        f = np.vstack([f, new])
    return v, f, len(rims)


def _without_flat(v: Vertices, f: Faces) -> tuple[Faces, int]:
    """Flip the longest edge of triangles whose corners are collinear, and count the flips."""
    igl, flipped = library("igl"), 0
    for _ in range(_MOST_PASSES):
        # Indexed by the corner where each edge starts.
        squared = np.roll(igl.squared_edge_lengths(v, f), 1, axis=1)
        flat = np.flatnonzero(igl.doublearea(v, f) <= _FLAT * squared.max(axis=1))
        if not len(flat):
            return f, flipped
        neighbours, edges = igl.triangle_triangle_adjacency(f)
        touched: set[np.integer] = set()
        f = f.copy()
        for row, k in zip(flat, np.argmax(squared[flat], axis=1), strict=True):
            other = neighbours[row, k]
            if row not in touched and other not in touched:
                a, b, middle = f[row, (k + np.arange(3)) % 3]
                apex = f[other, (edges[row, k] + 2) % 3]
                f[row], f[other] = (a, apex, middle), (apex, b, middle)
                touched.update((row, other))
                flipped += 1
    raise ValueError(
        f"faces: {len(flat)} degenerate triangles (three vertices on a line) that cannot be "
        "removed; allowed are triangles with area"
    )


def _inside_out(v: Vertices, f: Faces) -> Bool[np.ndarray, "f"]:
    """Whether each triangle belongs to a part that is inside out. A part inside another one is a
    cavity.
    """
    igl = library("igl")
    _, part = igl.facet_components(f)
    outward, turned = igl.orient_outward(v, f, part[:, None])
    lowest = np.lexsort((v[f, 2].min(axis=1), part))
    _, first = np.unique(part[lowest], return_index=True)
    corners = f[lowest[first]]
    corner = corners[np.arange(len(corners)), np.argmin(v[corners, 2], axis=1)]
    # At its own lowest corner, a part has a winding number of at most one half.
    around = np.floor(igl.winding_number(v, outward, v[corner]) + 0.25)
    return (turned.astype(bool) ^ (around % 2 == 1))[part]
