"""Triangles of an object within a box, to be drawn."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from vibrissa.libraries import extra_library
from vibrissa.surfaces.base import Placed, Surface
from vibrissa.surfaces.mesh import Mesh
from vibrissa.surfaces.primitives import Box, Cone, Cylinder

_CELLS = 90
"""Cells along the longest side of a box: smooth at the size of a page."""
_SECTIONS = 180
"""Sides of a drawn circle."""
_COARSE = 48
"""Cells along the side of a cube in which a part of an object is looked for."""

Triangles = Float[np.ndarray, "f 3 3"]


def outline(surface: Surface, low: ArrayLike, high: ArrayLike) -> tuple[Triangles, Triangles]:
    """Triangles of an object: those of its own faces if it has edges, else of its zero level within
    a box, closed where the box cuts it.

    Parameters
    ----------
    surface
        Any object.
    low, high
        Least and largest coordinates (3,) of the box.

    Returns
    -------
    tuple
        Corners (f, 3, 3) of the triangles of the object's own surface, and of the cuts.

    Raises
    ------
    ImportError
        If the libraries of `vibrissa[mesh]` are not installed.
    """
    own = _own_faces(surface)
    if own is not None:
        return np.array(own.triangles), np.zeros((0, 3, 3))
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    cells = np.maximum(np.ceil(_CELLS * (high - low) / (high - low).max()), 1)
    cell = (high - low) / cells
    # Half a cell beyond the box on each side, so that its faces lie between two points.
    counts = cells.astype(int) + 2
    grid = _grid(low - cell / 2, high + cell / 2, counts)
    beyond = np.max(np.maximum(low - grid, grid - high), axis=-1)
    values = np.maximum(surface.levels(grid), beyond)
    igl = extra_library("igl", extra="mesh", need="drawing an object needs it")
    flat = (part.reshape(-1, *part.shape[3:], order="F") for part in (values, grid))
    corners, faces, _ = igl.marching_cubes(*map(np.ascontiguousarray, flat), *map(int, counts))
    triangles: Triangles = corners[faces]
    centers = triangles.mean(axis=1)
    cut = np.min(np.minimum(centers - low, high - centers) / cell, axis=1) < 1e-3
    return triangles[~cut], triangles[cut]


def box_of(
    surface: Surface, points: Float[np.ndarray, "n 3"], reach: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Least and largest coordinates of a box that shows what was touched of an object.

    On each side it holds the whole object where that ends within `reach` of the points, else what
    lies within an eighth of `reach` of them.
    """
    near_low, near_high = points.min(axis=0), points.max(axis=0)
    low, high = near_low - reach, near_high + reach
    inside = surface.levels(_grid(low, high, np.full(3, _COARSE))) <= 0
    cell = (high - low) / (_COARSE - 1)
    for axis in range(3):
        other = tuple(k for k in range(3) if k != axis)
        filled = np.flatnonzero(inside.any(axis=other))
        first, last = (filled[0], filled[-1]) if len(filled) else (0, _COARSE - 1)
        near = near_low[axis] - reach / 8, near_high[axis] + reach / 8
        begin, end = low[axis], low[axis]
        low[axis] = begin + (first - 1) * cell[axis] if first > 0 else near[0]
        high[axis] = end + (last + 1) * cell[axis] if last < _COARSE - 1 else near[1]
    return low, high


def _grid(low: Any, high: Any, counts: Int[np.ndarray, "3"]) -> Float[np.ndarray, "i j k 3"]:
    ticks = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    return np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1)


def _own_faces(surface: Surface) -> Any:
    """Triangle mesh of an object whose edges a grid would blur, or None."""
    if isinstance(surface, Placed):
        inner, motion = _own_faces(surface.surface), np.eye(4)
        motion[:3, :3], motion[:3, 3] = surface.rotation, surface.translation
        return None if inner is None else inner.apply_transform(motion)
    if not isinstance(surface, Mesh | Box | Cylinder | Cone):
        return None
    trimesh = extra_library("trimesh", extra="mesh", need="drawing an object needs it")
    create = trimesh.creation
    if isinstance(surface, Mesh):
        return trimesh.Trimesh(surface.vertices, surface.faces, process=False)
    if isinstance(surface, Box):
        sides = 2 * np.asarray(surface.half_extents)
        return create.box(sides).apply_translation(surface.center)
    if isinstance(surface, Cylinder):
        upright = create.cylinder(float(surface.radius), float(surface.length), sections=_SECTIONS)
    else:
        upright = create.cone(float(surface.radius), float(surface.height), sections=_SECTIONS)
    turned = upright.apply_transform(trimesh.geometry.align_vectors((0, 0, 1), surface.axis))
    return turned.apply_translation(surface.center)
