"""Results of a calibration, as machine-readable numbers and as text."""

import json
import math
from operator import methodcaller
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic_core import to_jsonable_python

from vibrissa.files import writable

if TYPE_CHECKING:
    from vibrissa.calibration import Calibration

_SHOWN = {
    "Pa": (1e-9, "GPa"),
    "m": (1e3, "mm"),
    "rad": (180 / math.pi, "°"),
    "N m2": (1e6, "N mm²"),
}
_OWN = (
    "unevenness",
    "held_out",
    "first_contact",
    "warnings",
    "tare",
    "tare_deviation",
    "drift",
    "drift_deviation",
    "friction",
    "free",
)


def summary(calibration: "Calibration[Any]") -> dict[str, Any]:
    """Everything but the residuals, as plain numbers and names; None for a missing number."""
    known, found = calibration.identifiability, calibration.fitness
    numbers = {
        "estimates": {
            name: {
                "unit": one.unit,
                "given": one.given,
                "value": one.value,
                "standard_deviation": one.deviation,
                "interval_95": one.interval(),
                "determined": one.determined,
                "holds_for": one.holds_for,
            }
            for name, one in calibration.estimates.items()
        },
        "not_determined": known.held,
        "hardly_told_apart": known.confused,
        "weakest_direction": dict(zip(known.names, known.directions[0], strict=True)),
        "names": known.names,
        "correlation": known.correlation,
        "deviation_if_others_were_known": dict(zip(known.names, known.alone, strict=True)),
        "rows": np.count_nonzero(calibration.residuals.contact),
        "reduced_chi_square": found.reduced_chi_square,
        "whiteness": found.whiteness,
        "variance_inflation": found.inflation,
        "outliers": found.outliers,
        "disturbed": found.disturbed,
        **{name: getattr(calibration, name) for name in _OWN},
    }
    return to_jsonable_python(numbers, inf_nan_mode="null", fallback=methodcaller("tolist"))


def table(calibration: "Calibration[Any]") -> list[tuple[str, str, str, str, str]]:
    """Rows of text, headings first: name, unit, given, found, half-width of the 95 % interval."""
    rows = [("parameter", "unit", "given", "found", "95 % ±")]
    for one in calibration.estimates.values():
        factor, unit = _SHOWN.get(one.unit, (1.0, one.unit))
        if not one.determined:
            rows.append((one.name, unit, f"{factor * one.given:.6g}", "not determined", ""))
            continue
        half = factor * (one.interval()[1] - one.value)
        places = max(0, 2 - math.floor(math.log10(half))) if half > 0 else 6
        rows.append(
            (
                one.name,
                unit,
                f"{factor * one.given:.{places}f}",
                f"{factor * one.value:.{places}f}",
                f"{half:.2g}{'*' * bool(one.holds_for)}",
            )
        )
    return rows


def findings(calibration: "Calibration[Any]") -> list[str]:
    """Sentences on how well the model fits the data, and on what the data cannot separate."""
    found, rows = calibration.fitness, np.count_nonzero(calibration.residuals.contact)
    lines = [
        f"{rows} rows in contact; the residuals' mean square is "
        f"{found.reduced_chi_square:.3f} times that of the noise; {found.outliers:.1%} of the rows "
        "fit badly and are down-weighted."
    ]
    if found.disturbed > 0:
        lines.append(
            f"{found.disturbed:.1%} of the rows lie in stretches that no equilibrium explains, "
            "such as where the rod swings, or sticks and slips: they are left out."
        )
    if calibration.unevenness > 0:
        factor, unit = (1e6, "µm") if calibration.setup.rod.units == "SI" else (1.0, "L")
        lines.append(
            f"The rod touches {factor * calibration.unevenness:.3g} {unit} (standard deviation) "
            "off the object as given, changing along the sweep; the intervals allow for it."
        )
    if np.any(found.inflation > 1):
        factors = ", ".join(f"{math.sqrt(factor):.2g}" for factor in found.inflation)
        lines.append(
            f"The residuals are more than white noise (p = {found.whiteness:.1g}): the model does "
            "not explain everything. The intervals assume that the six channels' noise is "
            f"{factors} times as large as stated."
        )
    else:
        lines.append("The residuals are explained by the stated noise.")
    parts = ", ".join(f"{part.part} {part.reduced_chi_square:.3g}" for part in calibration.held_out)
    if parts:
        lines.append(
            f"Mean squares of the residuals, predicted from the rest, over the noise's: {parts}."
        )
    if calibration.tolerances is None:
        lines.append(
            "No tolerances are stated: the intervals cover noise only; those of the object and of "
            "parameters held fixed belong in [tolerances]."
        )
    given = sorted({name for one in calibration.estimates.values() for name in one.holds_for})
    if given:
        lines.append(f"* holds for {', '.join(given)} as given.")
    return lines + [f"{sentence}." for sentence in calibration.identifiability.text]


def write_summary(folder: Path, calibration: "Calibration[Any]") -> None:
    """Write `summary.json` and `summary.md`.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    heading, *rows = (f"| {' | '.join(row)} |" for row in table(calibration))
    lines = ["# Calibration", "", heading, "|---" * 5 + "|", *rows, ""]
    lines += [f"- warning: {sentence}" for sentence in calibration.warnings]
    lines += [f"- {sentence}" for sentence in findings(calibration)]
    for name, text in (
        ("summary.json", json.dumps(summary(calibration), indent=1)),
        ("summary.md", "\n".join(lines)),
    ):
        writable(folder / name).write_text(text + "\n", encoding="utf-8")
