"""Unit mistakes: numbers that cannot be in metres, newtons and newton metres, or poses that cannot
be unit quaternions x, y, z, w.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from scipy.constants import g, inch, kgf, lbf

from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.mounting import loaded_rows
from vibrissa.sensor.raw import CHANNELS, RawRecording
from vibrissa.sensor.tare import Tare, fitted_tare

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

# Logs of nine decimals keep a norm to 1e-8, those of four to 1e-4.
_QUATERNION_TOLERANCE = 1e-3
# In rod lengths: 10 m of a wire of 50 mm. In millimetres a sweep of a fifth of a length is as much.
_LONGEST_SWEEP = 200.0
# Samples: a shorter touch says too little of units.
_FEWEST_LOADED = 10
# Lever arms in rod lengths and forces in EI/L²: a contact lies within one length of the clamp, and
# forces of the order of EI/L² bend a rod visibly. Units are mistaken by factors of ten and more, so
# that the first bounds, which refuse, leave two decades, and the second, which guess, one.
_POSSIBLE_ARM, _POSSIBLE_FORCE = (1e-2, 5.0), (2e-3, 500.0)
_LIKELY_ARM, _LIKELY_FORCE = (0.1, 1.15), (5e-3, 100.0)
# Noise at rest may be stated wrongly by this factor.
_LIKELY_NOISE = 5.0
_FORCES, _TORQUES = CHANNELS[:3], CHANNELS[3:]


class Reading(NamedTuple):
    """A recording with what the setup says of it, or with a mistake undone that `words` name."""

    words: str
    raw: RawRecording
    sensor: Any
    """The `Sensor`."""
    rod: Rod
    channels: tuple[str, ...] = CHANNELS

    def reactions(self, tare: Tare) -> Reactions | None:
        """Reactions, its tare taken in the same intervals; None where these hold no tare."""
        try:
            again = (
                fitted_tare(self.sensor, self.raw, tare.intervals, tare.found)
                if tare.intervals
                else tare
            )
        except ValueError:
            return None
        return self.sensor.reactions(self.raw, again)

    def is_plausible(self, tare: Tare, stated: "Sensor", noise: float) -> bool:
        """Whether a contact on the rod explains the loads, and the stated noise the readings at
        rest, to a factor of `noise`: lever arm and force are of the rod's length and stiffness.
        """
        reactions = self.reactions(tare)
        load = None if reactions is None else arm_and_force(reactions, self.rod)
        if load is None or not (_inside(load[0], _LIKELY_ARM) and _inside(load[1], _LIKELY_FORCE)):
            return False
        if stated.force_noise is None or not tare.intervals:
            return True
        start, stop = tare.intervals[0]
        wrench = self.raw.wrench[(self.raw.time >= start) & (self.raw.time < stop)]
        wrench = wrench[np.isfinite(wrench).all(axis=1)]
        ratio = np.std(wrench, axis=0) / np.sqrt(stated.reading_variance)
        # A channel without any noise is of a simulation, in any unit.
        return bool(np.all((ratio == 0) | (ratio > 1 / noise) & (ratio < noise)))


def _inside(value: float, limits: tuple[float, float]) -> bool:
    return limits[0] < value < limits[1]


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
    wrong = wrong_norms(orientation)
    turned = partial(Fault, FaultKind.UNITS, ("orientation",))
    if wrong.any():
        first, count, time = orientation[wrong][0], int(wrong.sum()), raw.time[known][wrong]
        norm = np.linalg.norm(first)
        guess = ", as of angles in degrees" if norm > 2 else ""
        text = (
            f"qx,qy,qz,qw = {first.tolist()} has the norm {norm:.3g} ({count} such){guess}; "
            "allowed is 1"
        )
        faults.append(turned(float(time[0]), float(time[-1]), count, text, unusable=True))
    elif len(orientation) and np.all(orientation[:, 0] == 1):
        text = (
            "qx = 1 throughout: half a turn about x, or quaternions written w first; "
            "allowed are x, y, z, w"
        )
        faults.append(turned(*span, text, quiet=True))
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
    load = arm_and_force(reactions, rod)
    if load is None or (_inside(load[0], _POSSIBLE_ARM) and _inside(load[1], _POSSIBLE_FORCE)):
        return []
    given = Reading("", raw, sensor, rod)
    likely = [
        reading
        for reading in _other_units(given)
        if reading.is_plausible(tare, sensor, _LIKELY_NOISE)
    ]
    channels = likely[0].channels if len(likely) == 1 else CHANNELS
    guess = f" ({' or '.join(reading.words for reading in likely)}?)" if likely else ""
    what = "wrench, clamp_position or rod" if channels == CHANNELS else ",".join(channels)
    text = (
        f"force is {load[1]:.3g} EI/L² in the median of the loaded samples"
        if _inside(load[0], _POSSIBLE_ARM)
        else f"torque over force is {load[0]:.3g} rod lengths in the median"
    )
    return [
        Fault(
            FaultKind.UNITS,
            channels,
            float(raw.time[0]),
            float(raw.time[-1]),
            int(np.count_nonzero(loaded_rows(reactions))),
            f"{text}, so {what} are mis-scaled{guess}; allowed are N, N m, m and Pa",
            unusable=True,
        )
    ]


def arm_and_force(reactions: Reactions, rod: Rod) -> tuple[float, float] | None:
    """Medians over the loaded samples, in rod lengths and in EI/L²; None with too few of them."""
    loaded = loaded_rows(reactions)
    if np.count_nonzero(loaded) < _FEWEST_LOADED:
        return None
    force, moment = (
        np.linalg.norm(part[loaded], axis=1) for part in (reactions.force, reactions.moment)
    )
    return float(np.median(moment / force)) / rod.length, float(np.median(force)) / rod.force_scale


# Channels, the mistake in words, and the factors of forces and of torques that undo it.
_WRENCHES = (
    (_FORCES, "forces in mN", 1e-3, 1.0),
    (_TORQUES, "torques in N mm", 1.0, 1e-3),
    (CHANNELS, "forces in mN and torques in N mm", 1e-3, 1e-3),
    (_TORQUES, "torques in N cm", 1.0, 1e-2),
    (_FORCES, "forces in kgf", kgf, 1.0),
    (_FORCES, "forces in gf", 1e-3 * g, 1.0),
    (_FORCES, "forces in lbf", lbf, 1.0),
    (CHANNELS, "forces in lbf and torques in lbf in", lbf, lbf * inch),
    (CHANNELS, "forces in kgf and torques in kgf cm", kgf, 1e-2 * kgf),
    (_FORCES, "forces in kN", 1e3, 1.0),
    (_TORQUES, "torques in kN m", 1.0, 1e3),
    (CHANNELS, "forces in kN and torques in kN m", 1e3, 1e3),
)
# The mistake in words, and the factors of length and of bending stiffness that undo it.
_RODS = (
    ("the rod's length in mm", 1e-3, 1.0),
    ("the rod's length and radius in mm", 1e-3, 1e-12),
    ("the rod's radius in mm", 1.0, 1e-12),
    ("youngs_modulus in GPa", 1.0, 1e9),
    ("youngs_modulus in MPa", 1.0, 1e6),
)


def _other_units(given: Reading) -> Iterator[Reading]:
    """Each known mistake undone."""
    raw, sensor, rod = given.raw, given.sensor, given.rod
    for channels, words, force, torque in _WRENCHES:
        scaled = replace(raw, force=force * raw.force, torque=torque * raw.torque)
        yield given._replace(words=words, raw=scaled, channels=channels)
    swapped = replace(raw, force=raw.torque, torque=raw.force)
    yield given._replace(words="forces and torques swapped", raw=swapped)
    clamp, point = 1e-3 * sensor.clamp_position, tuple(1e-3 * x for x in sensor.wrench_point)
    nearer = replace(sensor, clamp_position=clamp)
    yield given._replace(words="clamp_position in mm", sensor=nearer)
    yield given._replace(words="wrench_point in mm", sensor=replace(sensor, wrench_point=point))
    for words, length, stiffness in _RODS:
        other = replace(
            rod, length=length * rod.length, bending_stiffness=stiffness * rod.bending_stiffness
        )
        yield given._replace(words=words, rod=other)
