"""All that can be told of a recording before anyone trusts it."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import chi2

from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.mounting import mount_faults
from vibrissa.sensor.poses import filled_poses, pose_jumps
from vibrissa.sensor.raw import CHANNELS, RawRecording
from vibrissa.sensor.readings import drop_outs, held_rows, standing_channels
from vibrissa.sensor.rest import Interval, Rest, find_rest, restless_tare
from vibrissa.sensor.stamps import increasing_stamps, rounded_stamps, stamp_faults
from vibrissa.sensor.tare import Tare, planned_tare, without_given
from vibrissa.sensor.units import pose_unit_faults, wrench_unit_faults

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

_LARGEST, _LATEST = 1e12, 1e20
_FALSE_ALARM = 1e-6
_NOISE_RATIO = 1.25
_NEARLY = 0.5
_DRIFT_DEVIATIONS = 5.5
# A median of 0.67 is noise alone, and known to a few hundredths from some hundred rows.
_MISFIT = 1.0
_LASTING_MISFIT = 3.0
_LOADED = 10.0
_FEWEST_AT_REST = 20


@dataclass(frozen=True, eq=False)
class Inspection:
    """What `inspect_raw` finds.

    Attributes
    ----------
    raw
        As logged.
    cleaned
        The recording with increasing stamps, a pose in every row, unit quaternions, and NaN for the wrench of rows that are not usable.
    faults
        In order of their start.
    usable
        Rows (n,) whose wrench and pose can be used.
    rate
        Samples a second [Hz], by the median step.
    rest
        Quiet stretches.
    tare
        As `Sensor.tare` finds it, or None where it cannot; `faults` says why.
    noise
        Standard deviation (6,) at rest [N], [N m], a straight line taken off; NaN without rest.
    drift, drift_deviation
        Rate of the offset from rest at the start to rest at the end (6,) [N/s], [N m/s], a given drift taken off, and its standard deviation; NaN without both.
    single_contact_misfit
        Median size of m0·f0 in its standard deviations over the loaded rows: 0.67 for a single contact and noise alone. NaN without a load.
    notes
        What reading left out, recovered or estimated, a sentence each.
    """

    raw: RawRecording
    cleaned: RawRecording
    faults: tuple[Fault, ...]
    usable: Bool[np.ndarray, "n"]
    rate: float
    rest: Rest
    tare: Tare | None
    noise: Float[np.ndarray, "6"]
    drift: Float[np.ndarray, "6"]
    drift_deviation: Float[np.ndarray, "6"]
    single_contact_misfit: float
    notes: tuple[str, ...] = ()

    @property
    def unusable(self) -> tuple[Fault, ...]:
        """Faults that make the whole recording unusable; mistaken units first, as others may follow from them."""
        return tuple(sorted((fault for fault in self.faults if fault.unusable), key=lambda fault: fault.kind is not FaultKind.UNITS))


def inspect_raw(raw: RawRecording, sensor: "Sensor", rod: Rod) -> Inspection:
    """Look for faults in a recording, and say what its rest tells of the sensor.

    Parameters
    ----------
    raw
        As logged; rows may hold NaN.
    sensor
        What the log's numbers mean: ranges, resolution, noise, tare.
    rod
        For the check of units: contacts lie on it.

    Raises
    ------
    ValueError
        If no row has a stamp, or none a pose.
    """
    if not np.any(np.abs(raw.time) < _LATEST):
        raise ValueError(f"none of {len(raw.time)} rows has a stamp; allowed are stamps in seconds")
    given = _bounded(raw)
    faults = stamp_faults(given.time, rounded=rounded_stamps(given)) + pose_unit_faults(given, rod)
    time, moved = increasing_stamps(given.time, rounded=rounded_stamps(given))
    position, orientation, poseless = filled_poses(given)
    timed = RawRecording(time, given.position, given.orientation, given.force, given.torque)
    lost, bad = drop_outs(timed, ~np.isfinite(given.time))
    held, repeated = held_rows(sensor, timed, bad | moved[:, None])
    bad |= repeated
    stuck, standing = standing_channels(sensor, timed, bad)
    usable = ~(bad.any(axis=1) | standing.any(axis=1) | moved | poseless)
    wrench = np.where(usable[:, None], given.wrench, np.nan)
    cleaned = RawRecording(time, position, orientation, wrench[:, :3], wrench[:, 3:])
    faults += lost + held + stuck + pose_jumps(cleaned, rod)
    if not usable.any():
        text = f"none of {len(usable)} rows is usable; allowed is at least one"
        faults.append(_over_all(FaultKind.DROP_OUT, CHANNELS, cleaned, text, unusable=True))
    return _at_rest(raw, cleaned, sensor, rod, usable, faults)


def _at_rest(
    logged: RawRecording, raw: RawRecording, sensor: "Sensor", rod: Rod, usable: Bool[np.ndarray, "n"], faults: list[Fault]
) -> Inspection:
    unknown = np.full(6, np.nan)
    rest, tare, misfit = find_rest(sensor, raw), None, float("nan")
    noise, drift, deviation = unknown, unknown, unknown
    if usable.any():
        try:
            tare = sensor.tare(raw)
        except ValueError as error:
            faults.append(_over_all(FaultKind.REST, CHANNELS, raw, str(error), unusable=True))
    if tare is not None and (sensor.tare_seconds is not None or sensor.rest_intervals):
        faults += restless_tare(sensor, raw, tare)
    interval = tare.intervals[0] if tare is not None and tare.intervals else rest.leading
    if interval is not None:
        noise = rest_noise(raw, interval)
        mis_scaled = _noise_unit_faults(sensor, raw, interval, noise)
        faults += mis_scaled or _noise_faults(sensor, raw, interval, noise)
    if rest.leading is not None and rest.trailing is not None and rest.trailing != rest.leading:
        drift, deviation = _drift(sensor, raw, rest.leading, rest.trailing, noise)
        faults += _drift_faults(sensor, raw, rest, drift, deviation)
    if tare is not None and not any(fault.unusable for fault in faults):
        reactions = sensor.reactions(raw, tare)
        mistaken = wrench_unit_faults(raw, reactions, rod, sensor, tare)
        faults += mistaken or mount_faults(reactions, rod)
        misfit = _misfit(reactions)
        # Errors that last, of pink noise and random walk, do not average out.
        if misfit > (_LASTING_MISFIT if sensor.coloured(raw.time) else _MISFIT):
            text = f"force and moment at the clamp belong to no single contact by {misfit:.3g} standard deviations in the median (0.67 is noise alone): "
            text += "check tare, cross-talk and mount"
            faults.append(_over_all(FaultKind.TARE, CHANNELS, raw, text))
    ordered = tuple(sorted(faults, key=lambda fault: (fault.start, fault.stop)))
    return Inspection(logged, raw, ordered, usable, raw.rate, rest, tare, noise, drift, deviation, misfit)


def _bounded(raw: RawRecording) -> RawRecording:
    """Numbers that are none, or too large to be any sensor's, made NaN."""
    parts = (np.where(np.abs(part) < _LARGEST, part, np.nan) for part in (raw.position, raw.orientation, raw.force, raw.torque))
    return RawRecording(np.where(np.abs(raw.time) < _LATEST, raw.time, np.nan), *parts)


def _misfit(reactions: Reactions) -> float:
    """Median of |m0·f0| in its standard deviations over rows of more than ten of them; NaN with fewer than 20, or where the noise is not known."""
    if reactions.covariance is None:
        return float("nan")
    covariance = np.broadcast_to(reactions.covariance, (len(reactions.force), 6, 6))
    force = np.linalg.norm(reactions.force, axis=1)
    loaded = force > _LOADED * np.sqrt(np.einsum("nii->n", covariance[:, :3, :3]) / 3)
    if np.count_nonzero(loaded) < _FEWEST_AT_REST:
        return float("nan")
    gradient = np.concatenate([reactions.moment, reactions.force], axis=1)[loaded]
    spread = np.sqrt(np.einsum("ni,nij,nj->n", gradient, covariance[loaded], gradient))
    product = np.abs(np.einsum("ni,ni->n", reactions.force[loaded], reactions.moment[loaded]))
    return float(np.median(product / spread))


def rest_noise(raw: RawRecording, interval: Interval) -> Float[np.ndarray, "6"]:
    """Standard deviation (6,) of the readings within an interval about their straight lines; NaN with fewer than three."""
    time, values = _within(raw, interval)
    if len(time) < 3:
        return np.full(6, np.nan)
    lines = np.stack([np.ones(len(time)), time - time.mean()], axis=1)
    left = values - lines @ np.linalg.lstsq(lines, values, rcond=None)[0]
    return np.sqrt(np.sum(left**2, axis=0) / (len(time) - 2))


def _within(raw: RawRecording, interval: Interval) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k 6"]]:
    rows = (raw.time >= interval[0]) & (raw.time < interval[1]) & np.isfinite(raw.wrench).all(axis=1)
    return raw.time[rows], raw.wrench[rows]


def _noise_unit_faults(sensor: "Sensor", raw: RawRecording, interval: Interval, noise: Float[np.ndarray, "6"]) -> list[Fault]:
    """Noise about a thousand times as large or as small as stated, on all three axes: other units."""
    if sensor.force_noise is None:
        return []
    faults = []
    ratios = noise / np.sqrt(sensor.reading_variance)
    for channels, part, small, large in ((CHANNELS[:3], ratios[:3], "mN", "kN"), (CHANNELS[3:], ratios[3:], "N mm", "kN m")):
        factor = float(np.exp(np.mean(np.log(part)))) if np.all(part > 0) else 1.0
        if np.all((part > factor / 2) & (part < 2 * factor)) and abs(abs(np.log10(factor)) - 3) < _NEARLY:
            unit = small if factor > 1 else large
            text = f"{','.join(channels)} at rest are {factor:.3g} times as noisy as stated, so they are mis-scaled (in {unit}?); allowed are N and N m"
            faults.append(Fault(FaultKind.UNITS, channels, *interval, len(_within(raw, interval)[0]), text, unusable=True))
    return faults


def _noise_faults(sensor: "Sensor", raw: RawRecording, interval: Interval, noise: Float[np.ndarray, "6"]) -> list[Fault]:
    """By the χ² of the variance at rest, and by a quarter at least: stated figures are rounded.

    What rounding leaves of noise below half a step is not judged as too small. Pink noise and random walk are left out by taking successive differences.
    """
    time, values = _within(raw, interval)
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
        larger = ratio > _NOISE_RATIO and freedom * ratio**2 > chi2.isf(_FALSE_ALARM, freedom)
        smaller = not coarse and ratio < 1 / _NOISE_RATIO and freedom * ratio**2 < chi2.ppf(_FALSE_ALARM, freedom)
        if larger or smaller:
            unit = "N" if channel < 3 else "N m"
            text = (
                f"{name} at rest has a standard deviation of {noise[channel]:.3g} {unit}, {ratio:.3g} times the stated {stated:.3g} {unit}"
            )
            faults.append(Fault(FaultKind.NOISE, (name,), float(time[0]), float(time[-1]), count, text))
    return faults


def _drift(
    sensor: "Sensor", raw: RawRecording, early: Interval, late: Interval, noise: Float[np.ndarray, "6"]
) -> tuple[Float[np.ndarray, "6"], Float[np.ndarray, "6"]]:
    given = RawRecording(raw.time, raw.position, raw.orientation, *np.split(without_given(sensor, raw), 2, axis=1))
    (first, before), (last, after) = _within(given, early), _within(given, late)
    span = float(last.mean() - first.mean())
    rate = (after.mean(axis=0) - before.mean(axis=0)) / span
    if sensor.force_noise is None:
        # A noiseless simulation is known to some digits only.
        noise = np.maximum(noise, 1e-6 * np.nanmax(np.abs(raw.wrench), axis=0)) + 1e-300
        return rate, noise * np.sqrt(1 / len(first) + 1 / len(last)) / span
    tare = planned_tare(sensor.without_estimates(), (early,), (len(first),))
    there = tare.covariance(sensor.without_estimates(), raw.time, raw.orientation)
    at = int(np.argmin(np.abs(raw.time - last.mean())))
    variance = np.diagonal(there if there.ndim == 2 else there[at]) - sensor.reading_variance * (1 - 1 / len(last))
    return rate, np.sqrt(variance) / span


def _drift_faults(
    sensor: "Sensor", raw: RawRecording, rest: Rest, drift: Float[np.ndarray, "6"], deviation: Float[np.ndarray, "6"]
) -> list[Fault]:
    """Of the channels whose offset moves by more than 5.5 standard deviations; none where drift or weight are estimated anyway."""
    if sensor.estimate_drift or (sensor.mount is not None and sensor.mount.estimated):
        return []
    assert rest.leading is not None
    assert rest.trailing is not None
    faults = []
    for channel, name in enumerate(CHANNELS):
        if abs(drift[channel]) > _DRIFT_DEVIATIONS * deviation[channel]:
            unit = "N" if channel < 3 else "N m"
            text = f"the offset of {name} drifts by {drift[channel]:.3g} {unit}/s, {abs(drift[channel]) / deviation[channel]:.3g} standard deviations "
            text += "more than stated; estimate_drift = true takes it off"
            faults.append(Fault(FaultKind.DRIFT, (name,), rest.leading[0], rest.trailing[1], len(raw.time), text))
    return faults


def _over_all(kind: FaultKind, channels: tuple[str, ...], raw: RawRecording, text: str, *, unusable: bool = False) -> Fault:
    return Fault(kind, channels, float(raw.time[0]), float(raw.time[-1]), len(raw.time), text, unusable=unusable)
