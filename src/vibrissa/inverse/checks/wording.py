"""Findings of a sweep, in one line each."""

import math

import numpy as np

from vibrissa.inverse.arrays import Flags
from vibrissa.inverse.checks.case import Misfit, Numbers
from vibrissa.inverse.checks.constraints import TANGENT, TIP
from vibrissa.inverse.checks.findings import Cause, length_text
from vibrissa.inverse.checks.rig import SUSPECTS
from vibrissa.inverse.checks.weighing import MATTERS, Weighed
from vibrissa.inverse.result import Reconstruction
from vibrissa.numerics.runs import runs
from vibrissa.rod import Rod

_SHOWN = 4
"""Causes per line; more would not help."""
_CLOSE = 0.3
"""Fraction of the largest component from which other components of a vector are named."""
_SIGNED = {
    "bending_stiffness": ("bending stiffness (EI) {size} {way}", "higher", "lower"),
    "length": ("length {size} {way}", "longer", "shorter"),
    "taper": ("a taper, the radius {size} {way} at the tip", "lower", "higher"),
    "pose_delay": ("poses {size} {way}", "late", "early"),
    "gain": ("all channels read {size} too {way}", "much", "little"),
    "force_gain": ("forces read {size} too {way}", "much", "little"),
    "torque_gain": ("torques read {size} too {way}", "much", "little"),
    "gain_": ("{channel} reads {size} too {way}", "much", "little"),
    "drift_": ("the zero of {channel} drifts by {way}{size}/s", "", "-"),
    "zero_": ("the zero of {channel} is off by {way}{size}", "", "-"),
}
"""Causes with one number: the clause, and `way` for a positive and for a negative one."""
_VECTORS = {
    "clamp_position": ("clamp shifted by {} of its axes", " along "),
    "clamp_orientation": ("clamp turned by {} of its axes", " about "),
    "rest_curvature": ("a rod that is not straight, sagitta {} of the clamp's axes", " along "),
}
"""Causes with several: the clause, and the word before the axis of each number."""


def unit_of(rod: Rod, name: str) -> tuple[str, float]:
    """Unit of a cause's numbers, and the factor to it from model units."""
    kind, _, channel = name.partition("_")
    if kind in ("drift", "zero"):
        force = channel.startswith("f")
        unit = rod.unit_of("force" if force else "moment") + "/s" * (kind == "drift")
        return unit, rod.force_scale if force else rod.moment_scale
    length = rod.unit_of("length"), rod.length
    return {
        "length": length,
        "clamp_position": length,
        "clamp_orientation": ("rad", 1.0),
        "rest_curvature": (rod.unit_of("curvature"), 1 / rod.length),
        "load": ("N/m" if rod.units == "SI" else "1", rod.force_scale / rod.length),
    }.get(name, ("1", 1.0))


def apart_line(found: Reconstruction, misfit: Misfit, rows: Flags) -> str:
    """Line on rows that contradict the rest of the sweep."""
    time = found.reactions.time
    assert time is not None
    when = " and ".join(
        f"from {time[start]:.4g} to {time[stop - 1]:.4g} s" for start, stop in runs(rows)
    )
    return (
        f"{when} force and moment are those of no single contact, by up to "
        f"{np.abs(misfit.alone).max():.0f} standard deviations, while the rest agrees with the "
        "setup: the rod touches two places there, or its tip is caught"
    )


def causes_line(rod: Rod, here: Weighed) -> str:
    """Line on causes that explain about the same: what is seen, how surely, and how far they would
    move contacts.
    """
    case, best, together = here.case, here.tried[0], here.alike
    signal = np.abs(case.slopes.constraints @ SUSPECTS[best.name] @ best.size) / case.deviations
    signal[~here.tip, TIP], signal[here.tip, TANGENT] = 0.0, 0.0
    seen = _seen(rod, here, int(np.argmax(np.sum(signal**2, axis=0))))
    order = sorted(together[:_SHOWN], key=lambda one: list(SUSPECTS).index(one.name))
    causes = [_named(rod, one.name, unit_of(rod, one.name)[1] * one.size) for one in order]
    share, place = 0.5, "in the median"
    if max(one.shift(share) for one in together) < MATTERS:
        share, place = 0.8, "in a fifth of the sweep"
    shift = max(one.shift(share) for one in together)
    return (
        f"{seen}, {np.sqrt(best.explained):.0f} standard deviations: likely "
        f"{', or '.join(causes)}; contacts are then off by {length_text(shift * rod.length, rod)} "
        f"{place}"
    )


def unexplained_line(rod: Rod, here: Weighed) -> str:
    """Line on a misfit that no cause explains."""
    case, misfit = here.case, here.misfit
    value = np.abs(case.here.value) / case.deviations * misfit.told
    row = int(np.argmax(np.max(value, axis=0)))
    return (
        f"{_seen(rod, here, row)}, {math.sqrt(misfit.square):.0f} standard "
        "deviations: no single cause explains it; check the units, signs and axes of wrench and "
        "poses, the sensor's calibration, and the rod's length and stiffness"
    )


def delay_told(rod: Rod, delay: Cause) -> str:
    """Line on late poses, from back-and-forth passes that disagree by twice their shift."""
    deviation = f"{delay.deviation[0] * 1e3:.1g} ms"
    late = _named(rod, delay.name, np.array(delay.estimate)).replace(" ms", f" ± {deviation}")
    return (
        f"passes to and fro over the same places are {length_text(2 * delay.shift, rod)} apart, "
        f"{delay.significance:.0f} standard deviations: likely {late}; contacts are then off by "
        f"{length_text(delay.shift, rod)} in the median"
    )


def _seen(rod: Rod, weighed: Weighed, row: int) -> str:
    here, tip = weighed.case.here, weighed.tip
    of_row = {TIP: tip, TANGENT: ~tip}.get(row, slice(None))
    size = here.value[of_row, row] / (here.steepness[of_row] if row == TIP else 1.0)
    middle = float(np.median(size))
    return (
        "force and moment belong to no single contact (m0·f0 is not 0)",
        "the moment along the rod is not 0",
        f"s₁ in tip contact is {length_text(middle * rod.length, rod)} too "
        f"{'long' if middle < 0 else 'short'}",
        f"in tangential contact k² is {(1 + middle) / 2:.3f} instead of ½",
    )[row]


def _named(rod: Rod, name: str, estimate: Numbers) -> str:
    """A cause as a clause, with its size; lengths in the rod's unit."""
    if name == "load":
        size = float(np.linalg.norm(estimate))
        unit = "N/m" if rod.units == "SI" else "EI/L³"
        parts = np.round(estimate / max(size, 1e-300), 1) + 0.0
        return (
            f"a load along the rod such as its own weight, {size:.2g} {unit} towards "
            f"({', '.join(f'{part:.1f}' for part in parts)}) of the world"
        )
    if name in _VECTORS:
        clause, along = _VECTORS[name]
        told = " and ".join(
            f"{_size(rod, name, value)}{along}{'-' if value < 0 else ''}{axis}"
            for value, axis in zip(estimate, "xyz", strict=False)
            if abs(value) >= _CLOSE * np.abs(estimate).max()
        )
        return clause.format(told)
    kind, _, channel = name.partition("_")
    clause, more, less = _SIGNED[name if name in _SIGNED else f"{kind}_"]
    (value,) = estimate
    return clause.format(
        size=_size(rod, name, value), way=more if value > 0 else less, channel=channel
    )


def _size(rod: Rod, name: str, value: float) -> str:
    """One number of a cause without its sign."""
    kind, size = name.partition("_")[0], abs(value)
    thousandths = f"{1e3 * size:.2g}"
    if kind in ("drift", "zero"):
        unit = "mN" if name.startswith(f"{kind}_f") else "N mm"
        return f"{thousandths} {unit}" if rod.units == "SI" else f"{size:.2g}"
    if name == "pose_delay":
        return f"{thousandths} ms"
    if name == "clamp_orientation":
        return f"{math.degrees(size):.2g}°"
    if name == "rest_curvature":
        return length_text(size * rod.length**2 / 8, rod)
    if name in ("length", "clamp_position"):
        return length_text(size, rod)
    return f"{100 * size:.2g} %"
