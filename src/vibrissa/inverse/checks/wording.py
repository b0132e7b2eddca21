"""Findings of a sweep, each as one line."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import label

from vibrissa.inverse.checks.case import Case, Misfit, Numbers, Phases, Tried, picked
from vibrissa.inverse.checks.constraints import TANGENT, TIP
from vibrissa.inverse.checks.findings import Cause
from vibrissa.inverse.checks.rig import SUSPECTS
from vibrissa.inverse.result import Reconstruction
from vibrissa.rod import Rod

MATTERS = 1e-3
"""Shift of the contacts [L], in a fifth of the sweep, below which a cause does not matter: 50 µm on
50 mm, as smoothed error bars have it.
"""
_SHOWN = 4
"""Causes in a line; more is no help."""
_CLOSE = 0.3
"""Share of the largest component from which others of a vector are told."""
_SIGNED = {
    "bending_stiffness": ("bending stiffness (EI) {share} {way}", "higher", "lower"),
    "length": ("length {size} {way}", "longer", "shorter"),
    "taper": ("a taper, the radius {share} {way} at the tip", "lower", "higher"),
    "pose_delay": ("poses {milliseconds} {way}", "late", "early"),
    "gain": ("all channels read {share} too {way}", "much", "little"),
    "force_gain": ("forces read {share} too {way}", "much", "little"),
    "torque_gain": ("torques read {share} too {way}", "much", "little"),
    "gain_": ("{channel} reads {share} too {way}", "much", "little"),
    "drift_": ("the zero of {channel} drifts by {way}{load}/s", "", "-"),
    "zero_": ("the zero of {channel} is off by {way}{load}", "", "-"),
}
"""Causes of one number: the clause, and `way` where it is positive and where it is negative."""
_VECTORS = {
    "clamp_position": ("clamp shifted by {} of its axes", " along "),
    "clamp_orientation": ("clamp turned by {} of its axes", " about "),
    "rest_curvature": ("a rod that is not straight, sagitta {} of the clamp's axes", " along "),
}
"""Causes of several: the clause, and what leads to the axis of each number."""


def unit_of(rod: Rod, name: str) -> tuple[str, float]:
    """Unit of a cause's numbers, and what takes them there from model units."""
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


def apart_line(found: Reconstruction, misfit: Misfit, rows: Bool[np.ndarray, "n"]) -> str:
    """On rows that contradict the rest of the sweep."""
    time = found.reactions.time
    assert time is not None
    runs, count = label(rows)
    spans = [time[runs == run] for run in range(1, count + 1)]
    when = " and ".join(f"from {own[0]:.4g} to {own[-1]:.4g} s" for own in spans)
    return (
        f"{when} force and moment are those of no single contact, by up to "
        f"{np.abs(misfit.alone).max():.0f} standard deviations, while the rest agrees with the "
        "setup: the rod touches two places there, or its tip is caught"
    )


def causes_line(found: Reconstruction, case: Case, tip: Phases, together: Sequence[Tried]) -> str:
    """On causes that explain about the same: what is seen, how surely, and by how much each would
    move contacts.
    """
    best, rod = together[0], found.rod
    signal = np.abs(case.along(SUSPECTS[best.name]).slope @ best.size) / case.deviations
    signal[~tip, TIP], signal[tip, TANGENT] = 0.0, 0.0
    seen = _seen(rod, case, tip, int(np.argmax(np.sum(signal**2, axis=0))))
    order = sorted(together, key=lambda one: list(SUSPECTS).index(one.name))[:_SHOWN]
    causes = [_named(rod, one.name, unit_of(rod, one.name)[1] * one.size) for one in order]
    shift, place = max(one.shift for one in together), "in the median"
    if shift < MATTERS:
        shift, place = max(one.largest for one in together), "in a fifth of the sweep"
    return (
        f"{seen}, {np.sqrt(best.explained):.0f} standard deviations: likely "
        f"{', or '.join(causes)}; contacts are then off by {_length(rod, shift * rod.length)} "
        f"{place}"
    )


def unexplained_line(found: Reconstruction, case: Case, tip: Phases, misfit: Misfit) -> str:
    """On a misfit that no cause explains."""
    value = picked(np.abs(case.here.value) / case.deviations, misfit.pick) * misfit.told
    row = int(misfit.pick[np.unravel_index(np.argmax(value), value.shape)])
    return (
        f"{_seen(found.rod, case, tip, row)}, {math.sqrt(misfit.square):.0f} standard "
        "deviations: no single cause explains it; check the units, signs and axes of wrench and "
        "poses, the sensor's calibration, and the rod's length and stiffness"
    )


def delay_told(rod: Rod, delay: Cause) -> str:
    """Of poses that come late, by passes to and fro that disagree by twice their shift."""
    deviation = f"{delay.deviation[0] * 1e3:.1g} ms"
    late = _named(rod, delay.name, np.array(delay.estimate)).replace(" ms", f" ± {deviation}")
    return (
        f"passes to and fro over the same places are {_length(rod, 2 * delay.shift)} apart, "
        f"{delay.significance:.0f} standard deviations: likely {late}; contacts are then off by "
        f"{_length(rod, delay.shift)} in the median"
    )


def _seen(rod: Rod, case: Case, tip: Phases, row: int) -> str:
    here = case.here
    of_row = tip if row == TIP else ~tip if row == TANGENT else np.ones_like(tip)
    size = here.value[of_row, row] / (here.steepness[of_row] if row == TIP else 1.0)
    middle = float(np.median(size))
    off = _length(rod, middle * rod.length)
    return (
        "force and moment belong to no single contact (m0·f0 is not 0)",
        "the moment along the rod is not 0",
        f"s₁ in tip contact is {off} too {'long' if middle < 0 else 'short'}",
        f"in tangential contact k² is {(1 + middle) / 2:.3f} instead of ½",
    )[row]


def _named(rod: Rod, name: str, estimate: Numbers) -> str:
    """A cause as a clause, with its size; lengths in the rod's unit."""
    first = float(estimate[0])
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
        texts = [
            f"{math.degrees(abs(value)):.2g}°"
            if name == "clamp_orientation"
            else _length(rod, value * (rod.length**2 / 8 if name == "rest_curvature" else 1.0))
            for value in estimate
        ]
        told = " and ".join(
            f"{text}{along}{'-' if value < 0 else ''}{axis}"
            for value, text, axis in zip(estimate, texts, "xyz", strict=False)
            if abs(value) >= _CLOSE * np.abs(estimate).max()
        )
        return clause.format(told)
    kind, _, channel = name.partition("_")
    clause, more, less = _SIGNED[name if name in _SIGNED else f"{kind}_"]
    thousandths = f"{abs(first) * 1e3:.2g}"
    unit = "mN" if channel.startswith("f") else "N mm"
    return clause.format(
        way=more if first > 0 else less,
        share=f"{100 * abs(first):.2g} %",
        size=_length(rod, first),
        milliseconds=f"{thousandths} ms",
        channel=channel,
        load=f"{thousandths} {unit}" if rod.units == "SI" else f"{abs(first):.2g}",
    )


def _length(rod: Rod, value: float) -> str:
    return f"{abs(value) * 1e3:.2g} mm" if rod.units == "SI" else f"{abs(value):.2g} L"
