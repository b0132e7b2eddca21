"""Which of several contacts that explain a row's reactions continues the sweep, and how sure that
is: a hidden Markov model along a touch, whose states are the contacts listed for each row, each on
the rod's flank or at its tip.

All of them explain the same readings, so a contact counts by how much better than the place's own
past it predicts where it is listed: a wrong one goes on like its past, and that ratio is the same
for readings and for places, however noisy. Of two places that both go on, neither is more probable,
be one steadier than the other. What tells is a row with one contact before or after, a leap, and a
place that stays at the tip within its errors, where a wrong one is by chance only.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.contacts import Status
from vibrissa.inverse.candidates import open_rows
from vibrissa.inverse.kernels import candidates_of, deviations_of_candidates
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.smoothing.model import Flags, Samples
from vibrissa.numerics.runs import runs

_SURE = 0.95
"""Probability from which a contact counts as the one that continues."""
_LEAP = np.log(1e-3)
"""Logarithm of the probability that a contact leaps along the rod, or comes to its tip or leaves
it, between two samples.
"""
_ANEW = np.log(0.1)
"""The same that a wrong place turns up anywhere, however near to another one."""
_MOST, _NOISE, _LEAST = 0.9, 1.645**2, 1e-3
"""Share of the moves between two samples that count as usual, the square below which that share of
normal errors lies, and how far those moves are at least [L].
"""

_log_sum = np.logaddexp.reduce
"""Of few numbers in a hundredth of the time that SciPy's takes."""


class Places(NamedTuple):
    """Where on the rod one row's contact may be, and standard deviations [L]."""

    arc_length: Float[np.ndarray, "k"]
    deviation: Float[np.ndarray, "k"]


class Branch(NamedTuple):
    """Of each row of one trail."""

    arc_length: Samples
    """Of the most probable contact [L]; 1 where the row lists one at most."""
    probability: Samples
    """That it is the true one of those listed; 1 where there is no other."""
    sure: Flags
    """Rows that list several, one of which is that probable."""


def branch_of(found: Reconstruction) -> Branch:
    """The contacts that continue each other along one trail (n, …)."""
    count, length = len(found.kind), found.rod.length
    branch = Branch(np.ones(count), np.ones(count), np.zeros(count, dtype=bool))
    setting, rows, samples = open_rows(found)
    if not rows.size:
        return branch
    assert found.arc_length_deviation is not None
    own, spread = found.arc_length / length, found.arc_length_deviation / length
    alone = np.isfinite(own + spread) & found.in_contact & (found.status == Status.OK)
    listed = {int(row): Places(own[[row]], spread[[row]]) for row in np.flatnonzero(alone)}
    seen: Any = candidates_of(setting, samples)
    deviations = np.asarray(deviations_of_candidates(setting, samples))
    for row, place, fits, deviation in zip(
        rows, seen[0].arc_length, seen[1], deviations, strict=True
    ):
        listed[int(row)] = Places(place[fits], deviation[fits])
    touches = [
        known
        for start, stop in runs(found.in_contact)
        if (known := [row for row in range(start, stop) if row in listed])
    ]
    pace = _pace([[listed[row] for row in known] for known in touches])
    for known in touches:
        places = [listed[row] for row in known]
        paces = pace * np.diff(known)
        for row, place, weight in zip(known, places, marginals(places, paces), strict=True):
            if not alone[row]:
                best = int(np.argmax(weight))
                branch.arc_length[row] = place.arc_length[best]
                branch.probability[row] = weight[best]
                branch.sure[row] = weight[best] >= _SURE
    return branch


def _pace(touches: list[list[Places]]) -> float:
    """How far a contact moves from one sample to the next at most, whichever it is [L]."""
    squares = []
    for before, after in (pair for places in touches for pair in pairwise(places)):
        away, noise = _apart(before, after)
        nearest = abs(away).argmin(axis=0), np.arange(away.shape[1])
        squares.append((away**2 - _NOISE * noise)[nearest])
    square = np.quantile(np.concatenate(squares), _MOST) if squares else 0.0
    return float(np.sqrt(max(square, _LEAST**2)))


def _apart(before: Places, after: Places) -> tuple[Float[np.ndarray, "j k"], ...]:
    """From each place to each of the next row, and the variance of that."""
    away = after.arc_length - before.arc_length[:, None]
    return away, after.deviation**2 + before.deviation[:, None] ** 2


def _density(away: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """Logarithm of a normal density [1/L]; that of a place anywhere on the rod is 0."""
    return -(away**2 / variance + np.log(2 * np.pi * variance)) / 2


def _at_tip(places: Places, pace: float = 0.0) -> Float[np.ndarray, "k"]:
    """The same of each listed place, the contact being at the tip or just leaving it."""
    return _density(places.arc_length - 1, places.deviation**2 + pace**2)


def _moves(past: Places, after: Places, pace: float) -> tuple[np.ndarray, Places]:
    """Logarithm (2j, 2k) of how well a contact on the flank (j) or at the tip (j) predicts the next
    row's listed places, for one on the flank (k) or at the tip (k) there, relative to each place's
    own past; and that past with the next row in it, by a Kalman filter.
    """
    away, noise = _apart(past, after)
    onward = _density(away, noise + pace**2)
    own, last = onward.max(axis=0), onward.argmax(axis=0)
    each, at_tip = np.zeros_like(onward), _at_tip(after)
    leaving = np.logaddexp(_at_tip(after, pace) + _LEAP, _LEAP)
    moves = np.block(
        [[np.logaddexp(onward, _LEAP), at_tip + _LEAP + each], [leaving + each, at_tip + each]]
    )
    wrong = np.maximum(own, _ANEW)
    before = np.where(own > _ANEW, past.deviation[last] ** 2 + pace**2, np.inf)
    gain = 1 / (1 + after.deviation**2 / before)
    arc_length = after.arc_length - (1 - gain) * away[last, np.arange(len(last))]
    return moves - np.tile(wrong, 2), Places(arc_length, after.deviation * np.sqrt(gain))


def marginals(places: list[Places], paces: Float[np.ndarray, "m"]) -> list[np.ndarray]:
    """Probability (k,) of each place of each row of a touch given all rows (forward-backward), by
    how far a contact usually moves between two rows [L].
    """
    moves, past = [], places[0]
    for after, pace in zip(places[1:], paces, strict=True):
        move, past = _moves(past, after, pace)
        moves.append(move)
    ahead, back = ([np.zeros(2 * len(place.arc_length)) for place in places] for _ in range(2))
    ahead[0] = np.concatenate([np.zeros_like(places[0].arc_length), _at_tip(places[0])])
    for i, move in enumerate(moves):
        ahead[i + 1] = _log_sum(ahead[i][:, None] + move, axis=0)
        ahead[i + 1] -= _log_sum(ahead[i + 1])
    for i, move in reversed(list(enumerate(moves))):
        back[i] = _log_sum(move + back[i + 1], axis=1)
        back[i] -= _log_sum(back[i])
    return [
        np.exp(a + b - _log_sum(a + b)).reshape(2, -1).sum(axis=0)
        for a, b in zip(ahead, back, strict=True)
    ]
