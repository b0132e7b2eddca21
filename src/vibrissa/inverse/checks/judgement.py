"""What one trail says of its setup."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import label, uniform_filter1d

from vibrissa.inverse.checks.candidates import Tried, alike, candidates, matters, solved_for
from vibrissa.inverse.checks.case import (
    GROSS,
    Case,
    case_of,
    phases_by,
    solved,
    spread_along,
    tolerances_of,
    tolerated,
    weighed,
)
from vibrissa.inverse.checks.findings import Cause, SetupCheck
from vibrissa.inverse.checks.regression import Misfit
from vibrissa.inverse.checks.rig import frame_of
from vibrissa.inverse.checks.sentences import apart_line, causes_line, unexplained_line, unit_of
from vibrissa.inverse.checks.stretches import stretches_of
from vibrissa.inverse.checks.suspects import SUSPECTS, TELLING
from vibrissa.inverse.result import Reconstruction

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
    nothing = SetupCheck((), 1.0, found.friction or 0.0, (), (), shift)
    averaged = stretches_of(found)
    case = (
        None
        if averaged is None
        else case_of(averaged, frame_of(found.reactions, found.rod.length), found.friction)
    )
    return nothing if case is None else _of_case(found, case, shift)


def _of_case(found: Reconstruction, case: Case, shift: Float[np.ndarray, "n 3"]) -> SetupCheck:
    tip = phases_by(case, [suspect.directions for suspect in SUSPECTS[:TELLING]])
    misfit, friction = weighed(case, tip, tolerated(case, found.reactions, found.rod.length))
    first = candidates(case, tip, misfit)
    contradicted = matters(
        alike(first), _WITH_FRICTION if case.silent.any() else 0.0
    ) and not _tolerable(found, case)
    apart = _apart(misfit, first[0] if contradicted else None)
    if apart is not None:
        rest = case_of(case.bench.stretches.chosen(~apart), case.bench.frame, found.friction)
        if rest is not None and not _of_case(found, rest, shift).warnings:
            rows = _rows_of(case, apart, len(found.kind))
            line = apart_line(found, misfit, rows)
            return replace(
                _concluded(found, case, misfit, friction, first, [], []),
                warnings=(line,),
                apart=rows,
            )
    if not contradicted:
        return _concluded(found, case, misfit, friction, first, [], [])
    best = next((one for one in alike(first) if one.suspect in SUSPECTS[:TELLING]), None)
    if (
        best is not None
        and float(np.max(np.abs(best.size) / spread_along(case, best.suspect.directions))) > _GROSS
    ):
        first = solved_for(found, case, tip, misfit, first)
    groups: list[list[Tried]] = []
    lines: list[str] = []
    about = case
    tried = first
    while len(groups) < _MOST and matters(alike(tried), _FURTHER * first[0].score):
        groups.append(alike(tried))
        lines.append(causes_line(found, about, tip, groups[-1]))
        errors = about.errors + np.clip(
            tried[0].suspect.directions @ tried[0].size, -GROSS * case.spread, GROSS * case.spread
        )
        about = about.about(errors, found.friction)
        tip = phases_by(
            about, [suspect.directions for suspect in SUSPECTS[:TELLING]], started=False
        )
        tried = candidates(
            about, tip, weighed(about, tip, tolerated(about, found.reactions, found.rod.length))[0]
        )
    concluded = _concluded(found, case, misfit, friction, first, groups, lines)
    return (
        concluded
        if lines
        else replace(
            concluded, warnings=(unexplained_line(found, case, tip, misfit),), misread=True
        )
    )


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
    tip = phases_by(about, [directions])
    tried = candidates(
        about, tip, weighed(about, tip, tolerated(about, found.reactions, found.rod.length))[0]
    )
    return not matters(alike(tried), _WITH_FRICTION if case.silent.any() else 0.0)


def _apart(misfit: Misfit, best: Tried | None) -> Bool[np.ndarray, "k"] | None:
    """Stretches of one part of the sweep that alone contradict the rest; None where there is no
    such part, or the best cause, if any, explains nearly all.
    """
    rows = len(misfit.value)
    excess = float(misfit.value @ misfit.value) - rows
    if best is not None and (excess < rows or best.explained > _NEARLY_ALL * excess):
        return None
    square = uniform_filter1d(np.sum(misfit.alone**2, axis=1), _WINDOW, mode="nearest")
    runs, _ = label(square > _PERHAPS)
    sure = np.unique(runs[square > (_GROSSLY if best is None else _SURELY)])
    apart = np.isin(runs, sure[sure > 0])
    return apart if 0 < np.mean(apart) < _MOST_APART else None


def _rows_of(case: Case, chosen: Bool[np.ndarray, "k"], count: int) -> Bool[np.ndarray, "n"]:
    """Samples of stretches, and those between neighbours."""
    rows = np.zeros(count, dtype=bool)
    runs, found = label(chosen)
    for run in range(1, found + 1):
        own = np.flatnonzero(runs == run)
        rows[case.bench.stretches.first[own[0]] : case.bench.stretches.last[own[-1]]] = True
    return rows


def _concluded(
    found: Reconstruction,
    case: Case,
    misfit: Misfit,
    friction: float,
    first: list[Tried],
    groups: list[list[Tried]],
    lines: list[str],
) -> SetupCheck:
    square, rows = float(misfit.value @ misfit.value), len(misfit.value)
    return SetupCheck(
        tuple(_cause(found, one, max(square - rows, 1.0)) for one in first),
        square / rows,
        friction,
        tuple(tuple(one.suspect.name for one in group) for group in groups),
        tuple(lines),
        _shift_of_rows(found, case, groups),
    )


def _cause(found: Reconstruction, one: Tried, total: float) -> Cause:
    unit, factor = unit_of(found, one.suspect.name)
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
