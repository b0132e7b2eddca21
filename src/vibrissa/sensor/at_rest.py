"""What rest tells of the sensor: noise in other units or other than stated, lines of the mains, and
a zero that drifts.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy import ndimage
from scipy.constants import kgf, lbf
from scipy.signal import periodogram
from scipy.stats import chi2

from vibrissa.sensor.figures import Noise
from vibrissa.sensor.raw import (
    CHANNEL_UNITS,
    CHANNELS,
    Fault,
    FaultKind,
    Interval,
    RawRecording,
    Wrench,
    Wrenches,
)
from vibrissa.sensor.sensor import Sensor
from vibrissa.sensor.tare import Tare, fitted_tare, planned_tare, without_given

# Chance that a sound recording is warned of.
_FALSE_ALARM = 1e-6
# Stated figures are rounded, and noise differs from one sensor of a kind to the next.
_NOISE_RATIO = 1.25
# Decades about the thousand by which a unit is mistaken, and factor by which axes may differ.
_NEARLY, _ALIKE = 0.5, 2.0
# A variance of 20 samples is known to a third, a slope's deviation by 50 to a tenth; a spectrum of
# 100 has 25 neighbours of a line.
_FEWEST_FOR_NOISE, _FEWEST_FOR_SLOPES, _FEWEST_FOR_LINES = 20, 50, 100
# Cycles within the rest: what is slower is a drift.
_FEWEST_CYCLES = 5
# Frequencies on either side whose median is the floor under a line.
_NEIGHBOURS = 12
# Of the stated noise: a line of half its size adds an eighth to its variance.
_NOTICEABLE = 0.5
# Standard deviations over some hundred samples are known to a twentieth.
_SAME_RATIO = 0.15
# Frequencies of the mains and their multiples [Hz].
_MAINS = np.outer(np.arange(1, 11), [50.0, 60.0]).ravel()
# Readings without noise are known to some digits only, a noiseless simulation to single precision.
_DIGITS, _SINGLE, _TINY = 1e-9, 1e-6, 1e-30
# By chance in one of four million recordings, of which each has six channels.
_DRIFT_DEVIATIONS = 5.5
# Of the largest load: a zero that moves by more is the load of a clamp that stands in contact
# rather.
_ANOTHER_LEVEL = 0.2
# Squares of three standard deviations: what the slopes within both rests must say to tell a drift
# from a contact.
_TOLD = 9.0


@dataclass(frozen=True, eq=False)
class Stretch:
    """Whole rows of a rest, a given drift and weight taken off.

    Attributes
    ----------
    interval
        Start and stop [s].
    time, values
        Stamps (n,) [s] and readings (n, 6).
    """

    interval: Interval
    time: Float[np.ndarray, "n"]
    values: Wrenches

    @classmethod
    def of(cls, sensor: Sensor, raw: RawRecording, interval: Interval) -> "Stretch":
        """The rest in an interval of a recording."""
        rows = raw.during(interval) & raw.whole
        return cls(interval, raw.time[rows], without_given(sensor, raw)[rows])

    @cached_property
    def about_lines(self) -> tuple[Wrench, Wrenches]:
        """Slopes (6,) of straight lines through the readings, and what is left (n, 6)."""
        elapsed = self.time - self.time.mean()
        slopes, levels = np.polyfit(elapsed, self.values, 1)
        return slopes, self.values - levels - elapsed[:, None] * slopes

    @cached_property
    def noise(self) -> Wrench:
        """Standard deviation (6,) about the lines; NaN with fewer than three rows."""
        freedom = len(self.time) - 2
        if freedom < 1:
            return np.full(6, np.nan)
        return np.sqrt(np.sum(self.about_lines[1] ** 2, axis=0) / freedom)

    @cached_property
    def slope_deviation(self) -> Wrench:
        """Standard deviation (6,) of the slopes, by the scatter about the lines."""
        scatter = np.maximum(self.noise, _DIGITS * np.abs(self.values).max(axis=0)) + _TINY
        return scatter / np.linalg.norm(self.time - self.time.mean())


def noise_unit_faults(stated: Noise, rest: Stretch) -> Iterator[Fault]:
    """Noise about a thousand times as large or small as stated on all three axes: other units."""
    if not stated.known:
        return
    found = (rest.noise / np.sqrt(stated.variance)).reshape(2, 3)
    units = ((CHANNELS[:3], "mN", "kN"), (CHANNELS[3:], "N mm", "kN m"))
    for (channels, small, large), ratios in zip(units, found, strict=True):
        decades = np.log10(np.maximum(ratios, _TINY))
        usual = decades.mean()
        alike = np.all(np.abs(decades - usual) < np.log10(_ALIKE))
        if alike and abs(abs(usual) - 3) < _NEARLY:
            text = (
                f"{','.join(channels)} at rest are {10**usual:.3g} times as noisy as stated, so "
                f"they are mis-scaled (in {small if usual > 0 else large}?); allowed are N and N m"
            )
            count = len(rest.time)
            yield Fault.over(FaultKind.UNITS, channels, rest.interval, text, count, unusable=True)


def noise_faults(stated: Noise, rest: Stretch) -> Iterator[Fault]:
    """By the χ² of the variance at rest, and by a quarter at least: stated figures are rounded.

    What rounding leaves of noise below half a step is not judged as too small. Pink noise and
    random walk are left out by taking successive differences.
    """
    count, noise = len(rest.time), rest.noise
    if not stated.known or count < _FEWEST_FOR_NOISE:
        return
    freedom = count - 2.0
    if stated.lasting:
        # Differences of neighbours overlap: two thirds of them count.
        noise = np.sqrt(np.mean(np.diff(rest.values, axis=0) ** 2, axis=0) / 2)
        freedom = 2 * count / 3
    deviation, step = np.sqrt(stated.variance), stated.resolution
    coarse = step > 2 * stated.white
    ratio = noise / np.where(coarse, np.maximum(deviation, step / 2), deviation)
    square = freedom * ratio**2
    larger = (ratio > _NOISE_RATIO) & (square > chi2.isf(_FALSE_ALARM, freedom))
    smaller = ~coarse & (ratio < 1 / _NOISE_RATIO) & (square < chi2.ppf(_FALSE_ALARM, freedom))
    for channel in np.flatnonzero(larger | smaller):
        name, unit = CHANNELS[channel], CHANNEL_UNITS[channel]
        text = (
            f"{name} at rest has a standard deviation of {noise[channel]:.3g} {unit}, "
            f"{ratio[channel]:.3g} times the stated {deviation[channel]:.3g} {unit}"
        )
        text += "; the error bars use it" if larger[channel] else ""
        quiet = not larger[channel]
        yield Fault.over(FaultKind.NOISE, (name,), rest.time, text, quiet=quiet)
    # Forces as much quieter, on all axes, as a unit is larger: a hint, as sensors may be quieter.
    quieter = (noise / deviation)[:3]
    for unit, factor in (("kgf", kgf), ("lbf", lbf)):
        if np.all(np.abs(quieter * factor - 1) < _SAME_RATIO):
            text = (
                f"fx,fy,fz at rest are {np.mean(quieter):.3g} times as noisy as stated: in {unit}, "
                "taken for N?"
            )
            yield Fault.over(FaultKind.UNITS, CHANNELS[:3], rest.time, text)


def noisier(sensor: Sensor, noise: Wrench, faults: list[Fault]) -> Sensor:
    """The sensor with the noise at rest of the channels that were found larger than stated; the
    rest of its figures stay.
    """
    loud = [fault for fault in faults if fault.kind is FaultKind.NOISE and not fault.quiet]
    if not loud:
        return sensor
    white, larger = sensor.noise.white, np.isin(CHANNELS, [fault.channels[0] for fault in loud])
    found = np.sqrt(np.maximum(noise**2 - sensor.noise.resolution**2 / 12, white**2))
    figures = tuple(np.where(larger, found, white).tolist())
    return sensor.updated(force_noise=figures[:3], torque_noise=figures[3:])


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
    inner = slice(_FEWEST_CYCLES, -1)
    # The median of the squares of two normal numbers is ln 2 of their mean.
    floor = ndimage.median_filter(power, (2 * _NEIGHBOURS + 1, 1), mode="mirror") / np.log(2)
    ratio = (power / np.maximum(floor, 1e-300))[inner]
    frequency, amplitude = frequency[inner], np.sqrt(2 * power[inner])
    noise = np.sqrt(stated.variance) if stated.known else rest.noise
    folded = np.abs(_MAINS - rate * np.round(_MAINS / rate))
    for channel, at in enumerate(np.argmax(ratio, axis=0)):
        size, name = amplitude[at, channel], CHANNELS[channel]
        rare = ratio[at, channel] > -np.log(_FALSE_ALARM / (6 * len(ratio)))
        if rare and size > _NOTICEABLE * noise[channel]:
            text = (
                f"{name} at rest holds a line of {size:.3g} {CHANNEL_UNITS[channel]} at "
                f"{frequency[at]:.4g} Hz"
            )
            for line in _MAINS[np.abs(folded - frequency[at]) < 2 * rate / count][:1]:
                sampled = "" if line < rate / 2 else f" at {rate:.4g} samples a second"
                text += f", as of {line:g} Hz{sampled}: hum of the mains"
            yield Fault.over(FaultKind.HUM, (name,), rest.time, text)


def drift_of(
    sensor: Sensor, raw: RawRecording, early: Stretch, late: Stretch, noise: Wrench
) -> tuple[Wrench, Wrench]:
    """Rate of the offset from one rest to another (6,) [N/s], [N m/s], a given drift taken off, and
    its standard deviation.
    """
    middle, counts = late.time.mean(), (len(early.time), len(late.time))
    span = middle - early.time.mean()
    rate = (late.values.mean(axis=0) - early.values.mean(axis=0)) / span
    if not sensor.noise.known:
        noise = np.maximum(noise, _SINGLE * np.nanmax(np.abs(raw.wrench), axis=0)) + 1e-300
        return rate, noise * np.sqrt(1 / counts[0] + 1 / counts[1]) / span
    plain = sensor.without_estimates()
    tare = planned_tare(plain, (early.interval,), counts[:1])
    later = tare.covariance(plain, raw.time, raw.orientation).reshape(-1, 6, 6)
    there = later[-1 if len(later) == 1 else np.argmin(np.abs(raw.time - middle))]
    variance = np.diag(there) - sensor.noise.variance * (1 - 1 / counts[1])
    return rate, np.sqrt(variance) / span


def drift_faults(
    sensor: Sensor,
    raw: RawRecording,
    ends: tuple[Stretch, Stretch],
    tare: Tare | None,
    drift: Wrench,
    deviation: Wrench,
) -> tuple[list[Fault], Tare | None]:
    """Channels whose offset moves by more than 5.5 standard deviations, and the tare with a line
    from rest to rest in its place where the slopes within them agree.

    None where drift or weight are estimated anyway, and none where the readings within the rests
    stand: a clamp that stops in contact has another level, too.
    """
    moved = np.abs(drift) > _DRIFT_DEVIATIONS * deviation
    if sensor.estimates or not moved.any():
        return [], None
    # Log-likelihood (times two) of the drift over none, from the slopes within the rests, and how
    # much they could tell.
    slopes = np.stack([rest.about_lines[0][moved] for rest in ends])
    of_slopes = np.stack([rest.slope_deviation[moved] for rest in ends])
    most = np.sum((drift[moved] / of_slopes) ** 2)
    told = 2 * np.sum(slopes * drift[moved] / of_slopes**2) - most
    if told < 0 and most > _TOLD:
        return [], None
    line = _line(sensor, raw, ends[1], tare, drift) if told > 0 and most > _TOLD else None
    advice = (
        "estimate_drift = true takes it off"
        if line is None
        else "a line from rest to rest is taken off"
    )
    span, faults = (ends[0].interval[0], ends[1].interval[1]), []
    for channel in np.flatnonzero(moved):
        name = CHANNELS[channel]
        text = (
            f"the offset of {name} drifts by {drift[channel]:.3g} {CHANNEL_UNITS[channel]}/s, "
            f"{abs(drift[channel]) / deviation[channel]:.3g} standard deviations more than stated; "
            f"{advice}"
        )
        faults.append(Fault.over(FaultKind.DRIFT, (name,), span, text, len(raw.time)))
    return faults, line


def _line(
    sensor: Sensor, raw: RawRecording, late: Stretch, tare: Tare | None, drift: Wrench
) -> Tare | None:
    """The tare as a line, unless the zero moves by a noticeable share of the load."""
    if tare is None or len(tare.intervals) != 1 or tare.intervals[0][1] >= late.interval[0]:
        return None
    loads = np.linalg.norm((raw.wrench - tare.offset).reshape(-1, 2, 3), axis=2)
    step = drift * (late.interval[0] - tare.intervals[0][0])
    moved = np.linalg.norm(step.reshape(2, 3), axis=1)
    if np.any(moved > _ANOTHER_LEVEL * np.nanmax(loads, axis=0)):
        return None
    found = f"{tare.found}, and at the end, as the zero drifts"
    drifting = sensor.updated(estimate_drift=True)
    return fitted_tare(drifting, raw, (*tare.intervals, late.interval), found)


def lone_drift_faults(stated: Noise, raw: RawRecording, rest: Stretch) -> Iterator[Fault]:
    """Channels that drift within the rest at the start, where there is none at the end to draw a
    line to.
    """
    count = len(rest.time)
    if not stated.known or stated.lasting or count < _FEWEST_FOR_SLOPES:
        return
    slope, deviation = rest.about_lines[0], rest.slope_deviation
    over_all = np.abs(slope) * (raw.time[-1] - raw.time[0])
    clear = np.abs(slope) > _DRIFT_DEVIATIONS * deviation
    for channel in np.flatnonzero(clear & (over_all > np.sqrt(stated.variance))):
        name = CHANNELS[channel]
        text = (
            f"the offset of {name} drifts by {slope[channel]:.3g} ± {deviation[channel]:.2g} "
            f"{CHANNEL_UNITS[channel]}/s within the rest at the start, and there is none at the "
            "end: record one and set estimate_drift = true, or give "
            f"{'force' if channel < 3 else 'torque'}_drift"
        )
        yield Fault.over(FaultKind.DRIFT, (name,), rest.interval, text, count)
