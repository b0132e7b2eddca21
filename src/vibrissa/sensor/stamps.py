"""Faults of the clock: gaps, duplicates, stamps that run backwards, other units than seconds."""

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.raw import RawRecording

_GAP = 1.5
_DEVIATIONS = 6.0
MEDIAN_TO_DEVIATION = 0.6745
"""Median size of normal numbers of unit variance."""
_FEW, _MANY = 10, 0.1
_SLOWEST, _FASTEST = 1.0, 1e5


def rounded_stamps(raw: RawRecording) -> bool:
    """Whether stamps stand for a tenth of the rows and more while the readings go on: they are
    rounded, and no row is there twice.
    """
    same = np.diff(raw.time) == 0
    moving = np.any(np.diff(raw.wrench, axis=0) != 0, axis=1)
    going, standing = int(np.count_nonzero(same & moving)), int(np.count_nonzero(same & ~moving))
    return going > max(_MANY * len(raw.time), 2.0 * standing)


def stamp_faults(time: Float[np.ndarray, "n"], *, rounded: bool = False) -> list[Fault]:
    """Gaps, duplicate stamps, backward ones, rates that are none of a sensor's.

    A gap is a step of more than 1.5 median ones, and of more than six deviations of the steps above
    the median where the stamps jitter. Where more than a tenth of the steps are such, the stamps
    come in bursts, and that is one finding; so are stamps that are rounded.
    """
    rows = np.flatnonzero(np.isfinite(time))
    if len(rows) < 2:
        return []
    stamps = time[rows]
    steps = np.diff(stamps)
    rising = steps[steps > 0]
    first, last = float(stamps[0]), float(stamps[-1])
    if not len(rising):
        return [
            Fault(
                FaultKind.BACKWARD,
                ("time",),
                first,
                last,
                len(steps),
                "no stamp is after the one before; allowed are stamps that increase",
                unusable=True,
            )
        ]
    usual = float(np.median(rising))
    ordered = np.unique(stamps)
    faults = _gaps(ordered, usual)
    late = _late(stamps)
    equal = late & np.isin(stamps, stamps[~late])
    if rounded:
        text = f"{np.count_nonzero(equal)} of {len(stamps)} rows have a stamp that is there already while the readings go on, as of stamps rounded to {usual:.4g} s; "
        text += "they are spread evenly"
        faults.append(
            Fault(FaultKind.DUPLICATE, ("time",), first, last, int(np.count_nonzero(equal)), text)
        )
    for start, stop in runs(equal) if not rounded else ():
        text = f"{stop - start} rows with a stamp that is there already"
        faults.append(
            Fault(
                FaultKind.DUPLICATE,
                ("time",),
                float(stamps[start]),
                float(stamps[stop - 1]),
                stop - start,
                text,
            )
        )
    falling = np.flatnonzero(steps < 0)
    if falling.size:
        row, count = int(falling[0]), int(np.count_nonzero(late & ~equal)) or len(falling)
        text = f"time = {stamps[row + 1]} after {stamps[row]} ({len(falling)} such); allowed are increasing times"
        faults.append(
            Fault(
                FaultKind.BACKWARD,
                ("time",),
                float(stamps[row + 1]),
                float(stamps[row]),
                count,
                text,
                unusable=True,
            )
        )
    if not _SLOWEST <= 1 / usual <= _FASTEST:
        guess = " (milliseconds, microseconds or nanoseconds?)" if usual > 1 else ""
        text = f"{1 / usual:.3g} samples a second, as of no sensor{guess}; allowed are seconds"
        faults.append(Fault(FaultKind.UNITS, ("time",), first, last, len(time), text))
    return faults


def _gaps(stamps: Float[np.ndarray, "n"], usual: float) -> list[Fault]:
    steps = np.diff(stamps)
    jitter = float(np.median(np.abs(steps - np.median(steps)))) / MEDIAN_TO_DEVIATION
    long = np.flatnonzero(steps > max(_GAP * usual, usual + _DEVIATIONS * jitter))
    if len(long) > max(_FEW, _MANY * len(steps)):
        text = f"{len(long)} of {len(steps)} steps are longer than {_GAP} times the median step of {usual:.4g} s: the stamps come in bursts, "
        text += "as where samples are stamped when they arrive"
        return [
            Fault(FaultKind.GAP, ("time",), float(stamps[0]), float(stamps[-1]), len(long), text)
        ]
    return [_gap(stamps, int(row), usual) for row in long]


def _gap(stamps: Float[np.ndarray, "n"], row: int, usual: float) -> Fault:
    step = float(stamps[row + 1] - stamps[row])
    missing = max(1, round(step / usual) - 1)
    text = f"{missing} samples missing: a step of {step:.4g} s, {step / usual:.3g} times the usual"
    return Fault(
        FaultKind.GAP, ("time",), float(stamps[row]), float(stamps[row + 1]), missing, text
    )


def _late(stamps: Float[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    """Rows whose stamp is not after all those above."""
    before = np.maximum.accumulate(stamps)
    return np.concatenate([[False], stamps[1:] <= before[:-1]])


def increasing_stamps(
    time: Float[np.ndarray, "n"], *, rounded: bool = False
) -> tuple[Float[np.ndarray, "n"], Bool[np.ndarray, "n"]]:
    """Stamps made increasing, and which rows they are moved in: missing ones lie between their
    neighbours, repeated ones a last digit after the one above.

    Stamps that are rounded are spread evenly up to the next one, which moves none of the rows.
    """
    finite = np.isfinite(time)
    rows = np.arange(len(time))
    fixed = np.interp(rows, rows[finite], time[finite])
    moved = ~finite
    if rounded and np.all(np.diff(fixed) >= 0):
        fixed = _spread(fixed)
    if np.any(np.diff(fixed) <= 0):
        for row in range(1, len(fixed)):
            if fixed[row] <= fixed[row - 1]:
                fixed[row], moved[row] = np.nextafter(fixed[row - 1], np.inf), True
    return fixed, moved


def _spread(stamps: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    values, first, count = np.unique(stamps, return_index=True, return_counts=True)
    steps = np.diff(
        values,
        append=values[-1] + np.median(np.diff(values)) if len(values) > 1 else values[-1] + 1,
    )
    # A stamp is not spread over a gap behind it.
    steps = np.minimum(steps, np.median(steps))
    return np.asarray(
        stamps
        + np.repeat(steps / count, count) * (np.arange(len(stamps)) - np.repeat(first, count))
    )


def runs(mask: Bool[np.ndarray, "n"]) -> list[tuple[int, int]]:
    """Stretches [start, stop) in which a mask holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)]
