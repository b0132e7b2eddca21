"""The same solids once more, without JAX: membership by inequalities, distance to thousands of
points of the outline.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from vibrissa import surfaces
from vibrissa.surfaces import Surface

CENTER = np.array([0.1, -0.2, 0.9])
AXIS = np.array([2.0, -1.0, 2.0]) / 3
HALF = np.array([0.5, 0.3, 0.2])


class Solid(NamedTuple):
    """A surface; whether points (k, 3) are in it; unsigned distances (k,) by brute force; and
    places (j, 3) on it that are special.
    """

    surface: Surface
    inside: Callable[[np.ndarray], np.ndarray]
    distance: Callable[[np.ndarray], np.ndarray]
    places: np.ndarray


def in_meridian(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the axis and height along it."""
    offset = points - CENTER
    z = offset @ AXIS
    return np.linalg.norm(offset - z[:, None] * AXIS, axis=1), z


def from_outline(*pieces: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Distance to a body of revolution, whose closest point lies in the meridian of the point: to
    the outline (ρ, z) there, in 40 001 points a piece.

    Between two of them, s apart, the distance d is too large by at most s²/(8 d).
    """
    tree = cKDTree(np.concatenate(pieces))
    return lambda points: tree.query(np.column_stack(in_meridian(points)))[0]


def segment(first: tuple[float, float], last: tuple[float, float]) -> np.ndarray:
    return np.linspace(first, last, 40_001)


def arc(center: tuple[float, float], radius: float, start: float, stop: float) -> np.ndarray:
    angle = np.linspace(start, stop, 40_001)
    return np.array(center) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def to_box(points: np.ndarray) -> np.ndarray:
    """Distance to the nearest of six rectangles."""
    offset = points - CENTER
    nearest = np.full(len(points), np.inf)
    for axis in range(3):
        for side in (-1, 1):
            foot = np.clip(offset, -HALF, HALF)
            foot[:, axis] = side * HALF[axis]
            nearest = np.minimum(nearest, np.linalg.norm(offset - foot, axis=1))
    return nearest


def around(rho: float, z: float, angles: int = 5) -> np.ndarray:
    """Points at one radius and height."""
    first = np.cross(AXIS, [1.0, 0, 0])
    first /= np.linalg.norm(first)
    second = np.cross(AXIS, first)
    angle = np.linspace(0, 2 * np.pi, angles, endpoint=False)[:, None]
    return CENTER + z * AXIS + rho * (np.cos(angle) * first + np.sin(angle) * second)


_CORNERS = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
R, L = 0.3, 0.8
MAJOR, MINOR = 0.5, 0.2


def _cylinder(points: np.ndarray) -> np.ndarray:
    rho, z = in_meridian(points)
    return (rho < R) & (np.abs(z) < L / 2)


def _capsule(points: np.ndarray) -> np.ndarray:
    rho, z = in_meridian(points)
    return np.hypot(rho, np.maximum(np.abs(z) - L / 2, 0)) < R


def _cone(points: np.ndarray) -> np.ndarray:
    rho, z = in_meridian(points)
    return (z > 0) & (rho / R + z / L < 1)


def _torus(points: np.ndarray) -> np.ndarray:
    rho, z = in_meridian(points)
    return (rho - MAJOR) ** 2 + z**2 < MINOR**2


SOLIDS = {
    "box": Solid(
        surfaces.Box(CENTER, HALF),
        lambda p: np.all(np.abs(p - CENTER) < HALF, axis=1),
        to_box,
        CENTER + HALF * _CORNERS[np.any(_CORNERS != 0, axis=1)],
    ),
    "cylinder": Solid(
        surfaces.Cylinder(CENTER, 3 * AXIS, R, L),
        _cylinder,
        from_outline(
            segment((0, -L / 2), (R, -L / 2)),
            segment((R, -L / 2), (R, L / 2)),
            segment((R, L / 2), (0, L / 2)),
        ),
        np.concatenate(
            [around(R, 0.0), around(R, L / 2), around(0.1, -L / 2), around(0, L / 2, 1)]
        ),
    ),
    "capsule": Solid(
        surfaces.Capsule(CENTER, AXIS, R, L),
        _capsule,
        from_outline(
            segment((R, -L / 2), (R, L / 2)),
            arc((0, L / 2), R, 0, np.pi / 2),
            arc((0, -L / 2), R, -np.pi / 2, 0),
        ),
        np.concatenate(
            [around(R, 0.0), around(R, L / 2), around(0, L / 2 + R, 1), around(0, -L / 2 - R, 1)]
        ),
    ),
    "cone": Solid(
        surfaces.Cone(CENTER, AXIS, R, L),
        _cone,
        from_outline(segment((0, 0), (R, 0)), segment((R, 0), (0, L))),
        np.concatenate([around(R, 0.0), around(R / 2, L / 2), around(R / 2, 0), around(0, 0, 1)]),
    ),
    "torus": Solid(
        surfaces.Torus(CENTER, AXIS, MAJOR, MINOR),
        _torus,
        from_outline(arc((MAJOR, 0), MINOR, 0, 2 * np.pi)),
        np.concatenate([around(MAJOR + MINOR, 0), around(MAJOR - MINOR, 0), around(MAJOR, MINOR)]),
    ),
}
