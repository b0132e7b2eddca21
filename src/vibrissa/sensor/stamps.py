"""Faults of the clock: gaps, duplicates, stamps that run backwards, units other than seconds."""

from collections.abc import Iterator
from functools import partial

import numpy as np
from scipy.stats import median_abs_deviation

from vibrissa.numerics.runs import runs
from vibrissa.sensor.raw import Fault, FaultKind, RawRecording, Rows, Times

# Median steps: half a sample more than usual means a lost one.
_GAP = 1.5
# Standard deviations of jittering stamps: by chance in one of 10⁸ steps.
_DEVIATIONS = 6.0
# More gaps than this number, and than this fraction of the steps, are how the stamps normally come.
_FEW, _MANY = 10, 0.1
# Sampling rates of force/torque sensors [Hz], with a decade to spare on both sides.
_SLOWEST, _FASTEST = 1.0, 1e5
_fault = partial(Fault.over, ("time",))


def rounded_stamps(raw: RawRecording) -> bool:
    """Whether stamps repeat in more than a tenth of the rows while the readings change: then they
    are rounded, rather than rows duplicated.
    """
    same = np.diff(raw.time) == 0
    moving = np.any(np.diff(raw.wrench, axis=0) != 0, axis=1)
    going, standing = np.count_nonzero(same & moving), np.count_nonzero(same & ~moving)
    return bool(going > max(_MANY * len(raw.time), 2.0 * standing))


def stamp_faults(time: Times, *, rounded: bool = False) -> Iterator[Fault]:
    """Gaps, duplicate and backward stamps, and rates that no sensor has.

    A gap is a step of more than 1.5 times the median, and, if the stamps jitter, more than six
    deviations of the steps above it. If more than a tenth of the steps are gaps, the stamps come in
    bursts, which is a single finding; so are rounded stamps.
    """
    stamps = time[np.isfinite(time)]
    steps = np.diff(stamps)
    if not np.any(steps > 0):
        if len(steps):
            text = "no stamp is later than the one before; allowed are increasing stamps"
            yield _fault(FaultKind.BACKWARD, stamps, text, len(steps), unusable=True)
        return
    usual = float(np.median(steps[steps > 0]))
    late = np.append(False, stamps[1:] <= np.maximum.accumulate(stamps)[:-1])
    equal = late & np.isin(stamps, stamps[~late])
    yield from _gaps(np.unique(stamps), usual)
    if rounded:
        count = int(np.count_nonzero(equal))
        text = (
            f"{count} of {len(stamps)} rows repeat an earlier stamp while the readings change: the "
            f"stamps are rounded to {usual:.4g} s; they are spread evenly"
        )
        yield _fault(FaultKind.DUPLICATE, stamps, text, count)
    for start, stop in [] if rounded else runs(equal):
        text = f"{stop - start} rows repeat an earlier stamp"
        yield _fault(FaultKind.DUPLICATE, stamps[start:stop], text)
    falling = np.flatnonzero(steps < 0)
    if falling.size:
        before, after = stamps[falling[0]], stamps[falling[0] + 1]
        count = int(np.count_nonzero(late & ~equal)) or len(falling)
        text = f"time = {after} after {before} ({len(falling)} such); allowed are increasing times"
        yield _fault(FaultKind.BACKWARD, (after, before), text, count, unusable=True)
    # Rows in disorder say nothing about the unit of their stamps.
    ordered = len(falling) <= _MANY * len(steps)
    if ordered and not _SLOWEST <= 1 / usual <= _FASTEST:
        guess = " (milliseconds, microseconds or nanoseconds?)" if usual > 1 else ""
        text = (
            f"{1 / usual:.3g} samples a second, which no sensor sends{guess}; allowed are seconds"
        )
        yield _fault(FaultKind.UNITS, stamps, text, len(time))


def _gaps(stamps: Times, usual: float) -> Iterator[Fault]:
    steps = np.diff(stamps)
    jitter = median_abs_deviation(steps, scale="normal")
    long = np.flatnonzero(steps > max(_GAP * usual, usual + _DEVIATIONS * jitter))
    if len(long) > max(_FEW, _MANY * len(steps)):
        text = (
            f"{len(long)} of {len(steps)} steps are longer than {_GAP} times the median step of "
            f"{usual:.4g} s: the stamps come in bursts, as when samples are stamped on arrival"
        )
        yield _fault(FaultKind.GAP, stamps, text, len(long))
        return
    for row in long:
        relative = steps[row] / usual
        missing = max(1, round(relative) - 1)
        text = (
            f"{missing} samples missing: a step of {steps[row]:.4g} s, {relative:.3g} times the "
            "usual"
        )
        yield _fault(FaultKind.GAP, stamps[row : row + 2], text, missing)


def increasing_stamps(time: Times, *, rounded: bool = False) -> tuple[Times, Rows]:
    """Stamps made increasing, and the rows in which they were changed: missing ones are
    interpolated, repeated ones moved one unit in the last place after the one above.

    Rounded stamps are spread evenly up to the next one, which does not count as a change.
    """
    rows, moved = np.arange(len(time)), ~np.isfinite(time)
    fixed = np.interp(rows, rows[~moved], time[~moved])
    if rounded and np.all(np.diff(fixed) >= 0):
        values, first, count = np.unique(fixed, return_index=True, return_counts=True)
        steps = np.diff(values)
        usual = np.median(steps) if len(steps) else 1.0
        # Stamps are not spread into a gap that follows.
        steps = np.minimum(np.append(steps, usual), usual)
        fixed += np.repeat(steps / count, count) * (rows - np.repeat(first, count))
    for row in rows[1:] if np.any(np.diff(fixed) <= 0) else ():
        if fixed[row] <= fixed[row - 1]:
            fixed[row], moved[row] = np.nextafter(fixed[row - 1], np.inf), True
    return fixed, moved
