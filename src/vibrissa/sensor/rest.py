"""Where a recording is at rest: stretches in which the wrench does not change beyond its noise."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.sensor.deviations import (
    MEDIAN_TO_DEVIATION,
    own_rows,
    reading_deviation,
    shown_steps,
)
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.maps import to_reactions
from vibrissa.sensor.raw import (
    Covariances,
    Interval,
    RawRecording,
    Rows,
    Times,
    Wrench,
    Wrenches,
    channel_names,
)
from vibrissa.sensor.tare import Tare, without_given

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

# A block lasts two periods of the mains, and holds enough samples for a mean of them.
_BLOCK_SECONDS = 0.04
_BLOCK_SAMPLES = 5
# Fewer means do not tell rest from a turning point of the load.
_FEWEST_BLOCKS = 4
# Standard errors: by chance in one of 10⁸ comparisons.
_DEVIATIONS = 6.0
# Share of a rest that is left out next to its change, which may have begun unnoticed.
_GUARD = 0.1
# Of the largest deviation from the first level: two rests that differ by more are not both free of
# contact.
_ANOTHER_LEVEL = 0.2
# Standard deviations from which on a force is a load, and how many such samples a median needs.
_LOADED, _FEWEST_LOADED = 10.0, 20
# Of the sensor's whole way: one that travels more within a rest is not in contact there.
_MOVED = 0.02
# The median size of n normal numbers has the standard error 0.79/√n, where it is 0.67.
_MEDIAN_ERROR = 0.79 / MEDIAN_TO_DEVIATION


@dataclass(frozen=True)
class Rest:
    """Quiet stretches of a recording.

    Attributes
    ----------
    intervals
        (start, stop) [s] on the recording's clock, in order, without the ends that may hold the
        beginning of a contact.
    leading, trailing
        The one at the start of the recording and the one at its end, or None.
    """

    intervals: tuple[Interval, ...]
    leading: Interval | None
    trailing: Interval | None

    @property
    def ends(self) -> tuple[Interval, Interval] | None:
        """Rest at the start and another at the end, or None."""
        if self.leading is None or self.trailing is None or self.leading == self.trailing:
            return None
        return self.leading, self.trailing


class _Blocks(NamedTuple):
    """Consecutive samples, their rows, and the means of their readings."""

    rows: Int[np.ndarray, "blocks size"]
    means: Float[np.ndarray, "blocks 6"]
    tolerance: Wrench
    """Six standard errors (6,) of a block's mean."""


def find_rest(sensor: "Sensor", raw: RawRecording) -> Rest:
    """Quiet stretches of a recording: block means that stay, in all channels, within six standard
    errors of the mean of the stretch so far.

    A stretch has at least four blocks, each of 0.04 s or five samples, whichever is longer. A
    weight of the mount and a drift that are given are taken off before.
    """
    blocks = _blocks(sensor, raw, np.ones(len(raw.time), dtype=bool))
    count = len(blocks.rows)
    if count < _FEWEST_BLOCKS:
        return Rest((), None, None)
    # The last stretch is followed from the end, so that it reaches it also where the offset drifts.
    ending = count - _stays(blocks.means[::-1], blocks.tolerance, 0)
    ending = ending if count - ending >= _FEWEST_BLOCKS else count
    found: dict[tuple[int, int], Interval] = {}
    for first, last in [*_stretches(blocks), (ending, count)]:
        guard = max(1, round(_GUARD * (last - first)))
        begin, end = first + (guard if first > 0 else 0), last - (guard if last < count else 0)
        own = first == 0 or last <= ending or (first, last) == (ending, count)
        if own and end - begin >= _FEWEST_BLOCKS:
            stop = raw.time[blocks.rows[end - 1, -1]] + 0.5 / raw.rate
            found[first, last] = (float(raw.time[blocks.rows[begin, 0]]), float(stop))
    leading = next((interval for (first, _), interval in found.items() if first == 0), None)
    trailing = next((interval for (_, last), interval in found.items() if last == count), None)
    return Rest(tuple(found.values()), leading, trailing)


def rest_for_tare(sensor: "Sensor", raw: RawRecording) -> tuple[tuple[Interval, ...], str]:
    """Intervals free of contact in which the tare is taken, and how they were found.

    Raises
    ------
    ValueError
        If none is given and none can be found, because the recording starts in contact or under a
        changing load.
    """
    policy, first = sensor.tare_policy, float(raw.time[0])
    if policy.rest_intervals:
        given = ((first + start, first + stop) for start, stop in policy.rest_intervals)
        return tuple(given), "given as rest_intervals"
    stated = policy.tare_seconds is not None and not sensor.estimates_mount
    leading = (first, first + (policy.tare_seconds or 0.0))
    if stated and not policy.estimate_drift:
        return (leading,), "given as tare_seconds"
    rest = find_rest(sensor, raw)
    if sensor.estimates_mount:
        return rest.intervals, "found automatically, in all orientations"
    if not stated:
        leading = _checked_leading(sensor, raw, rest)
    if not policy.estimate_drift:
        return (leading,), "found automatically"
    trailing, late = rest.trailing, leading[1] if stated else -np.inf
    if trailing is None or trailing == leading or trailing[0] <= late:
        raise ValueError(
            "estimate_drift = True: no rest is found at the end of the recording; allowed are "
            "rest_intervals that name one"
        )
    if stated:
        return (leading, trailing), "given as tare_seconds, and found at the end"
    return (leading, trailing), "found automatically, at the start and at the end"


def restless_tare(sensor: "Sensor", raw: RawRecording, tare: Tare) -> list[Fault]:
    """Given tare intervals in which the readings change by more than their noise, from the first
    block of samples that does: a contact, or a drift.
    """
    faults = []
    for interval in tare.intervals:
        blocks = _blocks(sensor, raw, raw.during(interval))
        count = len(blocks.rows)
        if count < _FEWEST_BLOCKS:
            continue
        # A given drift is off the readings already.
        drift = tare.drift - sensor.tare_policy.drift
        elapsed = raw.time[blocks.rows].mean(axis=1) - tare.epoch
        means = blocks.means - elapsed[:, None] * drift
        before = np.arange(1, count)[:, None]
        usual = np.cumsum(means, axis=0)[:-1] / before
        off = np.abs(means[1:] - usual) > blocks.tolerance * np.sqrt(1 + 1 / before)
        if not off.any():
            continue
        channels = channel_names(off.any(axis=0))
        rows = blocks.rows[1 + int(np.argmax(off.any(axis=1))) :].ravel()
        text = (
            f"the tare, {tare.found}, is not taken at rest: {', '.join(channels)} change from "
            f"{raw.time[rows[0]] - raw.time[0]:.3g} s on; a contact, or a drift"
        )
        faults.append(Fault.over(FaultKind.REST, channels, raw.time[rows], text))
    return faults


def _checked_leading(sensor: "Sensor", raw: RawRecording, rest: Rest) -> Interval:
    """The rest at the start, unless there is none, or the one at the end has another level and
    leaves loads that fit a single contact better.
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
    largest = np.nanmax(np.abs(readings - levels[0]), axis=0)
    moved, most = (
        np.linalg.norm(part.reshape(2, 3), axis=1) for part in (levels[1] - levels[0], largest)
    )
    step = float(np.max(moved / (most + 1e-300)))
    if step < _ANOTHER_LEVEL:
        return rest.leading
    between = ~np.any([raw.during(interval) for interval in rest.intervals], axis=0)
    early, late = (_contact_misfits(sensor, raw, readings - level, between) for level in levels)
    # Where the samples between do not tell the two apart, one that travels is free of contact.
    better = _clearly_less(late, early)
    if better is False or (better is None and _travelled(raw, rest.leading) > _MOVED):
        return rest.leading
    raise ValueError(
        "tare_seconds is not given, and the rest at the start, to "
        f"{rest.leading[1] - first:.3g} s, seems to be in contact: the one at the end, from "
        f"{rest.ends[1][0] - first:.3g} s, differs from it by {step:.0%} of the largest load; "
        f"{advice}"
    )


def _clearly_less(first: Float[np.ndarray, "k"], second: Float[np.ndarray, "m"]) -> bool | None:
    """Whether the first median is below the second; None where they do not differ by six standard
    errors, or too few numbers are there.
    """
    fewest = min(len(first), len(second))
    if fewest < _FEWEST_LOADED:
        return None
    medians = float(np.median(first)), float(np.median(second))
    apart = _DEVIATIONS * _MEDIAN_ERROR / np.sqrt(fewest) * min(medians)
    return None if abs(medians[0] - medians[1]) <= apart else medians[0] < medians[1]


def _contact_misfits(
    sensor: "Sensor", raw: RawRecording, loads: Wrenches, rows: Rows
) -> Float[np.ndarray, "m"]:
    """Sizes of m0·f0 in its standard deviations (m,) on the loaded ones of some rows."""
    rows = rows & np.isfinite(loads).all(axis=1)
    deviation = reading_deviation(sensor, loads[rows])
    rows = rows & np.isfinite(raw.orientation).all(axis=1)
    rows[rows] = np.linalg.norm(loads[rows, :3], axis=1) > _LOADED * deviation[0]
    if np.count_nonzero(rows) < _FEWEST_LOADED:
        return np.zeros(0)
    maps = to_reactions(sensor, rotation_matrices(raw.orientation[rows]))
    at_clamp = np.einsum("nij,nj->ni", maps, loads[rows])
    return contact_misfits(at_clamp, (maps * deviation**2) @ np.swapaxes(maps, 1, 2))


def contact_misfits(wrench: Wrenches, covariance: Covariances) -> Times:
    """Sizes (n,) of m0·f0 in its standard deviations, which is zero for a single contact
    (mechanics.md, "Statics alone").
    """
    gradient = np.roll(wrench, 3, axis=1)
    spread = np.sqrt(np.einsum("ni,nij,nj->n", gradient, covariance, gradient))
    return np.abs(np.sum(wrench[:, :3] * wrench[:, 3:], axis=1)) / np.maximum(spread, 1e-300)


def _blocks(sensor: "Sensor", raw: RawRecording, rows: Rows) -> _Blocks:
    """Blocks of the usable ones of some rows, a given drift and weight taken off."""
    usable, readings = raw.whole & own_rows(raw.wrench), without_given(sensor, raw)
    wanted = _BLOCK_SECONDS * raw.rate if np.isfinite(raw.rate) else 0.0
    size = max(_BLOCK_SAMPLES, round(wanted))
    chosen = np.flatnonzero(usable & rows)
    blocks = chosen[: len(chosen) // size * size].reshape(-1, size)
    variance = np.zeros(6)
    if len(blocks):
        variance += reading_deviation(sensor, readings[usable]) ** 2 / size
        variance += (shown_steps(sensor, readings[usable]) / 4) ** 2
        start, length = float(raw.time[usable][0]), size / raw.rate
        early = (start, start + length)
        # The offset wanders between the blocks of a stretch: ten blocks apart on average.
        late = (start + 10 * length, start + 11 * length)
        for process, scale in sensor.noise.coloured(raw.time[np.isfinite(raw.time)]):
            apart = process.between_means(early, early) + process.between_means(late, late)
            apart -= 2 * process.between_means(early, late)
            variance += scale**2 * max(apart, 0.0)
    return _Blocks(blocks, readings[blocks].mean(axis=1), _DEVIATIONS * np.sqrt(variance))


def _stretches(blocks: _Blocks) -> list[tuple[int, int]]:
    """Stretches [first, last) of four blocks and more that stay near their mean so far."""
    found, first = [], 0
    while first < len(blocks.means):
        last = _stays(blocks.means, blocks.tolerance, first)
        if last - first >= _FEWEST_BLOCKS:
            found.append((first, last))
        first = last
    return found


def _stays(means: Float[np.ndarray, "blocks 6"], tolerance: Wrench, first: int) -> int:
    """First block that is off the mean of those since `first`."""
    total = means[first].copy()
    for count, mean in enumerate(means[first + 1 :], start=1):
        if np.any(np.abs(mean - total / count) > tolerance * np.sqrt(1 + 1 / count)):
            return first + count
        total += mean
    return len(means)


def _travelled(raw: RawRecording, interval: Interval) -> float:
    """Share of the whole way of the sensor that lies within an interval."""
    inside = raw.position[raw.during(interval)]
    whole = float(np.linalg.norm(np.ptp(raw.position, axis=0)))
    return float(np.linalg.norm(inside[-1] - inside[0])) / whole if whole > 0 else 0.0
