"""What else the phases of a contact may be, and with which probability: where a signal is weak, no
sequence of them is certain.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from vibrissa.inverse.smoothing.changes import (
    Model,
    Places,
    log_likelihoods,
    moved,
    phase_changes,
    room,
)
from vibrissa.inverse.smoothing.merging import TOGETHER
from vibrissa.inverse.smoothing.phases import runs_of
from vibrissa.inverse.smoothing.series import FREE, GO_ON, JUMP, KINK, TANGENTIAL, TIP, Labels

_DRAWN = 8
"""Of the labels: a power of two, so that odd multiples permute them."""
_EDGES = np.arange(7) / 6
"""Where a tangential phase may begin and end, in shares of the contact."""
_BENDS = (1.0, 1 / 4, 1 / 16)
"""Of the rates of which nothing is known."""
_GROUPS, _ROUGH_GROUPS = 350, 120
_HOPELESS = 40.0
"""Logarithm of the likelihood by which a rival may be behind at first, with few groups and one
scale: the scales change it by up to 28.
"""
_ALWAYS = 2
"""The given phases, and the tip throughout, with which all are compared."""
_MARGIN = 48
_LEAST_ROWS = 24


class Rivals(NamedTuple):
    """Labels of one contact, and their probabilities."""

    first: int
    last: int
    labels: list[Labels]
    """The first are the given ones."""
    probability: Float[np.ndarray, "k"]


def rivals_of(model: Model, labels: Labels, first: int, last: int) -> Rivals:
    """Tip contact throughout and one tangential phase, long or short, early or late, tried beside
    the phases of a contact; all are as usual.
    """
    count = last - first + 1
    candidates = [labels]
    if count >= _LEAST_ROWS:
        places = np.unique(first + np.round(_EDGES * count).astype(int))
        candidates.append(_with_tangential(labels, first, last, first, first))
        candidates += [
            _with_tangential(labels, first, last, int(low), int(high))
            for low in places
            for high in places
            if low < high
        ]
    rows = first - _MARGIN, last + _MARGIN
    if len(candidates) > 1:
        rough = log_likelihoods(model, candidates, *rows, max(TOGETHER, -(-count // _ROUGH_GROUPS)))
        likely = np.nan_to_num(rough, nan=-np.inf) > np.nanmax(rough) - _HOPELESS
        candidates = (
            [other for k, other in enumerate(candidates) if k < _ALWAYS or likely[k]]
            if likely[1:].any()
            else [labels]
        )
    values = np.zeros(len(candidates))
    if len(candidates) > 1:
        together = max(TOGETHER, -(-count // _GROUPS))
        # How sharply a motion bends is not known beforehand, and must not decide: all orders of
        # magnitude are as probable.
        each = log_likelihoods(model, candidates, *rows, together, _BENDS).reshape(len(_BENDS), -1)
        values = logsumexp(each - each[:, 1:2], axis=0)
    values = np.where(np.isfinite(values), values, -np.inf)
    values = (
        values if np.isfinite(values[0]) else np.where(np.arange(len(values)) == 0, 0.0, -np.inf)
    )
    return Rivals(first, last, candidates, np.exp(values - logsumexp(values)))


def _with_tangential(labels: Labels, first: int, last: int, low: int, high: int) -> Labels:
    """Tangential from `low` to before `high`, at the tip in the rest of the contact. Jumps stay."""
    phase, link = labels.phase.copy(), labels.link.copy()
    inside = np.arange(first + 1, last + 1)
    link[inside] = np.where(link[inside] == JUMP, JUMP, GO_ON)
    phase[first : last + 1] = TIP
    phase[low:high] = TANGENTIAL
    changes = inside[phase[inside] != phase[inside - 1]]
    link[changes] = np.maximum(link[changes], KINK)
    return labels._replace(phase=phase, link=link)


def drawn(model: Model, labels: Labels, places: dict[int, Places]) -> list[Labels]:
    """Equally probable labels: for each contact one of its rivals, each change at one quantile of
    its places; those of different contacts and changes unrelated.
    """
    rivals = [
        rivals_of(model, labels, first, last) for first, last in runs_of(labels.phase != FREE)
    ]
    changes = [change for change in phase_changes(labels) if change in places]
    found = []
    for k in range(_DRAWN):
        other = labels
        for j, change in enumerate(changes):
            quantile = places[change].quantile(_share(k, j))
            other = moved(other, change, int(np.clip(quantile, *room(other, change))))
        for j, rival in enumerate(rivals, len(changes)):
            number = int(np.searchsorted(np.cumsum(rival.probability), _share(k, j)))
            if 0 < number < len(rival.labels):
                other = _spliced(other, rival.labels[number], rival.first, rival.last)
        found.append(other)
    return found


def _share(k: int, j: int) -> float:
    return ((2 * j + 1) * k % _DRAWN + 0.5) / _DRAWN


def _spliced(labels: Labels, other: Labels, first: int, last: int) -> Labels:
    """One contact of the other."""
    rows = slice(first, last + 1)
    phase, link = labels.phase.copy(), labels.link.copy()
    phase[rows], link[rows] = other.phase[rows], other.link[rows]
    return labels._replace(phase=phase, link=link)
