"""Offset between the clocks of wrenches and poses, estimated from the data: reactions are constant
while the clamp is at rest, and the same each time it passes the same place.

In a quasi-static sweep the reactions are a function of the pose. In short windows that function is
fitted along the main direction of motion, by splines, for each trial offset; the right offset
leaves the smallest residual. A window of constant speed fits equally well with any offset (the
object is then merely found shifted along the trail), so only stops, starts and turns under load
carry information.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BSpline
from scipy.linalg import solve
from scipy.optimize import brentq, minimize_scalar
from scipy.signal import savgol_filter
from scipy.sparse import csr_array
from scipy.spatial.transform import Rotation

from vibrissa.io.recordings.streams import Poses, Wrenches
from vibrissa.sensor.raw import Times

Channels = Float[np.ndarray, "n 6"]
Columns = Float[np.ndarray, "n k"]

# Rotations count as the path of a point at this distance [m], a few rod lengths.
_LEVER = 0.1
# Bounds on the work for long recordings.
_MOST_ROWS, _MOST_WINDOWS, _MOST_STRETCHES, _MOST_PIECES = 1000, 40, 2000, 60
# Fewer rows in a window do not determine a function of the pose.
_FEWEST_ROWS = 30
# Ridge, relative to the largest entry of the normal equations: well below the noise, well above
# rounding.
_RIDGE = 1e-9
# Knot spacing in rod lengths: finer than the scale on which reactions change along a sweep.
_PITCH = 0.02
# [s], so that a stop or turn and its surroundings lie in one window.
_SHORTEST_WINDOW = 2.0
# Each window shares half of its rows with each neighbour, so each row counts twice.
_OVERLAP = 2
# Trial offsets before the deepest minima are refined, and the number of minima.
_STEPS, _MOST_MINIMA = 201, 12
# Log-likelihood ratio; chance alone gives about 5 among 201 offsets, ln 201.
_EVIDENCE = 12.0
# Fraction of the largest offset at which the search for the standard error begins.
_FINEST = 1e-5
# In units of the pose noise: less motion than this counts as standing still.
_STANDING = 8.0
# Time [s] and steps over which a speed is taken, and the fraction of a fast speed that is slow.
_MOMENT, _FEWEST_STEPS, _SLOW = 0.05, 4, 0.1
_UNDETERMINED = (
    "the data do not determine it: the clamp does not stop, start or turn under load; "
    "allowed is a number of seconds, or a recording in which it does"
)


class ClockOffset(NamedTuple):
    """Offset to add to the stamps of the poses.

    Attributes
    ----------
    seconds
        [s].
    standard_error
        [s]; None if the offset was given.
    """

    seconds: float
    standard_error: float | None


def estimated_offset(wrench: Wrenches, pose: Poses, largest: float, scale: float) -> ClockOffset:
    """Offset that makes the reactions most nearly a function of the pose, with its standard error.

    The standard error comes from the profile likelihood, with the number of independent samples
    that the residuals' correlation leaves. It does not cover friction, which reverses with the
    motion, or a wire that is still vibrating.

    Parameters
    ----------
    wrench, pose
        On their own clocks; poses valid and in order.
    largest
        Bound on the offset [s].

    Raises
    ------
    ValueError
        If the streams hardly overlap, or the data do not determine the offset: no change of speed
        under load, several offsets equally good, or the best one at the bound.
    """
    windows = _windows(wrench, pose, largest, scale)
    if not windows:
        raise ValueError(_UNDETERMINED)
    offsets, step = np.linspace(-largest, largest, _STEPS, retstep=True)
    spreads = np.array([_fits(windows, offset)[0] for offset in offsets])
    weights = _fits(windows, float(offsets[np.argmin(spreads.sum(axis=(1, 2)))]))[1]
    misfit = np.einsum("twc,wc->t", spreads, weights)

    def cost(offset: float) -> float:
        return float(np.sum(weights * _fits(windows, offset)[0]))

    (least, seconds), *others = _lowest(cost, offsets, misfit, float(step))
    error = _standard_error(cost, seconds, largest)
    if error > largest / 10 or np.median(misfit) - least < _EVIDENCE:
        raise ValueError(_UNDETERMINED)
    for value, rival in others:
        if value - least < _EVIDENCE and abs(rival - seconds) > 6 * error + step / 10:
            raise ValueError(
                f"the data do not determine it: {seconds:.4f} s and {rival:.4f} s explain them "
                "equally well; allowed is a number of seconds, or a smaller largest_offset"
            )
    if abs(seconds) > largest - 3 * error - step:
        raise ValueError(
            f"the data do not determine it within largest_offset = {largest:g} s, whose bound "
            "fits best; allowed is a larger one, or a number of seconds"
        )
    return ClockOffset(seconds, error)


def _lowest(
    cost: Callable[[float], float],
    offsets: Times,
    misfit: Times,
    step: float,
) -> list[tuple[float, float]]:
    """Misfit and offset of the deepest minima, lowest first."""
    higher = np.pad(misfit, 1, constant_values=np.inf)
    minima = np.flatnonzero((misfit <= higher[:-2]) & (misfit <= higher[2:]))
    found = []
    for at in offsets[minima[np.argsort(misfit[minima])][:_MOST_MINIMA]]:
        bounds, options = (at - step, at + step), {"xatol": 1e-3 * step}
        best = minimize_scalar(cost, bounds=bounds, method="bounded", options=options)
        found.append((float(best.fun), float(best.x)))
    return sorted(found)


def _standard_error(cost: Callable[[float], float], at: float, largest: float) -> float:
    """Half the distance at which the misfit has risen by 2 (two standard deviations of a normal
    error), on the side where that is farther; infinite beyond the largest offset.
    """
    least, reaches = cost(at), []
    for side in (-1, 1):

        def rise(distance: float, side: int = side) -> float:
            return cost(at + side * distance) - least - 2

        outside = _FINEST * largest
        while rise(outside) < 0:
            outside *= 2
            if outside > largest:
                return float("inf")
        reaches.append(brentq(rise, 0, outside, xtol=0.01 * outside))
    return max(reaches) / 2


class _Window(NamedTuple):
    """Wrenches in an interval, and the clamp's path along the main direction of its motion there,
    with its own stamps.
    """

    time: Times
    values: Channels
    way_time: Times
    way: Times
    floor: Float[np.ndarray, "6"]
    pitch: float
    still: float


def _windows(wrench: Wrenches, pose: Poses, largest: float, scale: float) -> list[_Window]:
    """Intervals in which the clamp stops or reverses, each with poses that extend beyond its ends
    by the largest offset.
    """
    first, last = (pose.time[0], pose.time[-1]) if len(pose.time) > _FEWEST_STEPS else (0.0, 0.0)
    sound = np.isfinite(wrench.channels).all(axis=1)
    sound &= (wrench.time > first + largest) & (wrench.time < last - largest)
    rows = wrench.rows(sound)
    if len(rows.time) < 2 * _FEWEST_ROWS:
        raise ValueError(
            f"only {len(rows.time)} wrenches have poses {largest:g} s before and after; "
            "allowed is a smaller largest_offset, or a longer recording"
        )
    features, channels = _features(pose), rows.channels
    floor, pitch = 0.1 * _noise(channels), _PITCH * scale
    fast = float(np.quantile(np.linalg.norm(_speeds(pose.time, features), axis=1), 0.9))
    still = _STANDING * float(np.linalg.norm(_noise(features)))
    length = max(_SHORTEST_WINDOW, 4 * largest)
    step = max(length / _OVERLAP, float(np.ptp(rows.time)) / _MOST_STRETCHES)
    found = []
    for start in np.arange(rows.time[0], rows.time[-1], step):
        part = slice(*np.searchsorted(rows.time, (start, start + length)))
        near = slice(*np.searchsorted(pose.time, (start - largest, start + length + largest)))
        time, way_time = rows.time[part], pose.time[near]
        if min(len(time), len(way_time)) < _FEWEST_ROWS:
            continue
        # Coordinate along the direction of greatest spread.
        spread = features[near] - features[near].mean(axis=0)
        way = spread @ np.linalg.svd(spread, full_matrices=False)[2][0]
        if _comes_back(way_time, way, fast):
            # Average groups of rows, large enough to keep their number below a bound.
            each = -(-len(time) // _MOST_ROWS)
            table = np.column_stack([time, channels[part]])[: len(time) // each * each]
            table = table.reshape(-1, each, 7).mean(axis=1)
            found.append(_Window(table[:, 0], table[:, 1:], way_time, way, floor, pitch, still))
    chosen = np.linspace(0, len(found) - 1, min(len(found), _MOST_WINDOWS)).round().astype(int)
    return [found[index] for index in chosen]


def _noise(values: Columns) -> Float[np.ndarray, "k"]:
    """Standard deviation of white noise (k,), from second differences, to which smooth motion
    contributes little.
    """
    return np.sqrt(np.mean(np.diff(values, 2, axis=0) ** 2, axis=0) / 6)


def _features(pose: Poses) -> Channels:
    """Positions, and rotations times a lever of 0.1 m: twice the vector part of the quaternion of
    canonical sign, relative to the first pose. Both are smoothed by parabolas through nine
    neighbours; otherwise encoder noise makes the minimum jump from stamp to stamp.
    """
    turns = Rotation.from_quat(pose.orientation)
    relative = (turns[0].inv() * turns).as_quat(canonical=True)
    features = np.hstack([pose.position - pose.position[0], 2 * _LEVER * relative[:, :3]])
    return savgol_filter(features, 9, 2, axis=0) if len(features) >= 9 else features


def _speeds(time: Times, features: Columns) -> Columns:
    """Mean velocities over 0.05 s or four steps, whichever is longer."""
    lag = min(max(_FEWEST_STEPS, round(_MOMENT / float(np.median(np.diff(time))))), len(time) - 1)
    return (features[lag:] - features[:-lag]) / (time[lag:] - time[:-lag])[:, None]


def _comes_back(time: Times, way: Times, fast: float) -> bool:
    """Whether the clamp moves and is at some place more than once: it stands still for a while, or
    retraces part of its path.
    """
    speed = _speeds(time, way[:, None])[:, 0] / fast
    forth, back = np.sum(speed[speed > _SLOW]), -np.sum(speed[speed < -_SLOW])
    standing = np.count_nonzero(np.abs(speed) < _SLOW) / len(speed)
    return bool(0.02 < standing < 0.98 or min(forth, back) > 0.1 * max(forth, back))


def _fits(windows: list[_Window], offset: float) -> tuple[Channels, Channels]:
    """For each window and channel, of the residuals from a function of the pose: half the logarithm
    of their variance, and the number of independent samples, reduced where neighbouring residuals
    are correlated.
    """
    spreads, weights = [], []
    for window in windows:
        along = np.interp(window.time - offset, window.way_time, window.way)
        basis = _pieces(along, window.pitch, window.still)
        gram = (basis.T @ basis).toarray()
        free = len(along) - np.count_nonzero(gram.diagonal())
        gram += _RIDGE * gram.max() * np.eye(len(gram))
        fitted = basis @ solve(gram, basis.T @ window.values, assume_a="pos")
        residual = window.values - fitted
        square = np.maximum(np.sum(residual**2, axis=0), 1e-300)
        spreads.append(0.5 * np.log(square / free + window.floor**2))
        alike = np.clip(np.sum(residual[1:] * residual[:-1], axis=0) / square, 0, 0.98)
        weights.append(free * (1 - alike) / (1 + alike) / _OVERLAP)
    return np.array(spreads), np.array(weights)


def _pieces(along: Times, pitch: float, still: float) -> csr_array:
    """Cubic B-splines (n, k) with equal spacing over the range of motion; a constant if the clamp
    stands still.

    The knots move with the range, so a uniform motion has the same fit wherever it is.
    """
    extent = float(np.ptp(along))
    if extent <= still:
        return csr_array(np.ones((len(along), 1)))
    count = max(1, min(_MOST_PIECES, int(np.ceil(extent / pitch))))
    knots = np.arange(-3, count + 4) * (extent / count)
    return BSpline.design_matrix(np.clip(along - along.min(), 0, extent * (1 - 1e-12)), knots, 3)
