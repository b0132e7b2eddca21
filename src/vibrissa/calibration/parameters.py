"""What can be calibrated: names, units, and where it stands in the bench."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vibrissa.calibration.bench import LOGARITHMIC, NO_STEP, Step
from vibrissa.geometry.checks import positive
from vibrissa.rod import Rod
from vibrissa.tolerances import Tolerances

STIFFNESS = ("youngs_modulus", "bending_stiffness")
_OFFSETS = ("tare", "drift")
_DEFAULT = ("length", "clamp_position", "clamp_orientation", *_OFFSETS)
_AXES = ("x", "y", "z")
_CHANNELS = tuple(f"{kind}_{axis}" for kind in ("force", "torque") for axis in _AXES)
_SAME = ((STIFFNESS[0], STIFFNESS[1:]), ("gain", ("force_gain", "torque_gain")))
"""Groups that are the same parameters as others."""


@dataclass(frozen=True)
class Parameter:
    """One number that can be free.

    Attributes
    ----------
    name
        Of the parameter, with its axis or channel.
    group
        The name under which `free` and `prior` know it.
    unit
        Of its value and its standard deviation.
    field, entries
        The numbers of a `Step` that it changes together.
    scale
        A step that would be a gross change: by what parameters of different units are compared.
    factor
        Its value over the bench's number.
    """

    name: str
    group: str
    unit: str
    field: str
    entries: tuple[int, ...]
    scale: float
    factor: float

    def value(self, numbers: Step) -> float:
        """Among the numbers of a bench."""
        return self.factor * float(getattr(numbers, self.field)[self.entries[0]])

    def slope(self, numbers: Step) -> float:
        """Change of the value for a unit step."""
        return self.value(numbers) if self.field in LOGARITHMIC else 1.0

    def column(self, derivatives: Step) -> Float[np.ndarray, "n 6"]:
        """Of derivatives by the numbers of a step (n, 6, entries)."""
        return np.asarray(getattr(derivatives, self.field)[..., list(self.entries)].sum(axis=-1))


def default_names(rod: Rod) -> tuple[str, ...]:
    """What is free unless stated."""
    return (STIFFNESS[rod.radius is None], *_DEFAULT)


def _all(rod: Rod) -> list[Parameter]:
    """Every parameter of a bench with this rod, in a fixed order: rod, clamp, object, sensor."""
    unit, each = rod.unit_of("length"), ((0,), (1,), (2,))
    inertia = None if rod.radius is None else math.pi / 4 * rod.radius**4
    table = (
        *([(STIFFNESS[0], "stiffness", "Pa", 1.0, ((0,),))] if inertia else []),
        (STIFFNESS[1], "stiffness", "N m2" if rod.units == "SI" else "1", 1.0, ((0,),)),
        ("length", "length", unit, 1.0, ((0,),)),
        ("clamp_position", "clamp", unit, rod.length, each),
        ("clamp_orientation", "tilt", "rad", 1.0, each),
        ("object_position", "shift", unit, rod.length, each),
        ("object_orientation", "turn", "rad", 1.0, each),
        ("standoff", "standoff", unit, rod.length, ((0,),)),
        ("gain", "gain", "1", 1.0, tuple((channel,) for channel in range(6))),
        ("force_gain", "gain", "1", 1.0, ((0, 1, 2),)),
        ("torque_gain", "gain", "1", 1.0, ((3, 4, 5),)),
    )
    suffixes = {
        1: ("",),
        3: tuple(f"_{axis}" for axis in _AXES),
        6: tuple(f"_{one}" for one in _CHANNELS),
    }
    return [
        Parameter(
            group + suffix,
            group,
            unit_of,
            field,
            entries,
            scale,
            1 / inertia if inertia and group == STIFFNESS[0] else 1.0,
        )
        for group, field, unit_of, scale, rows in table
        for suffix, entries in zip(suffixes[len(rows)], rows, strict=True)
    ]


def parameters(names: Iterable[str], rod: Rod) -> list[Parameter]:
    """Free parameters of the bench, in a fixed order.

    Raises
    ------
    ValueError
        If a name is unknown, twice, or contradicts another.
    """
    wanted, known = list(names), _all(rod)
    allowed = (*dict.fromkeys(one.group for one in known), *_OFFSETS)
    for name in wanted:
        if name not in allowed:
            needs = " (youngs_modulus needs the rod's radius)" if name == STIFFNESS[0] else ""
            raise ValueError(
                f"free: {name!r} is no parameter; allowed are {', '.join(allowed)}{needs}"
            )
        if wanted.count(name) > 1:
            raise ValueError(f"free: {name!r} is given twice; allowed is each once")
    for first, others in _SAME:
        clash = [name for name in others if name in wanted]
        if first in wanted and clash:
            raise ValueError(
                f"free: {first!r} and {clash[0]!r} are the same parameters; allowed is one of them"
            )
    found = [one for one in known if one.group in wanted]
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
    """Parameters with a tolerance, and this in their steps."""
    deviations = {
        STIFFNESS[rod.radius is None]: np.hypot(tolerances.youngs_modulus, 4 * tolerances.radius),
        "length": tolerances.length / rod.length,
        "clamp_position": tolerances.clamp_position,
        "clamp_orientation": tolerances.clamp_orientation,
        "gain": tolerances.gain,
        "object_position": tolerances.object_position,
    }
    each = {
        one: float(np.atleast_1d(deviations[one.group])[one.entries[0]])
        for group in deviations
        for one in _all(rod)
        if one.group == group
    }
    return {one: deviation for one, deviation in each.items() if deviation > 0}


def stepped(free: list[Parameter], values: Float[np.ndarray, "parameters"]) -> Step:
    """Steps of parameters as one of the bench."""
    step = Step(*(part.copy() for part in NO_STEP))
    for one, value in zip(free, values, strict=True):
        getattr(step, one.field)[list(one.entries)] += value
    return step
