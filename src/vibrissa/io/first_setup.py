"""A commented setup as text, for a bench that has none yet."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from vibrissa.io.config import NO_TURN
from vibrissa.io.recordings.decide import Decision
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.sensor.sensor import WrenchSign

_MEANS = {
    "on_sensor": "the readings are what the rod does to the sensor",
    "on_rod": "the readings are what holds the rod: the support reaction",
}
_REAL = """\
# What else the rod is, if it matters; lists are along clamp axes, x first.
# kind = "tapered"                # with base_radius and tip_radius [m] in place of radius
# inner_radius = 0.0              # m, of a tube
# density = 7850                  # kg/m³, for its weight
# poisson_ratio = 0.3             # 1, for its twist
# yield_strain = 0.008            # 1
# temperature = 35.0              # °C, with [rod.thermal]
# [rod.rest]                      # its shape without load
# kind = "arc"                    # or polynomial, parabola, points, components
# radius = 0.5                    # m
# roll = 0.0                      # rad, from clamp x towards y: the side to which it bends
# [rod.loads]
# gravity = [0.0, 0.0, -9.81]     # m/s², world axes
# wind = [0.0, 0.0, 0.0]          # m/s, world axes
# [rod.support]                   # a clamp that yields
# kind = "pivot"                  # or compliant: six rows of N/m, N/rad and N, N m/rad
# stiffness = [10.0, 10.0, 10.0]  # N m/rad
# [rod.thermal]
# modulus_slope = -2.8e-4         # 1/K
# expansion = 11.5e-6             # 1/K
# reference = 20.0                # °C, at which the rod is as described
"""
_OBJECT = """

# An object of known shape and place, for `vibrissa calibrate`: a ball is best.
# [object]
# kind = "sphere"
# radius = 0.03                  # m
# center = [0.0, 0.0, 0.0575]    # m, world axes: those of the robot's positions
"""


@dataclass(frozen=True)
class Bench:
    """What is measured at a bench: rod and clamp, SI units, and the sensor's preset, if any."""

    length: float
    radius: float
    youngs_modulus: float
    clamp_position: tuple[float, ...]
    clamp_orientation: tuple[float, ...] = NO_TURN
    preset: str = ""


def setup_text(bench: Bench, wrench: WrenchSign, found: Decision, name: str) -> str:
    """Return the text of a setup that `load_setup` reads.

    Parameters
    ----------
    bench
        As measured.
    wrench
        The sign of the readings.
    found
        What the recording tells: layout, noise at rest, and why the sign is this one.
    name
        Of the recording, for the comments.
    """
    orientation = "quaternion x, y, z, w that turns +z to the rod's direction, in sensor axes"
    lines = [
        f"# A first setup, from {name} and what was measured at the bench. SI units.",
        "[rod]",
        'kind = "cylinder"',
        _line("length", bench.length, "m, free length from clamp to tip"),
        _line("radius", bench.radius, "m, half the diameter"),
        _line("youngs_modulus", bench.youngs_modulus, "Pa"),
        _REAL,
        "[sensor]",
    ]
    if bench.preset:
        lines.append(_line("preset", bench.preset, "range, steps and noise of its data sheet"))
    position = "m, where the rod leaves its clamp, in sensor axes"
    lines += [
        _line("clamp_position", bench.clamp_position, position),
        f"# {orientation}",
        _line("clamp_orientation", bench.clamp_orientation),
        *_sign(wrench, found),
        *_noise(found, name),
        "# The tare is taken where the log is at rest; tare_seconds = 1.0 takes the first second.",
        "",
        *_recording(found.keys),
    ]
    return "\n".join(lines).rstrip() + _OBJECT


def _sign(wrench: WrenchSign, found: Decision) -> list[str]:
    """The sign of the readings, and what speaks for it."""
    lines = [_line("wrench", wrench, _MEANS[wrench])]
    if wrench in found.ratios:
        both = [f"{ratio:.2f} for {sign}" for sign, ratio in found.ratios.items()]
        text = f"# work of the clamp over energy of the rod: {', '.join(both)}; 1 is right"
        lines.insert(0, text)
    return lines


def _noise(found: Decision, name: str) -> list[str]:
    """Noise of readings at rest, unless a data sheet states it, and of the poses."""
    seen = found.inspection
    noise = np.zeros(6) if seen is None else seen.noise
    lines: list[str] = []
    if seen is not None and not seen.sensor.noise.known:
        if not (noise > 0).all():
            return ["# Error bars need force_noise [N] and torque_noise [N m], measured at rest."]
        force, torque = (_rounded(part) for part in np.split(noise, 2))
        lines += [
            _line("force_noise", force, f"N, standard deviation at rest in {name}"),
            _line("torque_noise", torque, "N m"),
        ]
    for key, unit in (("position_noise", "m"), ("orientation_noise", "rad")):
        if seen is not None and (size := getattr(seen.sensor, key)):
            lines.append(_line(key, _rounded([size])[0], f"{unit}, of the poses, about each axis"))
    return lines


def _rounded(numbers: Iterable[float]) -> list[float]:
    """To the two digits to which noise is known."""
    return [float(f"{one:.2g}") for one in numbers]


def _recording(keys: Mapping[str, Any]) -> list[str]:
    """The table [recording], in the order of its keys; without it the usual names hold."""
    ordered = [key for key in RecordingTable.model_fields if key in keys]
    if not ordered:
        return []
    return ["[recording]", *(_line(key, keys[key]) for key in ordered)]


def _line(key: str, value: Any, remark: str = "") -> str:
    """A key of TOML; its strings, numbers and lists are written as in JSON."""
    shown = json.dumps(value, ensure_ascii=False)
    if isinstance(value, float) and float(f"{value:g}") == value:
        shown = f"{value:g}"  # 2e+11 rather than its twelve digits
    text = f"{key} = {shown}"
    return f"{text:24} # {remark}" if remark else text
