"""Findings of a sweep, each as one line."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool
from scipy.ndimage import label

from vibrissa.inverse.checks.candidates import MATTERS, Tried
from vibrissa.inverse.checks.case import Case
from vibrissa.inverse.checks.constraints import TANGENT, TIP, Constraints
from vibrissa.inverse.checks.regression import Misfit
from vibrissa.inverse.checks.suspects import SUSPECTS
from vibrissa.inverse.checks.wording import named, observed
from vibrissa.inverse.result import Reconstruction

_SHOWN = 4


def apart_line(found: Reconstruction, misfit: Misfit, rows: Bool[np.ndarray, "n"]) -> str:
    """On rows that contradict the rest of the sweep."""
    time = found.reactions.time
    assert time is not None
    runs, count = label(rows)
    spans = [np.flatnonzero(runs == run) for run in range(1, count + 1)]
    when = " and ".join(f"from {time[own[0]]:.4g} to {time[own[-1]]:.4g} s" for own in spans)
    return (
        f"{when} force and moment are those of no single contact, by up to {np.abs(misfit.alone).max():.0f} standard deviations, while the rest agrees with the "
        "setup: the rod touches two places there, or its tip is caught"
    )


def unit_of(found: Reconstruction, name: str) -> tuple[str, float]:
    """Unit of a cause's numbers, and what takes them there from model units."""
    rod = found.rod
    si = rod.units == "SI"
    match name.split("_", maxsplit=1)[0]:
        case "length" | "clamp" if name != "clamp_orientation":
            return rod.unit_of("length"), rod.length
        case "clamp":
            return "rad", 1.0
        case "rest":
            return rod.unit_of("curvature"), 1 / rod.length
        case "load":
            return "N/m" if si else "1", rod.force_scale / rod.length
        case "drift" | "zero":
            force = name[-2] == "f"
            unit = rod.unit_of("force" if force else "moment")
            return unit + (
                "/s" if name.startswith("drift") else ""
            ), rod.force_scale if force else rod.moment_scale
    return "1", 1.0


def causes_line(
    found: Reconstruction, case: Case, tip: Bool[np.ndarray, "k"], together: Sequence[Tried]
) -> str:
    """On causes that explain about the same: what is seen, how surely, and by how much each would
    move contacts.
    """
    best, here, rod = together[0], case.here, found.rod
    signal = (
        np.abs(case.slopes.constraints @ (best.suspect.directions @ best.size)) / case.deviations
    )
    signal[~tip, TIP], signal[tip, TANGENT] = 0.0, 0.0
    seen = _seen(found, here, tip, int(np.argmax(np.sum(signal**2, axis=0))))
    order = sorted(together, key=lambda one: SUSPECTS.index(one.suspect))[:_SHOWN]
    causes = [
        named(
            one.suspect.name,
            tuple(unit_of(found, one.suspect.name)[1] * one.size),
            rod.length,
            rod.unit_of("length"),
        )
        for one in order
    ]
    shift, place = max(one.shift for one in together), "in the median"
    if shift < MATTERS:
        shift, place = max(one.largest for one in together), "in a fifth of the sweep"
    moved = f"{1e3 * shift * rod.length:.2g} mm" if rod.units == "SI" else f"{shift:.2g} L"
    return f"{seen}, {np.sqrt(best.explained):.0f} standard deviations: likely {', or '.join(causes)}; contacts are then off by {moved} {place}"


def unexplained_line(
    found: Reconstruction, case: Case, tip: Bool[np.ndarray, "k"], misfit: Misfit
) -> str:
    """On a misfit that no cause explains."""
    value = np.take_along_axis(
        np.abs(case.here.value) / case.deviations, misfit.pick, axis=1
    ) * misfit.told.reshape(-1, 3)
    stretch, column = np.unravel_index(np.argmax(value), value.shape)
    seen = _seen(found, case.here, tip, int(misfit.pick[stretch, column]))
    deviations = np.sqrt(float(misfit.value @ misfit.value))
    return (
        f"{seen}, {deviations:.0f} standard deviations: no single cause explains it; check the units, signs and axes of wrench and poses, "
        "the sensor's calibration, and the rod's length and stiffness"
    )


def _seen(found: Reconstruction, here: Constraints, tip: Bool[np.ndarray, "k"], row: int) -> str:
    of_row = tip if row == TIP else ~tip if row == TANGENT else np.ones_like(tip)
    size = here.value[of_row, row] / (here.steepness[of_row] if row == TIP else 1.0)
    return observed(row, float(np.median(size)), found.rod.length, found.rod.unit_of("length"))
