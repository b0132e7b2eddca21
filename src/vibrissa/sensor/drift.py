"""Drift of the zero, from rest at the start and at the end."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.quiet import within
from vibrissa.sensor.raw import CHANNEL_UNITS, CHANNELS, RawRecording
from vibrissa.sensor.tare import Tare, fitted_tare, planned_tare, without_given

if TYPE_CHECKING:
    from vibrissa.sensor.rest import Interval, Rest
    from vibrissa.sensor.sensor import Sensor

_DRIFT_DEVIATIONS = 5.5
# Of the largest load: a zero that moves by more is the load of a clamp that stands in contact
# rather.
_ANOTHER_LEVEL = 0.2
# Squares of three standard deviations: what the slopes within both rests must say to tell a drift
# from a contact.
_TOLD = 9.0
_FEWEST = 50
_DIGITS = 1e-9


def drift_of(
    sensor: "Sensor",
    raw: RawRecording,
    early: "Interval",
    late: "Interval",
    noise: Float[np.ndarray, "6"],
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"]]:
    """Rate of the offset from one rest to another (6,) [N/s], [N m/s], a given drift taken off, and
    its standard deviation.
    """
    given = _without_given(sensor, raw)
    (first, before), (last, after) = within(given, early), within(given, late)
    span = float(last.mean() - first.mean())
    rate = (after.mean(axis=0) - before.mean(axis=0)) / span
    if sensor.force_noise is None:
        # A noiseless simulation is known to some digits only.
        noise = np.maximum(noise, 1e-6 * np.nanmax(np.abs(raw.wrench), axis=0)) + 1e-300
        return rate, noise * np.sqrt(1 / len(first) + 1 / len(last)) / span
    tare = planned_tare(sensor.without_estimates(), (early,), (len(first),))
    there = tare.covariance(sensor.without_estimates(), raw.time, raw.orientation)
    at = int(np.argmin(np.abs(raw.time - last.mean())))
    variance = np.diagonal(there if there.ndim == 2 else there[at]) - sensor.reading_variance * (
        1 - 1 / len(last)
    )
    return rate, np.sqrt(variance) / span


def _without_given(sensor: "Sensor", raw: RawRecording) -> RawRecording:
    return RawRecording(
        raw.time, raw.position, raw.orientation, *np.split(without_given(sensor, raw), 2, axis=1)
    )


def drift_faults(
    sensor: "Sensor",
    raw: RawRecording,
    rest: "Rest",
    tare: Tare | None,
    drift: Float[np.ndarray, "6"],
    deviation: Float[np.ndarray, "6"],
) -> tuple[list[Fault], Tare | None]:
    """Channels whose offset moves by more than 5.5 standard deviations, and the tare with a line
    from rest to rest in its place where the slopes within them agree.

    None where drift or weight are estimated anyway, and none where the readings within the rests
    stand: a clamp that stops in contact has another level, too.
    """
    if sensor.estimate_drift or (sensor.mount is not None and sensor.mount.estimated):
        return [], None
    assert rest.leading is not None
    assert rest.trailing is not None
    moved = np.abs(drift) > _DRIFT_DEVIATIONS * deviation
    if not moved.any():
        return [], None
    told, weight = _slopes(sensor, raw, (rest.leading, rest.trailing), drift, moved)
    if told < 0 and weight > _TOLD:
        return [], None
    line = _line(sensor, raw, rest, tare, drift) if told > 0 and weight > _TOLD else None
    advice = (
        "a line from rest to rest is taken off"
        if line is not None
        else "estimate_drift = true takes it off"
    )
    faults = []
    for channel, name in enumerate(CHANNELS):
        if moved[channel]:
            unit = CHANNEL_UNITS[channel]
            text = f"the offset of {name} drifts by {drift[channel]:.3g} {unit}/s, {abs(drift[channel]) / deviation[channel]:.3g} standard deviations "
            text += f"more than stated; {advice}"
            faults.append(
                Fault(
                    FaultKind.DRIFT, (name,), rest.leading[0], rest.trailing[1], len(raw.time), text
                )
            )
    return faults, line


def _slopes(
    sensor: "Sensor",
    raw: RawRecording,
    intervals: tuple["Interval", ...],
    drift: Float[np.ndarray, "6"],
    moved: np.ndarray,
) -> tuple[float, float]:
    """Log-likelihood (times two) of the drift over none, from the slopes within the rests, and how
    much they could tell: (drift/σ)², summed.
    """
    told, weight = 0.0, 0.0
    for interval in intervals:
        slope, deviation = slope_at_rest(sensor, raw, interval)
        square = (drift / deviation)[moved] ** 2
        weight += float(np.sum(square))
        told += float(np.sum((2 * slope * drift / deviation**2)[moved] - square))
    return told, weight


def slope_at_rest(
    sensor: "Sensor", raw: RawRecording, interval: "Interval"
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"]]:
    """Slopes of the readings within a rest (6,) and their standard deviations by the scatter about
    the lines.
    """
    time, values = within(_without_given(sensor, raw), interval)
    lines = np.stack([np.ones(len(time)), time - time.mean()], axis=1)
    found, *_ = np.linalg.lstsq(lines, values, rcond=None)
    scatter = np.sqrt(np.sum((values - lines @ found) ** 2, axis=0) / max(1, len(time) - 2))
    # Readings without noise are known to some digits only.
    scatter = np.maximum(scatter, _DIGITS * np.abs(values).max(axis=0)) + 1e-30
    return found[1], scatter / np.linalg.norm(lines[:, 1])


def _line(
    sensor: "Sensor",
    raw: RawRecording,
    rest: "Rest",
    tare: Tare | None,
    drift: Float[np.ndarray, "6"],
) -> Tare | None:
    """The tare as a line, unless the zero moves by a noticeable share of the load."""
    assert rest.trailing is not None
    if tare is None or len(tare.intervals) != 1 or tare.intervals[0][1] >= rest.trailing[0]:
        return None
    loads = raw.wrench - tare.offset
    step = drift * (rest.trailing[0] - tare.intervals[0][0])
    for part in (slice(0, 3), slice(3, 6)):
        if np.linalg.norm(step[part]) > _ANOTHER_LEVEL * np.nanmax(
            np.linalg.norm(loads[:, part], axis=1)
        ):
            return None
    found = f"{tare.found}, and at the end, as the zero drifts"
    return fitted_tare(
        replace(sensor, estimate_drift=True), raw, (*tare.intervals, rest.trailing), found
    )


def lone_drift_faults(sensor: "Sensor", raw: RawRecording, interval: "Interval") -> list[Fault]:
    """Channels that drift within the rest at the start, where there is none at the end to draw a
    line to.
    """
    count = len(within(raw, interval)[0])
    if (
        sensor.force_noise is None
        or sensor.noise_corner > 0
        or np.any(sensor.random_walk)
        or count < _FEWEST
    ):
        return []
    slope, deviation = slope_at_rest(sensor, raw, interval)
    faults = []
    for channel, name in enumerate(CHANNELS):
        noise, unit = np.sqrt(sensor.reading_variance[channel]), CHANNEL_UNITS[channel]
        over_all = abs(slope[channel]) * float(raw.time[-1] - raw.time[0])
        if abs(slope[channel]) > _DRIFT_DEVIATIONS * deviation[channel] and over_all > noise:
            text = f"the offset of {name} drifts by {slope[channel]:.3g} ± {deviation[channel]:.2g} {unit}/s within the rest at the start, and there is none at the end: "
            text += f"record one and set estimate_drift = true, or give {'force' if channel < 3 else 'torque'}_drift"
            faults.append(Fault(FaultKind.DRIFT, (name,), *interval, count, text))
    return faults
