"""Smooth curves through way-points, traversed at constant speed."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.optimize.elementwise import find_root
from scipy.spatial.transform import Rotation, RotationSpline

_CELLS = 32
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)


def along_spline(
    points: Float[np.ndarray, "k 3"], turns: Float[np.ndarray, "k 4"], count: int
) -> tuple[Float[np.ndarray, "count 3"], Float[np.ndarray, "count 4"]]:
    """Poses equally spaced in arc length on the cubic spline through way-points, parametrised by
    chord length; orientations by SciPy's `RotationSpline`.

    Raises
    ------
    ValueError
        If there are fewer than two points, or two successive ones coincide.
    """
    if len(points) < 2:
        raise ValueError(
            f"points has shape {points.shape}; allowed are at least two way-points (k, 3)"
        )
    chords = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    if not np.all(chords > 0):
        raise ValueError(
            f"points[{int(np.argmin(chords)) + 1}] equals the way-point before it; "
            "allowed are successive points that differ"
        )
    knots = np.concatenate([[0.0], np.cumsum(chords)]) / chords.sum()
    curve = CubicSpline(knots, points)
    parameter = _equally_spaced(curve, count)
    return curve(parameter), RotationSpline(knots, Rotation.from_quat(turns))(parameter).as_quat()


def _equally_spaced(curve: CubicSpline, count: int) -> Float[np.ndarray, "count"]:
    """Parameters that divide the curve into equal lengths."""
    velocity = curve.derivative()

    def gone(stop: np.ndarray, start: np.ndarray) -> np.ndarray:
        half = (stop - start) / 2
        at = (start + half)[..., None] + half[..., None] * _NODES
        return half * (np.linalg.norm(velocity(at), axis=-1) @ _WEIGHTS)

    grid = np.unique(np.linspace(curve.x[:-1], curve.x[1:], _CELLS + 1))
    length = np.concatenate([[0.0], np.cumsum(gone(grid[1:], grid[:-1]))])
    target = np.linspace(0, length[-1], count)
    cell = np.clip(np.searchsorted(length, target, side="right") - 1, 0, len(grid) - 2)
    start = grid[cell]
    missing = target - length[cell]
    found = find_root(
        lambda stop, start, missing: gone(stop, start) - missing,
        (start, grid[cell + 1]),
        args=(start, missing),
    )
    return np.where(found.success, found.x, np.where(missing > 0, grid[cell + 1], start))
