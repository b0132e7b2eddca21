"""Units of a recording's numbers: the names that setups and files use for them, by pint."""

from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from re import search, sub
from typing import Any, Literal, get_args

Force = Literal["N", "mN", "uN", "kN", "gf", "kgf", "lbf"]
Torque = Literal["N m", "N cm", "N mm", "mN m", "mN mm", "uN m", "kgf m", "kgf cm", "lbf in"]
Length = Literal["m", "cm", "mm", "um", "in"]
Angle = Literal["rad", "deg"]
Time = Literal["s", "ms", "us", "ns", "min", "h"]

FORCE, TORQUE, LENGTH, ANGLE, TIME = map(get_args, (Force, Torque, Length, Angle, Time))
ALLOWED = {"force": FORCE, "torque": TORQUE, "position": LENGTH, "angle": ANGLE, "time": TIME}
# "newton millimeters" has 18 letters: what is longer is a note or damage.
_LONGEST = 30


@cache
def _unit(text: str) -> Any:
    """A unit, also of a torque whose letters are joined; None if the text is not a unit."""
    # The kilopond is what pint calls kgf.
    plain = sub(r"[.\-·⋅]", "*", text.replace("kp", "kgf"))
    plain = sub(r"(N|gf|lbf)([cm]?m|in|ft)$", r"\1*\2", plain)
    # pint's parser raises whatever the operators in a text that is no unit lead to.
    try:
        return _registry().Unit(plain) if len(plain) <= _LONGEST else None
    except Exception:
        return None


@cache
def _registry() -> Any:
    import pint  # noqa: PLC0415

    return pint.UnitRegistry(non_int_type=Fraction)  # so that factors are exact


@cache
def factor(unit: str) -> float:
    """Factor to SI of a unit that a setup may name."""
    return float(_registry().Quantity(1, unit).to_base_units().magnitude)


def known(text: str | None, allowed: Sequence[str]) -> str | None:
    """Unit that a file names, in the spelling of `allowed`; None where it names none.

    Letters may be joined (Nm), parted by a point, hyphen or star (N*mm), written out (newton
    meter), and in capitals (NMM) where these mean no other unit of the same kind (MN).

    Raises
    ------
    ValueError
        If it names one that is not among `allowed`.
    """
    # As CF writes times: "seconds since 2026-01-01".
    plain = (text or "").split(" since ")[0].strip().replace("µ", "u").replace("μ", "u")
    if plain in {"", "1", "-"}:
        return None
    # By spelling first, then by meaning, last by letters alone.
    for unit in (_unit(plain), _unit(plain.lower())):
        for name in allowed:
            if name == plain or unit == _unit(name):
                return name
        if unit is not None and unit.dimensionality == _unit(allowed[0]).dimensionality:
            break
    else:
        letters = sub(r"[\W_]", "", plain).lower()
        for name in allowed:
            if letters == name.replace(" ", "").lower():
                return name
    raise ValueError(f"{text!r}; known are {', '.join(allowed)}")


def known_or_none(text: str, allowed: Sequence[str]) -> str | None:
    """As `known`, and None for a text that is no unit."""
    try:
        return known(text, allowed)
    except ValueError:
        return None


def is_unit(text: str) -> bool:
    """Whether a text is a unit of anything that is read."""
    return any(known_or_none(text, units) for units in ALLOWED.values())


def in_brackets(name: str, allowed: Sequence[str]) -> str | None:
    """Unit in brackets at the end of a name, as in `Fx [mN]` or `Fx (mN)`; None otherwise."""
    found = search(r"[\[(]([^\[\]()]+)[\])]\s*$", name)
    return known_or_none(found[1], allowed) if found else None
