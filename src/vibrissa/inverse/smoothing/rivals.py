"""What else the phases of a contact may be, and with which probability: where a signal is weak, no
sequence of them is certain.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from vibrissa.inverse.smoothing.changes import Places, log_likelihoods, moved, room
from vibrissa.inverse.smoothing.merging import TOGETHER
from vibrissa.inverse.smoothing.phases import runs_of
from vibrissa.inverse.smoothing.series import FREE, JUMP, KINK, TANGENTIAL, TIP, Fit, Labels

_DRAWN = 8
"""Of the labels: a power of two, so that odd multiples permute them."""
_EDGES = np.arange(7) / 6
"""Where a tangential phase may begin and end, in shares of the contact."""
_BENDS = (1.0, 1 / 4, 1 / 16)
"""Of the rates of which nothing is known."""
_GROUPS, _ROUGH_GROUPS = 350, 120
"""Groups of a contact in which rivals are compared, and are at first."""
_HOPELESS = 40.0
"""Logarithm of the likelihood by which a rival may be behind at first, with few groups and one
scale: the scales change it by up to 28.
"""
_ALWAYS = 2
"""The given phases, and the tip throughout, with which all are compared."""
_MARGIN = 48
_LEAST_ROWS = 24
"""Samples of a contact that may have a tangential phase of four in the least of its sixths."""


class Rivals(NamedTuple):
    """Labels of one contact, and their probabilities."""

    rows: slice
    labels: list[Labels]
    """The first are the given ones."""
    probability: Float[np.ndarray, "k"]


def _rivals_of(fit: Fit, first: int, last: int) -> Rivals:
    """Tip contact throughout and one tangential phase, long or short, early or late, tried beside
    the phases of a contact; all are as usual.
    """
    count, rows = last - first + 1, slice(first, last + 1)
    alone = Rivals(rows, [fit.labels], np.ones(1))
    if count < _LEAST_ROWS:
        return alone
    places = np.unique(first + np.round(_EDGES * count).astype(int)).tolist()
    pairs = [(first, first)] + [(low, high) for low in places for high in places if low < high]
    candidates = [fit.labels, *(_with_tangential(fit.labels, rows, *pair) for pair in pairs)]
    around = first - _MARGIN, last + _MARGIN
    rough = log_likelihoods(fit, candidates, *around, max(TOGETHER, -(-count // _ROUGH_GROUPS)))
    likely = rough > rough.max() - _HOPELESS
    if not likely[1:].any():
        return alone
    likely[:_ALWAYS] = True
    candidates = [other for other, keep in zip(candidates, likely, strict=True) if keep]
    # How sharply a motion bends is not known beforehand, and must not decide: all orders of
    # magnitude are as probable.
    together = max(TOGETHER, -(-count // _GROUPS))
    each = log_likelihoods(fit, candidates, *around, together, _BENDS).reshape(len(_BENDS), -1)
    values = logsumexp(each - each[:, 1:2], axis=0)
    if not np.isfinite(values[0]):
        return alone
    values[~np.isfinite(values)] = -np.inf
    return Rivals(rows, candidates, np.exp(values - logsumexp(values)))


def _with_tangential(labels: Labels, rows: slice, low: int, high: int) -> Labels:
    """Tangential from `low` to before `high`, at the tip in the rest of the contact. Jumps stay."""
    other, inside = labels.copy(), slice(rows.start + 1, rows.stop)
    other.phase[rows], other.phase[low:high] = TIP, TANGENTIAL
    jumps = np.where(labels.link[inside] == JUMP, JUMP, 0)
    other.link[inside] = np.maximum(jumps, KINK * other.begins[inside])
    return other


def drawn(fit: Fit, places: dict[int, Places]) -> list[Labels]:
    """Equally probable labels: for each contact one of its rivals, each change at one quantile of
    its places; those of different contacts and changes unrelated.
    """
    rivals = [_rivals_of(fit, *run) for run in runs_of(fit.labels.phase != FREE)]
    changes = [change for change in fit.labels.changes if change in places]
    found = []
    for k in range(_DRAWN):
        other = fit.labels
        for j, change in enumerate(changes):
            quantile = places[change].quantile(_share(k, j))
            other = moved(other, change, int(np.clip(quantile, *room(other, change))))
        for j, rival in enumerate(rivals, len(changes)):
            number = int(np.searchsorted(np.cumsum(rival.probability), _share(k, j)))
            if 0 < number < len(rival.labels):
                other = other.copy()
                other.phase[rival.rows] = rival.labels[number].phase[rival.rows]
                other.link[rival.rows] = rival.labels[number].link[rival.rows]
        found.append(other)
    return found


def _share(k: int, j: int) -> float:
    return ((2 * j + 1) * k % _DRAWN + 0.5) / _DRAWN
