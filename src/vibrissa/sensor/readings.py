"""Faults of the readings: rows that are missing, channels that stand still, readings at their
limit.
"""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.raw import CHANNEL_UNITS, CHANNELS, RawRecording
from vibrissa.sensor.rest import noise_by_differences, own_rows, repeating_rows
from vibrissa.sensor.stamps import runs

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

Mask = Bool[np.ndarray, "n 6"]

_FALSE_ALARM = 1e-6
_SHORTEST = 5
_JUMP = 8.0
_NEIGHBOURS = 5
_BELIEVED = 0.3
_FLAT_TOP = 10.0
_STUCK_SHARE = 0.1


def drop_outs(raw: RawRecording, unstamped: Bool[np.ndarray, "n"]) -> tuple[list[Fault], Mask]:
    """Rows in which numbers or stamps are missing, and rows of zeros from which and to which the
    readings jump by eight of their deviations.
    """
    wrench = raw.wrench
    missing = ~np.isfinite(wrench)
    pose = ~(np.isfinite(raw.position).all(axis=1) & np.isfinite(raw.orientation).all(axis=1))
    zero = _sudden_zeros(wrench)
    bad = missing | zero[:, None]
    faults = []
    for start, stop in runs(missing.any(axis=1)):
        channels = tuple(
            name
            for name, lost in zip(CHANNELS, missing[start:stop].any(axis=0), strict=True)
            if lost
        )
        faults.append(
            _fault(
                FaultKind.DROP_OUT,
                channels,
                raw,
                start,
                stop,
                f"{stop - start} rows without a number in {', '.join(channels)}",
            )
        )
    for start, stop in runs(zero):
        faults.append(
            _fault(
                FaultKind.DROP_OUT,
                CHANNELS,
                raw,
                start,
                stop,
                f"{stop - start} rows of zeros in all channels, amid others",
            )
        )
    for start, stop in runs(pose):
        faults.append(
            _fault(
                FaultKind.DROP_OUT,
                ("position", "orientation"),
                raw,
                start,
                stop,
                f"{stop - start} rows without a pose",
            )
        )
    for start, stop in runs(unstamped):
        faults.append(
            _fault(
                FaultKind.DROP_OUT,
                ("time",),
                raw,
                start,
                stop,
                f"{stop - start} rows without a stamp",
            )
        )
    return faults, bad


def _sudden_zeros(wrench: Float[np.ndarray, "n 6"]) -> Bool[np.ndarray, "n"]:
    zero = np.all(wrench == 0, axis=1)
    rest = np.flatnonzero(np.isfinite(wrench).all(axis=1) & ~zero)
    if not zero.any() or len(rest) < _NEIGHBOURS:
        return np.zeros(len(wrench), dtype=bool)
    deviation = np.nan_to_num(noise_by_differences(wrench[rest]))
    sudden = np.zeros(len(wrench), dtype=bool)
    for start, stop in runs(zero):
        place = np.searchsorted(rest, start)
        sides = [rest[max(0, place - _NEIGHBOURS) : place], rest[place : place + _NEIGHBOURS]]
        # A noiseless simulation begins at zero and leaves it gradually: there the step is no larger
        # than the next ones.
        steps = [
            np.abs(np.median(wrench[side], axis=0))
            > _JUMP * deviation + 4 * np.ptp(wrench[side], axis=0)
            for side in sides
            if len(side)
        ]
        sudden[start:stop] = all(step.any() for step in steps)
    return sudden


def longest_repeat(
    deviation: float, step: float, count: int, false_alarm: float = _FALSE_ALARM
) -> float:
    """Length that a run of equal readings reaches by chance, somewhere among `count`, with the
    probability `false_alarm`.

    A reading equals the one before with a probability of at most p = erf(step / (√8 deviation)),
    where the true value lies on a step; a run of r readings needs r − 1 such, and `count` places
    bound the chance by count p^(r−1).
    """
    same = _repeats(deviation, step)
    if same >= 1:
        return math.inf
    return (
        _SHORTEST
        if same <= 0
        else max(_SHORTEST, 1 + math.ceil(math.log(false_alarm / count) / math.log(same)))
    )


def held_rows(sensor: "Sensor", raw: RawRecording, bad: Mask) -> tuple[list[Fault], Mask]:
    """Rows that repeat the reading above them in all channels more often than chance allows: a lost
    sample, and the last one held in its place.

    Where a third of all rows do so, the sensor is slower than the log; that is one finding, and no
    row is marked.
    """
    wrench = np.where(bad, np.nan, raw.wrench)
    deviations = believed_noise(sensor, wrench)
    chance = float(
        np.prod(
            [
                _repeats(
                    float(deviations[channel]), _smallest_step(sensor, wrench[:, channel], channel)
                )
                for channel in range(6)
            ]
        )
    )
    same, held, faults = repeating_rows(wrench), np.zeros(len(wrench), dtype=bool), []
    count = int(np.count_nonzero(same))
    if not own_rows(wrench).all():
        text = f"{count} of {len(wrench)} rows repeat the reading above them in all channels, as of a sensor of {(1 - count / len(wrench)) * raw.rate:.4g} "
        text += f"readings a second in a log of {raw.rate:.4g}"
        return [
            replace(_fault(FaultKind.HELD, CHANNELS, raw, 0, len(wrench), text), count=count)
        ], np.zeros_like(bad)
    if chance >= 1 or not same.any():
        return [], np.zeros_like(bad)
    needed = (
        2
        if chance <= 0
        else max(2, 1 + math.ceil(math.log(_FALSE_ALARM / len(wrench)) / math.log(chance)))
    )
    found = [(start, stop) for start, stop in runs(same) if stop - start + 1 >= needed]
    for start, stop in found:
        held[start:stop] = True
        faults.append(
            _fault(
                FaultKind.HELD,
                CHANNELS,
                raw,
                start,
                stop,
                f"{stop - start} rows repeat the reading above them in all channels",
            )
        )
    return faults, np.repeat(held[:, None], 6, axis=1)


def _repeats(deviation: float, step: float) -> float:
    """Largest chance that a reading equals the one before."""
    return 1.0 if deviation <= 0 else math.erf(step / (math.sqrt(8) * deviation))


def standing_channels(sensor: "Sensor", raw: RawRecording, bad: Mask) -> tuple[list[Fault], Mask]:
    """Runs of equal readings longer than chance allows: flat-topped where they are a channel's
    extreme that it comes to and leaves gradually, else stuck.

    With a known range, readings at it are saturated, however few.
    """
    wrench = np.where(bad, np.nan, raw.wrench)
    deviations = believed_noise(sensor, wrench)
    standing, faults = np.zeros_like(bad), []
    for channel in range(len(CHANNELS)):
        full = _at_range(sensor, wrench[:, channel], channel)
        standing[:, channel] |= full
        faults += [_saturated(sensor, raw, channel, start, stop) for start, stop in runs(full)]
        tops: set[float] = set()
        needed = longest_repeat(
            float(deviations[channel]),
            _smallest_step(sensor, wrench[:, channel], channel),
            len(wrench),
        )
        for start, stop in _equal_runs(wrench[:, channel], full):
            if stop - start >= needed:
                standing[start:stop, channel] = True
                faults.append(
                    _repeating(
                        raw,
                        wrench[:, channel],
                        channel,
                        (start, stop),
                        float(deviations[channel]),
                        needed,
                    )
                )
                tops |= (
                    {float(wrench[start, channel])}
                    if faults[-1].kind is FaultKind.SATURATION
                    else set()
                )
        same = np.isin(wrench[:, channel], list(tops)) & ~standing[:, channel]
        standing[:, channel] |= same
        faults += [
            _at_the_top(raw, wrench[:, channel], channel, start, stop) for start, stop in runs(same)
        ]
    return faults, standing


def _at_range(
    sensor: "Sensor", values: Float[np.ndarray, "n"], channel: int
) -> Bool[np.ndarray, "n"]:
    limit = _limit(sensor, channel)
    return (
        np.zeros(len(values), dtype=bool) if limit is None else np.abs(values) >= limit * (1 - 1e-9)
    )


def _saturated(sensor: "Sensor", raw: RawRecording, channel: int, start: int, stop: int) -> Fault:
    text = f"{stop - start} readings of {CHANNELS[channel]} at the range of {_limit(sensor, channel):g} {CHANNEL_UNITS[channel]}"
    return _fault(FaultKind.SATURATION, (CHANNELS[channel],), raw, start, stop, text)


def _at_the_top(
    raw: RawRecording, values: Float[np.ndarray, "n"], channel: int, start: int, stop: int
) -> Fault:
    text = f"{stop - start} more readings of {CHANNELS[channel]} at its flat top of {values[start]:.6g} {CHANNEL_UNITS[channel]}"
    return _fault(FaultKind.SATURATION, (CHANNELS[channel],), raw, start, stop, text)


def _repeating(
    raw: RawRecording,
    values: Float[np.ndarray, "n"],
    channel: int,
    rows: tuple[int, int],
    deviation: float,
    needed: float,
) -> Fault:
    flat, name = _flat_topped(values, *rows, deviation), CHANNELS[channel]
    word = "flat-topped" if flat else "stuck"
    text = f"{name} is {word} at {values[rows[0]]:.6g} {CHANNEL_UNITS[channel]} for {rows[1] - rows[0]} rows; "
    text += f"{needed:.0f} in a row come by chance in one of a million recordings"
    return _fault(FaultKind.SATURATION if flat else FaultKind.STUCK, (name,), raw, *rows, text)


def believed_noise(sensor: "Sensor", wrench: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "6"]:
    """White noise (6,) by second differences; of a channel that shows next to none, what the others
    of its kind show, or what is stated if they agree with it.

    0 for a noiseless simulation, whose third differences are small against its second ones; those
    of white noise are larger by √(20/6).
    """
    good = wrench[np.isfinite(wrench).all(axis=1)]
    own = np.nan_to_num(noise_by_differences(good)) if len(good) > _NEIGHBOURS else np.zeros(6)
    if len(good) > _NEIGHBOURS:
        second, third = (
            np.median(np.abs(np.diff(good, n=order, axis=0)), axis=0) for order in (2, 3)
        )
        own = np.where(third > second, own, 0.0)
    believed = own.copy()
    for part in (slice(0, 3), slice(3, 6)):
        usual = np.full(3, np.median(own[part]))
        if sensor.force_noise is not None:
            stated = sensor.noise[part]
            usual = np.where(np.median(own[part] / stated) > _BELIEVED, stated, usual)
        quiet = own[part] < _STUCK_SHARE * usual
        believed[part] = np.where(quiet, usual, own[part])
    return believed


def _smallest_step(sensor: "Sensor", values: Float[np.ndarray, "n"], channel: int) -> float:
    """Step of the numbers: as stated, or the smallest that they show, if that is larger."""
    stated = float(sensor.resolution[channel])
    different = np.diff(np.unique(values[np.isfinite(values)]))
    # Equal decimals read as binary numbers differ in the last digit.
    different = (
        different[different > 1e-12 * np.nanmax(np.abs(values), initial=0.0)]
        if len(different)
        else different
    )
    return max(stated, float(different.min())) if len(different) else stated


def _equal_runs(
    values: Float[np.ndarray, "n"], without: Bool[np.ndarray, "n"]
) -> list[tuple[int, int]]:
    same = (np.diff(values) == 0) & ~without[1:] & ~without[:-1]
    return [(start, stop + 1) for start, stop in runs(same) if stop + 1 - start >= _SHORTEST]


def _flat_topped(values: Float[np.ndarray, "n"], start: int, stop: int, deviation: float) -> bool:
    value = values[start]
    finite = values[np.isfinite(values)]
    if (
        value not in (finite.max(), finite.min())
        or abs(value - np.median(finite)) < _FLAT_TOP * deviation
    ):
        return False
    steps = np.abs(np.diff(values))
    usual = _FLAT_TOP * max(deviation, float(np.nanmedian(steps)))
    # Next to a row that is missing it is not known how the channel came or left.
    before = start > 0 and steps[start - 1] > usual
    after = stop < len(values) and steps[stop - 1] > usual
    return not (before or after)


def _limit(sensor: "Sensor", channel: int) -> float | None:
    """Largest reading of a channel; none in world axes, in which no channel is one of the sensor's."""
    largest, step = sensor.ranges[channel], float(sensor.resolution[channel])
    if largest is None or sensor.wrench_frame == "world":
        return None
    return math.floor(largest / step + 1e-9) * step if step else largest


def _fault(
    kind: FaultKind, channels: tuple[str, ...], raw: RawRecording, start: int, stop: int, text: str
) -> Fault:
    return Fault(
        kind, channels, float(raw.time[start]), float(raw.time[stop - 1]), stop - start, text
    )
