"""When a contact begins and ends: the most probable instant, its standard deviation, and the least
that noise allows.
"""

from typing import NamedTuple

import numpy as np

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.changes import deviation_of, log_likelihoods
from vibrissa.inverse.smoothing.kalman import RATE, Gaussian
from vibrissa.inverse.smoothing.manifold import LOADS
from vibrissa.inverse.smoothing.merging import group_starts, merged
from vibrissa.inverse.smoothing.model import steps_of
from vibrissa.inverse.smoothing.series import FREE, GO_ON, JUMP, KINK, Fit, Labels

_BEFORE, _AFTER = 96, 128
"""Samples about a start from which its likelihood is taken."""
_COARSE, _FINE = np.arange(-64.0, 33.0, 4.0), np.arange(-8.0, 8.0, 0.5)
"""Places tried [samples] about the first guess, then about the best one."""
_NEGLIGIBLE = 1e-3
"""Probability of the outermost places at which no more need be tried."""
_LEAST_SHARE = 0.1
"""Of the time to the first sample: a shorter one is no motion to the filter."""


class Onset(NamedTuple):
    """The beginning of a contact, in samples of its series."""

    place: float
    """Between two samples: 7.25 is a quarter of the way from sample 7 to sample 8."""
    time: float
    deviation: float
    limit: float


def reversed_fit(fit: Fit) -> Fit:
    """The same series run backwards: an end becomes a beginning. An integrated Wiener process has
    the same law both ways.
    """
    back = fit.rows(slice(None, None, -1))
    # Of what later samples alone tell of the drift nothing is kept.
    states = back.states._replace(expected=back.states.mean, uncertainty=back.states.covariance)
    time = fit.series.time[-1] - back.series.time
    # A break between two samples stays between them; all else begins with whole steps.
    link = np.append(GO_ON, fit.labels.link[:0:-1])
    return back._replace(
        series=back.series._replace(time=time),
        labels=back.labels._replace(link=link, share=np.ones(len(link))).copy(),
        states=states,
    )


def onset_at(labels: Labels, first: int, place: float) -> Labels:
    """Labels with the contact that begins at sample `first` beginning at `place` instead."""
    begins = int(np.floor(place)) + 1
    phase, link, share, pace = placed = labels.copy()
    phase[begins:first], pace[begins:first] = phase[first], pace[first]
    phase[first:begins] = FREE
    link[min(first, begins) : max(first, begins) + 1] = GO_ON
    link[begins], share[first] = KINK, 1.0
    share[begins] = max(begins - place, _LEAST_SHARE)
    return placed


def onset_of(fit: Fit, first: int) -> Onset:
    """Begin of the contact whose first sample is `first`, by likelihood; its deviation is that of
    the likelihood taken as a density.
    """
    labels, place = fit.labels, first - 0.5
    for offsets in (_COARSE, _FINE, _FINE):
        places = np.unique(np.clip(place + offsets, *_room(labels, first)))
        values = log_likelihoods(
            fit,
            [onset_at(labels, first, part) for part in places],
            int(places[0]) - _BEFORE,
            max(int(places[-1]), first) + _AFTER,
        )
        weights = np.exp(values - values.max())
        weights /= weights.sum()
        place = float(places[int(np.argmax(values))])
        if offsets is _FINE and weights[[0, -1]].max() < _NEGLIGIBLE:
            break
    mean, time = float(weights @ places), fit.series.time
    return Onset(
        mean,
        float(np.interp(mean, np.arange(len(time)), time)),
        deviation_of(places, weights) * fit.series.step,
        _limit(fit._replace(labels=onset_at(labels, first, mean)), int(np.floor(mean)) + 1),
    )


def _room(labels: Labels, first: int) -> tuple[float, float]:
    """From the contact before to the next break of this one."""
    before = np.flatnonzero(labels.phase[:first] != FREE)
    breaks = np.flatnonzero((labels.link > GO_ON) | labels.begins)
    low = max(before, default=-2) + 2.0
    high = min(breaks[breaks > first], default=len(labels.phase)) - 3.0
    return min(low, first - 0.5), max(high, first - 0.5)


def _limit(fit: Fit, first: int) -> float:
    """Cramér-Rao: (gᵀ P⁻¹ g)^(−½), g the rates of the loads at the beginning, P the covariance with
    which what follows tells the loads there [s].
    """
    cut = fit.rows(slice(first, None))
    link = cut.labels.link.copy()
    link[0] = JUMP
    cut = cut._replace(labels=cut.labels._replace(link=link, share=np.ones(len(link))))
    before = Gaussian(*(part[0] for part in cut.states.zero))
    steps = merged(steps_of(cut), group_starts([cut.labels]))
    states = kalman.smoothed(steps, fit.intensities, kalman.at_rest(before))
    rates, told = states.mean[0, RATE][:LOADS], states.covariance[0, :LOADS, :LOADS]
    return float(max(rates @ np.linalg.solve(told, rates), 1e-300)) ** -0.5
