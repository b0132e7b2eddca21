"""Unit mistakes: numbers that cannot be in metres, newtons and newton metres, or poses that cannot be unit quaternions x, y, z, w."""

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.raw import RawRecording

_QUATERNION_TOLERANCE = 1e-3
_LONGEST_SWEEP = 200.0
_LOADED = 20.0
_FEWEST_LOADED = 10
_SHORTEST_ARM = 1e-2
_LONGEST_ARM = 5.0
_LARGEST_FORCE = 500.0


def pose_unit_faults(raw: RawRecording, rod: Rod) -> list[Fault]:
    """Positions in millimetres, orientations that are no unit quaternions, and quaternions that may have been written w first."""
    faults = []
    stamps = raw.time[np.isfinite(raw.time)]
    span = (float(stamps[0]), float(stamps[-1]), len(raw.time))
    position = raw.position[np.isfinite(raw.position).all(axis=1)]
    extent = float(np.ptp(position, axis=0).max(initial=0.0)) if len(position) else 0.0
    if extent > _LONGEST_SWEEP * rod.length:
        text = f"px,py,pz extend over {extent:.3g} with a rod of {rod.length:g} m; allowed are metres"
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
        faults.append(Fault(FaultKind.UNITS, ("orientation",), float(time[0]), float(time[-1]), count, text, unusable=True))
    elif len(orientation) and np.all(orientation[:, 0] == 1):
        text = "qx = 1 throughout: half a turn about x, or quaternions written w first; allowed are x, y, z, w"
        faults.append(Fault(FaultKind.UNITS, ("orientation",), *span, text))
    return faults


def wrong_norms(orientation: Float[np.ndarray, "n 4"]) -> Bool[np.ndarray, "n"]:
    """Rows whose quaternion is there, and differs from the norm 1 by more than a thousandth."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.abs(np.linalg.norm(orientation, axis=1) - 1) > _QUATERNION_TOLERANCE)


def wrench_unit_faults(raw: RawRecording, reactions: Reactions, rod: Rod) -> list[Fault]:
    """Tell millinewtons and newton millimetres from SI: the contact lies on the rod, so the lever arm is of its length, and the force of its stiffness."""
    force, moment = (np.linalg.norm(part, axis=1) for part in (reactions.force, reactions.moment))
    span = (float(raw.time[0]), float(raw.time[-1]))
    finite = force[np.isfinite(force)]
    if not len(finite):
        return []
    rest = float(np.median(finite[: max(2, len(finite) // 50)]))
    loaded = force > max(_LOADED * rest, 1e-12)
    count = int(np.count_nonzero(loaded))
    if count < _FEWEST_LOADED:
        return []
    arm = float(np.median(moment[loaded] / force[loaded])) / rod.length
    typical = float(np.median(force[loaded])) / rod.force_scale
    if not _SHORTEST_ARM < arm < _LONGEST_ARM:
        channels, guess = _mis_scaled(arm, typical)
        text = f"torque over force is {arm:.3g} rod lengths in the median, so tx,ty,tz or fx,fy,fz are mis-scaled{guess}; allowed are N and N m"
        return [Fault(FaultKind.UNITS, channels, *span, count, text, unusable=True)]
    if typical > _LARGEST_FORCE or typical < 1 / _LARGEST_FORCE:
        text = f"force is {typical:.3g} EI/L² in the median of the loaded samples, so wrench or rod are mis-scaled; allowed are N, m, Pa"
        return [Fault(FaultKind.UNITS, ("fx", "fy", "fz", "tx", "ty", "tz"), *span, count, text, unusable=True)]
    return []


def _mis_scaled(arm: float, typical: float) -> tuple[tuple[str, ...], str]:
    """Which of forces and torques do not fit the rod, and the unit that explains it."""
    forces, torques = ("fx", "fy", "fz"), ("tx", "ty", "tz")
    if arm <= _SHORTEST_ARM:
        return (forces, " (forces in mN?)") if typical > 1 else (torques, "")
    return (torques, " (torques in N mm?)") if typical > 1 / _LARGEST_FORCE else (forces, " (forces in kN?)")
