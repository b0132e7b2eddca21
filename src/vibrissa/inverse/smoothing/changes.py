"""Phases of contacts, tip or tangential: which there are and where they change, by the likelihood
of the samples around. Places of changes come with their probabilities.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import RATE, SIZE, Gaussian
from vibrissa.inverse.smoothing.merging import TOGETHER, group_starts, merged
from vibrissa.inverse.smoothing.model import steps_of
from vibrissa.inverse.smoothing.phases import raw_arc_lengths, runs_of
from vibrissa.inverse.smoothing.series import (
    FREE,
    GO_ON,
    JUMP,
    KINK,
    TANGENTIAL,
    TIP,
    Fit,
    Labels,
    NoMotionError,
    Samples,
)

Rows = Int[np.ndarray, "k"]

_MARGIN = 96
"""Samples about a place within which others of it are told from each other."""
_MOST_ROWS = 1536
_SWEEPS, _REACHES = 2, 3
_REACH, _SPACING, _FINE = 160, 8, 32
"""Samples within which a change is looked for, at first, their spacing, and most places after."""
_NEGLIGIBLE = 8.0
"""Log-likelihood by which places are behind that are left out: three in ten thousand."""
_LEAST_RUN, _SHORT_RUN = 4, 96
"""Least samples of a phase, and most of one that may be noise."""
_LEAST_GAIN = 3.0
"""Log-likelihood by which a phase has to be better than its neighbours, as by Akaike: its changes
have two places and its motion one more rate."""
_CLEARLY = 3.0
"""Standard deviations of a mean below the rod's length from which tangential contact is tried."""
_SIZES, _WIDER = (32, 64, 128, 256, 384), (1.0, 1.5, 2.25)
_TINY = 1e-300
"""In place of a divisor of zero."""


def log_likelihoods(
    fit: Fit,
    candidates: list[Labels],
    first: int,
    last: int,
    together: int = TOGETHER,
    bends: tuple[float, ...] = (1.0,),
) -> Samples:
    """Log-likelihoods of the rows from `first` to `last` by candidates for the labels; the drift
    before them is what the samples before tell.

    With several `bends`, factors of the rates of which nothing is known, those of all candidates
    for the first one come first.
    """
    first = max(first, 0)
    rows = slice(first, min(last + 1, first + _MOST_ROWS * together // TOGETHER))
    cut = fit.rows(rows)
    parts = [Labels(*(field[rows] for field in labels)).copy() for labels in candidates]
    starts = group_starts(parts, together=together)
    steps = []
    for labels in parts:
        labels.link[0] = JUMP if labels.phase[0] != FREE else GO_ON
        steps.append(merged(steps_of(cut.with_phases(labels)), starts))
    before = cut.states.expected_zero
    values = kalman.log_likelihoods(
        [_bending(step, bend) for bend in bends for step in steps],
        fit.intensities,
        kalman.at_rest(Gaussian(before.mean[0], before.covariance[0])),
    )
    if not np.isfinite(values).any():
        raise NoMotionError
    return np.nan_to_num(values, nan=-np.inf)


def _bending(steps: kalman.Step, factor: float) -> kalman.Step:
    """With that factor of the rates of which nothing is known."""
    scale = np.ones(SIZE)
    scale[RATE] = factor**2
    return steps._replace(entry=steps.entry._replace(spread=steps.entry.spread * scale))


def moved(labels: Labels, change: int, place: int) -> Labels:
    """Labels with the change of phase at sample `change` moved to `place`; links go with it."""
    moving, count = labels.copy(), len(labels.phase)
    kind = labels.link[change] if change < count else GO_ON
    if place < change:
        moving.phase[place:change] = labels.phase[change] if change < count else FREE
    else:
        moving.phase[change:place] = labels.phase[change - 1]
    moving.link[change : change + 1] = GO_ON
    moving.link[place : place + 1] = max(kind, KINK)
    return moving


class Places(NamedTuple):
    """Where one change of phase may be."""

    place: Rows
    """First samples of the new phase, increasing."""
    probability: Float[np.ndarray, "k"]

    def quantile(self, share: float) -> int:
        """Place before which, with this probability, the phase has changed."""
        number = int(np.searchsorted(np.cumsum(self.probability), share))
        return int(self.place[min(number, len(self.place) - 1)])

    @property
    def deviation(self) -> float:
        """Standard deviation, in samples."""
        return deviation_of(self.place, self.probability)


def deviation_of(places: np.ndarray, probability: Float[np.ndarray, "k"]) -> float:
    """Standard deviation of places that are each as wide as they are apart."""
    spacing = float(np.median(np.diff(places))) if len(places) > 1 else 1.0
    variance = probability @ (places - probability @ places) ** 2
    return float(np.sqrt(variance + spacing**2 / 12))


def with_phases(fit: Fit) -> tuple[Fit, dict[int, Places]]:
    """The fit with the phases that are most probable, and where each of their changes may be."""
    labels, places = _with_placed_changes(with_tangential_phases(with_fewer_phases(fit)))
    return fit._replace(labels=labels), places


def _with_placed_changes(fit: Fit) -> tuple[Labels, dict[int, Places]]:
    """Each change between tip and tangential contact at the median of its likelihood, and where
    else it may be, given the others.
    """
    labels, places = fit.labels, dict[int, Places]()
    for _ in range(_SWEEPS):
        places, before = {}, labels.changes
        for change in before:
            found = places_of(fit._replace(labels=labels), change)
            median = found.quantile(0.5)
            labels, places[median] = moved(labels, change, median), found
        # Only a change near to another depends on where that is.
        if len(before) < 2 or np.diff(before).min() > _REACH + _MARGIN:
            break
    return labels, places


def places_of(fit: Fit, change: int) -> Places:
    """Likelihood of a change's place as a density: over all places within reach, then more closely
    where it is not negligible.
    """
    low, high = room(fit.labels, change)

    def tried(first: int, last: int, spacing: int, best: int) -> tuple[Rows, Samples]:
        first, last = max(low, first), min(high, last)
        places = np.unique([*range(first, last + 1, spacing), best, last])
        around = min(change, int(places[0])), max(change, int(places[-1]))
        other = [moved(fit.labels, change, int(place)) for place in places]
        return places, log_likelihoods(
            fit, other, around[0] - _MARGIN // 2, around[1] + _MARGIN // 2
        )

    best = change
    for _ in range(_REACHES):
        coarse, values = tried(best - _REACH, best + _REACH, _SPACING, best)
        moved_on, best = best, int(coarse[np.argmax(values)])
        if abs(best - moved_on) < _REACH - 2 * _SPACING or best in (low, high):
            break
    likely = coarse[values > values.max() - _NEGLIGIBLE]
    first, last = max(low, int(likely[0]) - _SPACING), min(high, int(likely[-1]) + _SPACING)
    fine, values = tried(first, last, -(-(last - first + 1) // _FINE), best)
    width = np.diff(np.concatenate([fine[:1], (fine[:-1] + fine[1:]) / 2, fine[-1:]]))
    probability = np.exp(values - values.max()) * (width + 1e-9)
    return Places(fine, probability / probability.sum())


def room(labels: Labels, change: int) -> tuple[int, int]:
    """Between the neighbouring changes of any kind."""
    edges = np.flatnonzero(labels.begins | (labels.link == JUMP))
    low = max(edges[edges < change], default=0) + _LEAST_RUN
    high = min(edges[edges > change], default=len(labels.phase)) - _LEAST_RUN
    return min(int(low), change), max(int(high), change)


def with_fewer_phases(fit: Fit) -> Fit:
    """Short phases that the likelihood does not ask for are taken into the other phase; and tip
    contact is tried where a contact begins or ends tangentially.
    """
    phase = fit.labels.phase
    runs = [run for kind in (TIP, TANGENTIAL) for run in runs_of(phase == kind)]
    for first, last in runs:
        other = fit.labels.copy()
        other.phase[first : last + 1] = TIP + TANGENTIAL - fit.labels.phase[first]
        edges = [row for row in (first, last + 1) if 0 < row < len(phase)]
        beside = [other.phase[first - 1 : first], other.phase[last + 1 : last + 2]]
        neighbours = [kind for kind in np.concatenate(beside) if kind != FREE]
        if last - first >= _SHORT_RUN or any(kind != other.phase[first] for kind in neighbours):
            continue
        other.link[
            [row for row in edges if other.link[row] == KINK and other.phase[row - 1] != FREE]
        ] = GO_ON
        values = log_likelihoods(fit, [fit.labels, other], first - _MARGIN, last + _MARGIN)
        if values[1] > values[0] - _LEAST_GAIN * bool(neighbours):
            fit = fit._replace(labels=other)
    return fit


def with_tangential_phases(fit: Fit) -> Fit:
    """Tangential contact is tried within each stretch of tip contact, about where the samples by
    themselves put the contact most clearly before the tip.
    """
    value, deviation = raw_arc_lengths(fit.series, fit.states.zero.mean)
    for first, last in list(runs_of(fit.labels.phase == TIP)):
        inside = slice(first, last + 1)
        tried = [fit.labels]
        for low, high in _clearly_short(value[inside], deviation[inside] ** -2):
            labels = fit.labels.copy()
            labels.phase[first + low : first + high] = TANGENTIAL
            edges = [first + low, first + high]
            labels.link[edges] = np.maximum(labels.link[edges], KINK)
            tried.append(labels)
        if len(tried) > 1:
            rows = np.flatnonzero(np.ptp([labels.phase for labels in tried], axis=0))
            begin, end = int(rows[0]) - _MARGIN // 2, int(rows[-1]) + _MARGIN // 2
            values = log_likelihoods(fit, tried, min(begin, first - 1), max(end, first))
            # Tip contact all along and tangential contact in the middle are equally usual.
            fit = fit._replace(labels=tried[int(np.argmax(values))])
    return fit


def _clearly_short(value: Samples, weight: Samples) -> list[tuple[int, int]]:
    """Stretches about those over which the weighted mean of the arc lengths lies most clearly below
    the rod's: as s₁ leaves and returns slowly, longer ones too.
    """
    sums = np.cumsum(np.stack([weight, weight * (1 - value)]), axis=1)
    sums, found, count = np.pad(sums, ((0, 0), (1, 0))), set(), len(value)
    for size in (size for size in _SIZES if size < count):
        total, short = sums[:, size:] - sums[:, :-size]
        clearness = short / np.sqrt(np.maximum(total, _TINY))
        place = int(np.argmax(clearness))
        if clearness[place] < _CLEARLY:
            continue
        middle = place + size / 2
        for half in np.multiply(_WIDER, size / 2):
            low, high = round(middle - half), round(middle + half)
            found.add((max(low, _LEAST_RUN), min(high, count - _LEAST_RUN)))
    return sorted(found)
