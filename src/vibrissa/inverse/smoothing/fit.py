"""The iteration that smooths one series: linearise, smooth, down-weight outliers, estimate how
freely the contact moves and the sensor's zero drifts; and averages over possible labels.
"""

from typing import Any

import numpy as np
import scipy
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.special import ndtri

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import DRIFT, INTENSITIES, PLACE, Gaussian, States
from vibrissa.inverse.smoothing.manifold import (
    ARC_LENGTH,
    AT_REST,
    LOADS,
    chosen,
    finite,
    linearised,
)
from vibrissa.inverse.smoothing.model import (
    ARC_LENGTH_SPREAD,
    GO_ON,
    JUMP,
    TANGENTIAL,
    TILT_SPREAD,
    TIP,
    TOGETHER,
    Codes,
    Coordinates,
    Fit,
    Labels,
    NoMotionError,
    Samples,
    Series,
    group_starts,
    merged,
    smoothed_states,
    steps_of,
    together_for,
)
from vibrissa.inverse.smoothing.phases import first_labels, with_snaps, without_unloaded
from vibrissa.mechanics.model import RodModel

OUTLIER = 28.0
"""Squared residual, six degrees of freedom, that noise exceeds once in ten thousand samples; larger
ones are down-weighted.
"""
_START = np.array([1.0, 1.0, 0.01, 1e-6, 1e-3])
"""Intensities of a contact that crosses its range in a few seconds."""
_ROUGH_STEPS, MOST_STEPS = 8, 12
"""Gauss-Newton steps: four usually suffice for `_ROUGHLY`, six for `_CLOSE`. With five rough ones,
phases of a contact on a torus were judged before it had settled, and were wrong.
"""
_FLANK_STEPS = 3
_LONGEST = 4.0
"""The largest of them in any coordinate [EI/L, EI/L², L]. Where a rod is hardly loaded after it
snapped over a sharp edge, longer ones ran away: within four, samples were outliers, and force 200.
Some starts of contacts need steps of more than 1.
"""
_NEAR = 1
"""Steps after which the intensities are estimated."""
_CLOSE, _ROUGHLY = 1e-5, 1e-3
"""Change of the coordinates at which to stop: a hundredth of the errors from noise, or about them.
"""
_FARTHEST = 0.5
"""The least that counts as far [EI/L, EI/L²]: weak loads range no farther than their noise. With
it no sample at rest passed for a contact in 108 sweeps of an egg (1019 without).
"""
_OUTLIERS = 0.03
"""Share of outliers in contacts, some hundred times what noise makes, from which on a fit from the
first guess is tried as well. In a sweep over a rounded block it is the more likely one; the other
had 71 samples up to 5 mm beside the block, said to be OK.
"""
_AVERAGE = 0.04
"""[s] over which the first guess is averaged."""
_MEDIAN = 9
"""Window of a median that no outlier moves."""
_STRETCH = 48
"""Samples that share a pace."""
_USUALLY = 1.5
"""Prior standard deviation of the logarithm of s₁'s intensity."""
_BOUNDS = [(-18.0, 16.0)] * (INTENSITIES - 1) + [(-25.0, 3.0)]
_PACE_BOUNDS = (-14.0, 14.0)
"""Of logarithms, beyond which the likelihood is flat."""
_OF_LENGTH = ARC_LENGTH - 1
"""Index of the arc length among the intensities."""


def first_guess(
    rod: RodModel,
    series: Series,
    zero: Gaussian,
    false_alarm: float,
    incidence_spread: float | None,
) -> Fit:
    """Phases, jumps at steps of the wrench, and coordinates from its moving averages over 40 ms;
    states are not known yet.
    """
    phase, arc_length = first_labels(rod, series, zero, false_alarm)
    steady = median_filter(series.wrench, (_MEDIAN, 1), mode="nearest")
    size = max(1, round(_AVERAGE / series.step))
    load = uniform_filter1d(steady, size, axis=0, mode="nearest")
    labels = with_snaps(series, Labels.of(phase))
    labels = without_unloaded(series, labels, zero, false_alarm)
    touching = labels.touching
    # A series that begins in contact may begin with any load.
    labels.link[0] = JUMP if touching[0] else GO_ON
    x = np.column_stack([load[:, 3:5], -load[:, 2], arc_length, np.zeros(len(phase))])
    linear = linearised(rod, series.pose, np.where(touching[:, None], x, AT_REST))
    # Unknown rates: thirty times the range over the longest contact.
    longest = max(_longest_of(series.time, labels) or 1.0, series.step)
    most = float(np.ptp(linear.x[touching, :LOADS], axis=0).max()) if touching.any() else 1.0
    rates = np.array([*[max(most, 1e-2)] * LOADS, 0.3, TILT_SPREAD / 10]) * 30 / longest
    # So that no outlier is followed from the start.
    residual = series.whitened - median_filter(series.whitened, (_MEDIAN, 1), mode="nearest")
    weight = _robust(np.sum(residual**2, axis=1))
    unknown: Any = None
    return Fit(
        series, labels, linear, linear, weight, unknown, rates, _START, zero, incidence_spread, rod
    )


def fitted(fit: Fit, *, local: bool = True, most_steps: int = _ROUGH_STEPS) -> Fit:
    """Gauss-Newton with robust weights; the intensities are estimated once it is close.

    Steps that turn back are halved: where a rod is hardly loaded, its force may turn far, and full
    steps went to and fro, ever farther, until the samples counted as outliers.
    """
    close, rough = _CLOSE if most_steps > _ROUGH_STEPS else _ROUGHLY, True
    rate, before = 1.0, np.zeros_like(fit.linear.x)
    for iteration in range(most_steps):
        if iteration == _NEAR:
            fit = most_probable(fit, local=local)
        if rough and iteration == _ROUGH_STEPS - 1:
            rough, rate, before = False, 1.0, np.zeros_like(before)
        fit = fit._replace(states=smoothed_states(fit, steps_of(fit), rough=rough))
        step = _coordinates(fit.states) - fit.linear.x
        change = float(np.abs(step).max())
        if not np.isfinite(change):
            raise NoMotionError
        rate = rate / 2 if np.sum(step * before) < 0 else min(2 * rate, 1.0)
        before = step
        fit = _stepped(fit, fit.linear.x + np.clip(rate * step, -_LONGEST, _LONGEST))
        fit = fit._replace(weight=_robust(squared_residuals(fit)))
        if change < close and not rough:
            break
        rough = rough and (iteration <= _NEAR or change > _ROUGHLY)
    return fit.about(fit.linear)


def led_astray(fit: Fit, guess: Fit) -> bool:
    """Whether a load is farther from that of the first guess than half the range of all: what such
    a fit says of the zero's drift would make samples at rest count as loaded.
    """
    away = np.abs(fit.states.mean[:, PLACE][:, :LOADS] - guess.linear.x[:, :LOADS]).max(axis=0)
    within = np.ptp(guess.linear.x[:, :LOADS], axis=0) / 2
    return bool(np.any(away > np.maximum(within, _FARTHEST)))


def mistrusted(fit: Fit) -> bool:
    """Whether so many samples of contacts are outliers that the fit may have settled elsewhere than
    the samples say.
    """
    touching = fit.labels.touching
    return bool(np.sum(fit.weight[touching] < 1) > _OUTLIERS * np.sum(touching))


def _coordinates(states: States) -> Coordinates:
    """Coordinates about which to linearise."""
    values = states.mean[:, PLACE].copy()
    values[:, ARC_LENGTH] = np.clip(values[:, ARC_LENGTH], 0.02, 1.2)
    return values


def _stepped(fit: Fit, new: Coordinates) -> Fit:
    """About the new coordinates, or about the old ones where no rod has the new."""
    there = fit.linearised(new)
    return fit._replace(linear=chosen(finite(there), there, fit.linear))


def squared_residuals(fit: Fit) -> Samples:
    """Of the whitened wrench about the smoothed one: six degrees of freedom, slightly fewer as the
    motion follows the noise.
    """
    series = fit.series
    away = series.whiten(series.wrench - fit.linear.value.wrench)
    squared = np.sum((away - fit.states.mean[:, DRIFT]) ** 2, axis=1)
    return np.where(np.isfinite(squared), squared, 0.0)


def _robust(squared: Samples) -> Samples:
    """1 up to the limit, then the limit over the squared residual: the farther out, the weaker the
    pull, and no intensity has to explain it.
    """
    return np.minimum(1.0, OUTLIER / np.maximum(squared, OUTLIER))


def most_probable(fit: Fit, *, local: bool) -> Fit:
    """The fit with intensities, and the pace of each sample, that maximise the marginal likelihood.

    The pace is constant over stretches of 48 samples of a contact; its logarithm is a random walk
    from one to the next, with a standard deviation of 1. A short tangential phase says little about
    how freely s₁ moves: the logarithm of that intensity has a normal prior about the one with which
    s₁ crosses its range during a contact. Without `local`, all paces are 1.
    """
    labels, start, stretch = fit.labels, kalman.at_rest(fit.zero), stretches(fit.labels)
    steps = steps_of(fit)
    starts = group_starts([labels], stretch, together=together_for(labels))
    if not local:
        stretch[:] = -1
    grouped, number = merged(steps, starts), stretch[starts]
    first = np.flatnonzero(np.diff(stretch, prepend=-1) > 0)
    linked = np.diff(labels.contact[first]) == 0
    time = np.cumsum(steps.duration)
    longest = max(_longest_of(time, labels), 1e-3 * (time[-1] - time[0]), 1e-9)
    # That of an integrated Wiener process with this deviation at the end of the longest contact.
    expected = np.log(3 * ARC_LENGTH_SPREAD**2 / longest**3)

    def paces(walk: Samples, of: Codes) -> Samples:
        # Without contact, number −1, the pace is 1.
        return np.exp(np.append(walk, 0.0))[of]

    def objective(values: Samples) -> tuple[float, Samples]:
        logarithms, walk = np.split(values, [INTENSITIES])
        now = grouped._replace(pace=paces(walk, number))
        states = kalman.smoothed(now, np.exp(logarithms), start)
        of_walk = np.bincount(number + 1, states.score[:, :2].sum(axis=1), len(walk) + 1)[1:]
        step = np.where(linked, np.diff(walk), 0.0)
        pull = np.diff(step, prepend=0.0, append=0.0)[: len(walk)]
        away = (logarithms[_OF_LENGTH] - expected) / _USUALLY
        total = states.score.sum(axis=0)
        total[_OF_LENGTH] -= away / _USUALLY
        # Uniform prior on standard deviations (Gelman, *Bayesian Analysis* 1, 2006), so that none
        # collapses to zero. Those of the loads have paces.
        total[_OF_LENGTH:] += 0.5
        known = np.sum(states.log_likelihood) + np.sum(logarithms[_OF_LENGTH:]) / 2
        return float(step @ step + away**2) / 2 - float(known), -np.append(total, of_walk + pull)

    begin = np.clip(np.log(fit.intensities), *np.transpose(_BOUNDS))
    found = scipy.optimize.minimize(
        objective,
        np.append(begin, np.log(labels.pace[first])),
        jac=True,
        method="L-BFGS-B",
        bounds=_BOUNDS + [_PACE_BOUNDS] * len(first),
        options={"maxiter": 20, "ftol": 1e-5},
    )
    logarithms, walk = np.split(found.x, [INTENSITIES])
    labels = labels._replace(pace=paces(walk, stretch))
    return fit._replace(labels=labels, intensities=np.exp(logarithms))


def stretches(labels: Labels) -> Codes:
    """Number of the stretch that each sample belongs to; -1 without contact."""
    number, stretch = 0, np.full(len(labels.phase), -1)
    size = _STRETCH * together_for(labels) / TOGETHER
    for rows in labels.contacts:
        total = rows.stop - rows.start
        count = max(1, round(total / size))
        stretch[rows] = number + np.arange(total) * count // total
        number += count
    return stretch


def _longest_of(time: Samples, labels: Labels) -> float:
    """Duration [s] of the longest contact; 0 without contact."""
    return float(max((np.ptp(time[rows]) for rows in labels.contacts), default=0.0))


def as_flank(fit: Fit) -> Fit:
    """The fit with tip contacts also linearised about the coordinates that they would have in
    tangential contact, so that rivals are compared about their own.

    In tip contact they stay linearised about theirs: on a strongly curved rod a rival may be so far
    from the samples that no contact is found there, and its loads are no place to expand about.
    """
    labels, tip = fit.labels, fit.labels.phase == TIP
    if not tip.any():
        return fit
    phase = np.where(tip, TANGENTIAL, labels.phase)
    link = np.where(labels.link == JUMP, JUMP, GO_ON)
    flank = fit._replace(labels=labels._replace(phase=phase, link=link))
    for _ in range(_FLANK_STEPS):
        states = smoothed_states(flank, steps_of(flank))
        flank = _stepped(flank, _coordinates(states))
    return fit._replace(linear=chosen(tip, flank.linear, fit.linear))


def averaged(fit: Fit, candidates: list[Labels]) -> Fit:
    """Mean and covariance of the coordinates over equally probable labels and drift intensities:
    covariance within each, and between them.
    """
    means, squares, count = [], [], len(candidates)
    # Log-normally distributed factors, in an order unrelated to that of the alternatives: each is
    # followed by the one half the range away.
    order = np.arange(count).reshape(2, -1).T.ravel()
    factors = np.exp(_drift_deviation(fit) * ndtri((order + 0.5) / count))
    for labels, factor in zip(candidates, factors, strict=True):
        other = _with_drift(fit.with_phases(labels), factor)
        states = smoothed_states(other, steps_of(other), rough=False)
        means.append(_coordinates(states))
        squares.append(states.covariance[:, PLACE, PLACE])
    mean = np.mean(means, axis=0)
    away = np.stack(means) - mean
    covariance = fit.states.covariance.copy()
    between = np.einsum("kni,knj->nij", away, away) / count
    covariance[:, PLACE, PLACE] = np.mean(squares, axis=0) + between
    return fit._replace(
        linear=fit.linearised(mean), states=fit.states._replace(covariance=covariance)
    )


def _with_drift(fit: Fit, factor: float) -> Fit:
    """With the drift intensity multiplied by a factor."""
    intensities = np.append(fit.intensities[:-1], factor * fit.intensities[-1])
    return fit._replace(intensities=intensities)


def _drift_deviation(fit: Fit) -> float:
    """Standard deviation of the logarithm of the drift intensity, from the curvature of the
    likelihood.
    """
    less, more = (
        smoothed_states(_with_drift(fit, factor), steps_of(fit)).score[:, -1].sum()
        for factor in np.exp([-0.5, 0.5])
    )
    # Curvature of at least one e-fold: the likelihood says nothing about a drift that is not there.
    return float(1 / np.sqrt(max(less - more, 1.0)))
