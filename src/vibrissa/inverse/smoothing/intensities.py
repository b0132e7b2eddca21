"""How freely a contact moves along a sweep, and the sensor's zero drifts: the most probable
spectral densities.
"""

import numpy as np
from scipy.optimize import minimize

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import INTENSITIES, Step
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH
from vibrissa.inverse.smoothing.merging import TOGETHER, groups_of, merged, together_for
from vibrissa.inverse.smoothing.model import ARC_LENGTH_SPREAD
from vibrissa.inverse.smoothing.phases import runs_of
from vibrissa.inverse.smoothing.series import FREE, Codes, Fit, Labels, Samples

_STRETCH = 48
"""Samples of one pace."""
_USUALLY = 1.5
"""Standard deviation of the logarithm of s₁'s intensity."""
_BOUNDS = [(-18.0, 16.0)] * (INTENSITIES - 1) + [(-25.0, 3.0)]
_PACE_BOUNDS = (-14.0, 14.0)
"""Of logarithms, beyond which the likelihood is flat."""


def most_probable(fit: Fit, steps: Step, *, local: bool) -> Fit:
    """The fit with intensities, and the pace of each sample, that maximise the marginal likelihood.

    The pace is constant over stretches of 48 samples of a contact; its logarithm is a random walk
    from each to the next, with a standard deviation of 1. A short tangential phase tells little of
    how freely s₁ moves: the logarithm of that intensity has a normal prior about the one with which
    s₁ crosses its range in the time of a contact. Without `local`, paces stay as they are.
    """
    labels, start = fit.labels, kalman.at_rest(fit.zero)
    stretch = stretches(labels)
    starts = groups_of(labels, np.diff(stretch, prepend=-1) != 0)
    grouped, number = merged(steps, starts), stretch[starts]
    first = np.unique(stretch, return_index=True)[1][int((stretch < 0).any()) :]
    first = first if local else first[:0]
    linked = np.diff(labels.contact[first]) == 0
    time = np.cumsum(steps.duration)
    longest = max(longest_of(time, labels), 1e-3 * (time[-1] - time[0]), 1e-9)
    # That of an integrated Wiener process of this deviation at the end of the longest contact.
    expected = np.log(3 * ARC_LENGTH_SPREAD**2 / longest**3)

    def paces(values: np.ndarray, of: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
        # Without contact, number -1, the pace is 1.
        return np.exp(np.append(values, 0.0))[of] if local else otherwise

    def objective(values: Samples) -> tuple[float, Samples]:
        logarithms, walk = np.split(values, [INTENSITIES])
        intensities = np.exp(logarithms)
        now = grouped._replace(pace=paces(walk, number, grouped.pace))
        states = kalman.smoothed(now, intensities, start)
        inside = (number >= 0) & local
        of_walk = np.bincount(number[inside], states.score[inside, :2].sum(axis=1), len(walk))
        step = np.where(linked, np.diff(walk), 0.0)
        pull = np.diff(step, prepend=0.0, append=0.0)[: len(walk)]
        away = (logarithms[ARC_LENGTH - 1] - expected) / _USUALLY
        total = states.score.sum(axis=0)
        total[ARC_LENGTH - 1] -= away / _USUALLY
        # All standard deviations are equally probable (Gelman, *Bayesian Analysis* 1, 2006): none
        # collapses to zero. Those of the loads have paces.
        total[ARC_LENGTH - 1 :] += 0.5
        known = np.sum(states.log_likelihood) + np.sum(logarithms[ARC_LENGTH - 1 :]) / 2
        return float(step @ step + away**2) / 2 - float(known), -np.append(total, of_walk + pull)

    found = minimize(
        objective,
        np.append(
            np.clip(np.log(fit.intensities), *np.array(_BOUNDS).T), np.log(labels.pace[first])
        ),
        jac=True,
        method="L-BFGS-B",
        bounds=_BOUNDS + [_PACE_BOUNDS] * len(first),
        options={"maxiter": 20, "ftol": 1e-5},
    )
    logarithms, walk = np.split(found.x, [INTENSITIES])
    pace = paces(walk, stretch, labels.pace)
    return fit._replace(labels=labels._replace(pace=pace), intensities=np.exp(logarithms))


def stretches(labels: Labels) -> Codes:
    """Number of the stretch that each sample belongs to; -1 without contact."""
    number, stretch = 0, np.full(len(labels.phase), -1)
    size = _STRETCH * together_for(labels) / TOGETHER
    for first, last in runs_of(labels.phase != FREE):
        rows = last - first + 1
        count = max(1, round(rows / size))
        stretch[first : last + 1] = number + np.arange(rows) * count // rows
        number += count
    return stretch


def longest_of(time: Samples, labels: Labels) -> float:
    """Time [s] that the longest contact takes; 0 without contact."""
    spans = [time[last] - time[first] for first, last in runs_of(labels.phase != FREE)]
    return float(max(spans, default=0.0))
