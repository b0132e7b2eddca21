"""Unit mistakes: numbers that cannot be in metres, newtons and newton metres, or poses that cannot
be unit quaternions x, y, z, w.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.mounting import loaded_rows
from vibrissa.sensor.raw import CHANNELS, RawRecording
from vibrissa.sensor.tare import Tare, fitted_tare

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

_QUATERNION_TOLERANCE = 1e-3
_LONGEST_SWEEP = 200.0
_FEWEST_LOADED = 10
_SHORTEST_ARM = 1e-2
_LONGEST_ARM = 5.0
_LARGEST_FORCE = 500.0
_LIKELY_ARM, _LIKELY_FORCE, _LIKELY_NOISE = (0.1, 1.15), (5e-3, 100.0), 5.0


def pose_unit_faults(raw: RawRecording, rod: Rod) -> list[Fault]:
    """Positions in millimetres, orientations that are no unit quaternions, and quaternions that may
    have been written w first.
    """
    faults = []
    stamps = raw.time[np.isfinite(raw.time)]
    span = (float(stamps[0]), float(stamps[-1]), len(raw.time))
    position = raw.position[np.isfinite(raw.position).all(axis=1)]
    extent = float(np.ptp(position, axis=0).max(initial=0.0)) if len(position) else 0.0
    if extent > _LONGEST_SWEEP * rod.length:
        text = (
            f"px,py,pz extend over {extent:.3g} with a rod of {rod.length:g} m; allowed are metres"
        )
        faults.append(Fault(FaultKind.UNITS, ("position",), *span, text, unusable=True))
    known = np.isfinite(raw.orientation).all(axis=1) & np.isfinite(raw.time)
    orientation = raw.orientation[known]
    norm = np.linalg.norm(orientation, axis=1)
    wrong = wrong_norms(orientation)
    if wrong.any():
        first, count = int(np.argmax(wrong)), int(np.count_nonzero(wrong))
        guess = ", as of angles in degrees" if norm[first] > 2 else ""
        text = f"qx,qy,qz,qw = {orientation[first].tolist()} has the norm {norm[first]:.3g} ({count} such){guess}; allowed is 1"
        time = raw.time[known][wrong]
        faults.append(
            Fault(
                FaultKind.UNITS,
                ("orientation",),
                float(time[0]),
                float(time[-1]),
                count,
                text,
                unusable=True,
            )
        )
    elif len(orientation) and np.all(orientation[:, 0] == 1):
        text = "qx = 1 throughout: half a turn about x, or quaternions written w first; allowed are x, y, z, w"
        faults.append(Fault(FaultKind.UNITS, ("orientation",), *span, text, quiet=True))
    return faults


def wrong_norms(orientation: Float[np.ndarray, "n 4"]) -> Bool[np.ndarray, "n"]:
    """Rows whose quaternion is there, and differs from the norm 1 by more than a thousandth."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.abs(np.linalg.norm(orientation, axis=1) - 1) > _QUATERNION_TOLERANCE)


def wrench_unit_faults(
    raw: RawRecording, reactions: Reactions, rod: Rod, sensor: "Sensor", tare: Tare
) -> list[Fault]:
    """Tell millinewtons and newton millimetres from SI: the contact lies on the rod, so the lever
    arm is of its length, and the force of its stiffness.
    """
    loaded = loaded_rows(reactions)
    count = int(np.count_nonzero(loaded))
    if count < _FEWEST_LOADED:
        return []
    arm, typical = arm_and_force(reactions, loaded)
    arm, typical = arm / rod.length, typical / rod.force_scale
    if _SHORTEST_ARM < arm < _LONGEST_ARM and 1 / _LARGEST_FORCE < typical < _LARGEST_FORCE:
        return []
    channels, guess = _explained(raw, rod, sensor, tare)
    what = "wrench, clamp_position or rod" if channels == CHANNELS else ",".join(channels)
    if not _SHORTEST_ARM < arm < _LONGEST_ARM:
        text = f"torque over force is {arm:.3g} rod lengths in the median, so {what} are mis-scaled"
    else:
        text = f"force is {typical:.3g} EI/L² in the median of the loaded samples, so {what} are mis-scaled"
    return [
        Fault(
            FaultKind.UNITS,
            channels,
            float(raw.time[0]),
            float(raw.time[-1]),
            count,
            f"{text}{guess}; allowed are N, N m, m and Pa",
            unusable=True,
        )
    ]


def arm_and_force(reactions: Reactions, loaded: Bool[np.ndarray, "n"]) -> tuple[float, float]:
    """Medians [m], [N] over the loaded samples."""
    force, moment = (
        np.linalg.norm(part[loaded], axis=1) for part in (reactions.force, reactions.moment)
    )
    return float(np.median(moment / force)), float(np.median(force))


def plausible_load(raw: RawRecording, sensor: "Sensor", tare: Tare | None, rod: Rod) -> bool:
    """Whether a contact on the rod explains the loads of a recording that is read in some way:
    lever arm and force are of its length and stiffness.
    """
    if tare is None:
        return False
    again = fitted_tare(sensor, raw, tare.intervals, tare.found) if tare.intervals else tare
    reactions = sensor.reactions(raw, again)
    loaded = loaded_rows(reactions)
    if np.count_nonzero(loaded) < _FEWEST_LOADED:
        return False
    arm, typical = arm_and_force(reactions, loaded)
    return (
        _LIKELY_ARM[0] < arm / rod.length < _LIKELY_ARM[1]
        and _LIKELY_FORCE[0] < typical / rod.force_scale < _LIKELY_FORCE[1]
    )


_FORCES, _TORQUES = CHANNELS[:3], CHANNELS[3:]
_WRENCHES: tuple[tuple[tuple[str, ...], str, float, float], ...] = (
    (_FORCES, "forces in mN", 1e-3, 1.0),
    (_TORQUES, "torques in N mm", 1.0, 1e-3),
    (CHANNELS, "forces in mN and torques in N mm", 1e-3, 1e-3),
    (_TORQUES, "torques in N cm", 1.0, 1e-2),
    (_FORCES, "forces in kgf", 9.80665, 1.0),
    (_FORCES, "forces in gf", 9.80665e-3, 1.0),
    (_FORCES, "forces in lbf", 4.4482216152605, 1.0),
    (CHANNELS, "forces in lbf and torques in lbf in", 4.4482216152605, 0.1129848290276167),
    (CHANNELS, "forces in kgf and torques in kgf cm", 9.80665, 9.80665e-2),
    (_FORCES, "forces in kN", 1e3, 1.0),
    (_TORQUES, "torques in kN m", 1.0, 1e3),
    (CHANNELS, "forces in kN and torques in kN m", 1e3, 1e3),
)
_RODS = (
    ("the rod's length in mm", 1e-3, 1.0),
    ("the rod's length and radius in mm", 1e-3, 1e-12),
    ("the rod's radius in mm", 1.0, 1e-12),
    ("youngs_modulus in GPa", 1.0, 1e9),
    ("youngs_modulus in MPa", 1.0, 1e6),
)


def _explained(
    raw: RawRecording, rod: Rod, sensor: "Sensor", tare: Tare
) -> tuple[tuple[str, ...], str]:
    """Channels and words of the mistakes that explain the readings: with them undone, contacts lie
    on the rod, forces bend it, and the noise at rest is as stated.
    """
    found: list[tuple[tuple[str, ...], str]] = []
    for channels, words, force, torque in _WRENCHES:
        scaled = replace(raw, force=force * raw.force, torque=torque * raw.torque)
        if _plausible(scaled, sensor, tare, rod.length, rod.force_scale):
            found.append((channels, words))
    swapped = replace(raw, force=raw.torque, torque=raw.force)
    if _plausible(swapped, sensor, tare, rod.length, rod.force_scale):
        found.append((CHANNELS, "forces and torques swapped"))
    nearer = replace(sensor, clamp_position=1e-3 * sensor.clamp_position)
    if _plausible(raw, nearer, tare, rod.length, rod.force_scale):
        found.append((CHANNELS, "clamp_position in mm"))
    x, y, z = sensor.wrench_point
    if _plausible(
        raw,
        replace(sensor, wrench_point=(1e-3 * x, 1e-3 * y, 1e-3 * z)),
        tare,
        rod.length,
        rod.force_scale,
    ):
        found.append((CHANNELS, "wrench_point in mm"))
    for words, length, stiffness in _RODS:
        if _plausible(
            raw, sensor, tare, length * rod.length, stiffness / length**2 * rod.force_scale
        ):
            found.append((CHANNELS, words))
    if not found:
        return CHANNELS, ""
    return (
        found[0][0] if len(found) == 1 else CHANNELS
    ), f" ({' or '.join(words for _, words in found)}?)"


def _plausible(
    raw: RawRecording, sensor: "Sensor", tare: Tare, length: float, force_scale: float
) -> bool:
    """Whether a contact on a rod of that length [m] and of that EI/L² [N] explains the loads, and
    the stated noise the readings at rest.
    """
    try:
        again = fitted_tare(sensor, raw, tare.intervals, tare.found) if tare.intervals else tare
    except ValueError:
        return False
    reactions = sensor.reactions(raw, again)
    loaded = loaded_rows(reactions)
    if np.count_nonzero(loaded) < _FEWEST_LOADED:
        return False
    arm, typical = arm_and_force(reactions, loaded)
    if not (
        _LIKELY_ARM[0] < arm / length < _LIKELY_ARM[1]
        and _LIKELY_FORCE[0] < typical / force_scale < _LIKELY_FORCE[1]
    ):
        return False
    if sensor.force_noise is None or not tare.intervals:
        return True
    start, stop = tare.intervals[0]
    rows = raw.wrench[(raw.time >= start) & (raw.time < stop) & np.isfinite(raw.wrench).all(axis=1)]
    ratio = np.std(rows, axis=0) / np.sqrt(sensor.reading_variance)
    # A channel without any noise is of a simulation, in any unit.
    return bool(np.all((ratio == 0) | (ratio > 1 / _LIKELY_NOISE) & (ratio < _LIKELY_NOISE)))
