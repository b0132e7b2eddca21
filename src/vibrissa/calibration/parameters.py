"""What can be calibrated: names, units, and places in the bench."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from vibrissa.calibration.bench import LOGARITHMIC, Bench, Step
from vibrissa.calibration.form import REST, SUPPORT, TAPER
from vibrissa.geometry.checks import positive
from vibrissa.rod import Rod
from vibrissa.tolerances import Tolerances

STIFFNESS = ("youngs_modulus", "bending_stiffness")
_OF_RADIUS = (STIFFNESS[0], TAPER[1])
_OFFSETS = ("tare", "drift")
_DEFAULT = ("length", "clamp_position", "clamp_orientation", *_OFFSETS)
_STRAIGHT = 1e-9
"""Curvature, relative to the rod's length, below which its direction is nothing."""
_ONE: dict[str, tuple[int, ...]] = {"": (0,)}
_AXES = {f"_{axis}": (entry,) for entry, axis in enumerate("xyz")}
_CHANNELS = {
    f"_{kind}{axis}": (first + entry,)
    for kind, first in (("force", 0), ("torque", 3))
    for axis, (entry,) in _AXES.items()
}
"""Suffixes of a group's parameters, and the entries of each."""


@dataclass(frozen=True)
class Parameter:
    """One number that can be free.

    Attributes
    ----------
    name
        Name of the parameter, with its axis or channel.
    group
        Its name in `free` and `prior`.
    unit
        Unit of its value and standard deviation.
    field, entries
        The numbers of a `Step` that it changes together.
    scale
        A step that would be a gross change, to compare parameters of different units.
    factor, offset
        Its value is the factor times the bench's number, plus the offset.
    """

    name: str
    group: str
    unit: str
    field: str
    entries: tuple[int, ...]
    scale: float
    factor: float
    offset: float = 0.0

    def value(self, numbers: Step) -> float:
        """Its value, from the numbers of a bench."""
        return self.offset + self.factor * float(getattr(numbers, self.field)[self.entries[0]])

    def slope(self, numbers: Step) -> float:
        """Change of the value for a unit step."""
        if self.name == REST[1]:
            # A step is one of the curvature across the direction in which the rod is bent.
            return 1 / max(abs(float(numbers.rest[0])), _STRAIGHT * self.scale)
        return self.value(numbers) if self.field in LOGARITHMIC else self.factor

    def column(self, derivatives: Step) -> Float[np.ndarray, "n 6"]:
        """Its derivatives, from those by the numbers of a step (n, 6, entries)."""
        return np.asarray(getattr(derivatives, self.field)[..., list(self.entries)].sum(axis=-1))


def default_names(rod: Rod) -> tuple[str, ...]:
    """What is free by default."""
    return (STIFFNESS[rod.radius is None], *_DEFAULT)


def _all(rod: Rod) -> list[Parameter]:
    """Every parameter of a bench with this rod, in a fixed order: rod, clamp, object, sensor."""
    length = rod.unit_of("length")
    inertia = rod.second_moment or math.inf
    table = (
        (STIFFNESS[0], "stiffness", "Pa", 1.0, 1 / inertia, _ONE),
        (STIFFNESS[1], "stiffness", "N m2" if rod.units == "SI" else "1", 1.0, 1.0, _ONE),
        ("length", "length", length, 1.0, 1.0, _ONE),
        (TAPER[0], "taper", "1", 1.0, 1.0, _ONE),
        (REST[0], "rest", rod.unit_of("curvature"), 1 / rod.length, 1.0, _ONE),
        (REST[1], "rest", "rad", 1 / rod.length, 1.0, {"": (1,)}),
        (SUPPORT, "support", "N m/rad" if rod.units == "SI" else "1", 1.0, 1.0, _AXES),
        ("clamp_position", "clamp", length, rod.length, 1.0, _AXES),
        ("clamp_orientation", "tilt", "rad", 1.0, 1.0, _AXES),
        ("object_position", "shift", length, rod.length, 1.0, _AXES),
        ("object_orientation", "turn", "rad", 1.0, 1.0, _AXES),
        ("standoff", "standoff", length, rod.length, 1.0, _ONE),
        ("gain", "gain", "1", 1.0, 1.0, _CHANNELS),
        ("force_gain", "gain", "1", 1.0, 1.0, {"": (0, 1, 2)}),
        ("torque_gain", "gain", "1", 1.0, 1.0, {"": (3, 4, 5)}),
    )
    found = [
        Parameter(group + suffix, group, unit, field, entries, scale, factor)
        for group, field, unit, scale, factor, each in table[rod.radius is None :]
        for suffix, entries in each.items()
    ]
    if rod.radius is not None:
        tip = Parameter(TAPER[1], TAPER[1], length, "taper", (0,), 1.0, -rod.radius, rod.radius)
        place = next(at for at, one in enumerate(found) if one.name == TAPER[0])
        found.insert(place + 1, tip)
    return found


def parameters(names: Iterable[str], rod: Rod) -> list[Parameter]:
    """Free parameters of the bench, in a fixed order.

    Raises
    ------
    ValueError
        If a name is unknown, repeated, or conflicts with another.
    """
    wanted, known = list(names), _all(rod)
    allowed = (*dict.fromkeys(one.group for one in known), *_OFFSETS)
    for name in wanted:
        if name not in allowed:
            needs = f" ({name} needs the rod's radius)" if name in _OF_RADIUS else ""
            raise ValueError(
                f"free: {name!r} is no parameter; allowed are {', '.join(allowed)}{needs}"
            )
        if wanted.count(name) > 1:
            raise ValueError(f"free: {name!r} is given twice; allowed is each once")
    found = [one for one in known if one.group in wanted]
    for one, other in combinations(found, 2):
        if one.field == other.field and set(one.entries) & set(other.entries):
            raise ValueError(
                f"free: {one.group!r} and {other.group!r} are the same parameters; "
                "allowed is one of them"
            )
    if not found:
        raise ValueError(
            f"free = {wanted}: no parameter of rod, clamp, sensor or object; "
            f"allowed are {', '.join(allowed)}"
        )
    return found


def checked_prior(prior: Mapping[str, float] | None, names: Iterable[str]) -> dict[str, float]:
    """Standard deviations by name.

    Raises
    ------
    ValueError
        If a name is not free, or a deviation not positive.
    """
    wanted = [name for name in names if name not in _OFFSETS]
    for name, deviation in (prior or {}).items():
        if name not in wanted:
            raise ValueError(
                f"prior: {name!r} is not a free parameter of the bench; "
                f"allowed are {', '.join(wanted)}"
            )
        positive(deviation, f"prior[{name!r}]")
    return dict(prior or {})


def uncertain(rod: Rod, tolerances: Tolerances) -> dict[Parameter, float]:
    """Parameters with a tolerance, and that tolerance as a step of each."""
    deviations = {
        STIFFNESS[rod.radius is None]: np.hypot(tolerances.youngs_modulus, 4 * tolerances.radius),
        "length": tolerances.length / rod.length,
        "clamp_position": tolerances.clamp_position,
        "clamp_orientation": tolerances.clamp_orientation,
        "gain": tolerances.gain,
        "object_position": tolerances.object_position,
    }
    return {
        one: size
        for group, deviation in deviations.items()
        for one in _all(rod)
        if one.group == group and (size := float(np.ravel(deviation)[one.entries[0]])) > 0
    }


def stepped(free: list[Parameter], values: Float[np.ndarray, "parameters"], bench: Bench) -> Step:
    """Steps of parameters, as one step of the bench."""
    step = Step(*map(np.copy, bench.no_step))
    for one, value in zip(free, values, strict=True):
        getattr(step, one.field)[list(one.entries)] += value
    return step
