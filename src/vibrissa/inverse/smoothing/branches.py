"""Which of several contacts that explain a row's reactions continues the sweep, and how sure that
is: a hidden Markov model whose states are the contacts listed for each row, along a touch.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from vibrissa.contacts import Status
from vibrissa.inverse.candidates import open_rows
from vibrissa.inverse.kernels import candidates_of, deviations_of_candidates
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.smoothing.model import Flags, Samples
from vibrissa.numerics.runs import runs

_SURE = 0.95
"""Probability from which a contact counts as the one that continues."""
_LEAP = 1e-3
"""Probability that a contact leaps along the rod between two samples."""
_MOST, _LEAST = 0.9, 1e-3
"""Share of the moves between two samples that count as usual, and how far those are at least [L].
"""


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
        [row for row in range(start, stop) if row in listed]
        for start, stop in runs(found.in_contact)
    ]
    pace = _pace([[listed[row].arc_length for row in known] for known in touches])
    for known in touches:
        places = [listed[row] for row in known]
        moves = [
            _moves(a, b, pace * (after - before))
            for (a, b), (before, after) in zip(pairwise(places), pairwise(known), strict=True)
        ]
        for row, place, weight in zip(known, places, _marginals(places, moves), strict=True):
            if not alone[row]:
                best = int(np.argmax(weight))
                branch.arc_length[row] = place.arc_length[best]
                branch.probability[row] = weight[best]
                branch.sure[row] = weight[best] >= _SURE
    return branch


def _pace(touches: list[list[np.ndarray]]) -> float:
    """How far a contact moves from one sample to the next at most, whichever it is [L]."""
    steps = [
        abs(after[:, None] - before).min(axis=1)
        for places in touches
        for before, after in pairwise(places)
    ]
    return max(_LEAST, float(np.quantile(np.concatenate(steps), _MOST)) if steps else 0.0)


def _moves(before: Places, after: Places, pace: float) -> Float[np.ndarray, "j k"]:
    """Logarithm of how well one place continues another, relative to a perfect continuation: how
    sharply either is known does not count.
    """
    away = after.arc_length - before.arc_length[:, None]
    spread = np.sqrt(pace**2 + after.deviation**2 + before.deviation[:, None] ** 2)
    return np.log((1 - _LEAP) * np.exp(-((away / spread) ** 2) / 2) + _LEAP)


def _marginals(places: list[Places], moves: list[np.ndarray]) -> list[np.ndarray]:
    """Probability of each place given all rows (forward-backward)."""
    ahead, back = ([np.zeros(len(place.arc_length)) for place in places] for _ in range(2))
    for i, move in enumerate(moves):
        ahead[i + 1] = logsumexp(ahead[i][:, None] + move, axis=0)
        ahead[i + 1] -= logsumexp(ahead[i + 1])
    for i, move in reversed(list(enumerate(moves))):
        back[i] = logsumexp(move + back[i + 1], axis=1)
        back[i] -= logsumexp(back[i])
    return [np.exp(a + b - logsumexp(a + b)) for a, b in zip(ahead, back, strict=True)]
