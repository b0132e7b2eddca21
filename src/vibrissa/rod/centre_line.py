"""Centre lines at rest: curvature of a curve through points, points of a curve of given curvature,
and whether it meets itself.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

_LEAST_POINTS, _FOR_QUINTIC = 4, 6
_CELLS = 256
"""Least number of cells of the spline of curvature: 1e-9 of the curvature of a parabola that turns
by 60°.
"""
_GAUSS, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_STEEPEST = np.radians(5.0)
_APART = 0.01
"""Of the length: what the first point may be off the clamp."""
_STEPS = 512
"""Straight pieces of a centre line that is searched for loops."""
_CROSSING = 1e-6
"""Of the length: distance at which thin rods touch; the pieces are off the curve by less."""


def curvature_along(
    points: Float[np.ndarray, "k 3"],
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 3"]]:
    """Arc lengths (n,) and curvatures without twist (n, 3) of a spline through points; errors as
    in `RestShape.from_points`.
    """
    if len(points) < _LEAST_POINTS:
        raise ValueError(
            f"points has shape {points.shape}; allowed are at least {_LEAST_POINTS} points (k, 3)"
        )
    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if not np.all(chords > 0):
        raise ValueError(
            f"points[{int(np.argmin(chords)) + 1}] equals the point before it; "
            "allowed are successive points that differ"
        )
    if np.linalg.norm(points[0]) > _APART * chords.sum():
        raise ValueError(
            f"points[0] = {points[0].tolist()}; allowed is (0, 0, 0): the first is at the clamp"
        )
    knots = np.concatenate([[0.0], np.cumsum(chords)])
    curve = make_interp_spline(knots, points, k=5 if len(points) >= _FOR_QUINTIC else 3)
    fine = -(-_CELLS // len(chords))
    t = np.unique(np.linspace(knots[:-1], knots[1:], fine + 1))
    half = np.diff(t)[:, None] / 2
    speeds = np.linalg.norm(curve(t[:-1, None] + half * (1 + _GAUSS), 1), axis=-1)
    s = np.concatenate([[0.0], np.cumsum(half[:, 0] * (speeds @ _WEIGHTS))])
    velocity, bend = curve(t, 1), curve(t, 2)
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    tangent = velocity / speed
    # The vector of curvature without twist, t × t'.
    vector = np.cross(tangent, bend) / speed**2
    turn = _to_axis(tangent[0])
    tangent, vector, place = (each @ turn.T for each in (tangent, vector, curve(t)))
    first = _untwisted(place, tangent)
    second = np.cross(tangent, first)
    u = np.stack([np.sum(vector * first, 1), np.sum(vector * second, 1), np.zeros(len(s))], axis=1)
    return s, u


def _to_axis(tangent: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """The smallest turn that takes a tangent to +z."""
    off = np.arctan2(np.hypot(*tangent[:2]), tangent[2])
    if off > _STEEPEST:
        raise ValueError(
            f"points leave the clamp along {np.round(tangent, 4).tolist()}, "
            f"{np.degrees(off):.3g}° off its axis; allowed are clamp axes, in which the rod leaves "
            "along +z within 5°"
        )
    axis = np.cross(tangent, [0.0, 0.0, 1.0])
    size = np.linalg.norm(axis)
    return np.asarray(Rotation.from_rotvec(axis * (off / size if size else 0.0)).as_matrix())


def _untwisted(
    place: Float[np.ndarray, "n 3"], tangent: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """D₁ along a curve, x at the clamp, without rotation about the tangent: double reflection (W.
    Wang et al., ACM Transactions on Graphics 27 (2008) 2), of order 4.
    """
    first = np.zeros_like(place)
    first[0] = (1.0, 0.0, 0.0)
    for i, step in enumerate(np.diff(place, axis=0)):
        square = step @ step
        moved = first[i] - 2 / square * (step @ first[i]) * step
        turned = tangent[i] - 2 / square * (step @ tangent[i]) * step
        gap = tangent[i + 1] - turned
        size = gap @ gap
        first[i + 1] = moved - (2 / size * (gap @ moved) * gap if size else 0.0)
    return first


def centre_line(
    curvature: Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "n 3"]],
    length: float,
    steps: int = _STEPS,
) -> Float[np.ndarray, "steps_1 3"]:
    """Points of the curve from the clamp at 0 along +z: Magnus steps of order 4 (A. Iserles et al.,
    Acta Numerica 9 (2000) 215) for the axes, and their exact helix for the place.
    """
    h = length / steps
    middle = (np.arange(steps) + 0.5) * h
    gauss = h / np.sqrt(12)
    u, v = curvature(middle - gauss), curvature(middle + gauss)
    turn = Rotation.from_rotvec(h * (u + v) / 2 + h * h / np.sqrt(48) * np.cross(u, v))
    half = Rotation.from_rotvec(turn.as_rotvec() / 2)
    axes, points = Rotation.identity(), np.zeros((steps + 1, 3))
    sine = turn.magnitude() / 2
    chord = h * np.sinc(sine / np.pi)
    for i in range(steps):
        points[i + 1] = points[i] + chord[i] * (axes * half[i]).apply([0.0, 0.0, 1.0])
        axes = axes * turn[i]
    return points


def check_free(
    curvature: Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "n 3"]],
    length: float,
    radius: float,
) -> None:
    """Raise ValueError if a rod of this centre line and radius touches itself."""
    s = np.linspace(0, length, _STEPS + 1)
    size = np.linalg.norm(curvature(s)[:, :2], axis=1)
    if size.max() * radius >= 1:
        raise ValueError(
            f"rest: curvature {size.max():.3g} at radius {radius:g}; allowed is less than "
            f"{1 / radius:.3g}"
        )
    # What turns by less than half a turn in all does not come back to itself.
    if np.trapezoid(size, s) < np.pi:
        return
    points = centre_line(curvature, length)
    if (met := _meeting(points, length, radius)) is not None:
        raise ValueError(
            f"rest: the rod touches itself at arc lengths {met[0]:.3g} and {met[1]:.3g} of "
            f"{length:g}; allowed is a curvature without a loop"
        )


def _meeting(
    points: Float[np.ndarray, "n 3"], length: float, radius: float
) -> tuple[float, float] | None:
    """Arc lengths [m] at which a rod of this centre line touches itself, or None."""
    n = len(points) - 1
    h = length / n
    reach = max(2 * radius, _CROSSING * length)
    # Closer along the rod than half a turn of its own radius, it is the same stretch of rod.
    apart = int(np.ceil(np.pi / 2 * reach / h)) + 2
    middles = (points[1:] + points[:-1]) / 2
    i, j = np.triu_indices(n, apart)
    near = np.linalg.norm(middles[i] - middles[j], axis=1) <= reach + 1.5 * h
    i, j = i[near], j[near]
    if not len(i):
        return None
    gaps = _between(points[i], points[i + 1], points[j], points[j + 1])
    at = int(np.argmin(gaps))
    return (float(i[at] * h), float(j[at] * h)) if gaps[at] <= reach else None


def _between(
    a: Float[np.ndarray, "m 3"],
    b: Float[np.ndarray, "m 3"],
    c: Float[np.ndarray, "m 3"],
    d: Float[np.ndarray, "m 3"],
) -> Float[np.ndarray, "m"]:
    """Distance of segments ab and cd (C. Ericson, Real-Time Collision Detection, sec. 5.1.9)."""
    u, v, w = b - a, d - c, a - c
    uu, vv, uv = (np.sum(x * y, 1) for x, y in ((u, u), (v, v), (u, v)))
    uw, vw = np.sum(u * w, 1), np.sum(v * w, 1)
    area = uu * vv - uv * uv
    s = np.clip(np.where(area > 0, (uv * vw - vv * uw) / np.where(area > 0, area, 1.0), 0.0), 0, 1)
    t = np.clip((uv * s + vw) / vv, 0.0, 1.0)
    s = np.clip((uv * t - uw) / uu, 0.0, 1.0)
    return np.asarray(np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1))
