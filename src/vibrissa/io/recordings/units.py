"""Units of a recording's numbers, by the names that setups and files use, parsed by pint."""

from collections.abc import Sequence
from fractions import Fraction
from functools import cache
from re import fullmatch, search, split, sub
from typing import Any, Literal, get_args

Force = Literal["N", "mN", "uN", "kN", "gf", "kgf", "lbf"]
Torque = Literal["N m", "N cm", "N mm", "mN m", "mN mm", "uN m", "kgf m", "kgf cm", "lbf in"]
Length = Literal["m", "cm", "mm", "um", "in"]
Angle = Literal["rad", "deg"]
Time = Literal["s", "ms", "us", "ns", "min", "h"]

FORCE, TORQUE, LENGTH, ANGLE, TIME = map(get_args, (Force, Torque, Length, Angle, Time))
ALLOWED = {"force": FORCE, "torque": TORQUE, "position": LENGTH, "angle": ANGLE, "time": TIME}
# "newton millimeters" has 18 letters: longer text is a remark or corrupt.
_LONGEST = 30


@cache
def _unit(text: str) -> Any:
    """A unit, with joined torque units such as Nm allowed; None if the text is not a unit."""
    # pint calls the kilopond kgf.
    plain = sub(r"[.\-·⋅]", "*", text.replace("kp", "kgf"))
    plain = sub(r"(N|gf|lbf)([cm]?m|in|ft)$", r"\1*\2", plain)
    # For other text, pint's parser may raise almost any exception.
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
    """Factor to SI for a unit that a setup may name."""
    return float(_registry().Quantity(1, unit).to_base_units().magnitude)


def known(text: str | None, allowed: Sequence[str]) -> str | None:
    """Unit that a file names, as spelled in `allowed`; None if it names none.

    Parts may be joined (Nm), separated by a point, hyphen or asterisk (N*mm), spelled out (newton
    meter), or in capitals (NMM) unless these mean another unit of the same kind (MN).

    Raises
    ------
    ValueError
        If it names a unit that is not in `allowed`.
    """
    # CF writes times as "seconds since 2026-01-01".
    plain = (text or "").split(" since ")[0].strip().replace("µ", "u").replace("μ", "u")
    if plain in {"", "1", "-"}:
        return None
    # By spelling first, then by meaning, finally by letters alone.
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
    """As `known`, but None for text that is not an allowed unit."""
    try:
        return known(text, allowed)
    except ValueError:
        return None


_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def numbers_in(text: str, unit: str) -> list[float]:
    """Numbers with commas or blanks between them, in `unit` unless another stands at the end, as in
    `0, 0, 25.5 mm`.

    Raises
    ------
    ValueError
        If the text is something else, or its unit is of another kind.
    """
    found = fullmatch(rf"\s*({_NUMBER}(?:[,\s]+{_NUMBER})*)\s*([A-Za-zµμ]\w*)?\s*", text)
    own = _unit((found[2] or unit).replace("μ", "µ")) if found else None
    if found is None or own is None or own.dimensionality != _unit(unit).dimensionality:
        raise ValueError(text)
    return [
        float(_registry().Quantity(Fraction(part), own).to(unit).magnitude)
        for part in split(r"[,\s]+", found[1])
    ]


def is_unit(text: str) -> bool:
    """Whether a text is a unit of any quantity that is read."""
    return any(known_or_none(text, units) for units in ALLOWED.values())


def in_brackets(name: str, allowed: Sequence[str]) -> str | None:
    """Unit in brackets at the end of a name, as in `Fx [mN]` or `Fx (mN)`; None otherwise."""
    found = search(r"[\[(]([^\[\]()]+)[\])]\s*$", name)
    return known_or_none(found[1], allowed) if found else None
