"""Offset between the clocks of wrenches and poses, from the data: at rest the reactions stand, and at one place they are the same whenever the clamp comes by.

In a quasi-static sweep the reactions are a function of the pose. In short windows that function is fitted along the main direction of the motion, by
straight pieces, for each offset tried; the right offset leaves the least residual. A window without a change of speed fits equally well with any offset (the
object is then found shifted along the trail, and nothing contradicts it), so that only stops, starts and turns under load tell.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize_scalar

from vibrissa.io.recordings.streams import Stream

_LEVER = 0.1
_MOST_ROWS = 20_000
_FEWEST_ROWS = 30
_PIECES = 12
_SHORTEST_WINDOW = 1.0
_STEPS = 201
_EVIDENCE = 12.0
_STANDING = 8.0


@dataclass(frozen=True)
class ClockOffset:
    """What is added to the stamps of the poses.

    Attributes
    ----------
    seconds
        [s].
    standard_error
        [s]; None where the offset was given.
    """

    seconds: float
    standard_error: float | None


def estimated_offset(wrench: Stream, pose: Stream, largest: float) -> ClockOffset:
    """Offset that makes the reactions most nearly a function of the pose, with its standard error.

    The standard error is that of the profile likelihood, with as many independent samples as the residuals' correlation leaves. Friction, which turns with
    the motion, and a wire that still swings are not in it.

    Parameters
    ----------
    wrench, pose
        On their own clocks; poses sound and in order.
    largest
        Bound of the offset [s].

    Raises
    ------
    ValueError
        If the streams hardly overlap, or the data do not determine the offset: no change of speed under load, several offsets as good, or the best one at the bound.
    """
    windows = _windows(wrench, pose, largest)
    offsets = np.linspace(-largest, largest, _STEPS)
    spreads = np.array([_spreads(windows, offset) for offset in offsets])
    weights = _weights(windows, float(offsets[np.argmin(spreads.sum(axis=(1, 2)))]))
    misfit = np.einsum("twc,wc->t", spreads, weights)
    best = int(np.argmin(misfit))
    step = offsets[1] - offsets[0]

    def cost(offset: float) -> float:
        return float(np.sum(weights * _spreads(windows, offset)))

    found = minimize_scalar(cost, bounds=(offsets[best] - step, offsets[best] + step), method="bounded", options={"xatol": 1e-3 * step})
    seconds, error = float(found.x), _standard_error(cost, float(found.x), step)
    _check(seconds, error, offsets, misfit - min(float(found.fun), misfit[best]), largest)
    return ClockOffset(seconds, error)


def _check(seconds: float, error: float, offsets: Float[np.ndarray, "t"], excess: Float[np.ndarray, "t"], largest: float) -> None:
    said = "the data do not determine it"
    if not np.isfinite(error) or error > largest / 10 or float(np.max(excess)) < _EVIDENCE:
        raise ValueError(
            f"{said}: the clamp does not stop, start or turn under load; allowed is a number of seconds, or a recording in which it does"
        )
    others = np.abs(offsets - seconds) > max(10 * error, 4 * (offsets[1] - offsets[0]))
    rival = offsets[others][np.argmin(excess[others])]
    if float(np.min(excess[others])) < _EVIDENCE:
        raise ValueError(
            f"{said}: {seconds:.4f} s and {rival:.4f} s explain them equally well; allowed is a number of seconds, or a smaller largest_offset"
        )
    if abs(seconds) > largest - 3 * error - (offsets[1] - offsets[0]):
        raise ValueError(
            f"{said} within largest_offset = {largest:g} s, whose bound fits best; allowed is a larger one, or a number of seconds"
        )


def _standard_error(cost: Callable[[float], float], at: float, step: float) -> float:
    """From the curvature of the misfit, by a step that raises it by about 2."""
    reach, middle = step, cost(at)
    for _ in range(40):
        rise = (cost(at - reach) + cost(at + reach)) / 2 - middle
        if 0.5 < rise < 4:
            return reach / np.sqrt(2 * rise)
        reach *= np.sqrt(np.clip(2 / max(rise, 1e-3), 0.04, 4))
        if reach > 100 * step:
            break
    return float("inf")


@dataclass(frozen=True, eq=False)
class _Window:
    """Wrenches in a stretch of time, and the clamp's way along the main direction of its motion there, with stamps of its own."""

    time: Float[np.ndarray, "n"]
    values: Float[np.ndarray, "n 6"]
    way_time: Float[np.ndarray, "m"]
    way: Float[np.ndarray, "m"]
    floor: Float[np.ndarray, "6"]
    still: float


def _windows(wrench: Stream, pose: Stream, largest: float) -> list[_Window]:
    sound = np.isfinite(wrench.time) & np.all(np.isfinite(wrench.values), axis=1)
    if len(pose.time):
        sound &= (wrench.time > pose.time[0] + largest) & (wrench.time < pose.time[-1] - largest)
    rows = wrench.rows(sound & (len(pose.time) > 0))
    if len(rows.time) < 2 * _FEWEST_ROWS:
        raise ValueError(
            f"only {len(rows.time)} wrenches have poses {largest:g} s before and after; allowed is a smaller largest_offset, or a longer recording"
        )
    time, values = _thinned(rows.time, rows.values)
    number = np.floor((time - time[0]) / max(_SHORTEST_WINDOW, 2 * largest)).astype(int)
    features, floor = _features(pose), 0.1 * _noise(values)
    still = _STANDING * float(np.linalg.norm(_noise(features)))
    parts = [part for part in (number == index for index in np.unique(number)) if np.count_nonzero(part) >= _FEWEST_ROWS]
    found = []
    for part in parts:
        near = (pose.time >= time[part][0] - largest - 1) & (pose.time <= time[part][-1] + largest + 1)
        if np.count_nonzero(near) > 1:
            found.append(_Window(time[part], values[part], pose.time[near], _way(features[near]), floor, still))
    return found


def _thinned(time: Float[np.ndarray, "n"], values: Float[np.ndarray, "n 6"]) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m 6"]]:
    """Means of as many rows each as keep the count below a bound."""
    each = -(-len(time) // _MOST_ROWS) if len(time) else 1
    whole = len(time) // each * each
    return time[:whole].reshape(-1, each).mean(axis=1), values[:whole].reshape(-1, each, 6).mean(axis=1)


def _noise(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k"]:
    """Standard deviation of white noise (k,), by second differences, which a smooth motion hardly enters."""
    return np.asarray(np.sqrt(np.mean(np.diff(values, 2, axis=0) ** 2, axis=0) / 6)) if len(values) > 2 else np.zeros(values.shape[1])


def _features(pose: Stream) -> Float[np.ndarray, "n 6"]:
    """Positions, and turns seen from a lever of 0.1 m: twice the quaternion's vector part, of one sign, relative to the first pose."""
    x, y, z, w = (pose.values[:, 3:] / np.linalg.norm(pose.values[:, 3:], axis=1, keepdims=True)).T
    a, b, c, d = pose.values[0, 3:] / np.linalg.norm(pose.values[0, 3:])
    turn = np.stack([d * x - a * w - b * z + c * y, d * y - b * w - c * x + a * z, d * z - c * w - a * y + b * x], axis=1)
    sign = np.where(d * w + a * x + b * y + c * z < 0, -1.0, 1.0)
    return np.hstack([pose.values[:, :3] - pose.values[0, :3], 2 * _LEVER * sign[:, None] * turn])


def _way(features: Float[np.ndarray, "m 6"]) -> Float[np.ndarray, "m"]:
    """Coordinate along the direction of largest spread."""
    spread = features - features.mean(axis=0)
    return np.asarray(spread @ np.linalg.svd(spread, full_matrices=False)[2][0])


def _spreads(windows: list[_Window], offset: float) -> Float[np.ndarray, "w 6"]:
    """Half the logarithm of the residual variance, by window and channel."""
    found = []
    for window in windows:
        residual, rank = _residual(window, offset)
        found.append(0.5 * np.log(np.sum(residual**2, axis=0) / (len(residual) - rank) + window.floor**2 + 1e-300))
    return np.array(found)


def _residual(window: _Window, offset: float) -> tuple[Float[np.ndarray, "n 6"], int]:
    """What a function of the pose leaves of the reactions, and the number of its parameters."""
    basis = _pieces(np.interp(window.time - offset, window.way_time, window.way), window.still)
    solution, _, rank, _ = np.linalg.lstsq(basis, window.values, rcond=1e-9)
    return window.values - basis @ solution, int(rank)


def _pieces(along: Float[np.ndarray, "n"], still: float) -> Float[np.ndarray, "n k"]:
    """Hat functions over the range of the motion, whose sums are straight in pieces; a constant where the clamp stands.

    Their places go with the range, so that a uniform motion has the same fit wherever it is.
    """
    first, extent = along.min(), np.ptp(along)
    if extent <= still:
        return np.ones((len(along), 1))
    knots = np.arange(_PIECES + 1)
    return np.clip(1 - np.abs((along - first)[:, None] / extent * _PIECES - knots), 0, None)


def _weights(windows: list[_Window], offset: float) -> Float[np.ndarray, "w 6"]:
    """Independent samples by window and channel: fewer than there are where neighbouring residuals are alike."""
    weights = []
    for window in windows:
        residual, rank = _residual(window, offset)
        square = np.sum(residual**2, axis=0)
        alike = np.clip(np.divide(np.sum(residual[1:] * residual[:-1], axis=0), square, out=np.zeros(6), where=square > 0), 0, 0.98)
        weights.append((len(residual) - rank) * (1 - alike) / (1 + alike))
    return np.array(weights)
