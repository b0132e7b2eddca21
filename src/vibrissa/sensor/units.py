"""What the readings contradict of a setup: units, sign of the wrench, clamp and reference point;
and poses that cannot be in metres and unit quaternions x, y, z, w.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.geometry.rotation import third_axis
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor.raw import (
    CHANNELS,
    Fault,
    FaultKind,
    Quaternions,
    RawRecording,
    Rows,
    Times,
)
from vibrissa.sensor.sensor import Sensor
from vibrissa.sensor.tare import Tare, fitted_tare

# Logs of nine decimals keep a norm to 1e-8, those of four to 1e-4.
_QUATERNION_TOLERANCE = 1e-3
# In rod lengths: 10 m of a wire of 50 mm. In millimetres a sweep of a fifth of a length is as much.
_LONGEST_SWEEP = 200.0
# Forces of so many times the one at the start, at rest, are loads; a median needs some of them.
_LOADED, _LEAST_LOAD = 20.0, 1e-12
_FEWEST_LOADED = 10
# Lever arms in rod lengths and forces in EI/L²: a contact lies within one length of the clamp, and
# forces of the order of EI/L² bend a rod visibly. Units are mistaken by factors of ten and more, so
# that the first bounds, which refuse, leave two decades, and the second, which guess, one.
_POSSIBLE = (1e-2, 5.0), (2e-3, 500.0)
_LIKELY = (0.1, 1.15), (5e-3, 100.0)
# Noise at rest may be stated wrongly by this factor.
_LIKELY_NOISE = 5.0
# Of the largest work, and of what the forces could do at most: less may be friction or noise. Of
# the loaded rows: with more of them lost, so is a part of the work.
_NEGATIVE, _NOTICEABLE, _LOST = 0.5, 0.02, 0.02
# Rod lengths from the clamp, at all and along its axis: a contact lies nearer.
_FURTHEST = 1.1
_BEHIND, _FAR = -0.1, 0.3


class Reading(NamedTuple):
    """A recording with what the setup says of it, or with a mistake undone that `words` name."""

    words: str
    raw: RawRecording
    sensor: Sensor
    rod: Rod
    channels: tuple[str, ...] = CHANNELS

    def changed(self, words: str, **parts: Float[np.ndarray, "n k"]) -> "Reading":
        """The recording with other numbers."""
        return self._replace(words=words, raw=replace(self.raw, **parts))

    def reactions(self, tare: Tare) -> Reactions | None:
        """Reactions, its tare taken in the same intervals; None where these hold no tare."""
        try:
            again = fitted_tare(self.sensor, self.raw, tare.intervals, tare.found)
        except ValueError:
            return None
        return self.sensor.reactions(self.raw, again)

    def is_plausible(self, tare: Tare, stated: Sensor, noise: float) -> bool:
        """Whether a contact on the rod explains the loads, and the stated noise the readings at
        rest, to a factor of `noise`: lever arm and force are of the rod's length and stiffness.
        """
        reactions = self.reactions(tare)
        load = None if reactions is None else arm_and_force(reactions, self.rod)
        if load is None or not _within(load, _LIKELY):
            return False
        if not (stated.noise.known and tare.intervals):
            return True
        wrench = self.raw.wrench[self.raw.during(tare.intervals[0]) & self.raw.whole]
        ratio = np.std(wrench, axis=0) / np.sqrt(stated.noise.variance)
        # A channel without any noise is of a simulation, in any unit.
        return bool(np.all((ratio == 0) | (ratio > 1 / noise) & (ratio < noise)))


def _within(values: tuple[float, ...], limits: tuple[tuple[float, float], ...]) -> bool:
    return all(low < value < high for value, (low, high) in zip(values, limits, strict=False))


def pose_unit_faults(raw: RawRecording, rod: Rod) -> Iterator[Fault]:
    """Positions in millimetres, orientations that are no unit quaternions, and quaternions that may
    have been written w first.
    """
    extent = np.max(np.fmax.reduce(raw.position) - np.fmin.reduce(raw.position))
    if extent > _LONGEST_SWEEP * rod.length:
        text = (
            f"px,py,pz extend over {extent:.3g} with a rod of {rod.length:g} m; allowed are metres"
        )
        yield Fault.over(("position",), FaultKind.UNITS, raw.time, text, unusable=True)
    yield from norm_faults(raw.time, raw.orientation)
    along_x = raw.orientation[:, 0]
    if np.all((along_x == 1) | np.isnan(along_x)) and not wrong_norms(raw.orientation).any():
        text = (
            "qx = 1 throughout: half a turn about x, or quaternions written w first; "
            "allowed are x, y, z, w"
        )
        yield Fault.over(("orientation",), FaultKind.UNITS, raw.time, text, quiet=True)


def wrong_norms(orientation: Quaternions) -> Rows:
    """Rows whose quaternion is there, and differs from the norm 1 by more than a thousandth."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.abs(np.linalg.norm(orientation, axis=1) - 1) > _QUATERNION_TOLERANCE)


def norm_faults(time: Times, orientation: Quaternions) -> Iterator[Fault]:
    """The same as a finding, where there are such."""
    wrong = wrong_norms(orientation)
    for first in orientation[wrong][:1]:
        with np.errstate(over="ignore"):
            norm = np.linalg.norm(first)
        guess = ", as of angles in degrees" if norm > 2 else ""
        text = (
            f"qx,qy,qz,qw = {first.tolist()} has the norm {norm:.3g} ({wrong.sum()} such){guess}; "
            "allowed is 1"
        )
        yield Fault.over(("orientation",), FaultKind.UNITS, time[wrong], text, unusable=True)


def wrench_unit_faults(
    raw: RawRecording, reactions: Reactions, rod: Rod, sensor: Sensor, tare: Tare
) -> Iterator[Fault]:
    """Tell millinewtons and newton millimetres from SI: the contact lies on the rod, so the lever
    arm is of its length, and the force of its stiffness.
    """
    load = arm_and_force(reactions, rod)
    if load is None or _within(load, _POSSIBLE):
        return
    readings = _other_units(Reading("", raw, sensor, rod))
    likely = [each for each in readings if each.is_plausible(tare, sensor, _LIKELY_NOISE)]
    channels = likely[0].channels if len(likely) == 1 else CHANNELS
    guess = f" ({' or '.join(reading.words for reading in likely)}?)" if likely else ""
    what = "wrench, clamp_position or rod" if channels == CHANNELS else ",".join(channels)
    text = (
        f"force is {load[1]:.3g} EI/L² in the median of the loaded samples"
        if _within(load[:1], _POSSIBLE)
        else f"torque over force is {load[0]:.3g} rod lengths in the median"
    )
    text += f", so {what} are mis-scaled{guess}; allowed are N, N m, m and Pa"
    yield Fault.over(channels, FaultKind.UNITS, raw.time, text, unusable=True)


def loaded_rows(reactions: Reactions) -> Rows:
    """Rows of more than twenty times the force at the start; none with fewer than ten of them."""
    force = np.linalg.norm(reactions.force, axis=-1)
    start = force[np.isfinite(force)]
    start = start[: max(2, len(start) // 50)]
    rest = np.median(start) if len(start) else np.inf
    loaded = force > max(_LOADED * rest, _LEAST_LOAD)
    return loaded & (np.count_nonzero(loaded) >= _FEWEST_LOADED)


def arm_and_force(reactions: Reactions, rod: Rod) -> tuple[float, float] | None:
    """Medians over the loaded samples, in rod lengths and in EI/L²; None with too few of them."""
    loaded = loaded_rows(reactions)
    if not loaded.any():
        return None
    force, moment = np.linalg.norm([reactions.force[loaded], reactions.moment[loaded]], axis=2)
    return float(np.median(moment / force)) / rod.length, float(np.median(force)) / rod.force_scale


# Units that are taken for newtons and newton metres, alone and together.
_WRENCHES = (
    "forces in mN",
    "torques in N mm",
    "forces in mN and torques in N mm",
    "torques in N cm",
    "forces in kgf",
    "forces in gf",
    "forces in lbf",
    "forces in lbf and torques in lbf in",
    "forces in kgf and torques in kgf cm",
    "forces in kN",
    "torques in kN m",
    "forces in kN and torques in kN m",
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
    from pint import get_application_registry  # noqa: PLC0415, as it takes long to load

    raw, sensor, rod = given.raw, given.sensor, given.rod
    quantity = get_application_registry().Quantity  # type: ignore[no-untyped-call]
    for words in _WRENCHES:
        units = dict(part.split(" in ", 1) for part in words.split(" and "))
        force, torque = (
            quantity(1.0, units.get(kind, "")).to_base_units().magnitude
            for kind in ("forces", "torques")
        )
        channels = CHANNELS[:3] * ("forces" in units) + CHANNELS[3:] * ("torques" in units)
        scaled = given.changed(words, force=force * raw.force, torque=torque * raw.torque)
        yield scaled._replace(channels=channels)
    yield given.changed("forces and torques swapped", force=raw.torque, torque=raw.force)
    for name in ("clamp_position", "wrench_point"):
        nearer = sensor.updated(**{name: 1e-3 * np.asarray(getattr(sensor, name))})
        yield given._replace(words=f"{name} in mm", sensor=nearer)
    for words, length, stiffness in _RODS:
        other = replace(
            rod, length=length * rod.length, bending_stiffness=stiffness * rod.bending_stiffness
        )
        yield given._replace(words=words, rod=other)


def mount_faults(reactions: Reactions, rod: Rod) -> Iterator[Fault]:
    """What only a wrong sign, clamp or reference point explains.

    The clamp's work on a rod that is free at first is its bending energy and what friction took,
    never negative, and contacts push the rod into its clamp: both are the other way round where the
    wrench has the other sign. The line of the contact force passes the clamp within the rod's
    length, on the side to which the rod leaves.
    """
    loaded = loaded_rows(reactions)
    if not loaded.any() or reactions.time is None:
        return
    force, moment = reactions.force[loaded], reactions.moment[loaded]
    axis = third_axis(reactions.trail.orientation[loaded])
    # Points on the lines of the contact forces that are next to the clamp, seen from it.
    points = np.cross(force, moment) / np.sum(force**2, axis=1, keepdims=True)
    push = np.median(np.sum(force * axis, axis=1))
    away = np.median(np.linalg.norm(points, axis=1)) / rod.length
    ahead = np.median(np.sum(points * axis, axis=1)) / rod.length
    found = partial(Fault.over, CHANNELS, FaultKind.MOUNT, reactions.time[loaded])
    done = _work_by_rod(reactions, loaded) if push < 0 else 0.0
    if done:
        yield found(
            f"the rod is pulled from its clamp and does work on it, {-1e3 * done:.3g} mJ, where one "
            "that is pushed takes up work: this fits a wrench of the other sign; check wrench in "
            "[sensor]"
        )
    if away > _FURTHEST:
        yield found(
            f"the contact forces act along lines {away:.3g} rod lengths from the clamp in the "
            "median, where no rod is: check clamp_position, wrench_point and length"
        )
    elif ahead < _BEHIND and away > _FAR:
        yield found(
            f"the contact forces act {-ahead:.3g} rod lengths behind the clamp in the median, "
            "but the rod leaves to the other side: check clamp_orientation, whose +z it follows"
        )


def _work_by_rod(reactions: Reactions, loaded: Rows) -> float:
    """Work that the rod has done on its clamp since the first load, at most [J]; 0 where there was
    as much the other way, or little next to what the forces could do along the whole way.

    Nothing is told of a recording that begins under load, or of whose load a part is missing.
    """
    wrench, trail = reactions.wrench, reactions.trail
    finite, rows = np.isfinite(wrench).all(axis=1), np.flatnonzero(loaded)
    known, lost = np.flatnonzero(finite), np.count_nonzero(~finite[rows[0] : rows[-1]])
    if known[0] == rows[0] or lost > _LOST * len(rows):
        return 0.0
    path = trail[known].steps
    # Without a load there is noise alone.
    wrench = np.where(loaded[:, None], wrench, 0.0)[known]
    work = np.cumsum(np.sum((wrench[1:] + wrench[:-1]) / 2 * path, axis=1))
    loads, ways = np.linalg.norm(np.reshape([wrench[1:], path], (2, -1, 2, 3)), axis=3)
    done = -float(work.min())
    clear = done > max(_NEGATIVE * np.abs(work).max(), _NOTICEABLE * np.sum(loads * ways))
    return done if clear else 0.0
