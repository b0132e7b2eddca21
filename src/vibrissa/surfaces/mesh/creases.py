"""Smooth sheets of a mesh: its edges sorted into smooth ones and creases, and a normal for each
corner on each side of a crease.

A sheet's corner ("fan") is all triangle corners at one vertex that are connected by smooth edges.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from vibrissa.surfaces.mesh.libraries import Faces, Vertices, library
from vibrissa.surfaces.mesh.patches import Patch, slopes

# A cubic without constant term has 9 coefficients, a quadratic 5; one or two more points than that.
_CUBIC_FROM, _QUADRATIC_FROM = 11, 6
# Two rings of a regular mesh hold 18 vertices; of more than 24, an even selection is enough.
_NEIGHBOURS = 24
# Share of the weights' sum that keeps the least-squares matrix regular, at an error of its size.
_RIDGE = 1e-9
# Vertices fitted at a time: with 24 neighbours of 9 terms each they take 110 MB.
_CHUNK = 1 << 16
# A crease runs through a vertex if its two edges turn by no more than this.
_STRAIGHT = np.radians(40)
_ROUNDING = 1e-12


class Sheets(NamedTuple):
    """The mesh with its creases.

    Attributes
    ----------
    vertices, faces
        Watertight, with outward winding.
    neighbours
        (f, 3) triangle across the edge opposite each corner; −1 where that is a crease.
    fans
        (f, 3) fan of each corner.
    patches
        What the level over each triangle depends on, (f, …).
    """

    vertices: Vertices
    faces: Faces
    neighbours: Int[np.ndarray, "f 3"]
    fans: Int[np.ndarray, "f 3"]
    patches: Patch

    def sag(self) -> Float[np.ndarray, "f"]:
        """Chordal error of each triangle: how far the smooth surface bulges over its edges, judging
        by the normals at their ends.
        """
        v, n = self.patches.vertices, self.patches.normals
        edge, turn = v - np.roll(v, 1, axis=1), n - np.roll(n, 1, axis=1)
        return np.max(np.abs(np.sum(edge * turn, axis=-1)), axis=1) / 8


def sheets(vertices: Vertices, faces: Faces, crease_angle: float) -> Sheets:
    """Split a watertight, outward-wound mesh along the edges where it bends by more than
    `crease_angle` [rad].
    """
    igl = library("igl")
    # libigl numbers edges by where they start, we by the corner opposite.
    across, edge = (
        np.roll(part, -1, axis=1).astype(np.int64)
        for part in igl.triangle_triangle_adjacency(faces)
    )
    opposite = (edge + 2) % 3
    flat = igl.per_face_normals(vertices, faces, np.zeros(3))
    turn = np.arccos(np.clip(np.sum(flat[:, None] * flat[across], axis=-1), -1, 1))
    apex = vertices[faces[across, opposite]]
    height = np.einsum("fi,fki->fk", flat, apex - vertices[np.roll(faces, -1, axis=1)])
    creases = np.where(turn > crease_angle, np.where(height < 0, 1, -1), 0)
    # By edge and corner: the corner of the triangle across that is at the same end of the edge.
    corner = np.arange(3)
    there = (opposite[..., None] + corner[:, None] - corner) % 3
    fans = _fans(across, there, creases == 0)
    vertex = np.empty(fans.max() + 1, dtype=np.int64)
    vertex[fans] = faces
    normals = _fitted(vertices, faces, fans, vertex, flat)
    code, other = _corners(vertices, faces, creases, vertex)
    weighting = igl.PER_VERTEX_NORMALS_WEIGHTING_TYPE_ANGLE
    patches = Patch(
        vertices=vertices[faces],
        slopes=slopes(vertices[faces]),
        normals=normals[fans],
        beyond=normals[fans[across[..., None], there]],
        around=normals[other[fans]],
        pseudo=igl.per_vertex_normals(vertices, faces, weighting)[faces],
        edges=creases.astype(float),
        corners=code[faces],
    )
    return Sheets(vertices, faces, np.where(creases == 0, across, -1), fans, patches)


def _fans(
    across: Faces, there: Int[np.ndarray, "f 3 3"], smooth: Bool[np.ndarray, "f 3"]
) -> Int[np.ndarray, "f 3"]:
    """Fan number of each corner: the two corners at each end of a smooth edge belong together."""
    at_end = smooth[..., None] & ~np.eye(3, dtype=bool)
    here = np.arange(across.size).reshape(-1, 1, 3)
    pairs = np.stack(np.broadcast_arrays(here, 3 * across[..., None] + there), axis=-1)[at_end]
    labels = library("trimesh.graph").connected_component_labels(pairs, node_count=across.size)
    return np.asarray(labels, dtype=np.int64).reshape(-1, 3)


def _fitted(
    vertices: Vertices,
    faces: Faces,
    fans: Int[np.ndarray, "f 3"],
    vertex: Int[np.ndarray, "fans"],
    flat: Float[np.ndarray, "f 3"],
) -> Float[np.ndarray, "fans 3"]:
    """Normals of the cubic surfaces through each vertex that best fit the vertices within two edges
    (Cazals & Pouget 2005).

    Where those are too few, or where the fitted normal differs from the rough one by more than the
    triangles do, the rough one is kept: weighted by sin(angle)/(product of the edges), exact on
    spheres (Max, J. Graphics Tools 4, 1999).
    """
    count = len(vertex)
    v = vertices[faces]
    a, b = np.roll(v, -1, axis=1) - v, np.roll(v, -2, axis=1) - v
    rough = np.zeros((count, 3))
    product = np.sum(a * a, axis=-1) * np.sum(b * b, axis=-1)
    np.add.at(rough, fans, np.cross(a, b) / product[..., None])
    rough /= np.linalg.norm(rough, axis=1, keepdims=True)
    agreement = np.ones(count)
    np.minimum.at(agreement, fans, np.sum(flat[:, None] * rough[fans], axis=-1))
    # Which fans lie within two edges of each other.
    ring = scipy.sparse.csr_array(library("igl").adjacency_matrix(fans))
    rings = ring @ ring
    rings.setdiag(0)
    rings.eliminate_zeros()
    normals = rough.copy()
    for rows in np.array_split(np.arange(count), -(-count // _CHUNK)):
        # Evenly thinned out where there are more neighbours than are used.
        first, size = rings.indptr[rows, None], np.diff(rings.indptr)[rows, None]
        step = np.maximum(size, _NEIGHBOURS) / _NEIGHBOURS
        index = np.floor(np.arange(_NEIGHBOURS) * step).astype(np.int64)
        valid = index < size
        near = vertex[rings.indices[first + np.where(valid, index, 0)]]
        offset = vertices[near] - vertices[vertex[rows], None]
        fitted = _jets(offset, valid, rough[rows])
        trusted = np.sum(fitted * rough[rows], axis=1) >= agreement[rows] - _ROUNDING
        normals[rows[trusted]] = fitted[trusted]
    return normals


def _jets(
    offset: Float[np.ndarray, "n near 3"],
    valid: np.ndarray,
    rough: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "n 3"]:
    """Normals at the origin of the surfaces w = a₁u + a₂v + quadratic + cubic fitted to points, w
    being along the rough normals.
    """
    across = np.cross(rough, np.eye(3)[np.argmin(np.abs(rough), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    frame = np.stack([np.cross(rough, across), across, rough], axis=-1)
    distance = np.where(valid, np.linalg.norm(offset, axis=-1), 0.0)
    size = distance.max(axis=1, keepdims=True)
    u, v, w = np.moveaxis(offset @ frame, -1, 0) / size
    count = valid.sum(axis=1, keepdims=True)
    degree = np.where(count >= _CUBIC_FROM, 3, np.where(count >= _QUADRATIC_FROM, 2, 1))
    powers = [(n - j, j) for n in (1, 2, 3) for j in range(n + 1)]
    terms = np.stack([u**i * v**j * (i + j <= degree) for i, j in powers], axis=-1)
    # By the inverse square of the distance, except for vertices that nearly coincide.
    weight = np.where(valid, 1 / np.maximum((distance / size) ** 2, 1e-6), 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    weighted = np.swapaxes(terms * weight[..., None], 1, 2)
    matrix = weighted @ terms + _RIDGE * np.eye(len(powers))
    slope = np.linalg.solve(matrix, weighted @ w[..., None])[:, :2] * (degree > 1)[..., None]
    normal = rough - (frame[..., :2] @ slope)[..., 0]
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _corners(
    vertices: Vertices,
    faces: Faces,
    creases: Int[np.ndarray, "f 3"],
    vertex: Int[np.ndarray, "fans"],
) -> tuple[Float[np.ndarray, "v"], Int[np.ndarray, "fans"]]:
    """Code of each vertex as in `Patch.corners`, and for each fan the one across the crease, if one
    runs through its vertex.
    """
    row, k = np.nonzero(creases)
    start, stop = faces[row, (k + 1) % 3], faces[row, (k + 2) % 3]
    along = vertices[stop] - vertices[start]
    # Each crease is visited from both sides, in opposite directions: each end is its start once.
    count = len(vertices)
    sense = np.bincount(start, weights=creases[row, k], minlength=count)
    direction = np.zeros((count, 3))
    np.add.at(direction, start, along / np.linalg.norm(along, axis=1, keepdims=True))
    fans = np.bincount(vertex, minlength=count)
    # Two creases, both convex or both concave, that leave in about opposite directions.
    passing = (
        (fans == 2)
        & (np.abs(sense) == 2)
        & (np.linalg.norm(direction, axis=1) < 2 * (1 - np.cos(_STRAIGHT)))
    )
    code = np.where(fans <= 1, 0.0, np.where(passing, np.sign(sense), 2.0))
    # With two fans, the other one is the sum less this one.
    fan = np.arange(len(vertex))
    both = np.bincount(vertex, weights=fan).astype(np.int64)[vertex]
    return code, np.where(fans[vertex] == 2, both - fan, fan)
