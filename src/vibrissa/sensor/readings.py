"""Faults of the readings: rows that are missing, channels that stand still, readings at their
limit.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike
from scipy.special import erf

from vibrissa.sensor.deviations import (
    believed_noise,
    own_noise,
    own_rows,
    repeating_rows,
    smallest_steps,
)
from vibrissa.sensor.figures import Noise
from vibrissa.sensor.raw import (
    CHANNEL_UNITS,
    CHANNELS,
    Fault,
    FaultKind,
    RawRecording,
    Rows,
    Times,
    Wrench,
    Wrenches,
    channel_names,
    runs,
)
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
    posed = np.isfinite(np.hstack([raw.position, raw.orientation])).all(axis=1)
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
        faults += Fault.each(FaultKind.DROP_OUT, channels, mask, raw.time, what)
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
        # A noiseless simulation begins at zero and leaves it gradually: there the step is no larger
        # than the next ones.
        sudden[start:stop] = all(
            np.any(np.abs(np.median(near, axis=0)) > _JUMP * deviation + 4 * np.ptp(near, axis=0))
            for near in (wrench[side] for side in sides if len(side))
        )
    return sudden


def longest_repeat(
    deviation: ArrayLike, step: ArrayLike, count: int, false_alarm: float = _FALSE_ALARM
) -> Float[np.ndarray, "*channels"]:
    """Length that a run of equal readings reaches by chance, somewhere among `count`, with the
    probability `false_alarm`; at least five.

    A reading equals the one before with a probability of at most p = erf(step / (√8 deviation)),
    where the true value lies on a step; a run of r readings needs r − 1 such, and `count` places
    bound the chance by count p^(r−1).
    """
    longest = _longest(_repeats(deviation, step), count, false_alarm)
    return np.asarray(np.maximum(_SHORTEST, longest))


def _repeats(deviation: ArrayLike, step: ArrayLike) -> Float[np.ndarray, "*channels"]:
    """Largest chance that a reading equals the one before."""
    known = np.asarray(deviation) > 0
    return np.where(known, erf(step / (np.sqrt(8) * np.where(known, deviation, 1.0))), 1.0)


def _longest(chance: ArrayLike, count: int, false_alarm: float = _FALSE_ALARM) -> Any:
    with np.errstate(divide="ignore"):
        return 1 + np.ceil(np.log(count / false_alarm) / np.abs(np.log(chance)))


def _noise_and_steps(noise: Noise, wrench: Wrenches) -> tuple[Wrench, Wrench]:
    """White noise (6,), and the steps of the numbers (6,): as stated, or the smallest that they
    show, if that is larger.
    """
    stated, shown = noise.resolution, smallest_steps(wrench)
    steps = np.where(np.isfinite(shown), np.maximum(stated, shown), stated)
    return believed_noise(noise, wrench), steps


def held_rows(noise: Noise, raw: RawRecording, bad: Mask) -> tuple[list[Fault], Mask]:
    """Rows that repeat the reading above them in all channels more often than chance allows: a lost
    sample, and the last one held in its place.

    Where a third of all rows do so, the sensor is slower than the log; that is one finding, and no
    row is marked.
    """
    wrench, held = np.where(bad, np.nan, raw.wrench), np.zeros_like(bad)
    same = repeating_rows(wrench)
    if not own_rows(wrench).all():
        count = np.count_nonzero(same)
        text = (
            f"{count} of {len(wrench)} rows repeat the reading above them in all channels, as of a "
            f"sensor of {(1 - count / len(wrench)) * raw.rate:.4g} readings a second in a log of "
            f"{raw.rate:.4g}"
        )
        return [Fault.over(FaultKind.HELD, CHANNELS, raw.time, text, count)], held
    chance = np.prod(_repeats(*_noise_and_steps(noise, wrench)))
    needed = max(2, _longest(chance, len(wrench)))
    for start, stop in runs(same):
        held[start:stop] = stop - start + 1 >= needed
    what = "repeat the reading above them in all channels"
    return list(Fault.each(FaultKind.HELD, CHANNELS, held[:, 0], raw.time, what)), held


def standing_channels(sensor: Sensor, raw: RawRecording, bad: Mask) -> tuple[list[Fault], Mask]:
    """Runs of equal readings longer than chance allows: flat-topped where they are a channel's
    extreme that it comes to and leaves gradually, else stuck.

    With a known range, readings at it are saturated, however few.
    """
    wrench = np.where(bad, np.nan, raw.wrench)
    deviations, steps = _noise_and_steps(sensor.noise, wrench)
    needed = longest_repeat(deviations, steps, len(wrench))
    # In world axes no channel is one of the sensor's.
    limits = sensor.response.limits(sensor.noise.resolution)
    limits = np.full(6, np.inf) if sensor.wrench_frame == "world" else limits
    standing, faults = np.abs(wrench) >= limits * (1 - _ROUNDING), []
    for channel, name in enumerate(CHANNELS):
        found = _standing(
            *(wrench[:, channel], standing[:, channel], deviations[channel], needed[channel]),
            *(name, CHANNEL_UNITS[channel], limits[channel]),
        )
        for kind, start, stop, text in found:
            standing[start:stop, channel] = True
            faults.append(Fault.over(kind, (name,), raw.time[start:stop], text))
    return faults, standing


def _standing(
    values: Times,
    full: Rows,
    deviation: float,
    needed: float,
    name: str,
    unit: str,
    limit: float,
) -> Iterator[tuple[FaultKind, int, int, str]]:
    """Kind, rows and text of what stands in a channel, those at its range (n,) first."""
    marked, tops = full.copy(), []
    for start, stop in runs(full):
        text = f"{stop - start} readings of {name} at the range of {limit:g} {unit}"
        yield FaultKind.SATURATION, start, stop, text
    for start, last in runs((np.diff(values) == 0) & ~marked[1:] & ~marked[:-1]):
        stop = last + 1
        if stop - start >= needed:
            marked[start:stop] = True
            flat = _flat_topped(values, start, stop, deviation)
            tops += [values[start]] * flat
            text = (
                f"{name} is {'flat-topped' if flat else 'stuck'} at {values[start]:.6g} {unit} for "
                f"{stop - start} rows; {needed:.0f} in a row come by chance in one of a million "
                "recordings"
            )
            yield FaultKind.SATURATION if flat else FaultKind.STUCK, start, stop, text
    for start, stop in runs(np.isin(values, tops) & ~marked):
        text = (
            f"{stop - start} more readings of {name} at its flat top of {values[start]:.6g} {unit}"
        )
        yield FaultKind.SATURATION, start, stop, text


def _flat_topped(values: Times, start: int, stop: int, deviation: float) -> bool:
    value = values[start]
    height = np.abs(value - np.nanmedian(values))
    if value not in (np.nanmax(values), np.nanmin(values)) or height < _FLAT_TOP * deviation:
        return False
    steps = np.abs(np.diff(values))
    usual = _FLAT_TOP * max(deviation, np.nanmedian(steps))
    # Next to a row that is missing it is not known how the channel came or left.
    ends = np.concatenate([steps[max(0, start - 1) : start], steps[stop - 1 : stop]])
    return not np.any(ends > usual)
