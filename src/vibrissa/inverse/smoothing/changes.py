"""Where a contact begins, ends and changes phase, which phases it has, and which others it may
have: all by the likelihood of the surrounding samples under candidates for the labels.
"""

from itertools import combinations, compress
from typing import NamedTuple

import numpy as np
from jaxtyping import Int
from scipy.special import logsumexp, softmax

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import RATE, Gaussian, States
from vibrissa.inverse.smoothing.likelihood import log_likelihoods
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, LOADS
from vibrissa.inverse.smoothing.model import (
    FREE,
    GO_ON,
    JUMP,
    TANGENTIAL,
    TINY,
    TIP,
    TOGETHER,
    Codes,
    Fit,
    Flags,
    Labels,
    Samples,
    group_starts,
    merged,
    smoothed_states,
    steps_of,
)
from vibrissa.inverse.smoothing.phases import raw_arc_lengths
from vibrissa.numerics.runs import runs

_MARGIN = 96
"""Samples about a place, within which rival places can be told apart."""
_SWEEPS, _REACHES = 2, 3
_REACH, _SPACING, _FINE = 160, 8, 32
"""Samples within which a change is first sought, their spacing, and the most places tried next."""
_NEGLIGIBLE = 8.0
"""Places this far behind in log-likelihood are left out: three in ten thousand."""
_LEAST_RUN, _SHORT_RUN = 4, 96
"""Fewest samples of a phase, and most of one that may be noise."""
_LEAST_GAIN = 3.0
"""Log-likelihood that a phase must gain over its neighbours, as in Akaike's criterion: its changes
have two places and its motion one more rate.
"""
_CLEARLY = 3.0
"""Standard deviations that a mean must lie below the rod's length to try tangential contact."""
_BEYOND = 3.0
"""The same that a tangential contact must lie beyond the tip to be one at the tip."""
_SIZES, _WIDER = (32, 64, 128, 256, 384), (1.0, 1.5, 2.25)
"""Samples over which that mean is taken, and widths of the phases tried, relative to them."""
_BEFORE, _AFTER = 96, 128
"""Samples before and after a start that enter its likelihood."""
_ABOUT_GUESS, _ABOUT_BEST = np.arange(-64.0, 33.0, 4.0), np.arange(-8.0, 8.0, 0.5)
"""Starts tried [samples] about the first guess, then about the best one."""
_OUTERMOST = 1e-3
"""Probability of the outermost starts below which no more need be tried."""
_LEAST_SHARE = 0.1
"""Of the time to the first sample: with less, the filter sees no motion."""
_DRAWN = 8
"""Number of labels drawn: a power of two, so that odd multiples permute them."""
_EDGES = np.arange(7) / 6
"""Where a tangential phase may begin and end, as fractions of the contact."""
_BENDS = (1.0, 1 / 4, 1 / 16)
"""Factors on the unknown rates."""
_GROUPS, _ROUGH_GROUPS = 350, 120
"""Groups per contact in which rivals are compared, and in the first rough comparison."""
_HOPELESS = 40.0
"""Log-likelihood by which a rival may be behind at first, with few groups and one scale: the scales
change it by up to 28.
"""
_ALWAYS = 2
"""The given phases, and tip contact throughout, with which all are compared."""
_LEAST_ROWS = 24
"""Fewest samples of a contact that leave four for a tangential phase in one of its sixths."""


class Places(NamedTuple):
    """Where something may begin."""

    place: np.ndarray
    """First samples of it, or places between samples, increasing."""
    probability: Samples

    def quantile(self, share: float) -> int:
        """Place before which it has begun with this probability."""
        number = int(np.searchsorted(np.cumsum(self.probability), share))
        return int(self.place[min(number, len(self.place) - 1)])

    @property
    def mean(self) -> float:
        """In samples."""
        return float(self.probability @ self.place)

    @property
    def deviation(self) -> float:
        """Standard deviation, in samples, of places each as wide as their spacing."""
        spacing = float(np.median(np.diff(self.place))) if len(self.place) > 1 else 1.0
        variance = self.probability @ (self.place - self.mean) ** 2
        return float(np.sqrt(variance + spacing**2 / 12))


def with_phases(fit: Fit) -> tuple[Fit, dict[int, Places]]:
    """The fit with the most probable phases, each change between tip and tangential contact at the
    median of its likelihood; and where else each may be, given the others.
    """
    fit = _with_tangential_phases(_with_fewer_phases(fit))
    places = dict[int, Places]()
    for _ in range(_SWEEPS):
        places, before = {}, fit.labels.changes
        for change in before:
            found = _places_of(fit, change)
            median = found.quantile(0.5)
            fit, places[median] = fit._replace(labels=_parted(fit.labels, change, median)), found
        # A change depends on the place of another only if they are close.
        if len(before) < 2 or np.diff(before).min() > _REACH + _MARGIN:
            break
    return fit, places


def within_the_rod(labels: Labels, states: States) -> Labels:
    """Labels with tip contact where tangential contact would lie clearly beyond the tip: a thin tip
    hardly resists being bent until the force is perpendicular to a rod that went on.
    """
    beyond, clearly = states.mean[:, ARC_LENGTH] > 1, beyond_tip(labels, states)
    for first, stop in runs((labels.phase == TANGENTIAL) & beyond):
        if stop - first >= _LEAST_RUN and clearly[first:stop].any():
            labels = labels.in_phase(TIP, slice(first, stop))
    return labels


def beyond_tip(labels: Labels, states: States) -> Flags:
    """Samples whose tangential contact lies clearly beyond the tip."""
    deviation = np.sqrt(np.maximum(states.covariance[:, ARC_LENGTH, ARC_LENGTH], TINY))
    beyond = states.mean[:, ARC_LENGTH] - 1
    return (labels.phase == TANGENTIAL) & (beyond > _BEYOND * deviation)


def _places_of(fit: Fit, change: int) -> Places:
    """Likelihood of a change's place as a density: over all places within reach, then on a finer
    grid where it is not negligible.
    """
    low, high = _room(fit.labels, change)

    def tried(first: int, last: int, spacing: int, best: int) -> tuple[Codes, Samples]:
        first, last = max(low, first), min(high, last)
        places = np.unique([*range(first, last + 1, spacing), best, last])
        other = [_parted(fit.labels, change, place) for place in places.tolist()]
        begin, stop = min(change, int(places[0])), max(change, int(places[-1])) + 1
        return places, log_likelihoods(fit, other, begin - _MARGIN // 2, stop + _MARGIN // 2)

    best = change
    for _ in range(_REACHES):
        coarse, values = tried(best - _REACH, best + _REACH, _SPACING, best)
        before, best = best, int(coarse[np.argmax(values)])
        if abs(best - before) < _REACH - 2 * _SPACING or best in (low, high):
            break
    likely = coarse[values > values.max() - _NEGLIGIBLE]
    first, last = max(low, int(likely[0]) - _SPACING), min(high, int(likely[-1]) + _SPACING)
    fine, values = tried(first, last, -(-(last - first + 1) // _FINE), best)
    width = np.diff(np.concatenate([fine[:1], (fine[:-1] + fine[1:]) / 2, fine[-1:]]))
    return Places(fine, softmax(values + np.log(width + 1e-9)))


def _parted(labels: Labels, change: int, place: int) -> Labels:
    """Labels with a change moved; a jump at it stays, as the wrench shows its place."""
    other = labels.moved(change, place)
    if labels.link[change] == JUMP:
        other.link[[place, change]] = GO_ON, JUMP
    return other


def _room(labels: Labels, change: int) -> tuple[int, int]:
    """Range between the neighbouring changes of any kind."""
    edges = np.flatnonzero(labels.begins | (labels.link == JUMP))
    low = max(edges[edges < change], default=0) + _LEAST_RUN
    high = min(edges[edges > change], default=len(labels.phase)) - _LEAST_RUN
    return min(int(low), change), max(int(high), change)


def _with_fewer_phases(fit: Fit) -> Fit:
    """Short phases that the likelihood does not ask for are merged into the other phase; and tip
    contact is tried where a contact begins or ends tangentially.
    """
    given = fit.labels.phase
    for kind, other_kind in ((TIP, TANGENTIAL), (TANGENTIAL, TIP)):
        for first, stop in runs(given == kind):
            phase = fit.labels.phase
            beside = {*phase[:first][-1:], *phase[stop:][:1]} - {FREE}
            if stop - first > _SHORT_RUN or beside - {other_kind}:
                continue
            other = fit.labels.in_phase(other_kind, slice(first, stop))
            values = log_likelihoods(fit, [fit.labels, other], first - _MARGIN, stop + _MARGIN)
            asked = values[1] > values[0] - _LEAST_GAIN * bool(beside)
            if asked and (kind == TANGENTIAL or _possible(fit, other)):
                fit = fit._replace(labels=other)
    return fit


def _possible(fit: Fit, labels: Labels) -> bool:
    """Whether tangential contact as labelled lies on the rod."""
    other = fit._replace(labels=labels)
    within = within_the_rod(labels, smoothed_states(other, steps_of(other)))
    return np.array_equal(within.phase, labels.phase)


def _with_tangential_phases(fit: Fit) -> Fit:
    """Tangential contact is tried within each stretch of tip contact, around where the samples by
    themselves put the contact most clearly short of the tip.
    """
    value, deviation = raw_arc_lengths(fit)
    for run in runs(fit.labels.phase == TIP):
        rows = slice(*run)
        edges = rows.start + _clearly_short(value[rows], deviation[rows] ** -2)
        if not edges.size:
            continue
        parts = (slice(*edge) for edge in edges.tolist())
        tried = [fit.labels, *(fit.labels.in_phase(TANGENTIAL, part) for part in parts)]
        begin, stop = int(edges.min()) - _MARGIN // 2, int(edges.max()) + _MARGIN // 2
        values = log_likelihoods(fit, tried, min(begin, rows.start - 1), stop)
        # Tip contact throughout and tangential contact in the middle are equally likely a priori.
        fit = fit._replace(labels=tried[int(np.argmax(values))])
    return fit


def _clearly_short(value: Samples, weight: Samples) -> Int[np.ndarray, "k 2"]:
    """Stretches (k, 2), first and one past the last, around those whose weighted mean arc length
    lies most clearly below the rod's; longer ones too, as s₁ leaves and returns slowly.
    """
    sums = np.cumsum(np.stack([weight, weight * (1 - value)]), axis=1)
    sums, count, found = np.pad(sums, ((0, 0), (1, 0))), len(value), set[tuple[int, int]]()
    for size in (size for size in _SIZES if size < count):
        total, short = sums[:, size:] - sums[:, :-size]
        clearness = short / np.sqrt(np.maximum(total, TINY))
        place = int(np.argmax(clearness))
        if clearness[place] < _CLEARLY:
            continue
        for half in np.multiply(_WIDER, size / 2):
            low, high = round(place + size / 2 - half), round(place + size / 2 + half)
            found.add((max(low, _LEAST_RUN), min(high, count - _LEAST_RUN)))
    return np.array(sorted(found), dtype=int).reshape(-1, 2)


def reversed_fit(fit: Fit) -> Fit:
    """The same series run backwards: an end becomes a beginning. An integrated Wiener process has
    the same law in both directions.
    """
    back = fit.rows(slice(None, None, -1))
    # A break between two samples stays between them; all else begins on whole steps.
    link = np.append(GO_ON, fit.labels.link[:0:-1])
    return back._replace(
        series=back.series._replace(time=fit.series.time[-1] - back.series.time),
        labels=back.labels._replace(link=link, share=np.ones(len(link))).copy(),
        # The drift given later samples alone is not kept.
        states=back.states._replace(expected_zero=back.states.zero),
    )


def onset_at(labels: Labels, first: int, place: float) -> Labels:
    """Labels with the start of the contact at sample `first` moved to `place`."""
    begins = int(np.floor(place)) + 1
    placed = labels.moved(first, begins)
    placed.pace[begins:first] = labels.pace[first]
    placed.share[first], placed.share[begins] = 1.0, max(begins - place, _LEAST_SHARE)
    return placed


def with_onset(fit: Fit, first: int) -> tuple[Fit, int, Samples]:
    """The fit with the contact that begins at sample `first` beginning where it most probably does,
    but no earlier than the rod stops swinging; its first sample then; and the time, its deviation
    from the likelihood taken as a density, and the least that noise allows [s].
    """
    labels, place = fit.labels, first - 0.5
    # From the previous contact to the next break of this one.
    low = np.flatnonzero(labels.phase[:first]).max(initial=-2) + 2.0
    high = labels.breaks[labels.breaks > first].min(initial=len(labels.phase)) - 3.0
    for offsets in (_ABOUT_GUESS, _ABOUT_BEST, _ABOUT_BEST):
        tried = np.clip(place + offsets, min(low, first - 0.5), max(high, first - 0.5))
        places = np.unique(tried)
        stop = max(int(places[-1]), first) + _AFTER + 1
        candidates = [onset_at(labels, first, part) for part in places.tolist()]
        values = log_likelihoods(fit, candidates, int(places[0]) - _BEFORE, stop)
        found, place = Places(places, softmax(values)), float(places[int(np.argmax(values))])
        if offsets is _ABOUT_BEST and found.probability[[0, -1]].max() < _OUTERMOST:
            break
    swings = np.flatnonzero(fit.series.ringing[:first]).max(initial=-1)
    mean, time = max(found.mean, swings + 0.5), fit.series.time
    fit, begin = fit._replace(labels=onset_at(labels, first, mean)), int(np.floor(mean)) + 1
    at = np.interp(mean, np.arange(len(time)), time)
    return fit, begin, np.array([at, found.deviation * fit.series.step, _limit(fit, begin)])


def _limit(fit: Fit, first: int) -> float:
    """Cramér-Rao: (gᵀ P⁻¹ g)^(−½), with g the rates of the loads at the beginning and P the
    covariance of the loads there given what follows [s].
    """
    cut = fit.rows(slice(first, None))
    cut = cut._replace(labels=cut.labels.copy())
    cut.labels.link[0] = JUMP
    before = Gaussian(*(part[0] for part in cut.states.zero))
    steps = merged(steps_of(cut), group_starts([cut.labels]))
    states = kalman.smoothed(steps, fit.intensities, kalman.at_rest(before))
    rates, told = states.mean[0, RATE][:LOADS], states.covariance[0, :LOADS, :LOADS]
    return float(max(rates @ np.linalg.solve(told, rates), TINY)) ** -0.5


def drawn(fit: Fit, places: dict[int, Places]) -> list[Labels]:
    """Equally probable labels: for each contact one of its rivals, for each change one quantile of
    its places; unrelated between different contacts and changes.
    """
    contacts = fit.labels.contacts
    rivals = [_rivals_of(fit, rows) for rows in contacts]
    changes = [change for change in fit.labels.changes if change in places]
    found = []
    for k in range(_DRAWN):
        shares = ((np.arange(len(changes) + len(rivals)) * 2 + 1) * k % _DRAWN + 0.5) / _DRAWN
        other = fit.labels.copy()
        for change, share in zip(changes, shares, strict=False):
            place = int(np.clip(places[change].quantile(share), *_room(other, change)))
            other = _parted(other, change, place)
        each = zip(contacts, rivals, shares[len(changes) :], strict=True)
        for rows, (labels, probability), share in each:
            number = int(np.searchsorted(np.cumsum(probability), share))
            if 0 < number < len(labels):
                for part, rival in zip(other[:2], labels[number], strict=False):
                    part[rows] = rival[rows]
        found.append(other)
    return found


def _rivals_of(fit: Fit, rows: slice) -> tuple[list[Labels], Samples]:
    """Labels of a contact and their probabilities, the given ones first: besides them, tip contact
    throughout, one tangential phase, long or short, early or late, and one of the tip between two
    tangential ones; all equally likely a priori.
    """
    first, count = rows.start, rows.stop - rows.start
    alone = [fit.labels], np.ones(1)
    if count < _LEAST_ROWS:
        return alone
    places = np.unique(first + np.round(_EDGES * count).astype(int)).tolist()
    tip, flank = (fit.labels.in_phase(phase, rows) for phase in (TIP, TANGENTIAL))
    # Jumps stay.
    for labels in (tip, flank):
        labels.link[rows] *= labels.link[rows] == JUMP
    candidates = [fit.labels, tip]
    candidates += [tip.in_phase(TANGENTIAL, slice(*pair)) for pair in combinations(places, 2)]
    candidates += [flank.in_phase(TIP, slice(*pair)) for pair in combinations(places[1:-1], 2)]
    around = first - _MARGIN // 2, rows.stop + _MARGIN // 2
    rough = log_likelihoods(fit, candidates, *around, max(TOGETHER, -(-count // _ROUGH_GROUPS)))
    likely = rough > rough.max() - _HOPELESS
    if not likely[1:].any():
        return alone
    likely[:_ALWAYS] = True
    candidates = list(compress(candidates, likely))
    # How sharply a motion bends is not known in advance, and must not decide: all orders of
    # magnitude are equally probable.
    together = max(TOGETHER, -(-count // _GROUPS))
    each = log_likelihoods(fit, candidates, *around, together, _BENDS).reshape(len(_BENDS), -1)
    values = logsumexp(each - each[:, 1:2], axis=0)
    if not np.isfinite(values[0]):
        return alone
    for number in np.flatnonzero(values > values.max() - _NEGLIGIBLE).tolist():
        if number > 0 and not _possible(fit, candidates[number]):
            values[number] = -np.inf
    return candidates, softmax(np.where(np.isfinite(values), values, -np.inf))
