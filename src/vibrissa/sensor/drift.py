"""Drift of the zero, from rest at the start and at the end."""

from typing import TYPE_CHECKING

import numpy as np

from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.quiet import Stretch
from vibrissa.sensor.raw import CHANNEL_UNITS, CHANNELS, RawRecording, Wrench
from vibrissa.sensor.tare import Tare, fitted_tare, planned_tare

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

# By chance in one of four million recordings, of which each has six channels.
_DRIFT_DEVIATIONS = 5.5
# Of the largest load: a zero that moves by more is the load of a clamp that stands in contact
# rather.
_ANOTHER_LEVEL = 0.2
# Squares of three standard deviations: what the slopes within both rests must say to tell a drift
# from a contact.
_TOLD = 9.0
# A slope's deviation by the scatter of so many samples is known to a tenth.
_FEWEST = 50
# A noiseless simulation is known to single precision.
_DIGITS = 1e-6


def drift_of(
    sensor: "Sensor", raw: RawRecording, early: Stretch, late: Stretch, noise: Wrench
) -> tuple[Wrench, Wrench]:
    """Rate of the offset from one rest to another (6,) [N/s], [N m/s], a given drift taken off, and
    its standard deviation.
    """
    middle, counts = float(late.time.mean()), (len(early.time), len(late.time))
    span = middle - float(early.time.mean())
    rate = (late.values.mean(axis=0) - early.values.mean(axis=0)) / span
    if not sensor.noise.known:
        noise = np.maximum(noise, _DIGITS * np.nanmax(np.abs(raw.wrench), axis=0)) + 1e-300
        return rate, noise * np.sqrt(1 / counts[0] + 1 / counts[1]) / span
    plain = sensor.without_estimates()
    tare = planned_tare(plain, (early.interval,), counts[:1])
    there = tare.covariance(plain, raw.time, raw.orientation)
    there = there if there.ndim == 2 else there[np.argmin(np.abs(raw.time - middle))]
    variance = np.diagonal(there) - sensor.noise.variance * (1 - 1 / counts[1])
    return rate, np.sqrt(variance) / span


def drift_faults(
    sensor: "Sensor",
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
    if sensor.tare_policy.estimate_drift or sensor.estimates_mount or not moved.any():
        return [], None
    # Log-likelihood (times two) of the drift over none, from the slopes within the rests, and how
    # much they could tell.
    told, most = 0.0, 0.0
    for rest in ends:
        slope, of_slope = rest.about_lines[0][moved], rest.slope_deviation[moved]
        square = float(np.sum((drift[moved] / of_slope) ** 2))
        told += 2 * float(np.sum(slope * drift[moved] / of_slope**2)) - square
        most += square
    if told < 0 and most > _TOLD:
        return [], None
    line = _line(sensor, raw, ends[1], tare, drift) if told > 0 and most > _TOLD else None
    advice = (
        "estimate_drift = true takes it off"
        if line is None
        else "a line from rest to rest is taken off"
    )
    faults = []
    for channel in np.flatnonzero(moved):
        text = (
            f"the offset of {CHANNELS[channel]} drifts by {drift[channel]:.3g} "
            f"{CHANNEL_UNITS[channel]}/s, {abs(drift[channel]) / deviation[channel]:.3g} standard "
            f"deviations more than stated; {advice}"
        )
        span = (ends[0].interval[0], ends[1].interval[1])
        faults.append(Fault.over(FaultKind.DRIFT, (CHANNELS[channel],), span, text, len(raw.time)))
    return faults, line


def _line(
    sensor: "Sensor", raw: RawRecording, late: Stretch, tare: Tare | None, drift: Wrench
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
    return fitted_tare(
        sensor.updated(estimate_drift=True), raw, (*tare.intervals, late.interval), found
    )


def lone_drift_faults(sensor: "Sensor", raw: RawRecording, rest: Stretch) -> list[Fault]:
    """Channels that drift within the rest at the start, where there is none at the end to draw a
    line to.
    """
    count = len(rest.time)
    if not sensor.noise.known or sensor.noise.lasting or count < _FEWEST:
        return []
    slope, deviation = rest.about_lines[0], rest.slope_deviation
    over_all = np.abs(slope) * float(raw.time[-1] - raw.time[0])
    clear = np.abs(slope) > _DRIFT_DEVIATIONS * deviation
    faults = []
    for channel in np.flatnonzero(clear & (over_all > np.sqrt(sensor.noise.variance))):
        text = (
            f"the offset of {CHANNELS[channel]} drifts by {slope[channel]:.3g} ± "
            f"{deviation[channel]:.2g} {CHANNEL_UNITS[channel]}/s within the rest at the start, "
            "and there is none at the end: record one and set estimate_drift = true, or give "
            f"{'force' if channel < 3 else 'torque'}_drift"
        )
        span = rest.interval
        faults.append(Fault.over(FaultKind.DRIFT, (CHANNELS[channel],), span, text, count))
    return faults
