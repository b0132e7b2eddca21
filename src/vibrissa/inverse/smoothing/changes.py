"""Where something changes in a sweep: jumps, phases, the start and the end of a contact. The places
of changes of phase come with their probabilities.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import maximum_filter1d, median_filter
from scipy.stats import chi2

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import SIZE, States, Step
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, COORDINATES
from vibrissa.inverse.smoothing.merging import TOGETHER, group_starts, merged
from vibrissa.inverse.smoothing.phases import raw_arc_lengths, runs_of
from vibrissa.inverse.smoothing.series import (
    FREE,
    GO_ON,
    JUMP,
    KINK,
    TANGENTIAL,
    TIP,
    Labels,
    NoMotionError,
    Series,
    chosen,
    filled,
    linearised,
    steps_of,
)
from vibrissa.numerics.blocks import rounded_up

_LOADS = ARC_LENGTH
"""Moment and axial force: the coordinates whose jumps are looked for."""
_FALSE_JUMPS = 1e-3
"""Expected number of jumps found in a recording that has none."""
_APART = 12
_SIDE, _HALF = 3, 25
"""Samples to either side of a step, and of its neighbourhood."""
_STEP, _UNUSUAL = 12.0, 6.0
"""Standard deviations of a step, and its size over the usual difference: a contact that slides on,
also through a change of phase, is far from both.
"""
_MARGIN = 96
_AT_ONCE = 8
_MOST_ROWS = 1536
_SWEEPS, _REACHES = 2, 3
_REACH, _SPACING, _FINE = 160, 8, 32
_NEGLIGIBLE = 8.0
_LEAST_RUN = 4
_SHORT_RUN = 96
_LEAST_GAIN = 3.0
_CLEARLY = 3.0
_SIZES = (32, 64, 128, 256, 384)
_WIDER = (1.0, 1.5, 2.25)
_GROUPS = 512


class Model(NamedTuple):
    """What the likelihood of a stretch of a series depends on, besides its labels."""

    series: Series
    about: Float[np.ndarray, "n 5"]
    weight: Float[np.ndarray, "n"]
    rates: Float[np.ndarray, "5"]
    intensities: Float[np.ndarray, "5"]
    states: States
    modulus_spread: float | None


def with_snaps(series: Series, labels: Labels) -> Labels:
    """Jumps where the wrench steps from one sample to the next, far from its noise and from its
    course before and after; a change of phase beside one is moved there.
    """
    touching = (labels.phase != FREE) & series.sound
    load, count = series.whitened, len(touching)
    if count < 2 * _HALF or not series.sound.any():
        return labels
    known = np.flatnonzero(series.sound)
    load = np.stack([np.interp(np.arange(count), known, part[known]) for part in load.T], axis=1)
    # Medians of some samples to either side: a spike is no step.
    around = np.median(np.lib.stride_tricks.sliding_window_view(load, _SIDE, axis=0), axis=-1)
    step = np.zeros(count)
    step[_SIDE : count - _SIDE + 1] = np.linalg.norm(around[_SIDE:] - around[:-_SIDE], axis=1)
    usual = median_filter(step, 2 * _HALF + 1, mode="nearest")
    largest = maximum_filter1d(step, 2 * _APART + 1, mode="nearest")
    single = np.linalg.norm(np.diff(load, axis=0, prepend=load[:1]), axis=1)
    inside = touching & np.roll(touching, 1) & (np.arange(count) > 0)
    for place in np.flatnonzero(
        inside & (step == largest) & (step > _STEP) & (step > _UNUSUAL * usual)
    ):
        row = place - 1 + int(np.argmax(single[place - 1 : place + 2]))
        for change in phase_changes(labels):
            if abs(change - row) <= _APART:
                labels = moved(labels, change, int(row))
        link = labels.link.copy()
        link[row] = JUMP
        labels = labels._replace(link=link)
    return labels


def jumps(model: Model, labels: Labels) -> list[tuple[int, int]]:
    """Samples at which the motion of the contact breaks, with JUMP or KINK: shocks to its state
    that noise does not explain (de Jong & Penzer, *JASA* 93, 1998).
    """
    touching = (
        np.flatnonzero(
            (labels.phase[1:] != FREE) & (labels.phase[:-1] != FREE) & (labels.link[1:] == GO_ON)
        )
        + 1
    )
    if not touching.size:
        return []
    values, rates = list(range(_LOADS)), list(range(COORDINATES, COORDINATES + _LOADS))
    shock, turn = (
        _shock(model.states, touching, values + rates),
        _shock(model.states, touching, rates),
    )
    level = _FALSE_JUMPS / len(touching)
    limit, value_limit = chi2.isf(level, 2 * _LOADS), chi2.isf(level, _LOADS)
    found: list[tuple[int, int]] = []
    for k in np.argsort(-shock):
        row = int(touching[k])
        if shock[k] < limit:
            break
        broken = np.flatnonzero((labels.link > GO_ON) | (np.diff(labels.phase, prepend=FREE) != 0))
        others = np.concatenate([broken, [other for other, _ in found]])
        if not others.size or np.abs(others - row).min() >= _APART:
            found.append((row, KINK if shock[k] - turn[k] < value_limit else JUMP))
    return found


def _shock(states: States, rows: np.ndarray, entries: list[int]) -> Float[np.ndarray, "k"]:
    pull = states.pull[rows][:, entries]
    information = states.information[rows][:, entries][:, :, entries]
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", information), 1e-300))
    relative = information / scale[:, :, None] / scale[:, None, :]
    inverse = np.linalg.pinv(relative, rcond=1e-10, hermitian=True)
    return np.einsum("ni,nij,nj->n", pull / scale, inverse, pull / scale)


def log_likelihoods(
    model: Model,
    candidates: list[Labels],
    first: int,
    last: int,
    together: int = TOGETHER,
    bends: tuple[float, ...] = (1.0,),
) -> Float[np.ndarray, "k"]:
    """Log-likelihoods of the rows from `first` to `last` by candidates for the labels; the drift
    before them is what the samples before tell.

    With several `bends`, factors of the rates of which nothing is known, those of all candidates
    for the first one come first.
    """
    rows = slice(max(first, 0), min(last + 1, max(first, 0) + _MOST_ROWS * together // TOGETHER))
    cut = Series(*(part[rows] for part in model.series))
    mean = np.concatenate(
        [
            [0, 0, 0, 1.0, 0],
            np.zeros(COORDINATES),
            model.states.expected[rows.start, 2 * COORDINATES :],
        ]
    )
    covariance = np.zeros((SIZE, SIZE))
    covariance[2 * COORDINATES :, 2 * COORDINATES :] = model.states.uncertainty[
        rows.start, 2 * COORDINATES :, 2 * COORDINATES :
    ]
    about, steps = model.about[rows], []
    at_tip = about.copy()
    at_tip[:, ARC_LENGTH] = 1
    linears = linearised(about), linearised(at_tip)
    for labels in candidates:
        part = Labels(*(field[rows].copy() for field in labels))
        part.link[0] = JUMP if part.phase[0] != FREE else GO_ON
        tip = part.phase == TIP
        linear = chosen(tip, linears[1], linears[0])
        place = np.where(tip[:, None], at_tip, about)
        steps.append(
            steps_of(
                cut,
                part,
                place,
                model.weight[rows],
                model.rates,
                modulus_spread=model.modulus_spread,
                linear=linear,
            )
        )
    starts = group_starts(
        [Labels(*(field[rows] for field in labels)) for labels in candidates], together=together
    )
    steps = [filled(merged(part, starts), max(_GROUPS, rounded_up(len(starts)))) for part in steps]
    steps = [_bending(step, bend) for bend in bends for step in steps]
    wanted = len(steps)
    steps += steps[-1:] * (-wanted % _AT_ONCE)
    values = []
    for k in range(0, len(steps), _AT_ONCE):
        stacked = Step(*(np.stack(parts) for parts in zip(*steps[k : k + _AT_ONCE], strict=True)))
        values.append(
            np.asarray(
                kalman.log_likelihoods(
                    stacked, np.array(len(starts)), model.intensities, mean, covariance
                )
            )
        )
    told = np.concatenate(values)[:wanted]
    if not np.isfinite(told).any():
        raise NoMotionError
    return np.nan_to_num(told, nan=-np.inf)


def _bending(steps: Step, factor: float) -> Step:
    """With that factor of the rates of which nothing is known."""
    scale = np.ones(SIZE)
    scale[COORDINATES : 2 * COORDINATES] = factor**2
    return steps if factor == 1 else steps._replace(spread=steps.spread * scale)


def moved(labels: Labels, change: int, place: int) -> Labels:
    """Labels with the change of phase at sample `change` moved to `place`; links go with it."""
    phase, link = labels.phase.copy(), labels.link.copy()
    before, after, kind = (
        phase[change - 1],
        phase[change] if change < len(phase) else FREE,
        link[change] if change < len(phase) else GO_ON,
    )
    if place < change:
        phase[place:change] = after
    else:
        phase[change:place] = before
    if change < len(link):
        link[change] = GO_ON
    if place < len(link):
        link[place] = max(kind, KINK)
    return labels._replace(phase=phase, link=link)


def phase_changes(labels: Labels) -> list[int]:
    """First samples of a new phase within contacts."""
    phase = labels.phase
    return [
        int(row)
        for row in np.flatnonzero(
            (phase[1:] != phase[:-1]) & (phase[1:] != FREE) & (phase[:-1] != FREE)
        )
        + 1
    ]


class Places(NamedTuple):
    """Where one change of phase may be."""

    place: Int[np.ndarray, "k"]
    """First samples of the new phase, increasing."""
    probability: Float[np.ndarray, "k"]

    def quantile(self, share: float) -> int:
        """Place before which, with this probability, the phase has changed."""
        return int(
            self.place[
                min(int(np.searchsorted(np.cumsum(self.probability), share)), len(self.place) - 1)
            ]
        )

    @property
    def deviation(self) -> float:
        """Standard deviation, in samples."""
        spacing = float(np.median(np.diff(self.place))) if len(self.place) > 1 else 1.0
        mean = self.probability @ self.place
        return float(np.sqrt(self.probability @ (self.place - mean) ** 2 + spacing**2 / 12))


def with_placed_changes(model: Model, labels: Labels) -> tuple[Labels, dict[int, Places]]:
    """Each change between tip and tangential contact at the median of its likelihood, and where
    else it may be, given the others.
    """
    places: dict[int, Places] = {}
    for _ in range(_SWEEPS):
        places, before = {}, phase_changes(labels)
        for change in before:
            found = places_of(model, labels, change)
            median = found.quantile(0.5)
            labels, places[median] = moved(labels, change, median), found
        # Only a change near to another depends on where that is.
        if len(before) < 2 or np.diff(before).min() > _REACH + _MARGIN:
            break
    return labels, places


def places_of(model: Model, labels: Labels, change: int) -> Places:
    """Likelihood of a change's place as a density: over all places within reach, then more closely
    where it is not negligible.
    """
    low, high = room(labels, change)
    best = change
    for _ in range(_REACHES):
        coarse = _grid(max(low, best - _REACH), min(high, best + _REACH), _SPACING, best)
        values = _place_likelihoods(model, labels, change, coarse)
        moved_on, best = best, int(coarse[np.argmax(values)])
        if abs(best - moved_on) < _REACH - 2 * _SPACING or best in (low, high):
            break
    likely = coarse[values > values.max() - _NEGLIGIBLE]
    first, last = max(low, int(likely[0]) - _SPACING), min(high, int(likely[-1]) + _SPACING)
    fine = _grid(first, last, -(-(last - first + 1) // _FINE), best)
    values = _place_likelihoods(model, labels, change, fine)
    width = np.diff(np.concatenate([fine[:1], (fine[:-1] + fine[1:]) / 2, fine[-1:]]))
    probability = np.exp(values - values.max()) * (width + 1e-9)
    return Places(fine, probability / probability.sum())


def _grid(low: int, high: int, spacing: int, best: int) -> Int[np.ndarray, "k"]:
    return np.unique(np.append(np.arange(low, high + 1, spacing), [best, high]))


def _place_likelihoods(
    model: Model, labels: Labels, change: int, places: Int[np.ndarray, "k"]
) -> Float[np.ndarray, "k"]:
    rows = min(change, int(places[0])) - _MARGIN // 2, max(change, int(places[-1])) + _MARGIN // 2
    return log_likelihoods(
        model,
        [moved(labels, change, int(place)) for place in places],
        *_within(labels, change, *rows),
    )


def room(labels: Labels, change: int) -> tuple[int, int]:
    """Between the neighbouring changes of any kind."""
    edges = np.flatnonzero((np.diff(labels.phase, prepend=FREE) != 0) | (labels.link == JUMP))
    before, after = edges[edges < change], edges[edges > change]
    low = int(before[-1]) if before.size else 0
    high = int(after[0]) if after.size else len(labels.phase)
    return (
        low + _LEAST_RUN if low + _LEAST_RUN < change else change,
        high - _LEAST_RUN if high - _LEAST_RUN > change else change,
    )


def _within(labels: Labels, row: int, first: int, last: int) -> tuple[int, int]:
    return max(0, min(first, row - 1)), min(len(labels.phase) - 1, max(last, row))


def with_fewer_phases(model: Model, labels: Labels) -> Labels:
    """Short phases that the likelihood does not ask for are taken into the other phase; and tip
    contact is tried where a contact begins or ends tangentially.
    """
    for first, last in list(_phase_runs(labels)):
        if last - first + 1 > _SHORT_RUN:
            continue
        phase, link = labels.phase.copy(), labels.link.copy()
        phase[first : last + 1] = TIP + TANGENTIAL - phase[first]
        neighbours = [
            phase[row]
            for row in (first - 1, last + 1)
            if 0 <= row < len(phase) and phase[row] != FREE
        ]
        if neighbours and any(other != phase[first] for other in neighbours):
            continue
        link[
            [
                row
                for row in (first, last + 1)
                if row < len(link) and link[row] == KINK and row > 0 and phase[row - 1] != FREE
            ]
        ] = GO_ON
        other = labels._replace(phase=phase, link=link)
        values = log_likelihoods(
            model, [labels, other], *_within(labels, first, first - _MARGIN, last + _MARGIN)
        )
        if values[1] > values[0] - _LEAST_GAIN * (len(neighbours) > 0):
            labels = other
    return labels


def with_tangential_phases(model: Model, labels: Labels) -> Labels:
    """Tangential contact is tried within each stretch of tip contact, about where the samples by
    themselves put the contact most clearly before the tip.
    """
    value, deviation = raw_arc_lengths(model.series, model.states.mean[:, 2 * COORDINATES :])
    weight = 1 / deviation**2
    for first, last in list(runs_of(labels.phase == TIP)):
        tried = [labels]
        for low, high in _clearly_short(value[first : last + 1], weight[first : last + 1]):
            phase, link = labels.phase.copy(), labels.link.copy()
            phase[first + low : first + high] = TANGENTIAL
            link[[first + low, first + high]] = np.maximum(link[[first + low, first + high]], KINK)
            tried.append(labels._replace(phase=phase, link=link))
        if len(tried) > 1:
            rows = np.flatnonzero(np.any([other.phase != labels.phase for other in tried], axis=0))
            values = log_likelihoods(
                model,
                tried,
                *_within(labels, first, int(rows[0]) - _MARGIN // 2, int(rows[-1]) + _MARGIN // 2),
            )
            best = int(np.argmax(values))
            # Tip contact all along and tangential contact in the middle are equally usual.
            labels = tried[best]
    return labels


def _clearly_short(
    value: Float[np.ndarray, "k"], weight: Float[np.ndarray, "k"]
) -> list[tuple[int, int]]:
    """Stretches about those over which the weighted mean of the arc lengths lies most clearly below
    the rod's: as s₁ leaves and returns slowly, longer ones too.
    """
    total, short = (
        np.cumsum(np.concatenate([[0.0], part])) for part in (weight, weight * (1 - value))
    )
    found = set()
    for size in (size for size in _SIZES if size < len(value)):
        z = (short[size:] - short[:-size]) / np.sqrt(
            np.maximum(total[size:] - total[:-size], 1e-300)
        )
        place = int(np.argmax(z))
        if z[place] < _CLEARLY:
            continue
        for wider in _WIDER:
            low, high = place + size / 2 - wider * size / 2, place + size / 2 + wider * size / 2
            found.add((max(round(low), _LEAST_RUN), min(round(high), len(value) - _LEAST_RUN)))
    return sorted(found)


def _phase_runs(labels: Labels) -> Iterable[tuple[int, int]]:
    for phase in (TIP, TANGENTIAL):
        yield from runs_of(labels.phase == phase)
