"""Bracketed roots of many scalar functions, side by side."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

POINTS = 4
"""Points evaluated at a time: two estimates, and one beyond each to bracket them."""
_MOST_ROUNDS = 50
"""Twice as many as it takes to shrink a bracket to rounding, a fifth at a time."""
_WIDTH = 4e-16
"""Width of a bracket between two neighbouring floating-point numbers."""
_VALUE, _LEAST_VALUE = 1e-14, 1e-15
"""Rounding: as a fraction of the values at the ends, and of sums of terms of order one."""
_PROGRESS = 0.25
"""Largest fraction of a bracket that estimates may leave; even division leaves a fifth."""
_NEAREST = 3
"""Points kept on either side of the root."""


def roots(
    function: Callable[[Float[np.ndarray, "j n"], Int[np.ndarray, "j"]], Float[np.ndarray, "j n"]],
    ends: tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]],
    values: tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]],
) -> Float[np.ndarray, "k"]:
    """Roots of functions of (arguments, rows), each between two ends with known values of opposite
    sign. Where rounding has left both ends with the same sign, or the function is not finite in
    between, the known point nearest to zero.

    Notes
    -----
    A call costs more than an evaluation here, so each function is evaluated at four points at a
    time. On either side of the root, inverse interpolation uses the nearest three points on that
    side: a kink at the root, as at a change of phase, does not mislead it.
    """
    end, at_end = np.stack(ends, axis=1), np.stack(values, axis=1)
    known, value = (_outside(part, _NEAREST - 1) for part in (end, at_end))
    small = np.maximum(_VALUE * np.abs(at_end).max(axis=1), _LEAST_VALUE)
    even = np.ones(len(end), dtype=bool)
    left = np.flatnonzero(at_end[:, 0] * np.sign(at_end[:, 1]) < 0)
    for _ in range(_MOST_ROUNDS):
        if not left.size:
            break
        x, f = known[left], value[left]
        places = np.where(even[left, None], _divided(x), _estimated(x, f))
        found = function(places, left)
        known[left], value[left] = _nearest(np.hstack([x, places]), np.hstack([f, found]), x, f)
        best, least = _best(known[left], value[left])
        before, after = _width(x), _width(known[left])
        even[left] = after > _PROGRESS * before
        wide = (after > _WIDTH * (1 + np.abs(best))) & np.isfinite(found).any(axis=1)
        left = left[wide & (least > small[left])]
    return _best(known, value)[0]


def _best(
    x: Float[np.ndarray, "j six"], f: Float[np.ndarray, "j six"]
) -> tuple[Float[np.ndarray, "j"], Float[np.ndarray, "j"]]:
    """End of the bracket whose value is nearer to zero, and how near."""
    low, high = np.abs(f[:, _NEAREST - 1]), np.abs(f[:, _NEAREST])
    return np.where(low <= high, x[:, _NEAREST - 1], x[:, _NEAREST]), np.minimum(low, high)


def _outside(rows: Float[np.ndarray, "k n"], count: int) -> Float[np.ndarray, "k m"]:
    """Rows padded with `count` unknown points on either side."""
    return np.pad(rows, ((0, 0), (count, count)), constant_values=np.nan)


def _width(x: Float[np.ndarray, "j six"]) -> Float[np.ndarray, "j"]:
    return np.abs(x[:, _NEAREST] - x[:, _NEAREST - 1])


def _nearest(
    x: Float[np.ndarray, "j n"],
    f: Float[np.ndarray, "j n"],
    before: Float[np.ndarray, "j six"],
    values: Float[np.ndarray, "j six"],
) -> tuple[Float[np.ndarray, "j six"], Float[np.ndarray, "j six"]]:
    """From points in any order, those around the first change of sign after the start of the
    bracket.
    """
    first, last = before[:, [_NEAREST - 1]], before[:, [_NEAREST]]
    unknown = ~(np.isfinite(x) & np.isfinite(f))
    along = np.where(unknown, np.inf, (x - first) * np.sign(last - first))
    order = np.argsort(along, axis=1, kind="stable")
    x, f = (np.take_along_axis(np.where(unknown, np.nan, part), order, axis=1) for part in (x, f))
    changed = f * np.sign(values[:, [_NEAREST - 1]]) < 0
    around = changed.argmax(axis=1)[:, None] + np.arange(2 * _NEAREST)
    x, f = (np.take_along_axis(_outside(part, _NEAREST), around, axis=1) for part in (x, f))
    return x, f


def _divided(x: Float[np.ndarray, "j six"]) -> Float[np.ndarray, "j n"]:
    """Points that divide the bracket evenly."""
    first, last = x[:, [_NEAREST - 1]], x[:, [_NEAREST]]
    return first + np.arange(1, POINTS + 1) / (POINTS + 1) * (last - first)


def _estimated(x: Float[np.ndarray, "j six"], f: Float[np.ndarray, "j six"]) -> np.ndarray:
    """Estimates from either side, and a point beyond each, all within the bracket; where there is
    none, points that divide it evenly.
    """
    ends = x[:, _NEAREST - 1], x[:, _NEAREST]
    low, high = np.minimum(*ends), np.maximum(*ends)
    nearest = np.s_[_NEAREST - 1 :: -1], np.s_[_NEAREST:]
    inside = [_inverse(x[:, side], f[:, side], low, high) for side in nearest]
    left, right = (pick(*(estimate for estimate, _ in inside)) for pick in (np.fmin, np.fmax))
    # One estimate alone, or two that agree: the last correction shows how good it is.
    alone = ~(right - left > 0)
    correction = np.fmin(*(np.abs(last) for _, last in inside))
    apart = np.where(alone, np.fmin(correction, (high - low) / 16), right - left)
    apart = np.maximum(apart, _WIDTH * (1 + np.abs(left)))
    left, right = left - np.where(alone, apart / 4, 0), right + np.where(alone, apart / 4, 0)
    before = np.maximum(left - apart, (low + left) / 2)
    behind = np.minimum(right + apart, (right + high) / 2)
    places = np.column_stack([before, left, right, behind])
    return np.where(np.isfinite(places), places, _divided(x))


def _inverse(
    x: Float[np.ndarray, "j three"],
    f: Float[np.ndarray, "j three"],
    low: Float[np.ndarray, "j"],
    high: Float[np.ndarray, "j"],
) -> tuple[Float[np.ndarray, "j"], Float[np.ndarray, "j"]]:
    """Inverse interpolation through up to three points, the nearest first: its value at 0, and what
    the third point has added; NaN outside the bracket.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        slope = np.diff(x, axis=1) / np.diff(f, axis=1)
        linear = x[:, 0] - f[:, 0] * slope[:, 0]
        added = f[:, 0] * f[:, 1] * (slope[:, 1] - slope[:, 0]) / (f[:, 2] - f[:, 0])
    estimate = linear + np.where(np.isfinite(added), added, 0.0)
    return np.where((low < estimate) & (estimate < high), estimate, np.nan), added
