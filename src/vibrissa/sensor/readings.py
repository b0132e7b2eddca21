"""Faults of the readings: missing rows, stuck channels, and saturation."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.special import erf

from vibrissa.numerics.runs import runs
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
    Times,
    Wrench,
    Wrenches,
    names_of,
)
from vibrissa.sensor.sensor import Sensor

_COLUMNS = ("time", "position", "orientation", *CHANNELS)
# Probability that a good recording is called stuck.
_FALSE_ALARM = 1e-6
# Fewer equal readings in a row are not reported, however fine the resolution.
_SHORTEST = 5
# Deviations by which readings jump to and from lost rows that were written as zeros.
_JUMP = 8.0
# Samples on either side of a loss whose median and spread give the level of the readings.
_NEIGHBOURS = 5
# Deviations, or median steps: a channel that reaches its extreme by a larger step did not saturate.
_FLAT_TOP = 10.0
# Decimals converted to binary may fall short of the range in the last digit.
_ROUNDING = 1e-9


def without(raw: RawRecording, faults: Iterable[Fault]) -> RawRecording:
    """The recording with NaN for the readings that these findings mark; quiet ones mark none."""
    wrench = raw.wrench
    for fault in faults:
        if not fault.quiet:
            first, last = np.searchsorted(raw.time, (fault.start, fault.stop))
            wrench[first : last + 1, np.isin(CHANNELS, fault.channels)] = np.nan
    return raw.with_wrench(wrench)


def drop_outs(logged: RawRecording, time: Times) -> Iterator[Fault]:
    """Rows with missing numbers, and rows of zeros to and from which the readings jump by eight of
    their deviations; `time` holds increasing stamps (n,).
    """
    wrench, pose = logged.wrench, (logged.position.sum(axis=1), logged.orientation.sum(axis=1))
    missing = ~np.isfinite(np.column_stack([logged.time, *pose, wrench]))
    for start, stop in runs(missing.any(axis=1)):
        lost = names_of(missing[start:stop].any(axis=0), _COLUMNS)
        text = f"{stop - start} rows without a number in {', '.join(lost)}"
        yield Fault.over(lost, FaultKind.DROP_OUT, time[start:stop], text)
    zero = np.all(wrench == 0, axis=1)
    others = np.flatnonzero(np.isfinite(wrench).all(axis=1) & ~zero)
    deviation = own_noise(wrench[others])
    for start, stop in runs(zero & (len(others) >= _NEIGHBOURS)):
        before, after = np.split(others, [np.searchsorted(others, start)])
        sides = (wrench[side] for side in (before[-_NEIGHBOURS:], after[:_NEIGHBOURS]) if len(side))
        # A noiseless simulation starts at zero and leaves it gradually: its first step is no larger
        # than the next ones.
        if all(
            np.any(np.abs(np.median(near, axis=0)) > _JUMP * deviation + 4 * np.ptp(near, axis=0))
            for near in sides
        ):
            text = f"{stop - start} rows of zeros in all channels between other readings"
            yield Fault.over(CHANNELS, FaultKind.DROP_OUT, time[start:stop], text)


def repeat_chance(deviation: ArrayLike, step: ArrayLike) -> Float[np.ndarray, "*channels"]:
    """Largest probability that a reading equals the previous one: erf(step / (√8 deviation)), if
    the true value lies on a step; 1 without noise.
    """
    deviation = np.asarray(deviation, dtype=float)
    ratio = np.divide(step, deviation, out=np.full_like(deviation, np.inf), where=deviation > 0)
    return np.asarray(erf(ratio / np.sqrt(8)))


def longest_run(
    chance: ArrayLike, count: int, false_alarm: float = _FALSE_ALARM
) -> Float[np.ndarray, "*channels"]:
    """Length that a run of equal readings reaches by chance, somewhere among `count`, with
    probability `false_alarm`, if each equals the previous one with probability `chance`.

    A run of r readings takes r − 1 repeats; over `count` positions its probability is at most
    count p^(r−1).
    """
    with np.errstate(divide="ignore"):
        return np.asarray(1 + np.ceil(np.log(count / false_alarm) / np.abs(np.log(chance))))


def _repeat_chances(noise: Noise, wrench: Wrenches) -> tuple[Wrench, Wrench]:
    """White noise (6,), and the probability (6,) that a reading repeats, for the stated resolution
    or the smallest step seen in the numbers, whichever is larger.
    """
    shown, deviation = smallest_steps(wrench), believed_noise(noise, wrench)
    steps = np.maximum(noise.resolution, np.where(np.isfinite(shown), shown, 0))
    return deviation, repeat_chance(deviation, steps)


def held_rows(noise: Noise, raw: RawRecording) -> Iterator[Fault]:
    """Rows that repeat the reading above them in all channels more often than chance allows: lost
    samples, replaced by the last one.

    If a third of all rows do so, the sensor is slower than the log; that is a single, quiet
    finding.
    """
    wrench, rows = raw.wrench, len(raw.time)
    same, what = repeating_rows(wrench), "repeat the reading above them in all channels"
    if not own_rows(wrench).all():
        count = np.count_nonzero(same)
        text = (
            f"{count} of {rows} rows {what}, as from a sensor of "
            f"{(1 - count / rows) * raw.rate:.4g} readings a second in a log of {raw.rate:.4g}"
        )
        yield Fault.over(CHANNELS, FaultKind.HELD, raw.time, text, count, quiet=True)
        return
    needed = float(longest_run(np.prod(_repeat_chances(noise, wrench)[1]), rows))
    for start, stop in runs(same):
        if stop - start + 1 >= needed:
            text = f"{stop - start} rows {what}"
            yield Fault.over(CHANNELS, FaultKind.HELD, raw.time[start:stop], text)


def standing_channels(sensor: Sensor, raw: RawRecording) -> Iterator[Fault]:
    """Runs of equal readings longer than chance allows: flat-topped if they are at a channel's
    extreme and are reached and left gradually (which then goes for all readings of that value),
    else stuck.

    If the range is known, readings at its limit are saturated, however few.
    """
    deviations, chances = _repeat_chances(sensor.noise, raw.wrench)
    needed = np.maximum(_SHORTEST, longest_run(chances, len(raw.time)))
    limits = sensor.response.limits(sensor.noise.resolution)
    if sensor.wrench_frame == "world":
        # In world axes no channel is a single channel of the sensor.
        limits = np.full(6, np.inf)
    for name, unit, values, deviation, least, limit in zip(
        CHANNELS, CHANNEL_UNITS, raw.wrench.T, deviations, needed, limits, strict=True
    ):
        full, tops = np.abs(values) >= limit * (1 - _ROUNDING), []
        for start, last in runs((np.diff(values) == 0) & ~full[1:]):
            stop, value = last + 1, values[start]
            if stop - start < least:
                continue
            if _flat_topped(values, start, stop, deviation):
                tops.append(value)
                continue
            text = (
                f"{name} is stuck at {value:.6g} {unit} for {stop - start} rows; {least:.0f} in a "
                "row come by chance in one of a million recordings"
            )
            yield Fault.over((name,), FaultKind.STUCK, raw.time[start:stop], text)
        for start, stop in runs(full | np.isin(values, tops)):
            how = (
                f"at the range of {limit:g}"
                if full[start]
                else f"flat-topped at {values[start]:.6g}"
            )
            text = f"{stop - start} readings of {name} are {how} {unit}"
            yield Fault.over((name,), FaultKind.SATURATION, raw.time[start:stop], text)


def _flat_topped(values: Times, start: int, stop: int, deviation: float) -> bool:
    value, steps = values[start], np.abs(np.diff(values))
    height = np.abs(value - np.nanmedian(values))
    if value not in (np.nanmax(values), np.nanmin(values)) or height < _FLAT_TOP * deviation:
        return False
    # Next to a missing row, how the channel reached or left the value is unknown.
    ends = np.concatenate([steps[max(0, start - 1) : start], steps[stop - 1 : stop]])
    return not np.any(ends > _FLAT_TOP * max(deviation, np.nanmedian(steps)))
