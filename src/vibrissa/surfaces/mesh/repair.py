"""What may be wrong with a mesh: mended where that leaves no doubt, an error that counts it where
it does not.
"""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from vibrissa.geometry.checks import finite_array
from vibrissa.surfaces.mesh.libraries import library

MOST_HOLE_EDGES = 8
"""Longest rim of a hole that is closed."""

_SAME = 1e-9
_FLAT = 1e-9
_MOST_PASSES = 8

# Repairs change how many there are.
Vertices = Float[np.ndarray, "_ 3"]
Faces = Int[np.ndarray, "_ 3"]


@dataclass(frozen=True)
class Repairs:
    """What was mended in a mesh, each a count; falsy where nothing was.

    Attributes
    ----------
    merged_vertices
        Vertices within 1e-9 of the diagonal of another, which they became.
    unreferenced_vertices
        Vertices of no triangle, dropped.
    degenerate_faces
        Triangles without area, dropped, or turned over with their neighbour.
    duplicate_faces
        Triangles on the same three vertices as another, dropped.
    flipped_faces
        Triangles turned round so that all are wound alike, and outwards.
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
        return any(getattr(self, field.name) for field in fields(self))

    def __str__(self) -> str:
        """Counts that are not zero, in words."""
        found = (
            (getattr(self, field.name), field.name.replace("_", " ")) for field in fields(self)
        )
        return ", ".join(f"{count} {name}" for count, name in found if count) or "nothing"


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
    v, f = _checked(vertices, faces)
    given = len(v)
    v, f, merged = _merged(v, f)
    f, degenerate, duplicate = _without_flat(v, f)
    if not len(f):
        raise ValueError(f"faces: all {degenerate} are degenerate; allowed is a closed mesh")
    v, f, unreferenced = _referenced(v, f)
    many = _non_manifold_edges(f)
    if many:
        raise ValueError(_defects(f, many, 0))
    f, flipped = _wound_alike(f)
    v, f, filled = _filled(v, f)
    open_edges = len(_boundary(f))
    if open_edges:
        raise ValueError(_defects(f, 0, open_edges))
    f, turned = _outwards(v, f, flipped)
    crossing = _crossings(v, f)
    if crossing:
        raise ValueError(
            f"mesh: {crossing} pairs of triangles cross each other; allowed is a surface that does not intersect itself"
        )
    del given
    return v, f, Repairs(merged, unreferenced, degenerate, duplicate, turned, filled)


def _checked(vertices: ArrayLike, faces: ArrayLike) -> tuple[Vertices, Faces]:
    try:
        v = np.array(vertices, dtype=np.float64)
        f = np.asarray(faces)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"vertices, faces: {error}; allowed are arrays (v, 3) of numbers and (f, 3) of indices"
        ) from error
    if v.ndim != 2 or v.shape[1] != 3:
        raise ValueError(f"vertices has shape {v.shape}; allowed is (v, 3)")
    if f.ndim != 2 or f.shape[1] != 3:
        raise ValueError(f"faces has shape {f.shape}; allowed is (f, 3): triangles")
    if not len(v) or not len(f):
        raise ValueError(
            f"mesh: {len(v)} vertices and {len(f)} faces; allowed is a closed mesh, of at least 4 each"
        )
    if not np.issubdtype(f.dtype, np.integer):
        raise ValueError(f"faces has entries of type {f.dtype}; allowed are whole numbers")
    broken = int(np.sum(~np.isfinite(v).all(axis=1)))
    if broken:
        raise ValueError(
            f"vertices: {broken} of {len(v)} have coordinates that are not finite; allowed are finite numbers"
        )
    beyond = int(np.sum((f < 0) | (f >= len(v))))
    if beyond:
        raise ValueError(
            f"faces: {beyond} indices lie outside 0 … {len(v) - 1}; allowed are indices of vertices"
        )
    return finite_array(v, "vertices", last=3), np.ascontiguousarray(f, dtype=np.int64)


def _merged(v: Vertices, f: Faces) -> tuple[Vertices, Faces, int]:
    diagonal = float(np.linalg.norm(np.ptp(v, axis=0)))
    if diagonal == 0:
        raise ValueError("vertices: all lie in one point; allowed is a closed mesh")
    cell = np.round((v - v.min(axis=0)) / (_SAME * diagonal)).astype(np.int64)
    _, first, index = np.unique(
        cell.view([("", np.int64)] * 3).ravel(), return_index=True, return_inverse=True
    )
    used = np.zeros(len(v), dtype=bool)
    used[f.ravel()] = True
    # Vertices of no triangle count as such, not as merged.
    merged = int(used.sum()) - len(np.unique(index[used]))
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return v[first[order]], rank[index[f]], merged


def _referenced(v: Vertices, f: Faces) -> tuple[Vertices, Faces, int]:
    used = np.zeros(len(v), dtype=bool)
    used[f.ravel()] = True
    return v[used], (np.cumsum(used) - 1)[f], int(np.sum(~used))


def _without_flat(v: Vertices, f: Faces) -> tuple[Faces, int, int]:
    """Drop triangles with a vertex twice or on the vertices of another; turn over those whose
    corners lie on a line, with the neighbour on their long edge.
    """
    proper = (f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])
    degenerate = int(np.sum(~proper))
    f = f[proper]
    _, first = np.unique(np.sort(f, axis=1).view([("", np.int64)] * 3).ravel(), return_index=True)
    duplicate = len(f) - len(first)
    f = f[np.sort(first)]
    for _ in range(_MOST_PASSES):
        flat, longest = _flat(v, f)
        if not len(flat):
            break
        f, turned = _turned_over(f, flat, longest)
        degenerate += turned
        if not turned:
            raise ValueError(
                f"faces: {len(flat)} degenerate triangles (three vertices on a line) that cannot be removed; allowed are triangles with area"
            )
    return f, degenerate, duplicate


def _flat(v: Vertices, f: Faces) -> tuple[Int[np.ndarray, "k"], Int[np.ndarray, "k"]]:
    corners = v[f]
    sides = np.roll(corners, -1, axis=1) - corners
    longest = np.argmax(np.sum(sides**2, axis=2), axis=1)
    height = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    flat = np.flatnonzero(height <= _FLAT * np.max(np.sum(sides**2, axis=2), axis=1))
    return flat, longest[flat]


def _turned_over(
    f: Faces, flat: Int[np.ndarray, "k"], longest: Int[np.ndarray, "k"]
) -> tuple[Faces, int]:
    """Give the middle vertex of a flat triangle to the neighbour on its long edge, which becomes
    two triangles.
    """
    edges: dict[tuple[int, ...], list[int]] = {}
    for k in range(3):
        for row, pair in enumerate(
            np.sort(np.column_stack([f[:, k], f[:, (k + 1) % 3]]), axis=1).tolist()
        ):
            edges.setdefault(tuple(pair), []).append(row)
    touched: set[int] = set()
    f, new, gone = f.copy(), [], []
    for row, k in zip(flat.tolist(), longest.tolist(), strict=True):
        a, b, middle = (int(f[row, (k + i) % 3]) for i in range(3))
        others = [other for other in edges[min(a, b), max(a, b)] if other != row]
        if len(others) != 1 or row in touched or others[0] in touched:
            continue
        other = others[0]
        # The edge a b of the neighbour is cut at the middle vertex, in the neighbour's own sense.
        turn = next(i for i in range(3) if {int(f[other, i]), int(f[other, (i + 1) % 3])} == {a, b})
        p, q, apex = (int(f[other, (turn + i) % 3]) for i in range(3))
        new += [[p, middle, apex], [middle, q, apex]]
        gone += [row, other]
        touched |= {row, other}
    kept = np.delete(f, gone, axis=0) if gone else f
    return (np.concatenate([kept, np.array(new, dtype=np.int64)]) if new else kept), len(gone) // 2


def _edges(f: Faces) -> Int[np.ndarray, "e 2"]:
    return np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])


def _edge_keys(edges: Int[np.ndarray, "e 2"]) -> Int[np.ndarray, "e"]:
    width = int(edges.max()) + 1
    return edges.min(axis=1) * width + edges.max(axis=1)


def _non_manifold_edges(f: Faces) -> int:
    return int(np.sum(np.unique(_edge_keys(_edges(f)), return_counts=True)[1] > 2))


def _boundary(f: Faces) -> Int[np.ndarray, "e 2"]:
    """Edges of one triangle only, in its sense."""
    edges = _edges(f)
    _, index, counts = np.unique(_edge_keys(edges), return_inverse=True, return_counts=True)
    return edges[counts[index] == 1]


def _defects(f: Faces, many: int, open_edges: int) -> str:
    edges = open_edges if open_edges else len(_boundary(f))
    holes = _rims(_boundary(f))
    parts = [f"{many} edges with more than two triangles"] if many else []
    if edges:
        sizes = ", ".join(str(len(rim)) for rim in sorted(holes, key=len)[:5])
        parts.append(f"{edges} open edges in {len(holes)} holes (edges of the smallest: {sizes})")
    return f"mesh: {'; '.join(parts)}; allowed is a closed surface (holes of at most {MOST_HOLE_EDGES} edges are filled)"


def _rims(boundary: Int[np.ndarray, "e 2"]) -> list[list[int]]:
    """Closed rims of the holes: vertices in order."""
    following: dict[int, list[int]] = {}
    for start, stop in boundary.tolist():
        following.setdefault(start, []).append(stop)
    rims = []
    while following:
        start = here = next(iter(following))
        rim = []
        while here in following:
            rim.append(here)
            stops = following[here]
            after = stops.pop()
            if not stops:
                del following[here]
            here = after
            if here == start:
                break
        rims.append(rim)
    return rims


def _wound_alike(f: Faces) -> tuple[Faces, Bool[np.ndarray, "_"]]:
    """Turn triangles so that neighbours agree; which were turned."""
    wound, _ = library("igl").bfs_orient(f)
    wound = np.asarray(wound, dtype=np.int64)
    turned = wound[:, 0] != f[:, 0]
    turned |= (wound[:, 1] != f[:, 1]) | (wound[:, 2] != f[:, 2])
    return wound, turned


def _filled(v: Vertices, f: Faces) -> tuple[Vertices, Faces, int]:
    new_vertices: list[Float[np.ndarray, 3]] = []
    new_faces: list[list[int]] = []
    filled = 0
    for rim in _rims(_boundary(f)):
        if not 3 <= len(rim) <= MOST_HOLE_EDGES:
            continue
        if len(rim) == 3:
            new_faces.append(rim[::-1])
        else:
            middle = len(v) + len(new_vertices)
            new_vertices.append(v[rim].mean(axis=0))
            new_faces += [
                [after, before, middle]
                for before, after in zip(rim, rim[1:] + rim[:1], strict=True)
            ]
        filled += 1
    if not filled:
        return v, f, 0
    vertices = np.concatenate([v, np.array(new_vertices).reshape(-1, 3)])
    return vertices, np.concatenate([f, np.array(new_faces, dtype=np.int64)]), filled


def _outwards(v: Vertices, f: Faces, turned: Bool[np.ndarray, "_"]) -> tuple[Faces, int]:
    """Turn whole parts whose inside is outside; number of triangles turned in all. A part inside
    another one is a cavity.
    """
    edges = _edges(f)
    count, part = connected_components(
        coo_array(
            (np.ones(len(edges), dtype=np.int8), (edges[:, 0], edges[:, 1])), shape=(len(v), len(v))
        )
    )
    of_face = part[f[:, 0]]
    corners = v[f] - v.mean(axis=0)
    volume = np.bincount(
        of_face,
        weights=np.einsum("fi,fi->f", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6,
        minlength=count,
    )
    depth = _nesting(v, f, part, of_face, count)
    wrong = np.flatnonzero((volume < 0) != (depth % 2 == 1))
    reverse = np.isin(of_face, wrong)
    turned = np.concatenate([turned, np.zeros(len(f) - len(turned), dtype=bool)]) ^ reverse
    return np.where(reverse[:, None], f[:, ::-1], f), int(turned.sum())


def _nesting(
    v: Vertices, f: Faces, part: np.ndarray, of_face: np.ndarray, count: int
) -> Int[np.ndarray, "parts"]:
    """How many other parts each part lies in."""
    depth = np.zeros(count, dtype=np.int64)
    if count == 1:
        return depth
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, part, v)
    np.maximum.at(high, part, v)
    sample = v[np.unique(part, return_index=True)[1]]
    for outer in range(count):
        within = np.flatnonzero(np.all((low > low[outer]) & (high < high[outer]), axis=1))
        if len(within):
            shell = np.ascontiguousarray(f[of_face == outer])
            winding = np.asarray(
                library("igl").winding_number(v, shell, np.ascontiguousarray(sample[within]))
            )
            depth[within] += np.abs(winding) > 0.5
    return depth


def _crossings(v: Vertices, f: Faces) -> int:
    found, crossing, _ = library("igl.predicates").find_self_intersections(
        v, np.ascontiguousarray(f)
    )
    return len(crossing) if found else 0
