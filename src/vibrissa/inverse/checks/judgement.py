"""What one trail says about its setup: causes of error, each sized to explain most of the misfit,
and the conclusions.
"""

from operator import attrgetter

import numpy as np
from scipy.ndimage import binary_propagation, uniform_filter1d

from vibrissa.inverse.arrays import Flags, Vectors
from vibrissa.inverse.checks.case import GROSS, Case, Numbers, Solution, case_of, solved
from vibrissa.inverse.checks.findings import Cause, SetupCheck
from vibrissa.inverse.checks.rig import (
    ERRORS,
    GAIN,
    POSITION,
    SUSPECTS,
    TELLING,
    Directions,
    sensor_matrix,
)
from vibrissa.inverse.checks.stretches import stretches_of
from vibrissa.inverse.checks.weighing import Tried, Weighed, weighed
from vibrissa.inverse.checks.wording import apart_line, causes_line, unexplained_line, unit_of
from vibrissa.inverse.parameters import prepared
from vibrissa.inverse.result import Reconstruction
from vibrissa.numerics.runs import runs
from vibrissa.rod import Rod

_THINNEST = 0.01
"""Of the stiffness at the clamp, that at the tip: a thinner one bends too sharply for the steps of
`imperfect`.
"""
_HOPELESS = 0.5
"""Fraction of what the best explains, below which a cause is not worth solving for."""
_POOR = 3.0
"""χ² per row above which a solution is also sought from the other side."""
_FURTHER = 0.1
"""Fraction of what the first cause explained that a further one must explain: less may be the
nonlinear part of the first.
"""
_MOST = 3
_GROSS = 0.15
"""Size of the best cause, in prior standard deviations, from which causes are solved for: EI off by
more than 5 %.
"""
_NEARLY_ALL = 0.75
"""Fraction of the misfit beyond noise that a real cause explains: 0.8 and more for the single
causes that were measured, half for a second contact.
"""
_MOST_APART = 0.3
"""Fraction of the stretches that may be set apart: what affects more of them is no exception."""
_WINDOW, _GROSSLY, _SURELY, _PERHAPS = 3, 50.0, 12.0, 6.0
"""Stretches averaged together, and means of their three squares, of which noise makes 3 ± 1.4: from
which a part contradicts the rest, if no cause is found (swinging makes 15) and if one is, and down
to which it then extends.
"""


def described(rod: Rod) -> Rod | None:
    """A rod other than the straight uniform one, about which causes are then linearised."""
    return None if rod.plain else rod


def unjudged(rod: Rod) -> str:
    """Why a rod is not checked; empty if it is."""
    if rod.loads is not None:
        return "the setup is not checked: this is not possible for a rod with loads along it"
    if float(rod.bending_at(1.0)) < _THINNEST:
        return (
            "the setup is not checked: this is not possible for a rod whose bending stiffness "
            f"falls to less than {_THINNEST:.0%} of that at the clamp"
        )
    return ""


# Readings that no rod produces lead to unbounded numbers; non-finite ones are left out.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def judged(found: Reconstruction) -> SetupCheck:
    """Findings of one trail: none if noise or time are unknown, or too little is in contact."""
    reactions, rod = found.reactions, found.rod
    known = reactions.covariance is not None and reactions.time is not None
    if known and (note := unjudged(rod)):
        none = np.zeros(len(found.kind), dtype=bool)
        return SetupCheck(np.zeros_like(found.point), found.friction or 0.0, none, note=note)
    if known:
        averaged = stretches_of(found)
        (turn, arm, _), factor, _ = prepared(found.rod, reactions.setup_errors)
        tolerated = np.zeros((ERRORS, factor.shape[1]))
        # The clamp position is stated in sensor axes, and the parameters after the gains are the
        # clocks'.
        tolerated[: GAIN.stop] = factor[: GAIN.stop]
        tolerated[POSITION] = turn @ factor[POSITION]
        to_sensor = sensor_matrix(turn.T, turn.T @ arm)
        case = averaged and case_of(averaged, to_sensor, found.friction, tolerated, described(rod))
        if case:
            return _of_case(found, case)
    nowhere = np.zeros(len(found.kind), dtype=bool)
    return SetupCheck(np.zeros_like(found.point), found.friction or 0.0, nowhere)


def _of_case(found: Reconstruction, case: Case) -> SetupCheck:
    first, told, lines = weighed(case, case.phases()), list[Weighed](), list[str]()
    contradicted = first.matters and not _tolerable(case)
    apart = _apart(found, first, contradicted=contradicted)
    if apart.any():
        lines = [apart_line(found, first.misfit, apart)]
    elif contradicted:
        first = _solved_if_gross(first)
        told = _explained(first)
        lines = [causes_line(found.rod, here) for here in told]
    misread = contradicted and not lines
    if misread:
        lines = [unexplained_line(found.rod, first)]
    square, rows = first.misfit.square, len(first.misfit.value)
    return SetupCheck(
        shift=_shift_of_rows(found, case, told),
        friction=first.friction,
        causes=tuple(_cause(found.rod, one, max(square - rows, 1.0)) for one in first.tried),
        reduced_chi_square=square / rows,
        named=tuple(tuple(one.name for one in here.alike) for here in told),
        warnings=tuple(lines),
        misread=misread,
        apart=apart,
    )


def _explained(first: Weighed) -> list[Weighed]:
    """Up to three groups of causes, one after the other, each with the likeliest of those before
    removed.
    """
    told, least, here = list[Weighed](), _FURTHER * first.tried[0].score, first
    while len(told) < _MOST and here.explains(least):
        told.append(here)
        case, likeliest = here.case, here.tried[0]
        step, most = SUSPECTS[likeliest.name] @ likeliest.size, GROSS * case.spread
        case = case.about(case.errors + np.clip(step, -most, most))
        here = weighed(case, case.phases(started=False))
    return told


def _solution(
    case: Case, directions: Directions, spread: Numbers, start: Numbers
) -> Solution | None:
    """As `solved`; None where the search ends at readings that no rod produces."""
    try:
        return solved([case], directions, spread, start)
    except ValueError:  # not finite, or of no positive definite covariance
        return None


def _solved_if_gross(first: Weighed) -> Weighed:
    """Causes solved for if the best is gross, except those that the linear fit finds hopeless."""
    case, misfit = first.case, first.misfit
    best = next((one for one in first.alike if one.name in TELLING), None)
    if best is None or not np.any(np.abs(best.size) > _GROSS * case.spreads(SUSPECTS[best.name])):
        return first
    out, least = [], _HOPELESS * first.tried[0].score
    for one in first.tried:
        if one.name in TELLING and one.score > least:
            directions = SUSPECTS[one.name]
            spread = case.spreads(directions)
            start = np.clip(one.size, -spread, spread)
            found = [_solution(case, directions, spread, start)]
            poor = found[0] is None or found[0].left > _POOR * len(misfit.value)
            if len(spread) == 1 and poor:
                found.append(_solution(case, directions, spread, -start))
            solutions = [each for each in found if each is not None]
            if not solutions:
                continue
            _, _, size, covariance, left = min(solutions, key=attrgetter("left"))
            out.append(
                one._replace(size=size, covariance=covariance, explained=misfit.square - left)
            )
    out.sort(key=attrgetter("score"), reverse=True)
    return first._replace(tried=out or first.tried)


def _tolerable(case: Case) -> bool:
    """Whether errors within the stated tolerances explain it after all: solved for, as they are
    nonlinear.
    """
    spread = np.linalg.norm(case.tolerated, axis=0)
    # A delay shows in no single contact.
    directions, spread = case.tolerated[:, spread > 0] / spread[spread > 0], spread[spread > 0]
    if not spread.size:
        return False
    solution = _solution(case, directions, spread, np.zeros_like(spread))
    if solution is None:
        return False
    size = solution.size
    if np.max(np.abs(size) / spread) >= GROSS:
        return False
    about = case.about(case.errors + directions @ size)
    return not weighed(about, about.phases([directions])).matters


def _apart(found: Reconstruction, first: Weighed, *, contradicted: bool) -> Flags:
    """Samples of one part of the sweep that alone contradicts the rest, which agrees with the
    setup; none if the best cause, if there is one, explains nearly all.
    """
    case, misfit, samples = first.case, first.misfit, np.zeros(len(found.kind), dtype=bool)
    rows = len(misfit.value)
    excess = misfit.square - rows
    if contradicted and (excess < rows or first.tried[0].explained > _NEARLY_ALL * excess):
        return samples
    square = uniform_filter1d(np.sum(misfit.alone**2, axis=1), _WINDOW, mode="nearest")
    least = _SURELY if contradicted else _GROSSLY
    apart = binary_propagation(square > least, mask=square > _PERHAPS)
    if 0 < np.mean(apart) < _MOST_APART:
        stretches, to_sensor = case.bench.stretches, case.bench.to_sensor
        rest = case_of(
            stretches.chosen(~apart), to_sensor, found.friction, case.tolerated, case.bench.rod
        )
        if rest and not _of_case(found, rest).warnings:
            for start, stop in runs(apart):
                # Including those between neighbours.
                samples[stretches.first[start] : stretches.last[stop - 1]] = True
    return samples


def _cause(rod: Rod, one: Tried, total: float) -> Cause:
    unit, factor = unit_of(rod, one.name)
    return Cause(
        one.name,
        unit,
        estimate=tuple((factor * one.size).tolist()),
        deviation=tuple((factor * np.sqrt(np.diag(one.covariance))).tolist()),
        significance=float(np.sqrt(max(one.explained, 0.0))),
        explained=float(np.clip(one.explained / total, 0.0, 1.0)),
        shift=one.shift(0.5) * rod.length,
    )


def _shift_of_rows(found: Reconstruction, case: Case, told: list[Weighed]) -> Vectors:
    """World axes and units of the rod: the largest of each group, summed."""
    stretches, time = case.bench.stretches, found.reactions.time
    assert time is not None
    total = np.zeros((len(stretches.time), 3))
    for here in told:
        each = np.stack([one.moved for one in here.alike])
        largest = np.argmax(np.linalg.norm(each, axis=2), axis=0)
        total += each[largest, np.arange(len(total))]
    world = np.einsum("kij,kj->ki", stretches.turn, total) * found.rod.length
    return np.stack([np.interp(time, stretches.time, axis) for axis in world.T], axis=1)
