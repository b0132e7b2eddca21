"""Where a recording is at rest: stretches in which the wrench does not change beyond its noise."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.maps import to_reactions
from vibrissa.sensor.raw import CHANNELS, RawRecording
from vibrissa.sensor.stamps import MEDIAN_TO_DEVIATION
from vibrissa.sensor.tare import Tare, without_given

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

Interval = tuple[float, float]

_BLOCK_SECONDS = 0.04
_BLOCK_SAMPLES = 5
_FEWEST_BLOCKS = 4
_DEVIATIONS = 6.0
_GUARD = 0.1
# Of the largest deviation from the first level: two rests that differ by more are not both free of
# contact.
_ANOTHER_LEVEL = 0.2
_LOADED = 10.0
_FEWEST_LOADED = 20
_MOVED = 0.02
_SLOWER, _OFTEN = 1 / 3, 0.05
_NOISIER, _QUIETER = 1.5, 0.1


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


def noise_by_differences(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k"]:
    """Standard deviation (k,) of white noise on a smooth signal, by the median of second
    differences; NaN with fewer than three rows.
    """
    second = np.abs(np.diff(values, n=2, axis=0))
    if not len(second):
        return np.full(values.shape[1], np.nan)
    return np.asarray(np.median(second, axis=0) / (MEDIAN_TO_DEVIATION * np.sqrt(6)))


def repeating_rows(wrench: Float[np.ndarray, "n 6"]) -> Bool[np.ndarray, "n"]:
    """Rows that are equal to the one above in all channels."""
    return np.concatenate([np.zeros(1, dtype=bool), np.all(np.diff(wrench, axis=0) == 0, axis=1)])[
        : len(wrench)
    ]


def own_rows(wrench: Float[np.ndarray, "n 6"]) -> Bool[np.ndarray, "n"]:
    """Rows with a reading of their own: all, unless a third of them repeat the one above, as where
    the sensor is slower than the log.

    A simulation without noise repeats itself too, but in few stretches: before and after the
    contact.
    """
    same = repeating_rows(wrench)
    often = np.count_nonzero(np.diff(same.astype(np.int8)) > 0) > _OFTEN * len(same)
    return (
        ~same
        if often and np.count_nonzero(same) > _SLOWER * len(same)
        else np.ones(len(same), dtype=bool)
    )


def find_rest(sensor: "Sensor", raw: RawRecording) -> Rest:
    """Quiet stretches of a recording: block means that stay, in all channels, within six standard
    errors of the mean of the stretch so far.

    A stretch has at least four blocks, each of 0.04 s or five samples, whichever is longer. A
    weight of the mount and a drift that are given are taken off before.
    """
    rows = np.flatnonzero(
        np.isfinite(raw.wrench).all(axis=1) & np.isfinite(raw.time) & own_rows(raw.wrench)
    )
    size = _block_size(raw)
    count = len(rows) // size
    if count < _FEWEST_BLOCKS:
        return Rest((), None, None)
    blocks = rows[: count * size].reshape(count, size)
    readings = without_given(sensor, raw)
    means = readings[blocks].mean(axis=1)
    tolerance = _tolerance(sensor, raw, readings[rows], size)
    runs = _runs(means, tolerance)
    # The last stretch is followed from the end, so that it reaches it also where the offset drifts.
    ending = [
        (count - last, count - first) for first, last in _runs(means[::-1], tolerance) if first == 0
    ]
    runs = [run for run in runs if not ending or run[1] <= ending[0][0] or run[0] == 0] + [
        run for run in ending if run not in runs or run[0] > 0
    ]
    found: dict[tuple[int, int], Interval] = {}
    for first, last in runs:
        guard = max(1, round(_GUARD * (last - first)))
        begin, end = first + (guard if first > 0 else 0), last - (guard if last < count else 0)
        if end - begin >= _FEWEST_BLOCKS:
            stop = raw.time[blocks[end - 1, -1]] + 0.5 / raw.rate
            found[first, last] = (float(raw.time[blocks[begin, 0]]), float(stop))
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
    first = float(raw.time[0])
    estimated = sensor.mount is not None and sensor.mount.estimated
    if sensor.rest_intervals:
        return tuple(
            (first + start, first + stop) for start, stop in sensor.rest_intervals
        ), "given as rest_intervals"
    if sensor.tare_seconds is not None and not estimated:
        given = (first, first + sensor.tare_seconds)
        if not sensor.estimate_drift:
            return (given,), "given as tare_seconds"
        trailing = find_rest(sensor, raw).trailing
        if trailing is None or trailing[0] <= given[1]:
            raise ValueError(
                "estimate_drift = True: no rest is found at the end of the recording; allowed are rest_intervals that name one"
            )
        return (given, trailing), "given as tare_seconds, and found at the end"
    rest = find_rest(sensor, raw)
    if estimated:
        return rest.intervals, "found automatically, in all orientations"
    leading = _checked_leading(sensor, raw, rest)
    if not sensor.estimate_drift:
        return (leading,), "found automatically"
    if rest.trailing is None or rest.trailing == leading:
        raise ValueError(
            "estimate_drift = True: no rest is found at the end of the recording; allowed are rest_intervals that name one"
        )
    return (leading, rest.trailing), "found automatically, at the start and at the end"


def restless_tare(sensor: "Sensor", raw: RawRecording, tare: Tare) -> list[Fault]:
    """Given tare intervals in which the readings change by more than their noise, from the first
    block of samples that does: a contact, or a drift.
    """
    readings = without_given(sensor, raw)
    own = np.isfinite(raw.wrench).all(axis=1) & own_rows(raw.wrench)
    faults = []
    for start, stop in tare.intervals:
        rows = np.flatnonzero((raw.time >= start) & (raw.time < stop) & own)
        size = _block_size(raw)
        count = len(rows) // size
        if count < _FEWEST_BLOCKS:
            continue
        blocks = rows[: count * size].reshape(count, size)
        means = readings[blocks].mean(axis=1) - (
            raw.time[blocks].mean(axis=1)[:, None] - tare.epoch
        ) * _found_drift(sensor, tare)
        tolerance = _tolerance(sensor, raw, readings[own], size)
        usual = np.array([means[:block].mean(axis=0) for block in range(1, count)])
        off = np.abs(means[1:] - usual) > tolerance * np.sqrt(1 + 1 / np.arange(1, count))[:, None]
        if not off.any():
            continue
        first = 1 + int(np.argmax(off.any(axis=1)))
        channels = tuple(
            name for name, changed in zip(CHANNELS, off.any(axis=0), strict=True) if changed
        )
        at, end = float(raw.time[blocks[first, 0]]), float(raw.time[rows[-1]])
        text = f"the tare, {tare.found}, is not taken at rest: {', '.join(channels)} change from {at - float(raw.time[0]):.3g} s on; a contact, or a drift"
        faults.append(
            Fault(
                FaultKind.REST,
                channels,
                at,
                end,
                int(np.count_nonzero(rows >= blocks[first, 0])),
                text,
            )
        )
    return faults


def _found_drift(sensor: "Sensor", tare: Tare) -> Float[np.ndarray, "6"]:
    """The drift that was estimated; a given one is off the readings already."""
    return tare.drift - np.concatenate([sensor.force_drift, sensor.torque_drift])


def _checked_leading(sensor: "Sensor", raw: RawRecording, rest: Rest) -> Interval:
    first = float(raw.time[0])
    advice = "allowed are tare_seconds or rest_intervals that are free of contact, or tare_seconds = 0 for no tare"
    others = ", ".join(
        f"{start - first:.3g} s to {stop - first:.3g} s" for start, stop in rest.intervals[:4]
    )
    elsewhere = f" (the wrench does not change from {others} after its start)" if others else ""
    if rest.leading is None:
        raise ValueError(
            f"tare_seconds is not given, and the recording starts in contact or under a changing load{elsewhere}; {advice}"
        )
    if rest.trailing is None or rest.trailing == rest.leading:
        return rest.leading
    readings = without_given(sensor, raw)
    levels = [_level(raw, readings, interval) for interval in (rest.leading, rest.trailing)]
    largest = np.nanmax(np.abs(readings - levels[0]), axis=0)
    step = max(
        float(np.linalg.norm((levels[1] - levels[0])[part]))
        / (float(np.linalg.norm(largest[part])) + 1e-300)
        for part in _PARTS
    )
    if step < _ANOTHER_LEVEL:
        return rest.leading
    between = np.ones(len(raw.time), dtype=bool)
    for start, stop in rest.intervals:
        between &= (raw.time < start) | (raw.time >= stop)
    choice = _better_level(
        *(
            single_contact_residuals(
                sensor, raw, np.where(between[:, None], readings - level, np.nan)
            )
            for level in levels
        )
    )
    if choice == 0 or (choice is None and _travelled(raw, rest.leading) > _MOVED):
        return rest.leading
    raise ValueError(
        f"tare_seconds is not given, and the rest at the start, to {rest.leading[1] - first:.3g} s, seems to be in contact: the one at the end, from "
        f"{rest.trailing[0] - first:.3g} s, is another by {step:.0%} of the largest load; {advice}"
    )


_PARTS = (slice(0, 3), slice(3, 6))


def _better_level(first: Float[np.ndarray, "m"], second: Float[np.ndarray, "k"]) -> int | None:
    """Which of two tares leaves forces and moments that fit a single contact better, by six
    standard errors of a median; None for neither.
    """
    fewest = min(len(first), len(second))
    if fewest < _FEWEST_LOADED:
        return None
    medians = [float(np.median(part)) for part in (first, second)]
    # Of n normal numbers the median of the sizes has the standard error 0.79/√n, in units in which
    # it is 0.67.
    apart = _DEVIATIONS * 0.79 / np.sqrt(fewest) * min(medians) / MEDIAN_TO_DEVIATION
    if abs(medians[1] - medians[0]) <= apart:
        return None
    return int(medians[1] < medians[0])


def single_contact_residuals(
    sensor: "Sensor", raw: RawRecording, loads: Float[np.ndarray, "n 6"]
) -> Float[np.ndarray, "m"]:
    """Sizes of m0·f0 in its standard deviations (m,) on the loaded samples (mechanics.md, "Statics
    alone").
    """
    deviation = reading_deviation(sensor, loads[np.isfinite(loads).all(axis=1)])
    loaded = np.linalg.norm(loads[:, :3], axis=1) > _LOADED * deviation[0]
    loaded &= np.isfinite(raw.orientation).all(axis=1)
    maps = (
        to_reactions(sensor, rotation_matrices(raw.orientation[loaded]))
        if loaded.any()
        else np.zeros((0, 6, 6))
    )
    at_clamp = np.einsum("nij,nj->ni", maps, loads[loaded])
    gradient = np.concatenate([at_clamp[:, 3:], at_clamp[:, :3]], axis=1)
    spread = np.sqrt(np.sum((np.einsum("nij,ni->nj", maps, gradient) * deviation) ** 2, axis=1))
    product = np.abs(np.einsum("ni,ni->n", at_clamp[:, :3], at_clamp[:, 3:]))
    return product / np.maximum(spread, 1e-300)


def reading_deviation(sensor: "Sensor", values: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "6"]:
    """Standard deviation (6,) of a reading: as stated, or as second differences show where it is
    not, or where they show half as much again or a tenth.
    """
    if not len(values):
        return np.ones(6)
    own = np.nan_to_num(noise_by_differences(values))
    if sensor.force_noise is None:
        return np.maximum(own, 1e-6 * np.ptp(values, axis=0)) + 1e-300
    stated = np.sqrt(sensor.reading_variance)
    least = np.maximum(own, 1e-6 * np.ptp(values, axis=0)) + 1e-300
    steps = shown_steps(sensor, values)
    # Steps coarser than the noise hide it; elsewhere a tenth of what is stated is another unit, or
    # a simulation.
    quieter = (least < _QUIETER * stated) & (steps < stated)
    return np.where((own > _NOISIER * stated) | quieter, least, stated)


def shown_steps(sensor: "Sensor", values: Float[np.ndarray, "n 6"]) -> Float[np.ndarray, "6"]:
    """Stated steps (6,) of the numbers; 0 where the numbers show finer ones."""
    stated = sensor.resolution
    different = np.abs(np.diff(values, axis=0))
    smallest = np.min(
        np.where(different > 1e-9 * np.maximum(stated, 1e-300), different, np.inf),
        axis=0,
        initial=np.inf,
    )
    return np.where(smallest < stated / 2, 0.0, stated)


def _block_size(raw: RawRecording) -> int:
    rate = raw.rate
    return (
        max(_BLOCK_SAMPLES, round(_BLOCK_SECONDS * rate))
        if np.isfinite(rate) and rate < 1e9
        else _BLOCK_SAMPLES
    )


def _tolerance(
    sensor: "Sensor", raw: RawRecording, values: Float[np.ndarray, "n 6"], size: int
) -> Float[np.ndarray, "6"]:
    variance = (
        reading_deviation(sensor, values) ** 2 / size + (shown_steps(sensor, values) / 4) ** 2
    )
    span = raw.time[np.isfinite(raw.time)]
    for process, scale in sensor.coloured(span):
        length = size / raw.rate
        early, late = (
            (float(span[0]), float(span[0]) + length),
            (float(span[0]) + 10 * length, float(span[0]) + 11 * length),
        )
        apart = (
            process.between_means(early, early)
            + process.between_means(late, late)
            - 2 * process.between_means(early, late)
        )
        variance = variance + scale**2 * max(apart, 0.0)
    return _DEVIATIONS * np.sqrt(variance)


def _runs(
    means: Float[np.ndarray, "b 6"], tolerance: Float[np.ndarray, "6"]
) -> list[tuple[int, int]]:
    """Stretches [first, last) of blocks that stay near their mean so far."""
    runs, first, total = [], 0, means[0].copy()
    for block in range(1, len(means) + 1):
        if block < len(means) and np.all(
            np.abs(means[block] - total / (block - first))
            <= tolerance * np.sqrt(1 + 1 / (block - first))
        ):
            total += means[block]
            continue
        if block - first >= _FEWEST_BLOCKS:
            runs.append((first, block))
        if block < len(means):
            first, total = block, means[block].copy()
    return runs


def _level(
    raw: RawRecording, readings: Float[np.ndarray, "n 6"], interval: Interval
) -> Float[np.ndarray, "6"]:
    return np.asarray(
        np.nanmean(readings[(raw.time >= interval[0]) & (raw.time < interval[1])], axis=0)
    )


def _travelled(raw: RawRecording, interval: Interval) -> float:
    """Share of the whole way of the sensor that lies within an interval."""
    inside = raw.position[(raw.time >= interval[0]) & (raw.time < interval[1])]
    whole = float(np.linalg.norm(np.ptp(raw.position, axis=0)))
    return float(np.linalg.norm(inside[-1] - inside[0])) / whole if whole > 0 else 0.0
