"""What rest tells of the sensor's noise: other units, larger or smaller figures than stated, lines
of the mains.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy import ndimage
from scipy.stats import chi2

from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.raw import CHANNEL_UNITS, CHANNELS, Interval, RawRecording, Wrench
from vibrissa.sensor.tare import without_given

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

# Chance that a sound recording is warned of.
_FALSE_ALARM = 1e-6
# Stated figures are rounded, and noise differs from one sensor of a kind to the next.
_NOISE_RATIO = 1.25
# Decades about the thousand by which a unit is mistaken, and factor by which axes may differ.
_NEARLY, _ALIKE = 0.5, 2.0
# A variance of 20 samples is known to a third; a spectrum of 100 has 25 neighbours of a line.
_FEWEST_AT_REST, _FEWEST_FOR_LINES = 20, 100
# Cycles within the rest: what is slower is a drift.
_FEWEST_CYCLES = 5
# Frequencies on either side whose median is the floor under a line.
_NEIGHBOURS = 12
# Of the stated noise: a line of half its size adds an eighth to its variance.
_NOTICEABLE = 0.5
# Newtons, by definition of the units (standard gravity; international pound).
_LARGER_UNITS = (("kgf", 9.80665), ("lbf", 4.4482216152605))
# Standard deviations over some hundred samples are known to a twentieth.
_SAME_RATIO = 0.15
_MAINS, _HARMONICS = (50.0, 60.0), 10
# Readings without noise are known to some digits only.
_DIGITS, _TINY = 1e-9, 1e-30


@dataclass(frozen=True, eq=False)
class Stretch:
    """Whole rows of a rest, a given drift and weight taken off.

    Attributes
    ----------
    interval
        Start and stop [s].
    time, values
        Stamps (k,) [s] and readings (k, 6).
    """

    interval: Interval
    time: Float[np.ndarray, "k"]
    values: Float[np.ndarray, "k 6"]

    @classmethod
    def of(cls, sensor: "Sensor", raw: RawRecording, interval: Interval) -> "Stretch":
        """The rest in an interval of a recording."""
        rows = raw.during(interval) & raw.whole
        return cls(interval, raw.time[rows], without_given(sensor, raw)[rows])

    @cached_property
    def about_lines(self) -> tuple[Wrench, Float[np.ndarray, "k 6"]]:
        """Slopes (6,) of straight lines through the readings, and what is left (k, 6)."""
        lines = np.stack([np.ones(len(self.time)), self.time - self.time.mean()], axis=1)
        fitted = np.linalg.lstsq(lines, self.values, rcond=None)[0]
        return fitted[1], self.values - lines @ fitted

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


def noise_unit_faults(sensor: "Sensor", rest: Stretch) -> list[Fault]:
    """Noise about a thousand times as large or small as stated on all three axes: other units."""
    if not sensor.noise.known:
        return []
    faults, found = [], (rest.noise / np.sqrt(sensor.noise.variance)).reshape(2, 3)
    units = ((CHANNELS[:3], "mN", "kN"), (CHANNELS[3:], "N mm", "kN m"))
    for (channels, small, large), ratios in zip(units, found, strict=True):
        factor = float(np.exp(np.mean(np.log(ratios)))) if np.all(ratios > 0) else 1.0
        alike = np.all((ratios > factor / _ALIKE) & (ratios < _ALIKE * factor))
        if alike and abs(abs(np.log10(factor)) - 3) < _NEARLY:
            text = (
                f"{','.join(channels)} at rest are {factor:.3g} times as noisy as stated, so they "
                f"are mis-scaled (in {small if factor > 1 else large}?); allowed are N and N m"
            )
            faults.append(
                Fault.over(
                    FaultKind.UNITS, channels, rest.interval, text, len(rest.time), unusable=True
                )
            )
    return faults


def noise_faults(sensor: "Sensor", rest: Stretch) -> list[Fault]:
    """By the χ² of the variance at rest, and by a quarter at least: stated figures are rounded.

    What rounding leaves of noise below half a step is not judged as too small. Pink noise and
    random walk are left out by taking successive differences.
    """
    count, noise = len(rest.time), rest.noise
    if not sensor.noise.known or count < _FEWEST_AT_REST:
        return []
    freedom = count - 2.0
    if sensor.noise.lasting:
        # Differences of neighbours overlap: two thirds of them count.
        noise = np.sqrt(np.mean(np.diff(rest.values, axis=0) ** 2, axis=0) / 2)
        freedom = 2 * count / 3
    stated, step = np.sqrt(sensor.noise.variance), sensor.noise.resolution
    coarse = step > 2 * sensor.noise.white
    ratio = noise / np.where(coarse, np.maximum(stated, step / 2), stated)
    square = freedom * ratio**2
    larger = (ratio > _NOISE_RATIO) & (square > chi2.isf(_FALSE_ALARM, freedom))
    smaller = ~coarse & (ratio < 1 / _NOISE_RATIO) & (square < chi2.ppf(_FALSE_ALARM, freedom))
    faults = []
    for channel in np.flatnonzero(larger | smaller):
        name, unit = CHANNELS[channel], CHANNEL_UNITS[channel]
        text = (
            f"{name} at rest has a standard deviation of {noise[channel]:.3g} {unit}, "
            f"{ratio[channel]:.3g} times the stated {stated[channel]:.3g} {unit}"
        )
        text += "; the error bars use it" if larger[channel] else ""
        quiet = not larger[channel]
        faults.append(Fault.over(FaultKind.NOISE, (name,), rest.time, text, quiet=quiet))
    # Forces as much quieter, on all axes, as a unit is larger: a hint, as sensors may be quieter.
    quieter = (noise / stated)[:3]
    for unit, factor in _LARGER_UNITS:
        if np.all(np.abs(quieter * factor - 1) < _SAME_RATIO):
            text = (
                f"fx,fy,fz at rest are {np.mean(quieter):.3g} times as noisy as stated: in {unit}, "
                "taken for N?"
            )
            faults.append(Fault.over(FaultKind.UNITS, CHANNELS[:3], rest.time, text))
    return faults


def noisier(sensor: "Sensor", noise: Wrench, faults: list[Fault]) -> "Sensor":
    """The sensor with the noise at rest of the channels that were found larger than stated; the
    rest of its figures stay.
    """
    larger = [
        fault.channels[0] for fault in faults if fault.kind is FaultKind.NOISE and not fault.quiet
    ]
    if not larger:
        return sensor
    stated = sensor.noise
    found = np.sqrt(np.maximum(noise**2 - stated.resolution**2 / 12, stated.white**2))
    figures = np.where(np.isin(CHANNELS, larger), found, stated.white)
    fx, fy, fz, tx, ty, tz = figures.tolist()
    return sensor.updated(force_noise=(fx, fy, fz), torque_noise=(tx, ty, tz))


def hum_faults(sensor: "Sensor", rest: Stretch, rate: float) -> list[Fault]:
    """Lines of the spectrum at rest that stand out of their neighbourhood: by chance in one of a
    million recordings, and half as large as the noise at least.
    """
    count = len(rest.time)
    if count < _FEWEST_FOR_LINES:
        return []
    left = rest.about_lines[1] * np.hanning(count)[:, None]
    frequency, power = np.fft.rfftfreq(count, 1 / rate), np.abs(np.fft.rfft(left, axis=0)) ** 2
    inner = slice(_FEWEST_CYCLES, -1)
    # The median of the squares of two normal numbers is ln 2 of their mean.
    floor = ndimage.median_filter(power, (2 * _NEIGHBOURS + 1, 1), mode="mirror") / np.log(2)
    ratio = (power / np.maximum(floor, 1e-300))[inner]
    # Hann's window: a line of amplitude a has the power (a n / 4)².
    amplitude = 4 / count * np.sqrt(power[inner])
    noise = np.sqrt(sensor.noise.variance) if sensor.noise.known else np.std(left, axis=0)
    faults = []
    for channel, at in enumerate(np.argmax(ratio, axis=0)):
        size, name = amplitude[at, channel], CHANNELS[channel]
        rare = ratio[at, channel] > -np.log(_FALSE_ALARM / (6 * len(ratio)))
        if rare and size > _NOTICEABLE * noise[channel]:
            found = float(frequency[inner][at])
            text = (
                f"{name} at rest holds a line of {size:.3g} {CHANNEL_UNITS[channel]} at "
                f"{found:.4g} Hz{_mains(found, rate, 2 * rate / count)}"
            )
            faults.append(Fault.over(FaultKind.HUM, (name,), rest.time, text))
    return faults


def _mains(frequency: float, rate: float, width: float) -> str:
    """Which multiple of the mains it is, or would be folded from: words, or none."""
    for order in range(1, _HARMONICS + 1):
        for mains in _MAINS:
            line = order * mains
            if abs(abs(line - rate * round(line / rate)) - frequency) < width:
                at = "" if line < rate / 2 else f" at {rate:.4g} samples a second"
                return f", as of {line:g} Hz{at}: hum of the mains"
    return ""
