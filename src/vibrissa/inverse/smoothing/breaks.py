"""Where the motion of a contact breaks: steps of the wrench, shocks that are no noise."""

import numpy as np
from jaxtyping import Int
from scipy.ndimage import maximum_filter1d, median_filter
from scipy.special import chdtri

from vibrissa.inverse.smoothing.changes import moved
from vibrissa.inverse.smoothing.kalman import RATE, States
from vibrissa.inverse.smoothing.manifold import LOADS
from vibrissa.inverse.smoothing.model import (
    FREE,
    GO_ON,
    JUMP,
    KINK,
    TINY,
    Codes,
    Fit,
    Labels,
    Samples,
)

_FALSE_JUMPS = 1e-3
"""Expected number of jumps found in a recording that has none."""
_APART = 12
"""Least samples between two breaks: closer ones are one."""
_SIDE, _HALF = 3, 25
"""Samples to either side of a step, and of its neighbourhood."""
_STEP, _UNUSUAL = 12.0, 6.0
"""Standard deviations of a step, and its size over the usual difference: a contact that slides on,
also through a change of phase, is far from both.
"""


def with_snaps(fit: Fit) -> Labels:
    """Jumps where the wrench steps from one sample to the next, far from its noise and from its
    course before and after; a change of phase beside one is moved there.
    """
    labels, sound, count = fit.labels, fit.series.sound, len(fit.labels.phase)
    if count < 2 * _HALF or not sound.any():
        return labels
    known, touching = np.flatnonzero(sound), (labels.phase != FREE) & sound
    parts = [np.interp(np.arange(count), known, part) for part in fit.series.whitened[known].T]
    load = np.stack(parts, axis=1)
    # Medians of some samples to either side: a spike is no step.
    around = np.median(np.lib.stride_tricks.sliding_window_view(load, _SIDE, axis=0), axis=-1)
    step = np.zeros(count)
    step[_SIDE : count - _SIDE + 1] = np.linalg.norm(around[_SIDE:] - around[:-_SIDE], axis=1)
    usual = median_filter(step, 2 * _HALF + 1, mode="nearest")
    largest = step == maximum_filter1d(step, 2 * _APART + 1, mode="nearest")
    single = np.linalg.norm(np.diff(load, axis=0, prepend=load[:1]), axis=1)
    inside = touching & np.append(False, touching[:-1])
    for place in np.flatnonzero(inside & largest & (step > _STEP) & (step > _UNUSUAL * usual)):
        row = place - 1 + int(np.argmax(single[place - 1 : place + 2]))
        for change in labels.changes:
            if abs(change - row) <= _APART:
                labels = moved(labels, change, int(row))
        labels = labels.copy()
        labels.link[row] = JUMP
    return labels


def with_jumps(fit: Fit) -> Labels:
    """With JUMP or KINK where the motion of the contact breaks: at shocks to its state that noise
    does not explain (de Jong & Penzer, *JASA* 93, 1998).
    """
    labels = fit.labels.copy()
    touching = labels.phase != FREE
    rows = np.flatnonzero(touching[1:] & touching[:-1] & (labels.link[1:] == GO_ON)) + 1
    rates = RATE.start + np.arange(LOADS)
    turn = _shock(fit.states, rows, rates)
    shock = _shock(fit.states, rows, np.append(np.arange(LOADS), rates))
    level = _FALSE_JUMPS / max(len(rows), 1)
    limit, value_limit = chdtri(2 * LOADS, level), chdtri(LOADS, level)
    for k in np.argsort(-shock):
        if shock[k] < limit:
            break
        if np.abs(labels.breaks - rows[k]).min(initial=_APART) >= _APART:
            labels.link[rows[k]] = KINK if shock[k] - turn[k] < value_limit else JUMP
    return labels


def _shock(states: States, rows: Codes, entries: Int[np.ndarray, "k"]) -> Samples:
    """Chi-square of a shock to these entries of the state on the way to a sample."""
    information = states.information[rows][:, entries][:, :, entries]
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", information), TINY))
    relative = information / scale[:, :, None] / scale[:, None, :]
    inverse = np.linalg.pinv(relative, rcond=1e-10, hermitian=True)
    pull = states.pull[rows][:, entries] / scale
    return np.einsum("ni,nij,nj->n", pull, inverse, pull)
