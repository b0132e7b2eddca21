"""Rest in a recording: intervals in which the wrench changes by no more than its noise."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from vibrissa.sensor.deviations import (
    MEDIAN_TO_DEVIATION,
    own_rows,
    reading_deviation,
    shown_steps,
)
from vibrissa.sensor.raw import (
    Covariance,
    Fault,
    FaultKind,
    Interval,
    RawRecording,
    Wrench,
    Wrenches,
    names_of,
)
from vibrissa.sensor.tare import Tare, without_given

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

# A block lasts two mains periods, and holds enough samples for a mean.
_BLOCK_SECONDS = 0.04
_BLOCK_SAMPLES = 5
# Fewer means do not distinguish rest from a turning point of the load.
_FEWEST_BLOCKS = 4
# Standard errors: by chance in one of 10⁸ comparisons.
_DEVIATIONS = 6.0
# Fraction of a rest that is dropped next to a change, which may have begun unnoticed.
_GUARD = 0.1
ANOTHER_LEVEL = 0.2
"""Fraction of the largest load: two rests that differ by more are not both free of contact."""
# Standard deviations above which a force is a load, and how many such samples a median needs.
_LOADED, _FEWEST_LOADED = 10.0, 20
# Fraction of the extent of the motion: a sensor that moves more within a rest is not in contact.
_MOVED = 0.02
# The median absolute value of n normal numbers is 0.67, with a standard error of 0.79/√n.
_MEDIAN_ERROR = 0.79 / MEDIAN_TO_DEVIATION


@dataclass(frozen=True)
class Rest:
    """Quiet intervals of a recording.

    Attributes
    ----------
    intervals
        (start, stop) [s] on the recording's clock, in order, trimmed where a contact may have
        begun.
    leading, trailing
        Those at the start and at the end of the recording, or None.
    """

    intervals: tuple[Interval, ...] = ()
    leading: Interval | None = None
    trailing: Interval | None = None

    @property
    def ends(self) -> tuple[Interval, Interval] | None:
        """Rest at the start and a separate one at the end, or None."""
        if self.leading is None or self.trailing is None or self.leading == self.trailing:
            return None
        return self.leading, self.trailing


def find_rest(sensor: "Sensor", raw: RawRecording) -> Rest:
    """Quiet intervals of a recording: block means stay, in all channels, within six standard errors
    of the mean of the interval so far.

    An interval has at least four blocks of 0.04 s or five samples each, whichever is longer. Known
    mount weight and drift are subtracted first.
    """
    rows, means, tolerance = _blocks(sensor, raw)
    count = len(rows)
    if count < _FEWEST_BLOCKS:
        return Rest()
    # The last one is followed backwards from the end, so that it gets there even if there is drift.
    ending = count - _stays(means[::-1], tolerance)
    stretches, first = [], 0
    while first < count:
        last = first + _stays(means[first:], tolerance)
        if first == 0 or last <= ending:
            stretches.append((first, last))
        first = last
    leading = trailing = None
    intervals: dict[Interval, None] = {}
    for first, last in [*stretches, (ending, count)]:
        guard = max(1, round(_GUARD * (last - first)))
        begin, end = first + guard * (first > 0), last - guard * (last < count)
        if end - begin >= _FEWEST_BLOCKS:
            found = raw.time[rows[begin, 0]], raw.time[rows[end - 1, -1]] + 0.5 / raw.rate
            intervals[found] = None
            leading = found if first == 0 else leading
            trailing = found if last == count else trailing
    return Rest(tuple(intervals), leading, trailing)


def rest_for_tare(sensor: "Sensor", raw: RawRecording) -> tuple[tuple[Interval, ...], str]:
    """Contact-free intervals in which the tare is taken, and how they were found.

    Raises
    ------
    ValueError
        If the given rest does not fit the recording, or none is given and none can be found because
        the recording starts in contact or under a changing load.
    """
    policy, first, wanted = sensor.tare_policy, float(raw.time[0]), sensor.estimates
    seconds, leading = policy.tare_seconds, None
    how, where = "found automatically", "at the start and at the end"
    if policy.rest_intervals:
        given = ((first + start, first + stop) for start, stop in policy.rest_intervals)
        return tuple(given), "given as rest_intervals"
    if seconds == 0:
        if wanted:
            raise ValueError(
                f"{wanted[0]} = True with tare_seconds = 0; allowed are rest_intervals, "
                "a tare_seconds greater than 0, or none to find the rest"
            )
        return (), "none: tare_seconds = 0"
    if seconds is not None:
        count = np.count_nonzero(raw.time - first < seconds)
        if count < 2 or count >= len(raw.time):
            raise ValueError(
                f"tare_seconds = {seconds}: {count} of {len(raw.time)} samples lie within it; "
                "allowed are at least 2, and fewer than all"
            )
        leading = first, first + seconds
        how, where = "given as tare_seconds", "and found at the end"
    rest = Rest() if leading and not wanted else find_rest(sensor, raw)
    if "mount.estimated" in wanted:
        if not rest.intervals:
            raise ValueError(
                "no rest is found in the recording; allowed are rest_intervals that are free of "
                "contact"
            )
        return rest.intervals, "found automatically, in all orientations"
    leading = leading or _checked_leading(sensor, raw, rest)
    if not wanted:
        return (leading,), how
    if rest.trailing is None or rest.trailing[0] <= leading[0 if seconds is None else 1]:
        raise ValueError(
            "estimate_drift = True: no rest is found at the end of the recording; allowed are "
            "rest_intervals that name one"
        )
    return (leading, rest.trailing), f"{how}, {where}"


def restless_tare(sensor: "Sensor", raw: RawRecording, tare: Tare) -> Iterator[Fault]:
    """Given tare intervals in which the readings change by more than their noise, from the first
    such block of samples on: a contact, or a drift.
    """
    for interval in tare.intervals:
        rows, means, tolerance = _blocks(sensor, raw, interval)
        count = len(rows)
        if count < _FEWEST_BLOCKS:
            continue
        # Known drift has already been subtracted from the readings.
        drift = tare.drift - sensor.tare_policy.drift
        means = means - (raw.time[rows].mean(axis=1) - tare.epoch)[:, None] * drift
        first = _stays(means, tolerance)
        if first < count:
            off = np.abs(means[first:] - means[:first].mean(axis=0)) > tolerance
            channels, stamps = names_of(off.any(axis=0)), raw.time[rows[first:].ravel()]
            text = (
                f"the tare, {tare.found}, is not taken at rest: {', '.join(channels)} change from "
                f"{stamps[0] - raw.time[0]:.3g} s on; a contact, or a drift"
            )
            yield Fault.over(channels, FaultKind.REST, stamps, text)


def _checked_leading(sensor: "Sensor", raw: RawRecording, rest: Rest) -> Interval:
    """The rest at the start; raise ValueError if there is none, or if the rest at the end has
    another level that makes the loads fit single contacts better.
    """
    first = float(raw.time[0])
    advice = (
        "allowed are tare_seconds or rest_intervals that are free of contact, or tare_seconds = 0 "
        "for no tare"
    )
    if rest.leading is None:
        others = ", ".join(f"{a - first:.3g} s to {b - first:.3g} s" for a, b in rest.intervals[:4])
        elsewhere = f" (the wrench does not change from {others} after its start)" if others else ""
        raise ValueError(
            "tare_seconds is not given, and the recording starts in contact or under a changing "
            f"load{elsewhere}; {advice}"
        )
    if rest.ends is None:
        return rest.leading
    readings = without_given(sensor, raw)
    levels = [np.nanmean(readings[raw.during(interval)], axis=0) for interval in rest.ends]
    step = share_of_load(levels[1] - levels[0], readings - levels[0])
    if step < ANOTHER_LEVEL:
        return rest.leading
    between = ~np.any([raw.during(interval) for interval in rest.intervals], axis=0)
    rows = between & np.isfinite(np.hstack([readings, raw.orientation])).all(axis=1)
    maps = sensor.to_reactions(raw.orientation[rows])
    scaled = maps * reading_deviation(sensor.noise, readings[rows])
    misfits = [
        contact_misfits(
            np.einsum("nij,nj->ni", maps, readings[rows] - level),
            scaled @ np.swapaxes(scaled, 1, 2),
        )
        for level in levels
    ]
    fewest = min(map(len, misfits))
    early, late = map(np.median, misfits) if fewest else (0.0, 0.0)
    # If the samples between do not decide, a rest during which the sensor travels is free.
    apart = _DEVIATIONS * _MEDIAN_ERROR / np.sqrt(max(fewest, 1)) * min(early, late)
    way = raw.position[raw.during(rest.leading)]
    extent = np.linalg.norm(np.ptp(raw.position, axis=0))
    travelled = np.linalg.norm(way[-1] - way[0]) > _MOVED * extent
    if early <= late if abs(early - late) > apart else travelled:
        return rest.leading
    raise ValueError(
        "tare_seconds is not given, and the rest at the start, to "
        f"{rest.leading[1] - first:.3g} s, seems to be in contact: the one at the end, from "
        f"{rest.ends[1][0] - first:.3g} s, differs from it by {step:.0%} of the largest load; "
        f"{advice}"
    )


def share_of_load(step: Wrench, load: Wrenches) -> float:
    """A zero shift as a fraction of the largest load (n, 6): the larger of force and torque."""
    most = np.nanmax(np.linalg.norm(load.reshape(-1, 2, 3), axis=2), axis=0)
    return float(np.max(np.linalg.norm(step.reshape(2, 3), axis=1) / (most + 1e-300)))


def contact_misfits(wrench: Wrenches, covariance: Covariance) -> Float[np.ndarray, "loaded"]:
    """|m0·f0| over its standard deviation, m0·f0 being zero for a single contact (mechanics.md,
    (
        "Statics gives "
        "a line"
    )), in rows with forces of more than ten deviations; empty if fewer than 20.
    """
    covariance = np.broadcast_to(covariance, (len(wrench), 6, 6))
    deviation = np.sqrt(np.einsum("nii->n", covariance[:, :3, :3]) / 3)
    loaded = np.linalg.norm(wrench[:, :3], axis=1) > _LOADED * deviation
    loaded &= np.count_nonzero(loaded) >= _FEWEST_LOADED
    wrench, covariance = wrench[loaded], covariance[loaded]
    gradient = np.roll(wrench, 3, axis=1)
    spread = np.sqrt(np.einsum("ni,nij,nj->n", gradient, covariance, gradient))
    return np.abs(np.sum(wrench[:, :3] * wrench[:, 3:], axis=1)) / np.maximum(spread, 1e-300)


def _blocks(
    sensor: "Sensor", raw: RawRecording, interval: Interval = (-np.inf, np.inf)
) -> tuple[Int[np.ndarray, "blocks size"], Float[np.ndarray, "blocks 6"], Wrench]:
    """Blocks of consecutive usable samples of an interval: their rows, the means of their readings
    with known drift and weight subtracted, and six standard errors (6,) of a mean.
    """
    usable, readings = raw.whole & own_rows(raw.wrench), without_given(sensor, raw)
    size = max(_BLOCK_SAMPLES, round(_BLOCK_SECONDS * np.nan_to_num(raw.rate)))
    chosen = np.flatnonzero(usable & raw.during(interval))
    blocks = chosen[: len(chosen) // size * size].reshape(-1, size)
    variance = np.zeros(6)
    if len(blocks):
        good = readings[usable]
        variance += reading_deviation(sensor.noise, good) ** 2 / size
        variance += (shown_steps(sensor.noise, good) / 4) ** 2
        # The offset wanders between the blocks of an interval: ten blocks apart on average.
        early, late = raw.time[usable][0] + np.array([[0, 1], [10, 11]]) * size / raw.rate
        times = raw.time[np.isfinite(raw.time)]
        variance += sensor.noise.wandered(times, tuple(early), tuple(late))
    return blocks, readings[blocks].mean(axis=1), _DEVIATIONS * np.sqrt(variance)


def _stays(means: Float[np.ndarray, "blocks 6"], tolerance: Wrench) -> int:
    """Number of leading blocks that each stay near the mean of those before."""
    total = means[0].copy()
    for count, mean in enumerate(means[1:], start=1):
        if np.any(np.abs(mean - total / count) > tolerance * np.sqrt(1 + 1 / count)):
            return count
        total += mean
    return len(means)
