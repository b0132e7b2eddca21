"""What readings at rest say about the sensor: noise in wrong units or not as stated, mains hum, and
zero drift.
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

# Probability of a warning for a good recording.
_FALSE_ALARM = 1e-6
# Stated figures are rounded, and noise differs between sensors of the same type.
_NOISE_RATIO = 1.25
# First of three channels, the unit they may be in, the noise ratio this causes, and its tolerance
# in decades: stated noise is good to half a decade at worst, but distinguishing kilograms from a
# quieter sensor takes a tenth.
_UNITS = (
    (0, "mN", 1e3, 0.5),
    (0, "kN", 1e-3, 0.5),
    (3, "N mm", 1e3, 0.5),
    (3, "kN m", 1e-3, 0.5),
    (0, "kgf", 1 / kgf, 0.06),
    (0, "lbf", 1 / lbf, 0.06),
)
# 20 samples give a variance to a third, 50 a slope's deviation to a tenth; a spectrum of 100 has 25
# neighbours of a line.
_FEWEST_FOR_NOISE, _FEWEST_FOR_SLOPES, _FEWEST_FOR_LINES = 20, 50, 100
# Cycles within the rest: anything slower is drift.
_FEWEST_CYCLES = 5
# Frequencies on either side whose median gives the noise floor at a line.
_NEIGHBOURS = 12
# Relative to the stated noise: a line of half its size adds an eighth to its variance.
_NOTICEABLE = 0.5
# Mains frequencies and their harmonics [Hz].
_MAINS = np.outer(np.arange(1, 11), [50.0, 60.0]).ravel()
# Noise-free readings have a limited number of digits, a noiseless simulation single precision.
_DIGITS, _SINGLE, _TINY = 1e-9, 1e-6, 1e-30
# By chance in one of four million recordings of six channels each.
_DRIFT_DEVIATIONS = 5.5
# Three standard deviations squared: evidence required from the slopes within both rests to tell a
# drift from a contact.
_TOLD = 9.0


class Stretch(NamedTuple):
    """Complete rows of a rest, known drift and weight subtracted, with straight-line fits."""

    interval: Interval
    time: Times
    values: Wrenches
    slope: Wrench
    """Slopes of the lines [1/s]."""
    slope_deviation: Wrench
    """Standard deviation of the slopes, from the scatter about the lines."""
    noise: Wrench
    """Standard deviation about the lines; NaN with fewer than three rows, like the slopes."""

    @classmethod
    def of(cls, sensor: Sensor, raw: RawRecording, interval: Interval) -> "Stretch":
        """The rest in one interval of a recording."""
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
    """Noise on all three axes that is off by the factor of another unit. Factors of a thousand make
    a recording unusable; a pound or kilogram does not, as the sensor may just be quieter.
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
    """Channels whose noise differs from that stated, by the χ² of the variance at rest and by at
    least a quarter, as stated figures are rounded; and the sensor, with any larger noise adopted.

    Noise below half a step, which rounding hides, is not reported as too small. Successive
    differences exclude pink noise and random walk.
    """
    stated, count, noise = sensor.noise, len(rest.time), rest.noise
    faults: list[Fault] = []
    if not stated.known or count < _FEWEST_FOR_NOISE:
        return faults, sensor
    freedom = count - 2.0
    if stated.lasting:
        # Successive differences overlap: two thirds of them are independent.
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
    """Spectral lines at rest that stand out from their neighbourhood (by chance in one of a million
    recordings) and are at least half as large as the noise. Mains harmonics are named, also if
    aliased.
    """
    count = len(rest.time)
    if count < _FEWEST_FOR_LINES:
        return
    frequency, power = periodogram(
        rest.values, rate, "hann", detrend="linear", scaling="spectrum", axis=0
    )
    # The sum of squares of two normal numbers has a median of ln 2 times its mean.
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
                text += f", as from {mains:g} Hz{sampled}: mains hum"
            yield Fault.over((name,), FaultKind.HUM, rest.time, text)


def drift_of(
    sensor: Sensor, raw: RawRecording, early: Stretch, late: Stretch
) -> tuple[Wrench, Wrench]:
    """Rate of change of the offset from one rest to another (6,) [N/s], [N m/s], known drift
    subtracted, and its standard deviation.
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
    """Channels whose offset changes by more than 5.5 standard deviations, and a tare with a linear
    drift between the rests, if the slopes within them agree with it and the zero moves by only a
    small fraction of the load.

    No findings if drift or weight are estimated anyway, or if readings within the rests are
    constant: a clamp that stops in contact gives another level, too.
    """
    moved = np.abs(drift) > _DRIFT_DEVIATIONS * deviation
    if sensor.estimates or not moved.any():
        return [], None
    # Twice the log-likelihood ratio of this drift to none, from the slopes within the rests, and
    # its expected value if the drift is real.
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
            found = f"{tare.found}, and at the end because the zero drifts"
            line = fitted_tare(sensor.updated(estimate_drift=True), raw, (first, late), found)
            advice = "a line from rest to rest is subtracted"
    return list(_drifts(moved, drift, deviation, raw.time, advice)), line


def lone_drift_faults(stated: Noise, raw: RawRecording, rest: Stretch) -> Iterator[Fault]:
    """Channels that drift within the rest at the start, if there is none at the end to draw a line
    to.
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
