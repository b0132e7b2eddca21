"""What one trail says of its setup: causes of error, each as large as explains most of the misfit,
and what is concluded from them.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label, uniform_filter1d

from vibrissa.inverse.checks.case import (
    GROSS,
    Case,
    Solution,
    case_of,
    solved,
    tolerances_of,
    weighed,
)
from vibrissa.inverse.checks.findings import Cause, SetupCheck
from vibrissa.inverse.checks.regression import Misfit, Phases, fitted, shifts
from vibrissa.inverse.checks.rig import frame_of
from vibrissa.inverse.checks.stretches import stretches_of
from vibrissa.inverse.checks.suspects import SUSPECTS, TELLING, Suspect, Tried
from vibrissa.inverse.checks.wording import (
    MATTERS,
    apart_line,
    causes_line,
    unexplained_line,
    unit_of,
)
from vibrissa.inverse.result import Reconstruction

_LEAST = 20.0
"""Of χ² that a cause has to explain: four and a half standard deviations, of some thirty causes
that are tried; sound recordings show 3.6 at most.
"""
_PRICE = 6.0
"""Of χ² for each further number that a cause may choose (BIC for some four hundred rows)."""
_ALIKE, _ALIKE_BY = 0.05, 10.0
"""Causes are named beside the best that explain less by at most this share of it, and this of χ².
"""
_HOPELESS = 0.5
"""Share of what the best explains, below which a cause need not be solved for."""
_POOR = 3.0
"""χ² a row above which a solution is sought from the other side, too."""
_WITH_FRICTION = 100.0
"""Of χ² that a cause has to explain where friction leaves open what s₁ and k² should be: what then
remains is told less safely.
"""
_FURTHER = 0.1
"""Share of what the first cause explained that a further one has to explain: less may be what is
not linear in the first.
"""
_MOST = 3
_GROSS = 0.15
"""Size of the best cause, in standard deviations before the data, from which causes are solved for:
EI off by more than 5 %.
"""
_NEARLY_ALL = 0.75
"""Share of the misfit beyond noise that a cause explains which is real: 0.8 and more of single
causes that were measured, half of a second contact.
"""
_MOST_APART = 0.3
"""Share of the stretches that may be set apart: what concerns more of them is no exception."""
_WINDOW, _GROSSLY, _SURELY, _PERHAPS = 3, 50.0, 12.0, 6.0
"""Stretches together, and means of their three squares, of which noise makes 3 ± 1.4: from which a
part contradicts the rest, where no cause is found (swinging makes 15) and where one is, and to
which it then extends."""


# Readings that no rod has make numbers without bound; what is not finite is left out.
@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def judged(found: Reconstruction, shift: Float[np.ndarray, "n 3"]) -> SetupCheck:
    """Findings of one trail; `shift` is that of no cause."""
    averaged = stretches_of(found)
    if averaged is not None:
        frame = frame_of(found.reactions, found.rod.length)
        case = case_of(averaged, frame, found.friction)
        if case is not None:
            return _of_case(found, case)
    return SetupCheck((), 1.0, found.friction or 0.0, (), (), shift)


def _of_case(found: Reconstruction, case: Case) -> SetupCheck:
    tip = case.phases()
    misfit, friction = weighed(case, tip, found.reactions, found.rod.length)
    first = _candidates(case, tip, misfit)
    contradicted = _matters(case, first) and not _tolerable(found, case)
    groups: list[list[Tried]] = []
    lines: list[str] = []
    rows = _apart(found, case, misfit, first[0] if contradicted else None)
    if rows is not None:
        lines = [apart_line(found, misfit, rows)]
    elif contradicted:
        first = _solved_if_gross(found, case, tip, misfit, first)
        groups, lines = _explained(found, case, tip, first)
    excess = misfit.square - len(misfit.value)
    concluded = SetupCheck(
        tuple(_cause(found, one, max(excess, 1.0)) for one in first),
        misfit.square / len(misfit.value),
        friction,
        tuple(tuple(one.suspect.name for one in group) for group in groups),
        tuple(lines),
        _shift_of_rows(found, case, groups),
        apart=rows,
    )
    if lines or not contradicted:
        return concluded
    line = unexplained_line(found, case, tip, misfit)
    return replace(concluded, warnings=(line,), misread=True)


def _explained(
    found: Reconstruction, case: Case, tip: Phases, first: list[Tried]
) -> tuple[list[list[Tried]], list[str]]:
    """Up to three groups of causes, one after the other, each with the likeliest before taken off,
    and a line on each.
    """
    groups: list[list[Tried]] = []
    lines: list[str] = []
    tried = first
    while len(groups) < _MOST and matters(alike(tried), _FURTHER * first[0].score):
        groups.append(alike(tried))
        lines.append(causes_line(found, case, tip, groups[-1]))
        step, most = tried[0].suspect.directions @ tried[0].size, GROSS * case.spread
        case = case.about(case.errors + np.clip(step, -most, most), found.friction)
        tip = case.phases(started=False)
        tried = _candidates(case, tip, weighed(case, tip, found.reactions, found.rod.length)[0])
    return groups, lines


def alike(tried: list[Tried]) -> list[Tried]:
    """The best, and those that explain about as much."""
    best = tried[0].score
    return [one for one in tried if one.score >= best * (1 - _ALIKE) - _ALIKE_BY]


def matters(together: list[Tried], least: float) -> bool:
    """Whether causes that explain about the same explain enough, and would move contacts by more
    than error bars hold.
    """
    largest = max((one.largest for one in together), default=0.0)
    return largest >= MATTERS and together[0].score >= max(_LEAST, least)


def _matters(case: Case, tried: list[Tried]) -> bool:
    return matters(alike(tried), _WITH_FRICTION if case.silent.any() else 0.0)


def _candidates(case: Case, tip: Phases, misfit: Misfit) -> list[Tried]:
    """All causes beside friction, the best first."""
    rub = misfit.whitened(case.friction)
    by_friction = fitted(misfit, rub, case.friction_spread).explained if rub.shape[1] else 0.0
    moves = shifts(case.slopes, case.stretches.noise, case.here, tip)
    found = []
    for suspect in SUSPECTS:
        count, cause = suspect.directions.shape[1], case.rubbing(case.along(suspect.directions))
        both = fitted(misfit, misfit.whitened(cause.slope), cause.spread)
        size, covariance = both.size[:count], both.covariance[:count, :count]
        found.append(_tried(suspect, size, covariance, both.explained - by_friction, moves))
    return sorted(found, key=lambda one: -one.score)


def _tried(
    suspect: Suspect,
    size: Float[np.ndarray, "p"],
    covariance: Float[np.ndarray, "p p"],
    explained: float,
    moves: Float[np.ndarray, "k 3 errors"],
) -> Tried:
    score, deviation = explained - _PRICE * (len(size) - 1), np.sqrt(np.diag(covariance))
    return Tried(score, suspect, size, deviation, explained, moves @ (suspect.directions @ size))


def _solved_if_gross(
    found: Reconstruction,
    case: Case,
    tip: Phases,
    misfit: Misfit,
    first: list[Tried],
) -> list[Tried]:
    """Causes solved for where the best is gross, those that the linear fit finds hopeless left
    out.
    """

    def left(solution: Solution) -> float:
        return solution.misfits[0].square + float(np.sum((solution.size / spread) ** 2))

    telling = [one for one in first if one.suspect in SUSPECTS[:TELLING]]
    best = next((one for one in alike(first) if one.suspect in SUSPECTS[:TELLING]), None)
    if best is None or not _gross(case, best):
        return first
    moves = shifts(case.slopes, case.stretches.noise, case.here, tip)
    out = []
    for one in telling:
        if one.score <= _HOPELESS * first[0].score:
            continue
        directions = one.suspect.directions
        spread = case.along(directions).spread
        start = np.clip(one.size, -spread, spread)
        solution = solved([case], directions, spread, found.friction, start)
        if len(spread) == 1 and left(solution) > _POOR * len(misfit.value):
            other = solved([case], directions, spread, found.friction, -start)
            solution = min(solution, other, key=left)
        explained = misfit.square - left(solution)
        out.append(_tried(one.suspect, solution.size, solution.covariance, explained, moves))
    return sorted(out, key=lambda one: -one.score) or first


def _gross(case: Case, one: Tried) -> bool:
    return bool(np.any(np.abs(one.size) > _GROSS * case.along(one.suspect.directions).spread))


def _tolerable(found: Reconstruction, case: Case) -> bool:
    """Whether errors of the sizes that the setup states explain it after all: solved for, as they
    are not linear.
    """
    stated = tolerances_of(case, found.reactions, found.rod.length)
    spread = np.linalg.norm(stated, axis=0)
    # A delay shows in no single contact.
    directions, spread = stated[:, spread > 0] / spread[spread > 0], spread[spread > 0]
    if not spread.size:
        return False
    size = solved([case], directions, spread, found.friction, np.zeros_like(spread)).size
    if np.max(np.abs(size) / spread) >= GROSS:
        return False
    about = case.about(directions @ size, found.friction)
    tip = about.phases([directions])
    misfit, _ = weighed(about, tip, found.reactions, found.rod.length)
    return not _matters(case, _candidates(about, tip, misfit))


def _apart(
    found: Reconstruction, case: Case, misfit: Misfit, best: Tried | None
) -> Bool[np.ndarray, "n"] | None:
    """Samples of one part of the sweep that alone contradict the rest, which agrees with the setup;
    None where there is no such part, or the best cause, if any, explains nearly all.
    """
    rows = len(misfit.value)
    excess = misfit.square - rows
    if best is not None and (excess < rows or best.explained > _NEARLY_ALL * excess):
        return None
    square = uniform_filter1d(np.sum(misfit.alone**2, axis=1), _WINDOW, mode="nearest")
    runs, _ = label(square > _PERHAPS)
    sure = np.unique(runs[square > (_GROSSLY if best is None else _SURELY)])
    apart = np.isin(runs, sure[sure > 0])
    if not 0 < np.mean(apart) < _MOST_APART:
        return None
    stretches = case.bench.stretches
    rest = case_of(stretches.chosen(~apart), case.bench.frame, found.friction)
    if rest is None or _of_case(found, rest).warnings:
        return None
    samples = np.zeros(len(found.kind), dtype=bool)
    runs, count = label(apart)
    for run in range(1, count + 1):
        own = np.flatnonzero(runs == run)
        # Those between neighbours, too.
        samples[stretches.first[own[0]] : stretches.last[own[-1]]] = True
    return samples


def _cause(found: Reconstruction, one: Tried, total: float) -> Cause:
    unit, factor = unit_of(found.rod, one.suspect.name)
    return Cause(
        one.suspect.name,
        unit,
        tuple(map(float, factor * one.size)),
        tuple(map(float, factor * one.deviation)),
        float(np.sqrt(max(one.explained, 0.0))),
        float(np.clip(one.explained / total, 0.0, 1.0)),
        one.shift * found.rod.length,
    )


def _shift_of_rows(
    found: Reconstruction, case: Case, groups: Sequence[Sequence[Tried]]
) -> Float[np.ndarray, "n 3"]:
    """World axes and units of the rod: of each group the largest, all together."""
    stretches = case.bench.stretches
    total = np.zeros((len(stretches.time), 3))
    for group in groups:
        each = np.stack([one.moved for one in group])
        largest = np.argmax(np.linalg.norm(each, axis=2), axis=0)
        total += each[largest, np.arange(len(total))]
    world = np.einsum("kij,kj->ki", stretches.turn, total) * found.rod.length
    assert found.reactions.time is not None
    return np.stack(
        [np.interp(found.reactions.time, stretches.time, world[:, axis]) for axis in range(3)],
        axis=1,
    )
