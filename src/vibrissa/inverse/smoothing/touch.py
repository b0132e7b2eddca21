"""When a contact begins and ends: the most probable instant, its standard deviation, and the least
that noise allows.
"""

from typing import NamedTuple

import numpy as np

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.changes import Model, log_likelihoods
from vibrissa.inverse.smoothing.kalman import SIZE, States, fetched
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, COORDINATES
from vibrissa.inverse.smoothing.merging import group_starts, merged
from vibrissa.inverse.smoothing.series import (
    FREE,
    GO_ON,
    JUMP,
    KINK,
    Labels,
    Series,
    capacity_for,
    filled,
    steps_of,
)

_BEFORE, _AFTER = 96, 128
_COARSE = np.arange(-64.0, 33.0, 4.0)
_FINE = np.arange(-8.0, 8.0, 0.5)
_NEGLIGIBLE = 1e-3
"""Probability of the outermost places at which no more need be tried."""
_LEAST_SHARE = 0.1


class Onset(NamedTuple):
    """The beginning of a contact, in samples of its series."""

    place: float
    """Between two samples: 7.25 is a quarter of the way from sample 7 to sample 8."""
    time: float
    deviation: float
    limit: float


def reversed_model(model: Model) -> Model:
    """The same series run backwards: an end becomes a beginning. An integrated Wiener process has
    the same law both ways.
    """
    series = model.series
    backwards = Series(series.time[-1] - series.time[::-1], *(part[::-1] for part in series[1:]))
    states = States(*(part[::-1] for part in model.states))
    # Of what later samples alone tell of the drift nothing is kept.
    states = states._replace(expected=states.mean, uncertainty=states.covariance)
    return model._replace(
        series=backwards, about=model.about[::-1], weight=model.weight[::-1], states=states
    )


def reversed_labels(labels: Labels) -> Labels:
    """Labels of the reversed series: a break between two samples stays between them."""
    link = np.concatenate([[GO_ON], labels.link[:0:-1]])
    return Labels(labels.phase[::-1].copy(), link, np.ones(len(link)), labels.pace[::-1].copy())


def onset_at(labels: Labels, first: int, place: float) -> Labels:
    """Labels with the contact that begins at sample `first` beginning at `place` instead."""
    phase, link, share, pace = (field.copy() for field in labels)
    begins = int(np.floor(place)) + 1
    phase[begins:first] = phase[first]
    phase[first:begins] = FREE
    link[min(first, begins) : max(first, begins) + 1] = GO_ON
    link[begins] = KINK
    share[first] = 1.0
    share[begins] = max(begins - place, _LEAST_SHARE)
    pace[begins:first] = pace[first]
    return Labels(phase, link, share, pace)


def onset_of(model: Model, labels: Labels, first: int) -> Onset:
    """Begin of the contact whose first sample is `first`, by likelihood; its deviation is that of
    the likelihood taken as a density.
    """
    place = first - 0.5
    weights = np.ones(1)
    places = np.array([place])
    for tried, offsets in enumerate((_COARSE, _FINE, _FINE)):
        if tried > 1 and weights[[0, -1]].max() < _NEGLIGIBLE:
            break
        places = np.unique(np.clip(place + offsets, *_room(labels, first)))
        rows = (
            max(0, int(places[0]) - _BEFORE),
            min(len(labels.phase) - 1, max(int(places[-1]), first) + _AFTER),
        )
        values = log_likelihoods(model, [onset_at(labels, first, part) for part in places], *rows)
        weights = np.exp(values - values.max())
        weights /= weights.sum()
        place = float(places[int(np.argmax(values))])
    mean = float(weights @ places)
    step = model.series.step
    spacing = float(np.median(np.diff(places))) if len(places) > 1 else 1.0
    deviation = float(np.sqrt(weights @ (places - mean) ** 2 + spacing**2 / 12)) * step
    time = float(np.interp(mean, np.arange(len(model.series.time)), model.series.time))
    return Onset(
        mean,
        time,
        deviation,
        limit_of(model, onset_at(labels, first, mean), int(np.floor(mean)) + 1),
    )


def _room(labels: Labels, first: int) -> tuple[float, float]:
    """From the contact before to the next break of this one."""
    before = np.flatnonzero(labels.phase[:first] != FREE)
    breaks = np.flatnonzero(
        (labels.link[first + 1 :] > GO_ON) | (np.diff(labels.phase[first:]) != 0)
    )
    low = float(before[-1] + 2) if before.size else 0.0
    high = float(first + breaks[0] - 2) if breaks.size else len(labels.phase) - 3.0
    return min(low, first - 0.5), max(high, first - 0.5)


def limit_of(model: Model, labels: Labels, first: int) -> float:
    """Cramér-Rao: (gᵀ P⁻¹ g)^(−½), g the rates of the loads at the beginning, P the covariance with
    which what follows tells the loads there [s].
    """
    link = labels.link.copy()
    link[first] = JUMP
    rows = slice(first, len(link))
    cut = Series(*(part[rows] for part in model.series))
    part = Labels(labels.phase[rows], link[rows], np.ones(len(cut.time)), labels.pace[rows])
    steps = steps_of(
        cut,
        part,
        model.about[rows],
        model.weight[rows],
        model.rates,
        modulus_spread=model.modulus_spread,
    )
    starts = group_starts([part])
    steps = filled(merged(steps, starts), capacity_for(len(model.series.time)))
    covariance = np.zeros((SIZE, SIZE))
    covariance[2 * COORDINATES :, 2 * COORDINATES :] = model.states.covariance[
        first, 2 * COORDINATES :, 2 * COORDINATES :
    ]
    mean = np.concatenate([np.zeros(2 * COORDINATES), model.states.mean[first, 2 * COORDINATES :]])
    states = fetched(
        kalman.smoothed(steps, np.array(len(starts)), model.intensities, mean, covariance), 1
    )
    rates = states.mean[0, COORDINATES : COORDINATES + ARC_LENGTH]
    told = states.covariance[0, :ARC_LENGTH, :ARC_LENGTH]
    return float(np.maximum(rates @ np.linalg.solve(told, rates), 1e-300)) ** -0.5
