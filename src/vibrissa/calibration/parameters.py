"""What can be calibrated: names, units, and how a step changes the bench."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.calibration.equilibrium import CORE, Bench
from vibrissa.geometry.checks import positive
from vibrissa.rod import Rod

_AXES = ("x", "y", "z")
_CHANNELS = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")


@dataclass(frozen=True, eq=False)
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
    direction
        (21,) what a unit step of it does to the bench (`equilibrium.changed`).
    scale
        A step that would be a gross change: by what parameters of different units are compared.
    """

    name: str
    group: str
    unit: str
    direction: Float[np.ndarray, "21"]
    scale: float


STIFFNESS = ("youngs_modulus", "bending_stiffness")
STANDOFF = "standoff"
GROUPS = (
    "length",
    "clamp_position",
    "clamp_orientation",
    "object_position",
    "object_orientation",
    STANDOFF,
    "gain",
    "force_gain",
    "torque_gain",
    "tare",
    "drift",
)
DEFAULT_FREE = (STIFFNESS[0], "length", "clamp_position", "clamp_orientation", "tare", "drift")


def allowed_names(rod: Rod) -> tuple[str, ...]:
    """Names that `free` and `prior` may hold for a rod."""
    return (*(STIFFNESS if rod.radius is not None else STIFFNESS[1:]), *GROUPS)


def parameters(names: Iterable[str], rod: Rod) -> list[Parameter]:
    """Free parameters of the bench, in a fixed order: rod, clamp, object, sensor.

    Raises
    ------
    ValueError
        If a name is unknown, twice, or contradicts another.
    """
    wanted = list(names)
    allowed = allowed_names(rod)
    for name in wanted:
        if name not in allowed:
            needs = " (youngs_modulus needs the rod's radius)" if name == STIFFNESS[0] else ""
            raise ValueError(
                f"free: {name!r} is no parameter; allowed are {', '.join(allowed)}{needs}"
            )
        if wanted.count(name) > 1:
            raise ValueError(f"free: {name!r} is given twice; allowed is each once")
    for first, others in ((STIFFNESS[0], STIFFNESS[1:]), ("gain", ("force_gain", "torque_gain"))):
        clash = [name for name in others if name in wanted]
        if first in wanted and clash:
            raise ValueError(
                f"free: {first!r} and {clash[0]!r} are the same parameters; allowed is one of them"
            )
    found = [
        parameter
        for name in (*STIFFNESS, *GROUPS)
        if name in wanted
        for parameter in _of(name, rod)
    ]
    if not found:
        raise ValueError(
            f"free = {wanted}: no parameter of rod, clamp, sensor or object; allowed are {', '.join(allowed)}"
        )
    return found


def _of(name: str, rod: Rod) -> list[Parameter]:
    unit = rod.unit_of("length")
    match name:
        case "youngs_modulus":
            return [_one(name, "Pa", [0], 1.0)]
        case "bending_stiffness":
            return [_one(name, "N m2" if rod.units == "SI" else "1", [0], 1.0)]
        case "length":
            return [_one(name, unit, [1], 1.0)]
        case "clamp_position":
            return [_axis(name, unit, 2, axis, rod.length) for axis in range(3)]
        case "clamp_orientation":
            return [_axis(name, "rad", 5, axis, 1.0) for axis in range(3)]
        case "object_position":
            return [_axis(name, unit, 14, axis, rod.length) for axis in range(3)]
        case "object_orientation":
            return [_axis(name, "rad", 17, axis, 1.0) for axis in range(3)]
        case "standoff":
            return [_one(name, unit, [20], rod.length)]
        case "gain":
            return [
                Parameter(f"gain_{channel}", name, "1", _unit([8 + index]), 1.0)
                for index, channel in enumerate(_CHANNELS)
            ]
        case "force_gain":
            return [_one(name, "1", [8, 9, 10], 1.0)]
        case "torque_gain":
            return [_one(name, "1", [11, 12, 13], 1.0)]
    return []


def _one(name: str, unit: str, entries: list[int], scale: float) -> Parameter:
    return Parameter(name, name, unit, _unit(entries), scale)


def _axis(name: str, unit: str, first: int, axis: int, scale: float) -> Parameter:
    return Parameter(f"{name}_{_AXES[axis]}", name, unit, _unit([first + axis]), scale)


def _unit(entries: list[int]) -> Float[np.ndarray, "21"]:
    direction = np.zeros(CORE)
    direction[entries] = 1.0
    return direction


def checked_prior(prior: Mapping[str, float] | None, names: Iterable[str]) -> dict[str, float]:
    """Standard deviations by name.

    Raises
    ------
    ValueError
        If a name is not free, or a deviation not positive.
    """
    wanted = [name for name in names if name not in ("tare", "drift")]
    for name, deviation in (prior or {}).items():
        if name not in wanted:
            raise ValueError(
                f"prior: {name!r} is not a free parameter of the bench; allowed are {', '.join(wanted)}"
            )
        positive(deviation, f"prior[{name!r}]")
    return dict(prior or {})


def moved(bench: Bench, step: Float[np.ndarray, "21"]) -> Bench:
    """Bench after a finite step; rotation vectors turn."""
    clamp_turn, object_turn = (
        Rotation.from_rotvec(part).as_matrix() for part in (step[5:8], step[17:20])
    )
    return Bench(
        bench.stiffness * np.exp(step[0]),
        bench.length * np.exp(step[1]),
        bench.clamp + step[2:5],
        bench.axes @ clamp_turn,
        bench.gain * np.exp(step[8:14]),
        bench.shift + step[14:17],
        object_turn @ bench.turn,
        bench.pivot,
        bench.standoff + step[20],
    )
