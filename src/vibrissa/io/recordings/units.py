"""Units of a recording's numbers, as factors to SI."""

FORCE = {"N": 1.0, "mN": 1e-3, "uN": 1e-6, "kN": 1e3, "gf": 9.80665e-3, "lbf": 4.4482216152605}
TORQUE = {"N m": 1.0, "N cm": 1e-2, "N mm": 1e-3, "mN m": 1e-3, "mN mm": 1e-6, "uN m": 1e-6, "lbf in": 0.1129848290276167}
LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
ANGLE = {"rad": 1.0, "deg": 0.017453292519943295}
TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}

_SPELLINGS = {
    "Nm": "N m",
    "N.m": "N m",
    "N*m": "N m",
    "newton": "N",
    "newtons": "N",
    "newton meter": "N m",
    "Nmm": "N mm",
    "N.mm": "N mm",
    "mNm": "mN m",
    "metre": "m",
    "meter": "m",
    "meters": "m",
    "millimeter": "mm",
    "radian": "rad",
    "radians": "rad",
    "degree": "deg",
    "degrees": "deg",
    "second": "s",
    "seconds": "s",
    "sec": "s",
    "milliseconds": "ms",
    "microseconds": "us",
    "nanoseconds": "ns",
}


def known(text: str | None, units: dict[str, float]) -> str | None:
    """Unit that an attribute of a file names, in this module's spelling; None where it names none of these."""
    if text is None:
        return None
    # As CF writes times: "seconds since 2026-01-01".
    plain = text.strip().replace("µ", "u").replace("μ", "u").split(" since ")[0]
    unit = _SPELLINGS.get(plain, plain)
    return unit if unit in units else None
