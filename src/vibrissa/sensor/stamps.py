"""Faults of the clock: gaps, duplicates, stamps that run backwards, other units than seconds."""

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.sensor.faults import Fault, FaultKind

_GAP = 1.5
_SLOWEST, _FASTEST = 1.0, 1e5


def stamp_faults(time: Float[np.ndarray, "n"]) -> list[Fault]:
    """Gaps longer than 1.5 median steps, duplicate stamps, backward ones, rates that are none of a sensor's."""
    rows = np.flatnonzero(np.isfinite(time))
    if len(rows) < 2:
        return []
    stamps = time[rows]
    steps = np.diff(stamps)
    rising = steps[steps > 0]
    first, last = float(stamps[0]), float(stamps[-1])
    if not len(rising):
        return [Fault(FaultKind.BACKWARD, ("time",), first, last, len(steps), "no stamp is after the one before", unusable=True)]
    usual = float(np.median(rising))
    ordered = np.unique(stamps)
    faults = [_gap(ordered, int(row), usual) for row in np.flatnonzero(np.diff(ordered) > _GAP * usual)]
    late = _late(stamps)
    equal = late & np.isin(stamps, stamps[~late])
    for start, stop in runs(equal):
        text = f"{stop - start} rows with a stamp that is there already"
        faults.append(Fault(FaultKind.DUPLICATE, ("time",), float(stamps[start]), float(stamps[stop - 1]), stop - start, text))
    falling = np.flatnonzero(steps < 0)
    if falling.size:
        row, count = int(falling[0]), int(np.count_nonzero(late & ~equal)) or len(falling)
        text = f"time = {stamps[row + 1]} after {stamps[row]} ({len(falling)} such); allowed are increasing times"
        faults.append(Fault(FaultKind.BACKWARD, ("time",), float(stamps[row + 1]), float(stamps[row]), count, text, unusable=True))
    if not _SLOWEST <= 1 / usual <= _FASTEST:
        guess = " (milliseconds, microseconds or nanoseconds?)" if usual > 1 else ""
        text = f"{1 / usual:.3g} samples a second, as of no sensor{guess}; allowed are seconds"
        faults.append(Fault(FaultKind.UNITS, ("time",), first, last, len(time), text))
    return faults


def _gap(stamps: Float[np.ndarray, "n"], row: int, usual: float) -> Fault:
    step = float(stamps[row + 1] - stamps[row])
    missing = max(1, round(step / usual) - 1)
    text = f"{missing} samples missing: a step of {step:.4g} s, {step / usual:.3g} times the usual"
    return Fault(FaultKind.GAP, ("time",), float(stamps[row]), float(stamps[row + 1]), missing, text)


def _late(stamps: Float[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Rows whose stamp is not after all those above."""
    before = np.maximum.accumulate(stamps)
    return np.concatenate([[False], stamps[1:] <= before[:-1]])


def increasing_stamps(time: Float[np.ndarray, "n"]) -> tuple[Float[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """Stamps made increasing, and which rows they are moved in: missing ones lie between their neighbours, repeated ones a last digit after the one above."""
    finite = np.isfinite(time)
    rows = np.arange(len(time))
    fixed = np.interp(rows, rows[finite], time[finite])
    moved = ~finite
    if np.any(np.diff(fixed) <= 0):
        for row in range(1, len(fixed)):
            if fixed[row] <= fixed[row - 1]:
                fixed[row], moved[row] = np.nextafter(fixed[row - 1], np.inf), True
    return fixed, moved


def runs(mask: Bool[np.ndarray, "n"]) -> list[tuple[int, int]]:
    """Stretches [start, stop) in which a mask holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]
