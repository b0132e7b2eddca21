"""Readings that contradict the setup (units, sign of the wrench, clamp, reference point), and poses
that cannot be in metres and unit quaternions x, y, z, w.
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

# Logs with nine decimals keep the norm to 1e-8, those with four to 1e-4.
_QUATERNION_TOLERANCE = 1e-3
# In rod lengths: 10 m for a 50 mm wire. A sweep of a fifth of a length, in millimetres, gives this.
_LONGEST_SWEEP = 200.0
# Forces this many times the one at the start, at rest, are loads; a median needs some of them.
_LOADED, _LEAST_LOAD = 20.0, 1e-12
_FEWEST_LOADED = 10
# Lever arms in rod lengths and forces in EI/L²: a contact lies within one length of the clamp, and
# forces of order EI/L² bend a rod visibly. Wrong units are off by factors of ten and more, so the
# first bounds, used to refuse, leave two decades, and the second, used to guess, one.
_POSSIBLE = (1e-2, 5.0), (2e-3, 500.0)
_LIKELY = (0.1, 1.15), (5e-3, 100.0)
# The stated noise at rest may be off by this factor.
_LIKELY_NOISE = 5.0
# Fractions of the largest work, and of the most that the forces could do: less may be friction or
# noise. Fraction of the loaded rows: if more are lost, so is part of the work.
_NEGATIVE, _NOTICEABLE, _LOST = 0.5, 0.02, 0.02
# Rod lengths from the clamp, in total and along its axis: a contact is closer.
_FURTHEST = 1.1
_BEHIND, _FAR = -0.1, 0.3


class Reading(NamedTuple):
    """A recording as the setup describes it, or with the mistake undone that `words` names."""

    words: str
    raw: RawRecording
    sensor: Sensor
    rod: Rod
    channels: tuple[str, ...] = CHANNELS

    def changed(self, words: str, **parts: Float[np.ndarray, "n k"]) -> "Reading":
        """The same with other numbers in the recording."""
        return self._replace(words=words, raw=replace(self.raw, **parts))

    def reactions(self, tare: Tare) -> Reactions | None:
        """Reactions, with the tare taken anew in the same intervals; None if that fails."""
        try:
            again = fitted_tare(self.sensor, self.raw, tare.intervals, tare.found)
        except ValueError:
            return None
        return self.sensor.reactions(self.raw, again)

    def is_plausible(self, tare: Tare, stated: Sensor, noise: float) -> bool:
        """Whether a contact on the rod explains the loads (lever arm and force fit the rod's length
        and stiffness), and the stated noise the scatter at rest, to within a factor of `noise`.
        """
        reactions = self.reactions(tare)
        load = None if reactions is None else arm_and_force(reactions, self.rod)
        if load is None or not _within(load, _LIKELY):
            return False
        if not (stated.noise.known and tare.intervals):
            return True
        wrench = self.raw.wrench[self.raw.during(tare.intervals[0]) & self.raw.whole]
        ratio = np.std(wrench, axis=0) / np.sqrt(stated.noise.variance)
        # A channel without any noise is simulated, and tells nothing about units.
        return bool(np.all((ratio == 0) | (ratio > 1 / noise) & (ratio < noise)))


def _within(values: tuple[float, ...], limits: tuple[tuple[float, float], ...]) -> bool:
    return all(low < value < high for value, (low, high) in zip(values, limits, strict=False))


def pose_unit_faults(raw: RawRecording, rod: Rod) -> Iterator[Fault]:
    """Positions in millimetres, orientations that are not unit quaternions, and quaternions that
    may have w first.
    """
    extent = np.max(np.fmax.reduce(raw.position) - np.fmin.reduce(raw.position))
    if extent > _LONGEST_SWEEP * rod.length:
        guess = " (in mm?)" if extent * 1e-3 < _LONGEST_SWEEP * rod.length else ""
        text = (
            f"positions px,py,pz extend over {extent:.3g} m{guess} with a rod of {rod.length:g} m; "
            "allowed are metres, or position_unit in [recording]"
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
    """Rows with a quaternion whose norm differs from 1 by more than a thousandth."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.abs(np.linalg.norm(orientation, axis=1) - 1) > _QUATERNION_TOLERANCE)


def norm_faults(time: Times, orientation: Quaternions) -> Iterator[Fault]:
    """A finding about these rows, if there are any."""
    wrong = wrong_norms(orientation)
    for first in orientation[wrong][:1]:
        with np.errstate(over="ignore"):
            norm = np.linalg.norm(first)
        guess = ", as if angles in degrees" if norm > 2 else ""
        text = (
            f"qx,qy,qz,qw = {first.tolist()} has the norm {norm:.3g} ({wrong.sum()} such){guess}; "
            "allowed is 1"
        )
        yield Fault.over(("orientation",), FaultKind.UNITS, time[wrong], text, unusable=True)


def wrench_unit_faults(
    raw: RawRecording, reactions: Reactions, rod: Rod, sensor: Sensor, tare: Tare
) -> Iterator[Fault]:
    """Detect units such as millinewtons and newton millimetres: the contact lies on the rod, so the
    lever arm must fit its length, and the force its stiffness.
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
    """Rows with more than twenty times the force at the start; none if fewer than ten."""
    force = np.linalg.norm(reactions.force, axis=-1)
    start = force[np.isfinite(force)]
    start = start[: max(2, len(start) // 50)]
    rest = np.median(start) if len(start) else np.inf
    loaded = force > max(_LOADED * rest, _LEAST_LOAD)
    return loaded & (np.count_nonzero(loaded) >= _FEWEST_LOADED)


def arm_and_force(reactions: Reactions, rod: Rod) -> tuple[float, float] | None:
    """Median lever arm and force of the loaded rows, in rod lengths and EI/L²; None if too few."""
    loaded = loaded_rows(reactions)
    if not loaded.any():
        return None
    force, moment = np.linalg.norm([reactions.force[loaded], reactions.moment[loaded]], axis=2)
    return float(np.median(moment / force)) / rod.length, float(np.median(force)) / rod.force_scale


# Units mistaken for newtons and newton metres, separately and together.
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
    """The recording with each known mistake undone."""
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
    """Findings that only a wrong sign, clamp or reference point explains.

    The clamp's work on a rod that is free at first is the bending energy plus friction losses and
    never negative, and contacts push the rod into its clamp: with the wrong sign of the wrench,
    both are reversed. The line of the contact force passes the clamp within the rod's length, on
    the side towards which the rod points.
    """
    loaded = loaded_rows(reactions)
    if not loaded.any() or reactions.time is None:
        return
    force, moment = reactions.force[loaded], reactions.moment[loaded]
    axis = third_axis(reactions.trail.orientation[loaded])
    # Points on the lines of the contact forces that are closest to the clamp, relative to it.
    points = np.cross(force, moment) / np.sum(force**2, axis=1, keepdims=True)
    push = np.median(np.sum(force * axis, axis=1))
    away = np.median(np.linalg.norm(points, axis=1)) / rod.length
    ahead = np.median(np.sum(points * axis, axis=1)) / rod.length
    found = partial(Fault.over, CHANNELS, FaultKind.MOUNT, reactions.time[loaded])
    done = _work_by_rod(reactions, loaded) if push < 0 else 0.0
    if done:
        yield found(
            f"the rod is pulled from its clamp and does {1e3 * done:.3g} mJ of work on it, while a "
            "rod that is pushed takes up work: this fits a wrench of the other sign; check wrench "
            "in [sensor]"
        )
    if away > _FURTHEST:
        yield found(
            f"the contact forces act along lines {away:.3g} rod lengths from the clamp in the "
            "median, where no rod is: check clamp_position, wrench_point, length, and signs and "
            "axes of forces and torques"
        )
    elif ahead < _BEHIND and away > _FAR:
        yield found(
            f"the contact forces act {-ahead:.3g} rod lengths behind the clamp in the median, "
            "but the rod points the other way: check clamp_orientation, whose +z it follows"
        )


def _work_by_rod(reactions: Reactions, loaded: Rows) -> float:
    """Largest work that the rod has done on its clamp since the first load [J]; 0 if there was as
    much the other way, or little compared with what the forces could do along the whole path.

    Also 0 for a recording that begins under load, or that lacks part of its load.
    """
    wrench, trail = reactions.wrench, reactions.trail
    finite, rows = np.isfinite(wrench).all(axis=1), np.flatnonzero(loaded)
    known, lost = np.flatnonzero(finite), np.count_nonzero(~finite[rows[0] : rows[-1]])
    if known[0] == rows[0] or lost > _LOST * len(rows):
        return 0.0
    path = trail[known].steps
    # Without a load there is only noise.
    wrench = np.where(loaded[:, None], wrench, 0.0)[known]
    work = np.cumsum(np.sum((wrench[1:] + wrench[:-1]) / 2 * path, axis=1))
    loads, ways = np.linalg.norm(np.reshape([wrench[1:], path], (2, -1, 2, 3)), axis=3)
    done = -float(work.min())
    clear = done > max(_NEGATIVE * np.abs(work).max(), _NOTICEABLE * np.sum(loads * ways))
    return done if clear else 0.0
