"""What one trail says of its setup: causes of error, each as large as explains most of the misfit,
and what is concluded from them.
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label, uniform_filter1d

from vibrissa.inverse.checks.case import (
    GROSS,
    Case,
    Misfit,
    Numbers,
    Phases,
    Solution,
    Square,
    Tried,
    case_of,
    solved,
)
from vibrissa.inverse.checks.findings import Cause, SetupCheck
from vibrissa.inverse.checks.rig import SUSPECTS, TELLING, frame_of
from vibrissa.inverse.checks.stretches import stretches_of
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
def judged(found: Reconstruction) -> SetupCheck:
    """Findings of one trail."""
    averaged = stretches_of(found)
    if averaged is not None:
        case = case_of(averaged, frame_of(found.reactions, found.rod.length), found.friction)
        if case is not None:
            return _of_case(found, case)
    return SetupCheck(shift=np.zeros_like(found.point), friction=found.friction or 0.0)


def _of_case(found: Reconstruction, case: Case) -> SetupCheck:
    tip = case.phases()
    misfit, friction = case.weighed(tip, found.reactions, found.rod.length)
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
    misread = contradicted and not lines
    if misread:
        lines = [unexplained_line(found, case, tip, misfit)]
    excess = max(misfit.square - len(misfit.value), 1.0)
    return SetupCheck(
        shift=_shift_of_rows(found, case, groups),
        friction=friction,
        causes=tuple(_cause(found, one, excess) for one in first),
        reduced_chi_square=misfit.square / len(misfit.value),
        named=tuple(tuple(one.name for one in group) for group in groups),
        warnings=tuple(lines),
        misread=misread,
        apart=rows,
    )


def _explained(
    found: Reconstruction, case: Case, tip: Phases, first: list[Tried]
) -> tuple[list[list[Tried]], list[str]]:
    """Up to three groups of causes, one after the other, each with the likeliest before taken off,
    and a line on each.
    """
    groups: list[list[Tried]] = []
    lines: list[str] = []
    tried = first
    while len(groups) < _MOST and _enough(_alike(tried), _FURTHER * first[0].score):
        groups.append(_alike(tried))
        lines.append(causes_line(found, case, tip, groups[-1]))
        step, most = SUSPECTS[tried[0].name] @ tried[0].size, GROSS * case.spread
        case = case.about(case.errors + np.clip(step, -most, most), found.friction)
        tip = case.phases(started=False)
        misfit, _ = case.weighed(tip, found.reactions, found.rod.length)
        tried = _candidates(case, tip, misfit)
    return groups, lines


def _alike(tried: list[Tried]) -> list[Tried]:
    """The best, and those that explain about as much."""
    least = tried[0].score * (1 - _ALIKE) - _ALIKE_BY
    return [one for one in tried if one.score >= least]


def _enough(together: list[Tried], least: float) -> bool:
    """Whether causes that explain about the same explain enough, and would move contacts by more
    than error bars hold.
    """
    largest = max((one.largest for one in together), default=0.0)
    return largest >= MATTERS and together[0].score >= max(_LEAST, least)


def _matters(case: Case, tried: list[Tried]) -> bool:
    return _enough(_alike(tried), _WITH_FRICTION if case.silent.any() else 0.0)


def _candidates(case: Case, tip: Phases, misfit: Misfit) -> list[Tried]:
    """All causes beside friction, the best first."""
    by_friction = misfit.fitted(case.rubbing(case.along(np.zeros((len(case.spread), 0))))).explained
    moves, found = case.shifts(tip), []
    for name, directions in SUSPECTS.items():
        count = directions.shape[1]
        both = misfit.fitted(case.rubbing(case.along(directions)))
        size, covariance = both.size[:count], both.covariance[:count, :count]
        found.append(_tried(name, size, covariance, both.explained - by_friction, moves))
    return sorted(found, key=lambda one: -one.score)


def _tried(
    name: str,
    size: Numbers,
    covariance: Square,
    explained: float,
    moves: Float[np.ndarray, "k 3 errors"],
) -> Tried:
    score, moved = explained - _PRICE * (len(size) - 1), moves @ (SUSPECTS[name] @ size)
    return Tried(score, name, size, np.sqrt(np.diag(covariance)), explained, moved)


def _solved_if_gross(
    found: Reconstruction, case: Case, tip: Phases, misfit: Misfit, first: list[Tried]
) -> list[Tried]:
    """Causes solved for where the best is gross, those that the linear fit finds hopeless left
    out.
    """
    best = next((one for one in _alike(first) if one.name in TELLING), None)
    if best is None or not np.any(
        np.abs(best.size) > _GROSS * case.along(SUSPECTS[best.name]).spread
    ):
        return first
    moves, out = case.shifts(tip), []
    for one in first:
        if one.name not in TELLING or one.score <= _HOPELESS * first[0].score:
            continue
        directions = SUSPECTS[one.name]
        spread = case.along(directions).spread

        def left(solution: Solution, spread: Numbers = spread) -> float:
            return solution.misfits[0].square + float(np.sum((solution.size / spread) ** 2))

        start = np.clip(one.size, -spread, spread)
        solution = solved([case], directions, spread, found.friction, start)
        if len(spread) == 1 and left(solution) > _POOR * len(misfit.value):
            other = solved([case], directions, spread, found.friction, -start)
            solution = min(solution, other, key=left)
        explained = misfit.square - left(solution)
        out.append(_tried(one.name, solution.size, solution.covariance, explained, moves))
    return sorted(out, key=lambda one: -one.score) or first


def _tolerable(found: Reconstruction, case: Case) -> bool:
    """Whether errors of the sizes that the setup states explain it after all: solved for, as they
    are not linear.
    """
    stated = case.tolerances(found.reactions, found.rod.length)
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
    misfit, _ = about.weighed(tip, found.reactions, found.rod.length)
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
    unit, factor = unit_of(found.rod, one.name)
    estimate, deviation = (tuple((factor * part).tolist()) for part in (one.size, one.deviation))
    significance = float(np.sqrt(max(one.explained, 0.0)))
    explained = float(np.clip(one.explained / total, 0.0, 1.0))
    shift = one.shift * found.rod.length
    return Cause(one.name, unit, estimate, deviation, significance, explained, shift)


def _shift_of_rows(
    found: Reconstruction, case: Case, groups: list[list[Tried]]
) -> Float[np.ndarray, "n 3"]:
    """World axes and units of the rod: of each group the largest, all together."""
    stretches, time = case.bench.stretches, found.reactions.time
    assert time is not None
    total = np.zeros((len(stretches.time), 3))
    for group in groups:
        each = np.stack([one.moved for one in group])
        largest = np.argmax(np.linalg.norm(each, axis=2), axis=0)
        total += each[largest, np.arange(len(total))]
    world = np.einsum("kij,kj->ki", stretches.turn, total) * found.rod.length
    return np.stack([np.interp(time, stretches.time, axis) for axis in world.T], axis=1)
