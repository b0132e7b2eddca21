"""Units of a recording's numbers, as factors to SI."""

from re import search

FORCE = {
    "N": 1.0,
    "mN": 1e-3,
    "uN": 1e-6,
    "kN": 1e3,
    "gf": 9.80665e-3,
    "kgf": 9.80665,
    "lbf": 4.4482216152605,
}
TORQUE = {
    "N m": 1.0,
    "N cm": 1e-2,
    "N mm": 1e-3,
    "mN m": 1e-3,
    "mN mm": 1e-6,
    "uN m": 1e-6,
    "kgf m": 9.80665,
    "kgf cm": 9.80665e-2,
    "lbf in": 0.1129848290276167,
}
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
ANGLE = {"rad": 1.0, "deg": 0.017453292519943295}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
_NONE = {"", "1", "-"}

_SPELLINGS = {
    "Nm": "N m",
    "N.m": "N m",
    "N*m": "N m",
    "newton": "N",
    "newtons": "N",
    "newton meter": "N m",
    "newton metre": "N m",
    "N-m": "N m",
    "N·m": "N m",
    "N·mm": "N mm",
    "mN·m": "mN m",
    "Ncm": "N cm",
    "mNmm": "mN mm",
    "uNm": "uN m",
    "kgfm": "kgf m",
    "kgfcm": "kgf cm",
    "kp": "kgf",
    "Nmm": "N mm",
    "N.mm": "N mm",
    "mNm": "mN m",
    "metre": "m",
    "meter": "m",
    "meters": "m",
    "metres": "m",
    "millimeter": "mm",
    "millimetre": "mm",
    "millimeters": "mm",
    "inch": "in",
    "radian": "rad",
    "radians": "rad",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "second": "s",
    "seconds": "s",
    "sec": "s",
    "milliseconds": "ms",
    "microseconds": "us",
    "nanoseconds": "ns",
    "minutes": "min",
    "minute": "min",
    "hours": "h",
    "hour": "h",
}


def known(text: str | None, units: dict[str, float]) -> str | None:
    """Unit that an attribute of a file names, in this module's spelling; None where it names none.

    Raises
    ------
    ValueError
        If it names one that is none of these.
    """
    # As CF writes times: "seconds since 2026-01-01".
    plain = (text or "").strip().replace("µ", "u").replace("μ", "u").split(" since ")[0]
    unit = _SPELLINGS.get(plain, plain)
    if unit in _NONE:
        return None
    if unit not in units:
        raise ValueError(f"{text!r}; known are {', '.join(units)}")
    return unit


def is_unit(text: str) -> bool:
    """Whether a text is a unit of anything that is read."""
    for units in (FORCE, TORQUE, LENGTH, ANGLE, TIME):
        try:
            if known(text, units) is not None:
                return True
        except ValueError:
            continue
    return False


def in_brackets(name: str, units: dict[str, float]) -> str | None:
    """Unit in brackets at the end of a name, as in `Fx [mN]` or `Fx (mN)`; None where there is none
    of these.
    """
    found = search(r"[\[(]([^\[\]()]{1,20})[\])]\s*$", name)
    try:
        return known(found[1], units) if found else None
    except ValueError:
        return None
