"""What rest tells of the sensor's noise: other units, larger or smaller figures than stated, lines
of the mains.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.raw import CHANNEL_UNITS, CHANNELS, RawRecording

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

Interval = tuple[float, float]

_FALSE_ALARM = 1e-6
_NOISE_RATIO = 1.25
_NEARLY = 0.5
_FEWEST_AT_REST = 20
_FEWEST_FOR_LINES = 100
# Cycles within the rest: what is slower is a drift.
_FEWEST_CYCLES = 5
_NEIGHBOURS = 12
# Of the stated noise: a line of half its size adds an eighth to its variance.
_NOTICEABLE = 0.5
_LARGER_UNITS = (("kgf", 9.80665), ("lbf", 4.4482216152605))
# Standard deviations over some hundred samples are known to a twentieth.
_SAME_RATIO = 0.15
_MAINS = (50.0, 60.0)
_HARMONICS = 10


def within(
    raw: RawRecording, interval: Interval
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k 6"]]:
    """Stamps and readings of the whole rows in an interval."""
    rows = (
        (raw.time >= interval[0]) & (raw.time < interval[1]) & np.isfinite(raw.wrench).all(axis=1)
    )
    return raw.time[rows], raw.wrench[rows]


def rest_noise(raw: RawRecording, interval: Interval) -> Float[np.ndarray, "6"]:
    """Standard deviation (6,) of the readings within an interval about their straight lines; NaN
    with fewer than three.
    """
    time, values = within(raw, interval)
    return (
        np.full(6, np.nan)
        if len(time) < 3
        else np.sqrt(np.sum(_about_lines(time, values) ** 2, axis=0) / (len(time) - 2))
    )


def _about_lines(
    time: Float[np.ndarray, "k"], values: Float[np.ndarray, "k 6"]
) -> Float[np.ndarray, "k 6"]:
    lines = np.stack([np.ones(len(time)), time - time.mean()], axis=1)
    return np.asarray(values - lines @ np.linalg.lstsq(lines, values, rcond=None)[0])


def noise_unit_faults(
    sensor: "Sensor", raw: RawRecording, interval: Interval, noise: Float[np.ndarray, "6"]
) -> list[Fault]:
    """Noise about a thousand times as large or as small as stated, on all three axes: other units."""
    if sensor.force_noise is None:
        return []
    faults = []
    ratios = noise / np.sqrt(sensor.reading_variance)
    for channels, part, small, large in (
        (CHANNELS[:3], ratios[:3], "mN", "kN"),
        (CHANNELS[3:], ratios[3:], "N mm", "kN m"),
    ):
        factor = float(np.exp(np.mean(np.log(part)))) if np.all(part > 0) else 1.0
        if (
            np.all((part > factor / 2) & (part < 2 * factor))
            and abs(abs(np.log10(factor)) - 3) < _NEARLY
        ):
            unit = small if factor > 1 else large
            text = f"{','.join(channels)} at rest are {factor:.3g} times as noisy as stated, so they are mis-scaled (in {unit}?); allowed are N and N m"
            faults.append(
                Fault(
                    FaultKind.UNITS,
                    channels,
                    *interval,
                    len(within(raw, interval)[0]),
                    text,
                    unusable=True,
                )
            )
    return faults


def noise_faults(
    sensor: "Sensor", raw: RawRecording, interval: Interval, noise: Float[np.ndarray, "6"]
) -> list[Fault]:
    """By the χ² of the variance at rest, and by a quarter at least: stated figures are rounded.

    What rounding leaves of noise below half a step is not judged as too small. Pink noise and
    random walk are left out by taking successive differences.
    """
    time, values = within(raw, interval)
    count = len(time)
    if sensor.force_noise is None or count < _FEWEST_AT_REST:
        return []
    freedom = float(count - 2)
    if sensor.noise_corner > 0 or np.any(sensor.random_walk):
        noise, freedom = np.sqrt(np.mean(np.diff(values, axis=0) ** 2, axis=0) / 2), 2 * count / 3
    faults = []
    for channel, name in enumerate(CHANNELS):
        stated = float(np.sqrt(sensor.reading_variance[channel]))
        white, step = float(sensor.noise[channel]), float(sensor.resolution[channel])
        coarse = step > 2 * white
        ratio = float(noise[channel]) / (max(stated, step / 2) if coarse else stated)
        larger = bool(ratio > _NOISE_RATIO and freedom * ratio**2 > chi2.isf(_FALSE_ALARM, freedom))
        smaller = (
            not coarse
            and ratio < 1 / _NOISE_RATIO
            and freedom * ratio**2 < chi2.ppf(_FALSE_ALARM, freedom)
        )
        if larger or smaller:
            unit = CHANNEL_UNITS[channel]
            text = f"{name} at rest has a standard deviation of {noise[channel]:.3g} {unit}, {ratio:.3g} times the stated {stated:.3g} {unit}"
            text += "; the error bars use it" if larger else ""
            faults.append(
                Fault(
                    FaultKind.NOISE,
                    (name,),
                    float(time[0]),
                    float(time[-1]),
                    count,
                    text,
                    quiet=not larger,
                )
            )
    return faults + _other_unit(sensor, noise, time)


def _other_unit(
    sensor: "Sensor", noise: Float[np.ndarray, "6"], time: Float[np.ndarray, "k"]
) -> list[Fault]:
    """Forces as much quieter than stated, on all axes, as a unit is larger: a hint, as sensors may
    be quieter.
    """
    ratios = noise[:3] / np.sqrt(sensor.reading_variance[:3])
    for unit, factor in _LARGER_UNITS:
        if np.all(np.abs(ratios * factor - 1) < _SAME_RATIO):
            text = f"fx,fy,fz at rest are {np.mean(ratios):.3g} times as noisy as stated: in {unit}, taken for N?"
            return [
                Fault(
                    FaultKind.UNITS, CHANNELS[:3], float(time[0]), float(time[-1]), len(time), text
                )
            ]
    return []


def noisier(sensor: "Sensor", noise: Float[np.ndarray, "6"], faults: list[Fault]) -> "Sensor":
    """The sensor with the noise at rest of the channels that were found larger than stated; the
    rest of its figures stay.
    """
    larger = {
        fault.channels[0] for fault in faults if fault.kind is FaultKind.NOISE and not fault.quiet
    }
    if not larger:
        return sensor
    chosen = np.array([name in larger for name in CHANNELS])
    white = np.sqrt(np.maximum(noise**2 - sensor.resolution**2 / 12, sensor.noise**2))
    figures = np.where(chosen, white, sensor.noise)
    return replace(
        sensor, force_noise=tuple(figures[:3].tolist()), torque_noise=tuple(figures[3:].tolist())
    )


def hum_faults(sensor: "Sensor", raw: RawRecording, interval: Interval) -> list[Fault]:
    """Lines of the spectrum at rest that stand out of their neighbourhood: by chance in one of a
    million recordings, and half as large as the noise at least.
    """
    time, values = within(raw, interval)
    count = len(time)
    if count < _FEWEST_FOR_LINES or not np.isfinite(raw.rate):
        return []
    left = _about_lines(time, values) * np.hanning(count)[:, None]
    power = np.abs(np.fft.rfft(left, axis=0)) ** 2
    frequency = np.fft.rfftfreq(count, 1 / raw.rate)
    inner = slice(_FEWEST_CYCLES, len(power) - 1)
    faults = []
    for channel, name in enumerate(CHANNELS):
        floor = _running_median(power[:, channel])[inner] / np.log(2)
        ratio = power[inner, channel] / np.maximum(floor, 1e-300)
        at = int(np.argmax(ratio))
        # Hann's window: a line of amplitude a has the power (a n / 4)².
        amplitude = 4 / count * float(np.sqrt(power[inner, channel][at]))
        noise = (
            np.sqrt(sensor.reading_variance[channel])
            if sensor.force_noise is not None
            else np.std(left[:, channel])
        )
        if ratio[at] > -np.log(_FALSE_ALARM / (6 * len(ratio))) and amplitude > _NOTICEABLE * noise:
            found = float(frequency[inner][at])
            text = f"{name} at rest holds a line of {amplitude:.3g} {CHANNEL_UNITS[channel]} at {found:.4g} Hz{_mains(found, raw.rate, 2 * raw.rate / count)}"
            faults.append(
                Fault(FaultKind.HUM, (name,), float(time[0]), float(time[-1]), count, text)
            )
    return faults


def _running_median(power: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
    padded = np.pad(power, _NEIGHBOURS, mode="reflect")
    return np.asarray(
        np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1), axis=-1)
    )


def _mains(frequency: float, rate: float, width: float) -> str:
    """Which multiple of the mains it is, or would be folded from: words, or none."""
    for order in range(1, _HARMONICS + 1):
        for mains in _MAINS:
            line = order * mains
            folded = abs(line - rate * round(line / rate))
            if abs(folded - frequency) < width:
                return (
                    f", as of {line:g} Hz"
                    + ("" if line < rate / 2 else f" at {rate:.4g} samples a second")
                    + ": hum of the mains"
                )
    return ""
