"""What rest tells of the sensor: noise in other units or other than stated, lines of the mains, and
a zero that drifts.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool
from scipy import ndimage
from scipy.constants import kgf, lbf
from scipy.signal import periodogram
from scipy.stats import chi2

from vibrissa.sensor.figures import Noise
from vibrissa.sensor.noise import quantisation_of_mean
from vibrissa.sensor.raw import (
    CHANNEL_UNITS,
    CHANNELS,
    Fault,
    FaultKind,
    Interval,
    RawRecording,
    Times,
    Wrench,
    Wrenches,
)
from vibrissa.sensor.rest import ANOTHER_LEVEL, share_of_load
from vibrissa.sensor.sensor import Sensor
from vibrissa.sensor.tare import Tare, fitted_tare, without_given

# Chance that a sound recording is warned of.
_FALSE_ALARM = 1e-6
# Stated figures are rounded, and noise differs from one sensor of a kind to the next.
_NOISE_RATIO = 1.25
# First channel of three, unit that they may be in, by how much noisier they are then, and within
# how many decades: noise is stated to half a decade at worst, but to tell a kilogram from a quieter
# sensor takes a tenth.
_UNITS = (
    (0, "mN", 1e3, 0.5),
    (0, "kN", 1e-3, 0.5),
    (3, "N mm", 1e3, 0.5),
    (3, "kN m", 1e-3, 0.5),
    (0, "kgf", 1 / kgf, 0.06),
    (0, "lbf", 1 / lbf, 0.06),
)
# A variance of 20 samples is known to a third, a slope's deviation by 50 to a tenth; a spectrum of
# 100 has 25 neighbours of a line.
_FEWEST_FOR_NOISE, _FEWEST_FOR_SLOPES, _FEWEST_FOR_LINES = 20, 50, 100
# Cycles within the rest: what is slower is a drift.
_FEWEST_CYCLES = 5
# Frequencies on either side whose median is the floor under a line.
_NEIGHBOURS = 12
# Of the stated noise: a line of half its size adds an eighth to its variance.
_NOTICEABLE = 0.5
# Frequencies of the mains and their multiples [Hz].
_MAINS = np.outer(np.arange(1, 11), [50.0, 60.0]).ravel()
# Readings without noise are known to some digits only, a noiseless simulation to single precision.
_DIGITS, _SINGLE, _TINY = 1e-9, 1e-6, 1e-30
# By chance in one of four million recordings, of which each has six channels.
_DRIFT_DEVIATIONS = 5.5
# Squares of three standard deviations: what the slopes within both rests must say to tell a drift
# from a contact.
_TOLD = 9.0


class Stretch(NamedTuple):
    """Whole rows of a rest, a given drift and weight taken off, and straight lines through them."""

    interval: Interval
    time: Times
    values: Wrenches
    slope: Wrench
    """Of the lines [1/s]."""
    slope_deviation: Wrench
    """Standard deviation of the slopes, by the scatter about the lines."""
    noise: Wrench
    """Standard deviation about the lines; NaN with fewer than three rows, as the slopes are."""

    @classmethod
    def of(cls, sensor: Sensor, raw: RawRecording, interval: Interval) -> "Stretch":
        """The rest in an interval of a recording."""
        rows = raw.during(interval) & raw.whole
        time, values = raw.time[rows], without_given(sensor, raw)[rows]
        if len(time) < 3:
            return cls(interval, time, values, *np.full((3, 6), np.nan))
        elapsed = time - time.mean()
        (slope, _), squares, *_ = np.polyfit(elapsed, values, 1, full=True)
        noise = np.sqrt(squares / (len(time) - 2))
        scatter = np.maximum(noise, _DIGITS * np.abs(values).max(axis=0)) + _TINY
        return cls(interval, time, values, slope, scatter / np.linalg.norm(elapsed), noise)


def noise_unit_faults(stated: Noise, rest: Stretch) -> Iterator[Fault]:
    """Noise on all three axes as many times as large or small as stated as another unit is: of a
    thousand the recording cannot be used; of a pound it can, as sensors may be quieter.
    """
    if not stated.known:
        return
    ratios = np.maximum(rest.noise / np.sqrt(stated.variance), _TINY)
    for first, unit, times, decades in _UNITS:
        names, found = CHANNELS[first : first + 3], ratios[first : first + 3]
        if np.all(np.abs(np.log10(found / times)) < decades):
            text = (
                f"{','.join(names)} at rest are {np.mean(found):.3g} times as noisy as stated: "
                f"mis-scaled (in {unit}?); allowed are N and N m"
            )
            grave = unit not in ("kgf", "lbf")
            yield Fault.over(names, FaultKind.UNITS, rest.time, text, unusable=grave)


def noise_faults(sensor: Sensor, rest: Stretch) -> tuple[list[Fault], Sensor]:
    """By the χ² of the variance at rest, and by a quarter at least: stated figures are rounded; and
    the sensor with the noise of the channels that is larger than stated.

    What rounding leaves of noise below half a step is not judged as too small. Pink noise and
    random walk are left out by taking successive differences.
    """
    stated, count, noise = sensor.noise, len(rest.time), rest.noise
    faults: list[Fault] = []
    if not stated.known or count < _FEWEST_FOR_NOISE:
        return faults, sensor
    freedom = count - 2.0
    if stated.lasting:
        # Differences of neighbours overlap: two thirds of them count.
        noise = np.sqrt(np.mean(np.diff(rest.values, axis=0) ** 2, axis=0) / 2)
        freedom = 2 * count / 3
    white, deviation, step = stated.white, np.sqrt(stated.variance), stated.resolution
    coarse = step > 2 * white
    ratio = noise / np.where(coarse, np.maximum(deviation, step / 2), deviation)
    square = freedom * ratio**2
    larger = (ratio > _NOISE_RATIO) & (square > chi2.isf(_FALSE_ALARM, freedom))
    smaller = ~coarse & (ratio < 1 / _NOISE_RATIO) & (square < chi2.ppf(_FALSE_ALARM, freedom))
    for channel in np.flatnonzero(larger | smaller):
        name, unit, quiet = CHANNELS[channel], CHANNEL_UNITS[channel], bool(smaller[channel])
        text = (
            f"{name} at rest has a standard deviation of {noise[channel]:.3g} {unit}, "
            f"{ratio[channel]:.3g} times the stated {deviation[channel]:.3g} {unit}"
        )
        text += "" if quiet else "; the error bars use it"
        faults.append(Fault.over((name,), FaultKind.NOISE, rest.time, text, quiet=quiet))
    if larger.any():
        found = np.sqrt(np.maximum(rest.noise**2 - step**2 / 12, white**2))
        figures = np.where(larger, found, white).tolist()
        sensor = sensor.updated(force_noise=tuple(figures[:3]), torque_noise=tuple(figures[3:]))
    return faults, sensor


def hum_faults(stated: Noise, rest: Stretch, rate: float) -> Iterator[Fault]:
    """Lines of the spectrum at rest that stand out of their neighbourhood: by chance in one of a
    million recordings, and half as large as the noise at least. A multiple of the mains is named,
    also where it is folded back.
    """
    count = len(rest.time)
    if count < _FEWEST_FOR_LINES:
        return
    frequency, power = periodogram(
        rest.values, rate, "hann", detrend="linear", scaling="spectrum", axis=0
    )
    # The median of the squares of two normal numbers is ln 2 of their mean.
    floor = ndimage.median_filter(power, (2 * _NEIGHBOURS + 1, 1), mode="mirror") / np.log(2)
    inner = slice(_FEWEST_CYCLES, -1)
    frequency, power, floor = frequency[inner], power[inner], np.maximum(floor[inner], 1e-300)
    noise = np.sqrt(stated.variance) if stated.known else rest.noise
    folded = np.abs(_MAINS - rate * np.round(_MAINS / rate))
    rare = -np.log(_FALSE_ALARM / power.size)
    for name, unit, line, under, least in zip(
        CHANNELS, CHANNEL_UNITS, power.T, floor.T, _NOTICEABLE * noise, strict=True
    ):
        at = np.argmax(line / under)
        size = np.sqrt(2 * line[at])
        if line[at] > rare * under[at] and size > least:
            text = f"{name} at rest holds a line of {size:.3g} {unit} at {frequency[at]:.4g} Hz"
            for mains in _MAINS[np.abs(folded - frequency[at]) < 2 * rate / count][:1]:
                sampled = "" if mains < rate / 2 else f" at {rate:.4g} samples a second"
                text += f", as of {mains:g} Hz{sampled}: hum of the mains"
            yield Fault.over((name,), FaultKind.HUM, rest.time, text)


def drift_of(
    sensor: Sensor, raw: RawRecording, early: Stretch, late: Stretch
) -> tuple[Wrench, Wrench]:
    """Rate of the offset from one rest to another (6,) [N/s], [N m/s], a given drift taken off, and
    its standard deviation.
    """
    stated, digits = sensor.noise, _SINGLE * np.nanmax(np.abs(raw.wrench), axis=0) + _TINY
    white = stated.white if stated.known else np.fmax(early.noise, digits)
    variance = stated.wandered(raw.time, early.interval, late.interval)
    for count in (len(early.time), len(late.time)):
        variance += white**2 / count + quantisation_of_mean(white, stated.resolution, count)
    span = late.time.mean() - early.time.mean()
    return (late.values.mean(axis=0) - early.values.mean(axis=0)) / span, np.sqrt(variance) / span


def drift_faults(
    sensor: Sensor,
    raw: RawRecording,
    ends: list[Stretch],
    tare: Tare | None,
    drift: Wrench,
    deviation: Wrench,
) -> tuple[list[Fault], Tare | None]:
    """Channels whose offset moves by more than 5.5 standard deviations, and the tare with a line
    from rest to rest in its place where the slopes within them agree, and the zero moves by no
    noticeable share of the load.

    None where drift or weight are estimated anyway, and none where the readings within the rests
    stand: a clamp that stops in contact has another level, too.
    """
    moved = np.abs(drift) > _DRIFT_DEVIATIONS * deviation
    if sensor.estimates or not moved.any():
        return [], None
    # Log-likelihood (times two) of the drift over none, from the slopes within the rests, and how
    # much they could tell.
    weights = np.array([drift / rest.slope_deviation**2 for rest in ends])[:, moved]
    most = np.sum(drift[moved] * weights)
    told = 2 * np.sum(weights * [rest.slope[moved] for rest in ends]) - most
    if told < 0 and most > _TOLD:
        return [], None
    late, line, advice = ends[1].interval, None, "estimate_drift = true takes it off"
    if told > 0 and most > _TOLD and tare is not None and len(tare.intervals) == 1:
        (first,) = tare.intervals
        step = drift * (late[0] - first[0])
        if first[1] < late[0] and share_of_load(step, raw.wrench - tare.offset) < ANOTHER_LEVEL:
            found = f"{tare.found}, and at the end, as the zero drifts"
            line = fitted_tare(sensor.updated(estimate_drift=True), raw, (first, late), found)
            advice = "a line from rest to rest is taken off"
    return list(_drifts(moved, drift, deviation, raw.time, advice)), line


def lone_drift_faults(stated: Noise, raw: RawRecording, rest: Stretch) -> Iterator[Fault]:
    """Channels that drift within the rest at the start, where there is none at the end to draw a
    line to.
    """
    if not stated.known or stated.lasting or len(rest.time) < _FEWEST_FOR_SLOPES:
        return
    size = np.abs(rest.slope)
    over_all = size * (raw.time[-1] - raw.time[0]) > np.sqrt(stated.variance)
    clear = size > _DRIFT_DEVIATIONS * rest.slope_deviation
    advice = (
        "seen within the rest at the start, and there is none at the end: record one and set "
        "estimate_drift = true, or give force_drift or torque_drift"
    )
    yield from _drifts(clear & over_all, rest.slope, rest.slope_deviation, rest.time, advice)


def _drifts(
    moved: Bool[np.ndarray, "6"], rate: Wrench, deviation: Wrench, stamps: Times, advice: str
) -> Iterator[Fault]:
    for channel in np.flatnonzero(moved):
        name = CHANNELS[channel]
        text = (
            f"the offset of {name} drifts by {rate[channel]:.3g} ± {deviation[channel]:.2g} "
            f"{CHANNEL_UNITS[channel]}/s; {advice}"
        )
        yield Fault.over((name,), FaultKind.DRIFT, stamps, text)
