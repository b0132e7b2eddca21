"""Triangles of an object within a box, to be drawn."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy.typing import ArrayLike

from vibrissa.libraries import extra_library
from vibrissa.surfaces.base import Placed, Surface
from vibrissa.surfaces.derived import Union
from vibrissa.surfaces.mesh import Mesh
from vibrissa.surfaces.primitives import Box, Cone, Cylinder
from vibrissa.surfaces.quadrics import EllipticParaboloid

_CELLS = 90
"""Cells along the longest side of a box, and half the sides of a circle: smooth on a page."""
_COARSE = 48
"""Cells along the side of a cube in which a part of an object is looked for."""
_SEARCHES = 8
"""Cubes, each a quarter of the one before: the last has cells of 1e-6 of the first."""

Triangles = Float[np.ndarray, "f 3 3"]
Vector = Float[np.ndarray, "3"]


def outline(surface: Surface, low: ArrayLike, high: ArrayLike) -> Triangles:
    """Triangles of an object's surface within a box, open where the box cuts it.

    They are the object's own faces if it has edges and lies within the box, else those of its zero
    level on a grid.

    Parameters
    ----------
    surface
        Any object.
    low, high
        Least and largest coordinates (3,) of the box.

    Returns
    -------
    np.ndarray
        Their corners (f, 3, 3).

    Raises
    ------
    ImportError
        If the libraries of `vibrissa[mesh]` are not installed; an elliptic paraboloid needs none.
    """
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    if isinstance(surface, EllipticParaboloid) and min(surface.a, surface.b) > 0:
        return _bowl(surface, float(high[2]))
    own = _own_faces(surface)
    if own is not None and np.all(own.bounds >= low) and np.all(own.bounds <= high):
        return np.array(own.triangles)
    counts = np.ceil(_CELLS * (high - low) / (high - low).max()).astype(int) + 2
    grid = _grid(low, high, counts)
    igl = extra_library("igl", extra="mesh", need="drawing an object needs it")
    levels = surface.levels(grid)
    flat = (part.reshape(-1, *part.shape[3:], order="F") for part in (levels, grid))
    corners, faces, _ = igl.marching_cubes(*map(np.ascontiguousarray, flat), *map(int, counts))
    triangles: Triangles = corners[faces]
    return triangles


def box_of(
    surface: Surface, points: Float[np.ndarray, "n 3"], reach: float, beyond: float
) -> tuple[Vector, Vector] | None:
    """Least and largest coordinates of a box that shows an object and some points on it.

    It holds all of the object that ends within `reach` of the points, and what lies up to `beyond`
    from them on a side where it does not; None if nothing of it is found.
    """
    if isinstance(surface, Union):
        each = [box_of(part, points, reach, beyond) for part in surface.parts]
        boxes = [box for box in each if box is not None]
        ends = np.array(boxes)
        return (ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)) if boxes else None
    near_low, near_high = points.min(axis=0), points.max(axis=0)
    # The coarse grid of a large box misses a small object.
    for away in reach / 4.0 ** np.arange(_SEARCHES):
        low, high = near_low - away, near_high + away
        found = _extent(surface, low, high)
        if found is not None:
            break
    else:
        return None
    cut_low, cut_high = found[0] <= low, found[1] >= high
    low = np.where(cut_low, np.minimum(near_low, found[1]) - beyond, found[0])
    high = np.where(cut_high, np.maximum(near_high, found[0]) + beyond, found[1])
    # What is cut on one side may be smaller on the others.
    within = _extent(surface, low, high) or (low, high)
    low = np.where(cut_low, low, np.minimum(within[0], near_low))
    return low, np.where(cut_high, high, np.maximum(within[1], near_high))


def _extent(surface: Surface, low: Vector, high: Vector) -> tuple[Vector, Vector] | None:
    """Least and largest coordinates of an object within a box; None if a coarse grid misses it."""
    own = _own_faces(surface)
    if own is not None:
        ends = np.maximum(own.bounds[0], low), np.minimum(own.bounds[1], high)
        return ends if np.all(ends[0] < ends[1]) else None
    inside = surface.levels(_grid(low, high, np.full(3, _COARSE))) <= 0
    if not inside.any():
        return None
    ticks, sides = np.linspace(low, high, _COARSE), np.array([low, high])
    for axis in range(3):
        filled = np.flatnonzero(inside.any(axis=tuple(k for k in range(3) if k != axis)))
        # The surface ends before the next point, or, bulging between points, before the one after.
        first, last = max(filled[0] - 2, 0), min(filled[-1] + 2, _COARSE - 1)
        sides[:, axis] = ticks[[first, last], axis]
    return sides[0], sides[1]


def _grid(low: Vector, high: Vector, counts: Int[np.ndarray, "3"]) -> Float[np.ndarray, "i j k 3"]:
    ticks = [np.linspace(a, b, n) for a, b, n in zip(low, high, counts, strict=True)]
    return np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1)


def _bowl(surface: EllipticParaboloid, top: float) -> Triangles:
    """Rings of an elliptic paraboloid up to a height, spaced as their radii."""
    a, b, h = float(surface.a), float(surface.b), float(surface.h)
    radius, turn = np.meshgrid(
        np.linspace(0, np.sqrt(max(top - h, 0)), _CELLS // 2),
        np.linspace(0, 2 * np.pi, 2 * _CELLS + 1),
        indexing="ij",
    )
    x, y = radius * np.cos(turn) / np.sqrt(a), radius * np.sin(turn) / np.sqrt(b)
    corners = np.stack([x, y, h + radius**2], axis=-1)
    inner, outer = corners[:-1], corners[1:]
    quads = [inner[:, :-1], outer[:, :-1], outer[:, 1:], inner[:, 1:]]
    halves = [np.stack([quads[k] for k in half], axis=2) for half in ((0, 1, 2), (0, 2, 3))]
    return np.concatenate(halves).reshape(-1, 3, 3)


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
        round_part = float(surface.radius), float(surface.length)
        upright = create.cylinder(*round_part, sections=2 * _CELLS)
    else:
        round_part = float(surface.radius), float(surface.height)
        upright = create.cone(*round_part, sections=2 * _CELLS)
    turned = upright.apply_transform(trimesh.geometry.align_vectors((0, 0, 1), surface.axis))
    return turned.apply_translation(surface.center)
