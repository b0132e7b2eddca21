"""Faults of the readings: rows that are missing, channels that stand still, readings at their
limit.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool

from vibrissa.sensor.deviations import (
    believed_noise,
    own_noise,
    own_rows,
    repeating_rows,
    smallest_steps,
)
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.raw import (
    CHANNEL_UNITS,
    CHANNELS,
    RawRecording,
    Rows,
    Times,
    Wrench,
    Wrenches,
    channel_names,
    runs,
)

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

Mask = Bool[np.ndarray, "n 6"]

# Chance that a sound recording is said to stand still.
_FALSE_ALARM = 1e-6
# Equal readings in a row that are no finding, however fine the numbers.
_SHORTEST = 5
# Deviations by which readings jump to and from lost rows that are written as zeros.
_JUMP = 8.0
# Samples on either side of a loss, whose median and spread say where the readings were.
_NEIGHBOURS = 5
# Deviations, or median steps: a channel that comes to its extreme by more did not saturate.
_FLAT_TOP = 10.0
# Decimals read as binary numbers may fall short of the range by the last digit.
_ROUNDING = 1e-9


def drop_outs(raw: RawRecording, unstamped: Rows) -> tuple[list[Fault], Mask]:
    """Rows in which numbers or stamps are missing, and rows of zeros from which and to which the
    readings jump by eight of their deviations.
    """
    missing, zero = ~np.isfinite(raw.wrench), _sudden_zeros(raw.wrench)
    posed = np.isfinite(np.concatenate([raw.position, raw.orientation], axis=1)).all(axis=1)
    faults = []
    for start, stop in runs(missing.any(axis=1)):
        lost = channel_names(missing[start:stop].any(axis=0))
        text = f"{stop - start} rows without a number in {', '.join(lost)}"
        faults.append(Fault.over(FaultKind.DROP_OUT, lost, raw.time[start:stop], text))
    for mask, channels, what in (
        (zero, CHANNELS, "of zeros in all channels between other readings"),
        (~posed, ("position", "orientation"), "without a pose"),
        (unstamped, ("time",), "without a stamp"),
    ):
        for start, stop in runs(mask):
            text = f"{stop - start} rows {what}"
            faults.append(Fault.over(FaultKind.DROP_OUT, channels, raw.time[start:stop], text))
    return faults, missing | zero[:, None]


def _sudden_zeros(wrench: Wrenches) -> Rows:
    zero, sudden = np.all(wrench == 0, axis=1), np.zeros(len(wrench), dtype=bool)
    others = np.flatnonzero(np.isfinite(wrench).all(axis=1) & ~zero)
    if not zero.any() or len(others) < _NEIGHBOURS:
        return sudden
    deviation = own_noise(wrench[others])
    for start, stop in runs(zero):
        place = np.searchsorted(others, start)
        sides = others[max(0, place - _NEIGHBOURS) : place], others[place : place + _NEIGHBOURS]
        around = [wrench[side] for side in sides if len(side)]
        # A noiseless simulation begins at zero and leaves it gradually: there the step is no larger
        # than the next ones.
        sudden[start:stop] = all(
            np.any(np.abs(np.median(near, axis=0)) > _JUMP * deviation + 4 * np.ptp(near, axis=0))
            for near in around
        )
    return sudden


def longest_repeat(
    deviation: float, step: float, count: int, false_alarm: float = _FALSE_ALARM
) -> float:
    """Length that a run of equal readings reaches by chance, somewhere among `count`, with the
    probability `false_alarm`; at least five.

    A reading equals the one before with a probability of at most p = erf(step / (√8 deviation)),
    where the true value lies on a step; a run of r readings needs r − 1 such, and `count` places
    bound the chance by count p^(r−1).
    """
    return max(_SHORTEST, _longest(_repeats(deviation, step), count, false_alarm))


def _repeats(deviation: float, step: float) -> float:
    """Largest chance that a reading equals the one before."""
    return 1.0 if deviation <= 0 else math.erf(step / (math.sqrt(8) * deviation))


def _longest(chance: float, count: int, false_alarm: float = _FALSE_ALARM) -> float:
    if chance <= 0 or chance >= 1:
        return math.inf if chance >= 1 else 1
    return 1 + math.ceil(math.log(false_alarm / count) / math.log(chance))


def _steps(sensor: "Sensor", wrench: Wrenches) -> Wrench:
    """Steps (6,) of the numbers: as stated, or the smallest that they show, if that is larger."""
    stated, shown = sensor.noise.resolution, smallest_steps(wrench)
    return np.where(np.isfinite(shown), np.maximum(stated, shown), stated)


def held_rows(sensor: "Sensor", raw: RawRecording, bad: Mask) -> tuple[list[Fault], Rows]:
    """Rows that repeat the reading above them in all channels more often than chance allows: a lost
    sample, and the last one held in its place.

    Where a third of all rows do so, the sensor is slower than the log; that is one finding, and no
    row is marked.
    """
    wrench = np.where(bad, np.nan, raw.wrench)
    same, held = repeating_rows(wrench), np.zeros(len(wrench), dtype=bool)
    if not own_rows(wrench).all():
        count = int(np.count_nonzero(same))
        text = (
            f"{count} of {len(wrench)} rows repeat the reading above them in all channels, as of a "
            f"sensor of {(1 - count / len(wrench)) * raw.rate:.4g} readings a second in a log of "
            f"{raw.rate:.4g}"
        )
        return [Fault.over(FaultKind.HELD, CHANNELS, raw.time, text, count)], held
    figures = zip(believed_noise(sensor, wrench), _steps(sensor, wrench), strict=True)
    needed = max(2, _longest(math.prod(_repeats(*one) for one in figures), len(wrench)))
    faults = []
    for start, stop in runs(same):
        if stop - start + 1 >= needed:
            held[start:stop] = True
            text = f"{stop - start} rows repeat the reading above them in all channels"
            faults.append(Fault.over(FaultKind.HELD, CHANNELS, raw.time[start:stop], text))
    return faults, held


def standing_channels(sensor: "Sensor", raw: RawRecording, bad: Mask) -> tuple[list[Fault], Mask]:
    """Runs of equal readings longer than chance allows: flat-topped where they are a channel's
    extreme that it comes to and leaves gradually, else stuck.

    With a known range, readings at it are saturated, however few.
    """
    wrench = np.where(bad, np.nan, raw.wrench)
    # In world axes no channel is one of the sensor's.
    limits = sensor.response.limits(sensor.noise.resolution)
    limits = np.full(6, np.inf) if sensor.wrench_frame == "world" else limits
    figures = zip(believed_noise(sensor, wrench), _steps(sensor, wrench), limits, strict=True)
    faults, standing = [], np.zeros_like(bad)
    for channel, (deviation, step, limit) in enumerate(figures):
        needed = longest_repeat(float(deviation), float(step), len(wrench))
        found, standing[:, channel] = _standing(
            raw.time, wrench[:, channel], channel, float(deviation), needed, float(limit)
        )
        faults += found
    return faults, standing


def _standing(
    time: Times, values: Times, channel: int, deviation: float, needed: float, limit: float
) -> tuple[list[Fault], Rows]:
    name, unit = CHANNELS[channel], CHANNEL_UNITS[channel]
    full = np.abs(values) >= limit * (1 - _ROUNDING)
    marked, tops = full.copy(), []
    found = [
        (FaultKind.SATURATION, a, b, f"{b - a} readings of {name} at the range of {limit:g} {unit}")
        for a, b in runs(full)
    ]
    for start, last in runs((np.diff(values) == 0) & ~full[1:] & ~full[:-1]):
        stop = last + 1
        if stop - start >= needed:
            marked[start:stop] = True
            flat = _flat_topped(values, start, stop, deviation)
            tops += [values[start]] if flat else []
            kind = FaultKind.SATURATION if flat else FaultKind.STUCK
            text = (
                f"{name} is {'flat-topped' if flat else 'stuck'} at {values[start]:.6g} {unit} for "
                f"{stop - start} rows; {needed:.0f} in a row come by chance in one of a million "
                "recordings"
            )
            found.append((kind, start, stop, text))
    more = np.isin(values, tops) & ~marked
    for a, b in runs(more):
        text = f"{b - a} more readings of {name} at its flat top of {values[a]:.6g} {unit}"
        found.append((FaultKind.SATURATION, a, b, text))
    return [Fault.over(kind, (name,), time[a:b], text) for kind, a, b, text in found], marked | more


def _flat_topped(values: Times, start: int, stop: int, deviation: float) -> bool:
    value, finite = values[start], values[np.isfinite(values)]
    height = abs(value - np.median(finite))
    if value not in (finite.max(), finite.min()) or height < _FLAT_TOP * deviation:
        return False
    steps = np.abs(np.diff(values))
    usual = _FLAT_TOP * max(deviation, float(np.nanmedian(steps)))
    # Next to a row that is missing it is not known how the channel came or left.
    ends = np.concatenate([steps[max(0, start - 1) : start], steps[stop - 1 : stop]])
    return not np.any(ends > usual)
