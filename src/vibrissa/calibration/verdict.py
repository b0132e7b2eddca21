"""What has to be said of a calibration: estimates far from where they were given, rows left out and
what explains them, and what does not predict the rest.
"""

import math
from collections.abc import Iterable, Mapping

import numpy as np

from vibrissa.calibration.held_out import HeldOut
from vibrissa.calibration.result import Estimate
from vibrissa.calibration.score import Score
from vibrissa.calibration.statistics import Fitness
from vibrissa.rod import Rod
from vibrissa.tolerances import Tolerances

_MOST_LEFT_OUT, _MOST_SLIPPING = 0.1, 0.25
"""Share of the rows in contact that swinging, and with friction sticking and slipping, may take;
where a cause is found, a third of it.
"""
_TELLING = 6.0
"""Standard deviations from which a cause is named, and the share of the most significant one's from
which another is as likely.
"""
_ALIKE = 0.7
_FAR = 3.0
"""Tolerances, with the estimate's own deviation, by which an estimate may move."""
_STARTS = {
    "stiffness": 0.3,
    "length": 0.04,
    "position": 0.05,
    "orientation": math.radians(4.0),
    "gain": 0.05,
}
"""Without tolerances: what a start may be off by, and somewhat more; relative, of the rod's length,
and rad.
"""
_UNPREDICTED = 2.0
_INFLATED = 9.0
_TOO_FAR_OFF = 0.01
"""Of a rod length, by which first contact may be missed."""
_LEAST = {
    "object_scale": 0.002,
    "object_position": 0.002,
    "torque_gain": 0.004,
    "pose_delay": 0.002,
    "friction": 0.01,
    "taper": 0.05,
    "rest_curvature": 0.04,
}
"""Relative sizes from which a cause matters, curvature as the turn of the tip [rad]: below lie the
model and what real objects are true to.
"""

_SHAPES = ("taper", "rest_curvature")
"""Causes to first order only, which also take up an uneven object: sound benches show 8 to 11
standard deviations of them.
"""
_LINEAR = 0.5
"""Of the same sizes: a score is a linear extrapolation, and what would be off by half a rod or half
of a gain is beyond any.
"""


def warnings_of(
    estimates: Mapping[str, Estimate],
    stated: Mapping[str, float],
    rod: Rod,
    tolerances: Tolerances,
    fitness: Fitness,
    scores: Iterable[Score],
    parts: Iterable[HeldOut],
    missed: np.ndarray,
    friction: float,
) -> list[str]:
    """One sentence a finding, empty where all is well; `stated` holds tolerances of estimates, by
    name and in their units.
    """
    causes = _causes(list(scores), tolerances)
    lines = [*_left_out(fitness, causes, friction), *moved(estimates.values(), rod, stated)]
    if causes:
        best = max(cause.significance for cause in causes)
        named = "; or ".join(
            _told(cause, rod) for cause in causes if cause.significance > _ALIKE * best
        )
        lines.append(f"the readings contradict what is held: {named}")
    elif fitness.inflation.max() > _INFLATED:
        lines.append(
            f"the residuals are up to {math.sqrt(fitness.inflation.max()):.2g} times what the noise explains, by none of the causes that were tried: check the "
            "object's shape and orientation, the rod's straightness, and the sensor"
        )
    lines += unpredicted(parts, fitness.reduced_chi_square)
    lines += [
        f"recordings[{index}]: the loads begin where the rod as calibrated is {_length(gap, rod)} from first touching the object"
        for index, gap in enumerate(missed)
        if gap > _TOO_FAR_OFF * rod.length
    ]
    return lines


def unpredicted(parts: Iterable[HeldOut], inflation: float) -> list[str]:
    """Parts of the data that the others do not predict."""
    return [
        f"{part.part}: not what the rest predicts, mean square of the residuals {part.reduced_chi_square:.3g} of the noise's; "
        f"without it {part.parameter} moves by {part.move:.2g} standard deviations"
        for part in parts
        if part.reduced_chi_square > _UNPREDICTED * max(1.0, inflation) or part.move > _TELLING
    ]


def _causes(scores: list[Score], tolerances: Tolerances) -> list[Score]:
    """Those that are significant, large enough to matter, and beyond their tolerance."""
    return [
        score
        for score in scores
        if score.significance > (2 * _TELLING if score.suspect.name in _SHAPES else _TELLING)
        and _LEAST[score.suspect.name] < np.linalg.norm(score.value) * score.suspect.scale < _LINEAR
        and np.linalg.norm(score.value) > 2 * _allowed(score, tolerances)
    ]


def _allowed(score: Score, tolerances: Tolerances) -> float:
    match score.suspect.name:
        case "object_scale":
            return tolerances.object_scale
        case "object_position":
            return float(np.max(tolerances.object_position))
        case "torque_gain":
            return float(np.max(tolerances.gain[3:]))
        case "pose_delay":
            return tolerances.pose_delay
    return 0.0


def _told(score: Score, rod: Rod) -> str:
    value, sure = score.value, f"({score.significance:.0f} standard deviations)"
    match score.suspect.name:
        case "object_scale":
            text = f"the object seems {abs(value[0]):.1%} {'larger' if value[0] > 0 else 'smaller'} than stated"
        case "object_position":
            size = float(np.linalg.norm(value))
            text = f"the object seems to lie {_length(size, rod)} from where it is stated, along {(np.round(value / size, 2) + 0.0).tolist()}"
        case "torque_gain":
            text = f"torques seem to read {abs(value[0]):.1%} too {'much' if value[0] > 0 else 'little'} against forces"
        case "pose_delay":
            text = f"poses seem to come {1e3 * abs(value[0]):.3g} ms {'late' if value[0] > 0 else 'early'}"
        case "friction":
            text = (
                f"friction seems to be there, of a coefficient of the order of {abs(value[0]):.1g}"
            )
        case "taper":
            text = f"the rod seems to taper, its radius to be about {abs(value[0]):.0%} {'smaller' if value[0] > 0 else 'larger'} at the tip"
        case _:
            sagitta = float(np.linalg.norm(value)) * rod.length**2 / 8
            text = (
                f"the rod seems to be bent at rest, by a sagitta of about {_length(sagitta, rod)}"
            )
    return f"{text} {sure}: {score.suspect.remedy}"


def _left_out(fitness: Fitness, causes: list[Score], friction: float) -> list[str]:
    share = fitness.disturbed + fitness.outliers
    most = _MOST_SLIPPING if friction > 0 else _MOST_LEFT_OUT
    # Single outliers weigh less in good fits, too; whole stretches do not.
    if share < most and not (causes and fitness.disturbed > most / 3):
        return []
    return [
        f"{share:.0%} of the rows in contact do not fit and were left out or weigh less ({fitness.disturbed:.0%} in whole stretches): likely causes are the object's "
        "size, place or shape, friction, gains, a delay of the poses, a rod that tapers or is bent at rest; or it swings, or sticks and slips"
    ]


def moved(estimates: Iterable[Estimate], rod: Rod, stated: Mapping[str, float]) -> list[str]:
    """Estimates farther from where they were given than their tolerances, or a start, explain;
    `stated` as of `warnings_of`.
    """
    lines = []
    for one in estimates:
        if not one.determined:
            continue
        known = stated.get(one.name, 0.0)
        limit = (
            _FAR * math.hypot(known, one.deviation)
            if known > 0
            else _start(one, rod) + _FAR * one.deviation
        )
        move = abs(one.value - one.given)
        if move > limit:
            against = (
                f"{move / known:.1f} times its tolerance"
                if known > 0
                else "more than a start should be off by"
            )
            lines.append(
                f"{one.name}: found {_amount(one, move, rod)} from where it was given, {against}: it was misstated, or makes up for something else that is"
            )
    return lines


def _start(one: Estimate, rod: Rod) -> float:
    if one.name in ("youngs_modulus", "bending_stiffness"):
        return _STARTS["stiffness"] * abs(one.given)
    if one.name == "length":
        return _STARTS["length"] * one.given
    if one.unit == "rad":
        return _STARTS["orientation"]
    return (
        _STARTS["gain"] * abs(one.given) if "gain" in one.name else _STARTS["position"] * rod.length
    )


def _amount(one: Estimate, move: float, rod: Rod) -> str:
    if one.unit == "rad":
        return f"{math.degrees(move):.2g}°"
    if "position" in one.name or one.name == "standoff":
        return _length(move, rod)
    return f"{move / abs(one.given):.1%}"


def _length(value: float, rod: Rod) -> str:
    return f"{1e3 * value:.2g} mm" if rod.units == "SI" else f"{value:.2g} L"
