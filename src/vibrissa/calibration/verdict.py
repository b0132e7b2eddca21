"""Warnings about a calibration: estimates far from their given values, rows left out and what may
explain them, and parts of the data that do not fit the rest.
"""

import math
from collections.abc import Iterable, Mapping

import numpy as np

from vibrissa.calibration.bench import LOGARITHMIC
from vibrissa.calibration.held_out import HeldOut
from vibrissa.calibration.parameters import Parameter
from vibrissa.calibration.problem import Linear
from vibrissa.calibration.result import Estimate
from vibrissa.calibration.score import Score
from vibrissa.calibration.statistics import Fitness
from vibrissa.inverse.checks.findings import length_text
from vibrissa.rod import Rod

_MOST_LEFT_OUT, _MOST_SLIPPING = 0.1, 0.25
"""Share of the rows in contact that may be lost to swinging and, with friction, to sticking and
slipping; a third of it where a cause is found.
"""
_TELLING = 6.0
"""Standard deviations from which a cause is named; twice as many for taper and curvature, where
sound benches show 8 to 11.
"""
_ALIKE = 0.7
"""Share of the most significant cause's deviations from which another counts as likely, too."""
_LARGEST = 0.5
"""Relative size of a cause beyond which a linear extrapolation says nothing: half a gain."""
_FAR = 3.0
"""How many times its tolerance and own deviation, combined, an estimate may move."""
_STARTS = {
    "stiffness": 0.3,
    "length": 0.04,
    "clamp": 0.05,
    "shift": 0.05,
    "standoff": 0.05,
    "tilt": math.radians(4.0),
    "turn": math.radians(4.0),
    "gain": 0.05,
    # Whoever frees these does not know them.
    "taper": math.inf,
    "rest": math.inf,
    "support": math.inf,
}
"""Without tolerances: a little more than a start may be off by, in the parameters' scales."""
_UNPREDICTED = 2.0
"""Largest mean square of a part, relative to that of all residuals: sound benches show 1.2."""
_INFLATED = 9.0
"""Mean square of the residuals, relative to noise, that gives a warning: three deviations."""
_FEW = 0.1
"""Share of rows touching with the tip, or with the flank, that tells too little: sound benches show
a third of either.
"""
_ROUNDING = 1e-9
_RULER = 0.01
"""Relative error of a length by ruler, half a millimetre in 50: a calibration should do better."""
_TOO_FAR_OFF = 0.01
"""Share of a rod length by which first contact may be missed."""


def warnings_of(
    linear: Linear,
    rod: Rod,
    length: Estimate | None,
    moves: list[str],
    fitness: Fitness,
    scores: list[Score],
    parts: Iterable[HeldOut],
    missed: np.ndarray,
) -> list[str]:
    """One sentence per finding; empty if all is well."""
    causes = [score for score in scores if _matters(score)]
    share, lines = fitness.disturbed + fitness.outliers, list(moves)
    lines += one_sided(linear, length)
    most = _MOST_SLIPPING if linear.problem.friction > 0 else _MOST_LEFT_OUT
    # Single outliers are given less weight in good fits, too; whole stretches are not.
    if share >= most or (causes and fitness.disturbed > most / 3):
        lines.insert(
            0,
            f"{share:.0%} of the rows in contact do not fit and were left out or weigh less "
            f"({fitness.disturbed:.0%} in whole stretches): likely causes are the object's size, "
            "place or shape, friction, gains, a delay of the poses, a rod that tapers or is bent "
            "at rest; or it swings, or sticks and slips",
        )
    worst = float(fitness.inflation.max())
    if causes:
        named = "; or ".join(
            f"{one.suspect.said(one.value)} ({one.significance:.0f} standard deviations): "
            f"{one.suspect.remedy}"
            for one in causes
            if one.significance > _ALIKE * causes[0].significance
        )
        lines.append(f"the readings contradict what is held: {named}")
    elif worst > _INFLATED:
        lines.append(
            f"the residuals are up to {math.sqrt(worst):.2g} times what the noise explains, and "
            "none of the causes tried explains them: check the object's shape and orientation, the "
            "rod's straightness, and the sensor"
        )
    lines += unpredicted(parts, fitness.reduced_chi_square)
    return lines + [
        f"recordings[{index}]: the loads begin where the rod as calibrated is "
        f"{length_text(gap, rod)} from first touching the object"
        for index, gap in enumerate(missed)
        if gap > _TOO_FAR_OFF * rod.length
    ]


def one_sided(linear: Linear, length: Estimate | None) -> list[str]:
    """A sentence if the length stays unclear since the rod touches with its tip only, or never."""
    if length is None or (length.determined and length.deviation < _RULER * length.value):
        return []
    contact = linear.problem.rows.contact & linear.sound
    # Only with the tip in contact do readings depend on the rod's length.
    by_length = np.linalg.norm(linear.reading.by_step.length[contact][..., 0], axis=1)
    size = np.linalg.norm(linear.reading.wrench[contact], axis=1)
    share = np.mean(by_length > _ROUNDING * size)
    if share > 1 - _FEW:
        return [
            "the rod touches with its tip only: length, clamp and stiffness make up for each "
            "other; add a sweep closer to the object, where its flank touches"
        ]
    if share < _FEW:
        return [
            "the rod touches with its flank only, which does not show its length: add a sweep "
            "farther from the object, where its tip touches"
        ]
    return []


def _matters(score: Score) -> bool:
    """Whether a cause is significant, large enough to matter, and beyond its tolerance."""
    suspect, size = score.suspect, float(np.linalg.norm(score.value))
    return (
        score.significance > (_TELLING if suspect.linear else 2 * _TELLING)
        and suspect.least < size * suspect.scale < _LARGEST
        and size > 2 * suspect.tolerance
    )


def unpredicted(parts: Iterable[HeldOut], inflation: float) -> list[str]:
    """Parts of the data that the others do not predict."""
    return [
        f"{part.part}: not what the rest predicts, mean square of the residuals "
        f"{part.reduced_chi_square:.3g} of the noise's; "
        f"without it {part.parameter} moves by {part.move:.2g} standard deviations"
        for part in parts
        if part.reduced_chi_square > _UNPREDICTED * max(1.0, inflation) or part.move > _TELLING
    ]


def moved(
    chosen: Iterable[Parameter],
    estimates: Mapping[str, Estimate],
    rod: Rod,
    within: Mapping[Parameter, float],
) -> list[str]:
    """Estimates farther from their given values than their tolerances, or a start's usual errors,
    explain; `within` holds tolerances, as steps of the parameters.
    """
    lines = []
    for parameter in chosen:
        one, relative = estimates[parameter.name], parameter.field in LOGARITHMIC
        move, size = abs(one.value - one.given), abs(one.given) if relative else 1.0
        known = within.get(parameter, 0.0) * size
        if known > 0:
            limit = _FAR * math.hypot(known, one.deviation)
            against = f"{move / known:.1f} times its tolerance"
        else:
            limit = _STARTS[parameter.field] * parameter.scale * size + _FAR * one.deviation
            against = "more than a start should be off by"
        if one.determined and move > limit:
            amount = f"{move / size:.1%}" if relative else length_text(move, rod)
            if one.unit == "rad":
                amount = f"{math.degrees(move):.2g}°"
            lines.append(
                f"{one.name}: found {amount} from where it was given, {against}: it was misstated, "
                "or makes up for something else that is"
            )
    return lines
