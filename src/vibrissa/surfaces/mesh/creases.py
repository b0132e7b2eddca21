"""Smooth sheets of a mesh: its edges divided into smooth ones and creases, and a normal for each
corner on each side of a crease.

A sheet's corner ("fan") is all the corners of triangles about one vertex that smooth edges connect.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from vibrissa.surfaces.mesh.patches import COLUMNS

_NEIGHBOURS = 24
_CUBIC_FROM = 11
_QUADRATIC_FROM = 6
_RIDGE = 1e-9
_CHUNK = 65536
_STRAIGHT = np.cos(np.radians(40))

Faces = Int[np.ndarray, "f 3"]
Vertices = Float[np.ndarray, "v 3"]


@dataclass(frozen=True)
class Sheets:
    """The mesh with its creases.

    Attributes
    ----------
    vertices, faces
        Watertight and wound outwards.
    neighbours
        (f, 3) triangle across the edge opposite each corner.
    creases
        (f, 3) 0 a smooth edge, 1 a convex crease, −1 a concave one.
    fans
        (f, 3) fan of each corner.
    normals
        (fans, 3) unit normals.
    """

    vertices: Vertices
    faces: Faces
    neighbours: Int[np.ndarray, "f 3"]
    creases: Int[np.ndarray, "f 3"]
    fans: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "fans 3"]

    def sag(self) -> Float[np.ndarray, "f"]:
        """Chordal error of each triangle: how far the smooth surface bulges over its edges, by the
        normals at their ends.
        """
        v, n = self.vertices[self.faces], self.normals[self.fans]
        edge, turn = v - np.roll(v, 1, axis=1), n - np.roll(n, 1, axis=1)
        return np.max(np.abs(np.sum(edge * turn, axis=-1)), axis=1) / 8


def sheets(vertices: Vertices, faces: Faces, crease_angle: float) -> Sheets:
    """Divide a watertight, outward mesh along the edges at which it bends by more than
    `crease_angle` [rad].
    """
    neighbours, partner = _across(faces)
    face_normals, _angles = _face_normals(vertices, faces)
    turn = np.arccos(
        np.clip(np.sum(face_normals[:, None] * face_normals[neighbours], axis=-1), -1, 1)
    )
    apex = vertices[np.take_along_axis(faces[neighbours], partner[..., None], axis=2)[..., 0]]
    height = np.einsum("fi,fki->fk", face_normals, apex - vertices[np.roll(faces, -1, axis=1)])
    creases = np.where(turn > crease_angle, np.where(height < 0, 1, -1), 0).astype(np.int8)
    fans = _fans(faces, neighbours, partner, creases == 0)
    rough = _by_angle_and_length(vertices, faces, fans)
    return Sheets(vertices, faces, neighbours, creases, fans, _fitted(vertices, faces, fans, rough))


def patch_rows(sheet: Sheets, chosen: Int[np.ndarray, "k"]) -> Float[np.ndarray, "k 60"]:
    """Rows for `patches.unpacked` of the chosen triangles."""
    faces, creases = sheet.faces, sheet.creases
    face_normals, angles = _face_normals(sheet.vertices, faces)
    pseudo = np.zeros_like(sheet.vertices)
    for k in range(3):
        np.add.at(pseudo, faces[:, k], angles[:, k, None] * face_normals)
    code, other = _corners(sheet)
    rows = np.zeros((len(chosen), COLUMNS))
    fans = sheet.fans[chosen]
    rows[:, :9] = sheet.vertices[faces[chosen]].reshape(-1, 9)
    rows[:, 9:18] = sheet.normals[fans].reshape(-1, 9)
    beyond = np.empty((len(chosen), 3, 2, 3))
    across = sheet.neighbours[chosen]
    for k in range(3):
        for end in range(2):
            vertex = faces[chosen, (k + 1 + end) % 3]
            corner = np.argmax(faces[across[:, k]] == vertex[:, None], axis=1)
            beyond[:, k, end] = sheet.normals[sheet.fans[across[:, k], corner]]
    rows[:, 18:36] = beyond.reshape(-1, 18)
    rows[:, 36:45] = sheet.normals[other[fans]].reshape(-1, 9)
    rows[:, 45:54] = pseudo[faces[chosen]].reshape(-1, 9)
    rows[:, 54:57] = creases[chosen]
    rows[:, 57:60] = code[faces[chosen]]
    return rows


def _across(faces: Faces) -> tuple[Int[np.ndarray, "f 3"], Int[np.ndarray, "f 3"]]:
    """Triangle across the edge opposite each corner, and the corner opposite that edge there."""
    count = len(faces)
    start, stop = np.roll(faces, -1, axis=1).T.ravel(), np.roll(faces, -2, axis=1).T.ravel()
    width = int(faces.max()) + 1
    key, turned = start.astype(np.int64) * width + stop, stop.astype(np.int64) * width + start
    order = np.argsort(key)
    found = order[np.searchsorted(key, turned, sorter=order)]
    return (found % count).reshape(3, -1).T, (found // count).reshape(3, -1).T


def _face_normals(
    vertices: Vertices, faces: Faces
) -> tuple[Float[np.ndarray, "f 3"], Float[np.ndarray, "f 3"]]:
    """Unit normals of the triangles, and their angles at the corners."""
    v = vertices[faces]
    along, back = np.roll(v, -1, axis=1) - v, np.roll(v, 1, axis=1) - v
    normal = np.cross(along[:, 0], back[:, 0])
    size = np.linalg.norm(normal, axis=1)
    return normal / size[:, None], np.arctan2(size[:, None], np.sum(along * back, axis=-1))


def _fans(
    faces: Faces,
    neighbours: Int[np.ndarray, "f 3"],
    partner: Int[np.ndarray, "f 3"],
    smooth: Bool[np.ndarray, "f 3"],
) -> Faces:
    """Number of the fan of each corner."""
    count = len(faces)
    first, second = [], []
    for k in range(3):
        rows = np.flatnonzero(smooth[:, k])
        there, opposite = neighbours[rows, k], partner[rows, k]
        # The edge runs the other way there.
        for here, corner in (((k + 1) % 3, (opposite + 2) % 3), ((k + 2) % 3, (opposite + 1) % 3)):
            first.append(rows * 3 + here)
            second.append(there * 3 + corner)
    i, j = np.concatenate(first), np.concatenate(second)
    graph = coo_array((np.ones(len(i), dtype=np.int8), (i, j)), shape=(3 * count, 3 * count))
    return connected_components(graph, directed=False)[1].reshape(count, 3).astype(np.int64)


def _by_angle_and_length(
    vertices: Vertices, faces: Faces, fans: Faces
) -> Float[np.ndarray, "fans 3"]:
    """Normals of the fans weighted by sin(angle)/(product of the edges): exact on spheres (Max, J.
    Graphics Tools 4, 1999).
    """
    v = vertices[faces]
    total = np.zeros((int(fans.max()) + 1, 3))
    for k in range(3):
        a, b = v[:, (k + 1) % 3] - v[:, k], v[:, (k + 2) % 3] - v[:, k]
        weight = np.sum(a * a, axis=1) * np.sum(b * b, axis=1)
        part = np.cross(a, b) / weight[:, None]
        for axis in range(3):
            total[:, axis] += np.bincount(fans[:, k], weights=part[:, axis], minlength=len(total))
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def _fitted(
    vertices: Vertices, faces: Faces, fans: Faces, rough: Float[np.ndarray, "fans 3"]
) -> Float[np.ndarray, "fans 3"]:
    """Normals of the cubic surface through each vertex that comes nearest to those within two edges
    (Cazals & Pouget 2005).

    Kept is the rough normal where those are too few, or where the fitted one differs from it by
    more than the triangles do.
    """
    at = np.empty(len(rough), dtype=np.int64)
    at[fans.ravel()] = faces.ravel()
    face_normals, _ = _face_normals(vertices, faces)
    agreement = np.ones(len(rough))
    for k in range(3):
        np.minimum.at(agreement, fans[:, k], np.sum(face_normals * rough[fans[:, k]], axis=1))
    rings = _rings(fans, len(rough))
    normals = rough.copy()
    for start in range(0, len(rough), _CHUNK):
        rows = np.arange(start, min(start + _CHUNK, len(rough)))
        near, valid = _padded(rings, rows)
        fitted = _jets(vertices[at[near]] - vertices[at[rows], None], valid, rough[rows])
        trusted = np.sum(fitted * rough[rows], axis=1) >= agreement[rows] - 1e-12
        normals[rows[trusted]] = fitted[trusted]
    return normals


def _rings(fans: Faces, count: int) -> csr_array:
    """Which fans lie within two edges of each other."""
    i, j = fans.ravel(), np.roll(fans, 1, axis=1).ravel()
    ring = csr_array(
        (np.ones(2 * len(i), dtype=np.int32), (np.concatenate([i, j]), np.concatenate([j, i]))),
        shape=(count, count),
    )
    two = csr_array(ring @ ring)
    two.setdiag(0)
    two.eliminate_zeros()
    return two


def _padded(
    rings: csr_array, rows: Int[np.ndarray, "n"]
) -> tuple[Int[np.ndarray, "n 24"], Bool[np.ndarray, "n 24"]]:
    """Neighbours of each row, evenly thinned out where there are more than 24, and which of them
    count where there are fewer.
    """
    first, size = rings.indptr[rows], rings.indptr[rows + 1] - rings.indptr[rows]
    place = np.arange(_NEIGHBOURS)
    step = np.maximum(size, _NEIGHBOURS)[:, None] / _NEIGHBOURS
    index = np.floor(place * step).astype(np.int64)
    valid = index < size[:, None]
    return rings.indices[np.where(valid, first[:, None] + index, first[:, None])], valid


def _jets(
    offset: Float[np.ndarray, "n 24 3"],
    valid: Bool[np.ndarray, "n 24"],
    rough: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Normals at the origin of the surfaces w = a₁u + a₂v + quadratic + cubic fitted to points seen
    along the rough normals.
    """
    axis = np.eye(3)[np.argmin(np.abs(rough), axis=1)]
    across = np.cross(rough, axis)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(rough, across)
    squared = np.where(valid, np.sum(offset * offset, axis=-1), 0.0)
    size = np.sqrt(np.maximum(np.max(squared, axis=1, keepdims=True), 1e-300))
    u, v, w = (
        np.einsum("nki,ni->nk", offset, direction) / size for direction in (along, across, rough)
    )
    count = valid.sum(axis=1, keepdims=True)
    cubic, quadratic = count >= _CUBIC_FROM, count >= _QUADRATIC_FROM
    terms = np.stack(
        [
            u,
            v,
            *(part * quadratic for part in (u * u, u * v, v * v)),
            *(part * cubic for part in (u**3, u * u * v, u * v * v, v**3)),
        ],
        axis=-1,
    )
    weight = np.where(valid, 1 / np.maximum(squared / size**2, 1e-6), 0.0)
    weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    weighted = terms * weight[..., None]
    matrix = np.swapaxes(weighted, 1, 2) @ terms + _RIDGE * np.eye(9)
    right = np.einsum("nkt,nk->nt", weighted, w)
    slope = np.linalg.solve(matrix, right[..., None])[:, :2, 0] * (count >= _QUADRATIC_FROM)
    normal = rough - slope[:, :1] * along - slope[:, 1:] * across
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _corners(sheet: Sheets) -> tuple[Float[np.ndarray, "v"], Int[np.ndarray, "fans"]]:
    """Code of each vertex as in `Patch.corners`, and for each fan the other one where a crease runs
    through its vertex.
    """
    faces, creases, vertices = sheet.faces, sheet.creases, sheet.vertices
    count = len(vertices)
    number, direction, convex = np.zeros(count), np.zeros((count, 3)), np.zeros(count)
    for k in range(3):
        rows = np.flatnonzero(creases[:, k])
        start, stop = faces[rows, (k + 1) % 3], faces[rows, (k + 2) % 3]
        along = vertices[stop] - vertices[start]
        # Each crease is met twice, once from each side and in either direction: a vertex is its
        # start once.
        np.add.at(number, start, 1)
        np.add.at(convex, start, creases[rows, k])
        np.add.at(direction, start, along / np.linalg.norm(along, axis=1, keepdims=True))
    fan_vertex = np.empty(len(sheet.normals), dtype=np.int64)
    fan_vertex[sheet.fans.ravel()] = faces.ravel()
    fans = np.bincount(fan_vertex, minlength=count)
    # Two creases of the same sense that leave in about opposite directions.
    passing = (
        (number == 2)
        & (fans == 2)
        & (np.abs(convex) == 2)
        & (np.linalg.norm(direction, axis=1) < 2 * (1 - _STRAIGHT))
    )
    dart = fans <= 1
    code = np.where(dart, 0.0, np.where(passing, np.sign(convex), 2.0))
    order = np.argsort(fan_vertex, kind="stable")
    other = np.arange(len(fan_vertex))
    pairs = order[np.isin(fan_vertex[order], np.flatnonzero(fans == 2))].reshape(-1, 2)
    other[pairs[:, 0]], other[pairs[:, 1]] = pairs[:, 1], pairs[:, 0]
    return code, other
