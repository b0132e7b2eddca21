"""All the checks that a recording undergoes before it is trusted."""

from collections import Counter
from dataclasses import astuple, dataclass, replace

import numpy as np

from vibrissa.rod import Rod
from vibrissa.sensor.at_rest import (
    Stretch,
    drift_faults,
    drift_of,
    hum_faults,
    lone_drift_faults,
    noise_faults,
    noise_unit_faults,
)
from vibrissa.sensor.poses import filled_poses, pose_jumps, pose_noise_faults
from vibrissa.sensor.raw import (
    CHANNELS,
    Fault,
    FaultKind,
    Interval,
    Quaternions,
    RawRecording,
    Rows,
    Times,
    Vectors,
    Wrench,
)
from vibrissa.sensor.readings import drop_outs, held_rows, standing_channels, without
from vibrissa.sensor.rest import Rest, contact_misfits, find_rest, restless_tare
from vibrissa.sensor.sensor import Sensor
from vibrissa.sensor.stamps import increasing_stamps, rounded_stamps, stamp_faults
from vibrissa.sensor.tare import Tare
from vibrissa.sensor.units import mount_faults, pose_unit_faults, wrench_unit_faults

# Largest valid number in any unit, including stamps in nanoseconds since 1970.
_LARGEST = 1e20
# Noise alone gives a median of 0.67, known to a few hundredths from some hundred rows.
_MISFIT, _LASTING_MISFIT = 1.0, 3.0
# A second of a 250 Hz log: shorter ones hold too little rest and motion to be judged.
_SNIPPET = 250
# Not warned of: their rows are marked or unaffected, as the rows' statuses show.
_NO_WARNING = (FaultKind.DROP_OUT, FaultKind.HELD, FaultKind.DUPLICATE, FaultKind.GAP)


@dataclass(frozen=True, eq=False)
class Inspection:
    """Result of `inspect_raw`.

    Attributes
    ----------
    raw
        As logged.
    cleaned
        The recording with increasing stamps, a pose in every row, unit quaternions, and NaN for the
        wrench in unusable rows.
    faults
        Sorted by start.
    rest
        Quiet intervals.
    tare
        As found by `Sensor.tare`, or None if that fails; `faults` says why.
    noise
        Standard deviation (6,) about a straight line at rest [N], [N m]; NaN without rest.
    drift, drift_deviation
        Rate of change of the offset from rest at the start to rest at the end (6,) [N/s], [N m/s],
        known drift subtracted, and its standard deviation; NaN unless both rests exist.
    single_contact_misfit
        Median size of m0·f0 over its standard deviation in the loaded rows: 0.67 for a single
        contact and noise alone. NaN without a load.
    sensor
        As stated, but with the observed noise of readings and poses where that is larger: what the
        error bars use.
    notes
        What reading left out, recovered or estimated, one sentence each.
    """

    raw: RawRecording
    cleaned: RawRecording
    faults: tuple[Fault, ...]
    rest: Rest
    tare: Tare | None
    noise: Wrench
    drift: Wrench
    drift_deviation: Wrench
    sensor: Sensor
    single_contact_misfit: float = np.nan
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Return five lines: rows, tare, noise, faults, and whether it can be used."""
        kinds = Counter(str(fault.kind) for fault in self.faults)
        found = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
        force, torque = self.noise[:3].max(), self.noise[3:].max()
        return (
            f"Inspection of {len(self.usable)} rows, {self.rate:.5g} a second, "
            f"{self.usable.sum()} usable\n"
            f"  tare: {'none' if self.tare is None else self.tare.found}\n"
            f"  noise at rest: up to {1e3 * force:.3g} mN, {1e3 * torque:.3g} N mm\n"
            f"  findings: {found or 'none'}\n"
            f"  unusable: {'; '.join(fault.text for fault in self.unusable) or 'no'}"
        )

    @property
    def usable(self) -> Rows:
        """Rows (n,) whose wrench and pose can be used."""
        return self.cleaned.whole

    @property
    def tared(self) -> tuple[Interval, ...]:
        """Intervals in which the tare is taken; empty without a tare."""
        return () if self.tare is None else self.tare.intervals

    @property
    def rate(self) -> float:
        """Sampling rate [Hz], from the median step."""
        return self.cleaned.rate

    @property
    def unusable(self) -> tuple[Fault, ...]:
        """Faults that make the whole recording unusable; wrong units first, as they may cause
        others.
        """
        found = (fault for fault in self.faults if fault.unusable)
        return tuple(sorted(found, key=lambda fault: fault.kind is not FaultKind.UNITS))

    @property
    def misread(self) -> tuple[str, ...]:
        """Findings that let no contact be trusted: units, signs, axes, clamp."""
        kinds = {FaultKind.UNITS, FaultKind.MOUNT}
        return tuple(fault.text for fault in self.faults if fault.kind in kinds)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Findings that contradict the setup or spoil contacts, a line each, which `read_recording`
        warns of; none for snippets of fewer than 250 rows.
        """
        if len(self.usable) < _SNIPPET:
            return ()
        lines = {
            fault.text: None
            for fault in self.faults
            if not (fault.unusable or fault.quiet or fault.kind in _NO_WARNING)
        }
        return tuple(lines)


def inspect_raw(
    raw: RawRecording,
    sensor: Sensor,
    rod: Rod,
    *,
    poses: tuple[Times, Vectors, Quaternions] | None = None,
) -> Inspection:
    """Look for faults in a recording, and for what its rest says about the sensor.

    Parameters
    ----------
    raw
        As logged; rows may hold NaN.
    sensor
        What the log's numbers mean: ranges, resolution, noise, tare.
    rod
        For checking units: contacts lie on it. The sensor reads its loads at rest.
    poses
        Stamps (m,), positions (m, 3) and orientations (m, 4) as recorded, if those of the rows were
        interpolated between them: used for the pose noise.

    Raises
    ------
    ValueError
        If no row has a stamp, or none has a pose.
    """
    sensor = sensor.carrying(rod)
    # Infinite numbers, and those that loggers write for missing ones, do not come from a sensor.
    given = RawRecording(
        *(np.where(np.abs(part) < _LARGEST, part, np.nan) for part in astuple(raw))
    )
    if not np.isfinite(given.time).any():
        raise ValueError(f"none of {len(raw.time)} rows has a stamp; allowed are stamps in seconds")
    rounded = rounded_stamps(given)
    time, moved = increasing_stamps(given.time, rounded=rounded)
    position, orientation, poseless = filled_poses(given)
    good = replace(given, time=time)
    faults = [*stamp_faults(given.time, rounded=rounded), *pose_unit_faults(good, rod)]
    lost = list(drop_outs(given, time))
    good = without(good, lost)
    unmoved = np.where(moved[:, None], np.nan, good.wrench)
    held = list(held_rows(sensor.noise, good.with_wrench(unmoved)))
    good = without(good, held)
    stuck = list(standing_channels(sensor, good))
    good = without(good, stuck)
    usable = good.whole & ~moved & ~poseless
    good = good.with_wrench(np.where(usable[:, None], good.wrench, np.nan))
    cleaned = replace(good, position=position, orientation=orientation)
    faults += [*lost, *held, *stuck, *pose_jumps(cleaned, rod, poseless)]
    if not usable.any():
        text = f"none of {len(usable)} rows is usable; allowed is at least one"
        faults.append(Fault.over(CHANNELS, FaultKind.DROP_OUT, time, text, unusable=True))
    logged = poses or (time, given.position, given.orientation)
    scattered, sensor = pose_noise_faults(sensor, rod, *logged)
    found = _loaded(_at_rest(raw, cleaned, sensor, faults + scattered), sensor, rod)
    return replace(found, faults=tuple(sorted(found.faults, key=lambda f: (f.start, f.stop))))


def _at_rest(
    raw: RawRecording, cleaned: RawRecording, sensor: Sensor, faults: list[Fault]
) -> Inspection:
    """Add what rest shows: tare, noise and drift, and the sensor with the noise observed."""
    rest, tare, policy = find_rest(sensor, cleaned), None, sensor.tare_policy
    restless: list[Fault] = []
    if cleaned.whole.any():
        try:
            tare = sensor.tare(cleaned)
            if policy.tare_seconds is not None or policy.rest_intervals:
                restless = list(restless_tare(sensor, cleaned, tare))
        except ValueError as error:
            text = str(error)
            faults.append(Fault.over(CHANNELS, FaultKind.REST, cleaned.time, text, unusable=True))
    noise, drift, deviation = np.full((3, 6), np.nan)
    interval = tare.intervals[0] if tare is not None and tare.intervals else rest.leading
    if interval is not None:
        still, stated = Stretch.of(sensor, cleaned, interval), sensor.noise
        noise, mis_scaled = still.noise, list(noise_unit_faults(stated, still))
        faults += restless + mis_scaled
        # If there is a contact or drift within the tare, its scatter is not noise.
        if not (restless or any(fault.unusable for fault in mis_scaled)):
            noisy, sensor = noise_faults(sensor, still)
            faults += [*noisy, *hum_faults(stated, still, cleaned.rate)]
        if not (rest.ends or restless):
            faults += lone_drift_faults(stated, cleaned, still)
    if rest.ends is not None:
        ends = [Stretch.of(sensor, cleaned, end) for end in rest.ends]
        drift, deviation = drift_of(sensor, cleaned, *ends)
        drifting, line = drift_faults(sensor, cleaned, ends, tare, drift, deviation)
        faults += drifting
        if line is not None:
            sensor, tare = sensor.updated(estimate_drift=True), line
    return Inspection(raw, cleaned, tuple(faults), rest, tare, noise, drift, deviation, sensor)


def _loaded(found: Inspection, stated: Sensor, rod: Rod) -> Inspection:
    """Add what loads show: units, mount, and whether they are consistent with single contacts."""
    tare, misfit = found.tare, np.nan
    if tare is None or found.unusable:
        return found
    own = found.sensor.rod_readings(found.cleaned)
    raw, stated = found.cleaned.with_wrench(found.cleaned.wrench - own), stated.updated(rod=None)
    reactions = found.sensor.reactions(raw, tare)
    faults = list(wrench_unit_faults(raw, reactions, rod, stated, tare))
    faults = faults or list(mount_faults(reactions, rod))
    if reactions.covariance is not None:
        misfits = contact_misfits(reactions.wrench, reactions.covariance)
        misfit = float(np.median(misfits)) if len(misfits) else misfit
    # Errors of pink noise and random walk persist and do not average out.
    if misfit > (_LASTING_MISFIT if stated.noise.lasting else _MISFIT):
        text = (
            "force and moment at the clamp fit no single contact: they miss one by "
            f"{misfit:.3g} standard deviations in the median (noise alone gives 0.67); check "
            "tare, cross-talk and mount"
        )
        faults.append(Fault.over(CHANNELS, FaultKind.TARE, found.cleaned.time, text))
    return replace(found, faults=(*found.faults, *faults), single_contact_misfit=misfit)
