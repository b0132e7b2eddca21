"""Smooth curves through way-points, walked at constant speed."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

_ROUNDING = 1e-13
_CELLS = 32
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_ITERATIONS = 60


def along_spline(
    points: Float[np.ndarray, "k 3"], turns: Float[np.ndarray, "k 4"], count: int
) -> tuple[Float[np.ndarray, "count 3"], Float[np.ndarray, "count 4"]]:
    """Poses equally spaced in arc length on the cubic spline through way-points, over the length of
    their chords; turns by SciPy's `RotationSpline`.

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
            f"points[{int(np.argmin(chords)) + 1}] is the way-point before it; allowed are successive points that differ"
        )
    knots = np.concatenate([[0.0], np.cumsum(chords)]) / chords.sum()
    curve = CubicSpline(knots, points)
    parameter = _equally_spaced(curve, count)
    return curve(parameter), RotationSpline(knots, Rotation.from_quat(turns))(parameter).as_quat()


def _equally_spaced(curve: CubicSpline, count: int) -> Float[np.ndarray, "count"]:
    """Parameters at which the curve has gone equal shares of its length: Newton's method, bracketed
    by cells of known length.
    """
    velocity = curve.derivative()

    def gone(start: np.ndarray, stop: np.ndarray) -> np.ndarray:
        half = (stop - start) / 2
        at = (start + half)[:, None] + half[:, None] * _NODES
        return half * (np.linalg.norm(velocity(at), axis=-1) @ _WEIGHTS)

    grid = np.unique(np.linspace(curve.x[:-1], curve.x[1:], _CELLS + 1))
    length = np.concatenate([[0.0], np.cumsum(gone(grid[:-1], grid[1:]))])
    target = np.linspace(0, length[-1], count)
    cell = np.clip(np.searchsorted(length, target, side="right") - 1, 0, len(grid) - 2)
    start, low, high = grid[cell], grid[cell], grid[cell + 1]
    parameter = low + (high - low) * (target - length[cell]) / (length[cell + 1] - length[cell])
    for _ in range(_ITERATIONS):
        miss = length[cell] + gone(start, parameter) - target
        if np.abs(miss).max() <= _ROUNDING * length[-1]:
            break
        low, high = np.where(miss < 0, parameter, low), np.where(miss < 0, high, parameter)
        speed = np.linalg.norm(velocity(parameter), axis=-1)
        newton = parameter - np.divide(miss, speed, out=np.full(count, np.inf), where=speed > 0)
        parameter = np.where((newton >= low) & (newton <= high), newton, (low + high) / 2)
    parameter[0] = curve.x[0]
    if count > 1:
        parameter[-1] = curve.x[-1]
    return parameter
