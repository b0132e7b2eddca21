"""All that can be told of a recording before anyone trusts it."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor.drift import drift_faults, drift_of, lone_drift_faults
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.mounting import mount_faults
from vibrissa.sensor.pose_noise import pose_noise_faults
from vibrissa.sensor.poses import filled_poses, pose_jumps
from vibrissa.sensor.quiet import hum_faults, noise_faults, noise_unit_faults, noisier, rest_noise
from vibrissa.sensor.raw import CHANNELS, RawRecording
from vibrissa.sensor.readings import drop_outs, held_rows, standing_channels
from vibrissa.sensor.rest import Rest, find_rest, restless_tare
from vibrissa.sensor.stamps import increasing_stamps, rounded_stamps, stamp_faults
from vibrissa.sensor.tare import Tare, fitted_tare
from vibrissa.sensor.units import pose_unit_faults, wrench_unit_faults

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

_LARGEST, _LATEST = 1e12, 1e20
# A median of 0.67 is noise alone, and known to a few hundredths from some hundred rows.
_MISFIT = 1.0
_LASTING_MISFIT = 3.0
_LOADED = 10.0
_FEWEST_AT_REST = 20
# A second of a log at 250 Hz: shorter ones hold too little rest and motion to judge them by.
_SNIPPET = 250
# Their rows are marked, or lose nothing: what becomes of them is in the rows' statuses.
_NO_WARNING = (FaultKind.DROP_OUT, FaultKind.HELD, FaultKind.DUPLICATE, FaultKind.GAP)


@dataclass(frozen=True, eq=False)
class Inspection:
    """What `inspect_raw` finds.

    Attributes
    ----------
    raw
        As logged.
    cleaned
        The recording with increasing stamps, a pose in every row, unit quaternions, and NaN for the
        wrench of rows that are not usable.
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
        Rate of the offset from rest at the start to rest at the end (6,) [N/s], [N m/s], a given
        drift taken off, and its standard deviation; NaN without both.
    single_contact_misfit
        Median size of m0·f0 in its standard deviations over the loaded rows: 0.67 for a single
        contact and noise alone. NaN without a load.
    sensor
        As stated, with the noise of readings and poses that was found where that is larger: what
        the error bars use.
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
    sensor: "Sensor"
    notes: tuple[str, ...] = ()

    @property
    def unusable(self) -> tuple[Fault, ...]:
        """Faults that make the whole recording unusable; mistaken units first, as others may follow
        from them.
        """
        return tuple(
            sorted(
                (fault for fault in self.faults if fault.unusable),
                key=lambda fault: fault.kind is not FaultKind.UNITS,
            )
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings that contradict the setup or spoil contacts, a line each: those that
        `read_recording` warns of; none of a snippet of under 250 rows.
        """
        if len(self.usable) < _SNIPPET:
            return ()
        lines = (
            fault.text
            for fault in self.faults
            if not (fault.unusable or fault.quiet or fault.kind in _NO_WARNING)
        )
        return tuple(dict.fromkeys(lines))


def inspect_raw(
    raw: RawRecording,
    sensor: "Sensor",
    rod: Rod,
    *,
    poses: tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m 7"]] | None = None,
) -> Inspection:
    """Look for faults in a recording, and say what its rest tells of the sensor.

    Parameters
    ----------
    raw
        As logged; rows may hold NaN.
    sensor
        What the log's numbers mean: ranges, resolution, noise, tare.
    rod
        For the check of units: contacts lie on it.
    poses
        Stamps (m,) and poses (m, 7) as recorded, where those of the rows were interpolated between
        them: for their noise.

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
    faults += lost + held + stuck + pose_jumps(cleaned, rod, poseless)
    if not usable.any():
        text = f"none of {len(usable)} rows is usable; allowed is at least one"
        faults.append(_over_all(FaultKind.DROP_OUT, CHANNELS, cleaned, text, unusable=True))
    stamps, recorded = (
        (time, np.concatenate([given.position, given.orientation], axis=1))
        if poses is None
        else poses
    )
    scattered, sensor = pose_noise_faults(sensor, rod, stamps, recorded[:, :3], recorded[:, 3:])
    return _at_rest(raw, cleaned, sensor, rod, usable, faults + scattered)


def _at_rest(
    logged: RawRecording,
    raw: RawRecording,
    sensor: "Sensor",
    rod: Rod,
    usable: Bool[np.ndarray, "n"],
    faults: list[Fault],
) -> Inspection:
    unknown, stated = np.full(6, np.nan), sensor
    rest, tare, misfit = find_rest(sensor, raw), None, float("nan")
    noise, drift, deviation = unknown, unknown, unknown
    if usable.any():
        try:
            tare = sensor.tare(raw)
        except ValueError as error:
            faults.append(_over_all(FaultKind.REST, CHANNELS, raw, str(error), unusable=True))
    restless: list[Fault] = []
    if tare is not None and (sensor.tare_seconds is not None or sensor.rest_intervals):
        restless = restless_tare(sensor, raw, tare)
        faults += restless
    interval = tare.intervals[0] if tare is not None and tare.intervals else rest.leading
    both = rest.leading is not None and rest.trailing is not None and rest.trailing != rest.leading
    if interval is not None:
        noise = rest_noise(raw, interval)
        mis_scaled = noise_unit_faults(sensor, raw, interval, noise)
        # Where a contact or a drift lies within the tare, its scatter is no noise.
        faults += mis_scaled or (
            []
            if restless
            else noise_faults(sensor, raw, interval, noise) + hum_faults(sensor, raw, interval)
        )
        faults += [] if both or restless else lone_drift_faults(sensor, raw, interval)
        sensor = noisier(sensor, noise, faults)
        tare = (
            fitted_tare(sensor, raw, tare.intervals, tare.found)
            if tare is not None and tare.intervals
            else tare
        )
    if both:
        assert rest.leading is not None
        assert rest.trailing is not None
        drift, deviation = drift_of(sensor, raw, rest.leading, rest.trailing, noise)
        drifting, line = drift_faults(sensor, raw, rest, tare, drift, deviation)
        faults += drifting
        if line is not None:
            sensor, tare = replace(sensor, estimate_drift=True), line
    if tare is not None and not any(fault.unusable for fault in faults):
        reactions = sensor.reactions(raw, tare)
        mistaken = wrench_unit_faults(raw, reactions, rod, stated, tare)
        faults += mistaken or mount_faults(reactions, rod)
        misfit = _misfit(reactions)
        # Errors that last, of pink noise and random walk, do not average out.
        if misfit > (_LASTING_MISFIT if sensor.coloured(raw.time) else _MISFIT):
            text = f"force and moment at the clamp belong to no single contact by {misfit:.3g} standard deviations in the median (0.67 is noise alone): "
            text += "check tare, cross-talk and mount"
            faults.append(_over_all(FaultKind.TARE, CHANNELS, raw, text))
    ordered = tuple(sorted(faults, key=lambda fault: (fault.start, fault.stop)))
    return Inspection(
        logged, raw, ordered, usable, raw.rate, rest, tare, noise, drift, deviation, misfit, sensor
    )


def _bounded(raw: RawRecording) -> RawRecording:
    """Numbers that are none, or too large to be any sensor's, made NaN."""
    parts = (
        np.where(np.abs(part) < _LARGEST, part, np.nan)
        for part in (raw.position, raw.orientation, raw.force, raw.torque)
    )
    return RawRecording(np.where(np.abs(raw.time) < _LATEST, raw.time, np.nan), *parts)


def _misfit(reactions: Reactions) -> float:
    """Median of |m0·f0| in its standard deviations over rows of more than ten of them; NaN with
    fewer than 20, or where the noise is not known.
    """
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


def _over_all(
    kind: FaultKind,
    channels: tuple[str, ...],
    raw: RawRecording,
    text: str,
    *,
    unusable: bool = False,
) -> Fault:
    return Fault(
        kind,
        channels,
        float(raw.time[0]),
        float(raw.time[-1]),
        len(raw.time),
        text,
        unusable=unusable,
    )
