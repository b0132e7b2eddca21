"""Findings of a sweep, each as one line."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label

from vibrissa.inverse.checks.case import Case
from vibrissa.inverse.checks.constraints import TANGENT, TIP, Constraints
from vibrissa.inverse.checks.regression import Misfit, Phases, picked
from vibrissa.inverse.checks.suspects import SUSPECTS, Tried
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


def unit_of(rod: Rod, name: str) -> tuple[str, float]:
    """Unit of a cause's numbers, and what takes them there from model units."""
    force = name[-2] == "f"
    reading = rod.unit_of("force" if force else "moment")
    scale = rod.force_scale if force else rod.moment_scale
    length = rod.unit_of("length"), rod.length
    return {
        "length": length,
        "clamp_position": length,
        "clamp_orientation": ("rad", 1.0),
        "rest_curvature": (rod.unit_of("curvature"), 1 / rod.length),
        "load": ("N/m" if rod.units == "SI" else "1", rod.force_scale / rod.length),
        "drift": (f"{reading}/s", scale),
        "zero": (reading, scale),
    }.get(
        name if name[:5] not in ("drift", "zero_") else name.split("_", maxsplit=1)[0], ("1", 1.0)
    )


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
    signal = np.abs(case.along(best.suspect.directions).slope @ best.size) / case.deviations
    signal[~tip, TIP], signal[tip, TANGENT] = 0.0, 0.0
    seen = _seen(rod, case.here, tip, int(np.argmax(np.sum(signal**2, axis=0))))
    order = sorted(together, key=lambda one: SUSPECTS.index(one.suspect))[:_SHOWN]
    causes = [
        _named(rod, one.suspect.name, unit_of(rod, one.suspect.name)[1] * one.size) for one in order
    ]
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
        f"{_seen(found.rod, case.here, tip, row)}, {math.sqrt(misfit.square):.0f} standard "
        "deviations: no single cause explains it; check the units, signs and axes of wrench and "
        "poses, the sensor's calibration, and the rod's length and stiffness"
    )


def delay_told(rod: Rod, seconds: float, deviation: float, shift: float) -> str:
    """Of poses that come late, by passes to and fro that disagree by twice their shift."""
    return (
        f"passes to and fro over the same places are {_length(rod, 2 * shift)} apart, "
        f"{abs(seconds) / deviation:.0f} standard deviations: likely poses "
        f"{abs(seconds) * 1e3:.2g} ± {deviation * 1e3:.1g} ms {'late' if seconds > 0 else 'early'}"
        f"; contacts are then off by {_length(rod, shift)} in the median"
    )


def _seen(rod: Rod, here: Constraints, tip: Phases, row: int) -> str:
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


def _named(rod: Rod, name: str, estimate: Float[np.ndarray, "p"]) -> str:
    """A cause as a clause, with its size; lengths in the rod's unit."""
    lengths = [_length(rod, value) for value in estimate]
    if name == "clamp_position":
        return f"clamp shifted by {_vector(estimate, lengths)} of its axes"
    if name == "clamp_orientation":
        angles = [f"{math.degrees(abs(value)):.2g}°" for value in estimate]
        return f"clamp turned by {_vector(estimate, angles, ' about ')} of its axes"
    if name == "rest_curvature":
        sagitta = [_length(rod, value * rod.length**2 / 8) for value in estimate]
        return (
            f"a rod that is not straight, sagitta {_vector(estimate, sagitta)} of the clamp's axes"
        )
    if name == "load":
        size = float(np.linalg.norm(estimate))
        unit = "N/m" if rod.units == "SI" else "EI/L³"
        towards = ", ".join(
            f"{part + 0.0:.1f}" for part in np.round(estimate / max(size, 1e-300), 1)
        )
        return (
            f"a load along the rod such as its own weight, {size:.2g} {unit} towards ({towards}) "
            "of the world"
        )
    kind, _, channel = name.partition("_")
    clause, more, less = _SIGNED[name if name in _SIGNED else f"{kind}_"]
    first = float(estimate[0])
    thousandths = f"{abs(first) * 1e3:.2g}"
    unit = "mN" if channel.startswith("f") else "N mm"
    return clause.format(
        way=more if first > 0 else less,
        share=f"{100 * abs(first):.2g} %",
        size=lengths[0],
        milliseconds=f"{thousandths} ms",
        channel=channel,
        load=f"{thousandths} {unit}" if rod.units == "SI" else f"{abs(first):.2g}",
    )


def _length(rod: Rod, value: float) -> str:
    return f"{abs(value) * 1e3:.2g} mm" if rod.units == "SI" else f"{abs(value):.2g} L"


def _vector(values: Float[np.ndarray, "p"], texts: list[str], along: str = " along ") -> str:
    largest = np.abs(values).max()
    return " and ".join(
        f"{text}{along}{'-' if value < 0 else ''}{axis}"
        for value, text, axis in zip(values, texts, "xyz", strict=False)
        if abs(value) >= _CLOSE * largest
    )
