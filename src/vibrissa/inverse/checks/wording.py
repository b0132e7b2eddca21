"""Findings as sentences."""

import math

import numpy as np

from vibrissa.inverse.checks.constraints import COUPLE, TANGENT, TIP, TORSION

_AXES = ("x", "y", "z")
_CLOSE = 0.3
"""Share of the largest component from which others of a vector are told."""


def observed(row: int, size: float, length: float, unit: str) -> str:
    """What a constraint shows; `size` in its own units."""
    match row:
        case 0:  # COUPLE
            return "force and moment belong to no single contact (m0·f0 is not 0)"
        case 1:  # TORSION
            return "the moment along the rod is not 0"
        case 2:  # TIP
            return f"s₁ in tip contact is {_length(abs(size) * length, unit)} too {'long' if size < 0 else 'short'}"
    return f"in tangential contact k² is {(1 + size) / 2:.3f} instead of ½"


assert (COUPLE, TORSION, TIP, TANGENT) == (0, 1, 2, 3)


def named(name: str, estimate: tuple[float, ...], rod_length: float, unit: str) -> str:
    """A cause as a clause, with its size; lengths in the rod's unit."""
    first = estimate[0]
    match name:
        case "bending_stiffness":
            return f"bending stiffness (EI) {_share(first)} {_more(first)}"
        case "length":
            return f"length {_length(abs(first), unit)} {'longer' if first > 0 else 'shorter'}"
        case "clamp_position":
            return f"clamp shifted by {_vector([(value, _length(abs(value), unit)) for value in estimate])} of its axes"
        case "clamp_orientation":
            return f"clamp turned by {_vector([(value, f'{math.degrees(abs(value)):.2g}°') for value in estimate], ' about ')} of its axes"
        case "gain":
            return f"all channels read {_share(first)} too {_much(first)}"
        case "force_gain":
            return f"forces read {_share(first)} too {_much(first)}"
        case "torque_gain":
            return f"torques read {_share(first)} too {_much(first)}"
        case "taper":
            return f"a taper, the radius {_share(first)} {_more(-first)} at the tip"
        case "rest_curvature":
            sagitta = [value * rod_length**2 / 8 for value in estimate]
            return f"a rod that is not straight, sagitta {_vector([(value, _length(abs(value), unit)) for value in sagitta])} of the clamp's axes"
        case "load":
            load = float(np.linalg.norm(estimate))
            return f"a load along the rod such as its own weight, {load:.2g} {'N/m' if unit == 'm' else 'EI/L³'} towards {_direction(estimate)}"
        case "pose_delay":
            return f"poses {abs(first) * 1e3:.2g} ms {'late' if first > 0 else 'early'}"
    kind, _, channel = name.partition("_")
    force = channel.startswith("f")
    if kind == "gain":
        return f"{channel} reads {_share(first)} too {_much(first)}"
    size = (
        f"{abs(first) * 1e3:.2g} {'mN' if force else 'N mm'}"
        if unit == "m"
        else f"{abs(first):.2g}"
    )
    return (
        f"the zero of {channel} drifts by {'-' if first < 0 else ''}{size}/s"
        if kind == "drift"
        else f"the zero of {channel} is off by {'-' if first < 0 else ''}{size}"
    )


def _share(value: float) -> str:
    return f"{100 * abs(value):.2g} %"


def _more(value: float) -> str:
    return "higher" if value > 0 else "lower"


def _much(value: float) -> str:
    return "much" if value > 0 else "little"


def _length(value: float, unit: str) -> str:
    return f"{value * 1e3:.2g} mm" if unit == "m" else f"{value:.2g} L"


def _vector(parts: list[tuple[float, str]], along: str = " along ") -> str:
    largest = max(abs(value) for value, _ in parts)
    shown = [
        f"{text}{along}{'-' if value < 0 else ''}{axis}"
        for (value, text), axis in zip(parts, _AXES, strict=False)
        if abs(value) >= _CLOSE * largest
    ]
    return " and ".join(shown)


def _direction(vector: tuple[float, ...]) -> str:
    unit = np.asarray(vector) / max(float(np.linalg.norm(vector)), 1e-300)
    return "(" + ", ".join(f"{part + 0.0:.1f}" for part in np.round(unit, 1)) + ") of the world"


def delay_told(seconds: float, deviation: float, shift: float, unit: str) -> str:
    """Of poses that come late, by passes to and fro that disagree by twice their shift."""
    late = "late" if seconds > 0 else "early"
    return (
        f"passes to and fro over the same places are {_length(2 * shift, unit)} apart, {abs(seconds) / deviation:.0f} standard deviations: "
        f"likely poses {abs(seconds) * 1e3:.2g} ± {deviation * 1e3:.1g} ms {late}; contacts are then off by {_length(shift, unit)} in the median"
    )
