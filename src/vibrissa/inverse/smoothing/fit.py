"""The iteration that smooths one series: linearise, smooth, weigh outliers, estimate the
intensities.
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.stats import norm

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.intensities import longest_of, most_probable
from vibrissa.inverse.smoothing.kalman import (
    DRIFT,
    PLACE,
    SIZE,
    WRENCH,
    Gaussian,
    States,
)
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, AT_REST, LOADS, chosen, linearised
from vibrissa.inverse.smoothing.merging import (
    groups_of,
    merged,
    smoothed_states,
)
from vibrissa.inverse.smoothing.model import TILT_SPREAD, steps_of
from vibrissa.inverse.smoothing.phases import first_labels
from vibrissa.inverse.smoothing.series import (
    FREE,
    GO_ON,
    JUMP,
    KINK,
    TANGENTIAL,
    TIP,
    Fit,
    Flags,
    Labels,
    NoMotionError,
    Rates,
    Samples,
    Series,
)

Coordinates = Float[np.ndarray, "n coordinates"]

OUTLIER = 28.0
"""Squared residual, six degrees of freedom, that noise exceeds once in ten thousand samples;
further ones weigh less.
"""
TARED = Gaussian(np.zeros(WRENCH), 0.02 * np.eye(WRENCH))
"""The zero of a recording that begins at rest, in standard deviations of a sample: a tare over 50
samples."""
_START = np.array([1.0, 1.0, 0.01, 1e-6, 1e-3])
"""Intensities of a contact that crosses its range in some seconds."""
_ROUGH_STEPS, MOST_STEPS = 5, 12
"""Steps of Gauss-Newton: usually four are enough for `_ROUGHLY`, six for `_CLOSE`."""
_FLANK_STEPS = 3
_NEAR = 1
"""Steps after which the intensities are estimated."""
_CLOSE, _ROUGHLY = 1e-5, 1e-3
"""Change of the coordinates at which to stop: a hundredth of the noise's errors, and about them."""
_AVERAGE = 0.04
"""[s] over which the first guess is averaged."""
_MEDIAN = 9
"""Samples whose median no outlier moves."""


def first_guess(series: Series, loaded: Flags, drift: Float[np.ndarray, "*n wrench"]) -> Fit:
    """Phases, and coordinates from moving averages of the wrench over 40 ms."""
    phase, arc_length = first_labels(series, loaded, drift)
    size = max(1, round(_AVERAGE / series.step))
    average = uniform_filter1d(
        median_filter(series.wrench, (_MEDIAN, 1), mode="nearest"), size, axis=0, mode="nearest"
    )
    force, moment = np.split(average, 2, axis=1)
    x = np.column_stack([moment[:, :2], -force[:, 2], arc_length, np.zeros(len(phase))])
    link = np.where(np.diff(phase, prepend=FREE) != 0, KINK, GO_ON)
    # A series that begins in contact begins with any load.
    link[:1] = np.where(phase[:1] != FREE, JUMP, GO_ON)
    count, touching = len(phase), phase != FREE
    labels = Labels(phase, link, np.ones(count), np.ones(count))
    # No outlier is followed from the start.
    residual = series.whitened - median_filter(series.whitened, (_MEDIAN, 1), mode="nearest")
    linear = linearised(np.where(touching[:, None], x, AT_REST))
    nothing, square = np.zeros((count, SIZE)), np.zeros((count, SIZE, SIZE))
    return Fit(
        series,
        labels,
        linear,
        linear,
        _robust(np.sum(residual**2, axis=1)),
        States(nothing, square, nothing, square, nothing, np.zeros(count), nothing, square),
        _rates(series, labels, linear.x),
        _START,
        TARED,
        None,
    )


def _rates(series: Series, labels: Labels, x: Coordinates) -> Rates:
    """Standard deviations of rates of which nothing is known: thirty times the range over the
    longest contact.
    """
    touching = labels.phase != FREE
    longest = max(longest_of(series.time, labels) or 1.0, series.step)
    load = float(np.ptp(x[touching, :LOADS], axis=0).max()) if touching.any() else 1.0
    return np.array([*[max(load, 1e-2)] * LOADS, 0.3, TILT_SPREAD / 10]) * 30 / longest


def fitted(fit: Fit, *, local: bool = True, most_steps: int = _ROUGH_STEPS) -> Fit:
    """Gauss-Newton with robust weights, and with the intensities estimated once it is near."""
    close, rough = _CLOSE if most_steps > _ROUGH_STEPS else _ROUGHLY, True
    for iteration in range(most_steps):
        steps = steps_of(fit)
        if iteration == _NEAR:
            fit = most_probable(fit, steps, local=local)
            steps = steps._replace(pace=fit.labels.pace)
        rough = rough and iteration < most_steps - 1
        fit = fit._replace(states=smoothed_states(fit, steps, rough=rough))
        new = coordinates(fit.labels, fit.states.mean)
        change = float(np.abs(new - fit.linear.x).max())
        if not np.isfinite(change):
            raise NoMotionError
        fit = _stepped(fit, new)
        fit = fit._replace(weight=_robust(squared_residuals(fit)))
        if change < close and not rough:
            break
        rough = rough and (iteration <= _NEAR or change > _ROUGHLY)
    return fit.about(fit.linear)


def coordinates(labels: Labels, mean: Float[np.ndarray, "n state"]) -> Coordinates:
    """About which to linearise."""
    values = np.where((labels.phase == FREE)[:, None], AT_REST, mean[:, PLACE])
    values[:, ARC_LENGTH] = np.clip(values[:, ARC_LENGTH], 0.02, 1.2)
    return values


def _stepped(fit: Fit, new: Coordinates) -> Fit:
    """About the new coordinates; about the old ones where there is no rod with the new."""
    there = linearised(new)
    return fit._replace(linear=chosen(there.exists, there, fit.linear))


def as_flank(fit: Fit) -> Fit:
    """The fit with what would be its coordinates in tangential contact where the contact is taken
    for one at the tip: rivals are compared about their own.
    """
    labels, tip = fit.labels, fit.labels.phase == TIP
    if not tip.any():
        return fit
    goes_on = (labels.link == KINK) & (np.diff(labels.phase != FREE, prepend=False) == 0)
    flank = fit._replace(
        labels=labels._replace(
            phase=np.where(tip, TANGENTIAL, labels.phase),
            link=np.where(goes_on, GO_ON, labels.link),
        )
    )
    for _ in range(_FLANK_STEPS):
        states = smoothed_states(flank, steps_of(flank))
        flank = _stepped(flank, coordinates(flank.labels, states.mean))
    return fit.about(chosen(tip, flank.linear, fit.linear))


def averaged(fit: Fit, candidates: list[Labels]) -> Fit:
    """Mean and covariance of the coordinates over equally probable labels and intensities of the
    drift: that within each, and that between them.
    """
    means, squares = [], []
    # Factors with a log-normal distribution, in an order unrelated to that of the alternatives:
    # each is followed by the one half the range off.
    order, count = np.arange(len(candidates)).reshape(2, -1).T.ravel(), len(candidates)
    factors = np.exp(_drift_deviation(fit) * norm.ppf((order + 0.5) / count))
    for labels, factor in zip(candidates, factors, strict=True):
        other = fit.with_phases(labels)._replace(intensities=_with_drift(fit, factor))
        states = smoothed_states(other, steps_of(other), rough=False)
        means.append(coordinates(labels, states.mean))
        squares.append(states.covariance[:, PLACE, PLACE])
    mean = np.mean(means, axis=0)
    away = np.stack(means) - mean
    covariance = fit.states.covariance.copy()
    between = np.einsum("kni,knj->nij", away, away) / count
    covariance[:, PLACE, PLACE] = np.mean(squares, axis=0) + between
    states = fit.states._replace(covariance=covariance)
    return fit._replace(linear=linearised(mean), states=states)


def _with_drift(fit: Fit, factor: float) -> Float[np.ndarray, "intensities"]:
    """Intensities with that of the drift times a factor."""
    return np.append(fit.intensities[:-1], factor * fit.intensities[-1])


def _drift_deviation(fit: Fit) -> float:
    """Standard deviation of the logarithm of the drift's intensity, by the curvature of the
    likelihood.
    """
    steps, slopes = merged(steps_of(fit), groups_of(fit.labels)), []
    for half in (-0.5, 0.5):
        states = kalman.smoothed(steps, _with_drift(fit, np.exp(half)), kalman.at_rest(fit.zero))
        slopes.append(states.score[:, -1].sum())
    # At least that of an e-fold: the likelihood tells nothing of a drift that there is not.
    return float(1 / np.sqrt(max(slopes[0] - slopes[1], 1.0)))


def squared_residuals(fit: Fit) -> Samples:
    """Of the whitened wrench about the smoothed one: six degrees of freedom, a little fewer as the
    motion follows the noise.
    """
    series = fit.series
    expected = np.where((fit.labels.phase == FREE)[:, None], 0.0, fit.linear.value.wrench)
    whitened = np.einsum("nij,nj->ni", series.whitening, series.wrench - expected)
    squared = np.sum((whitened - fit.states.mean[:, DRIFT]) ** 2, axis=1)
    return np.where(np.isfinite(squared), squared, 0.0)


def _robust(squared: Samples) -> Samples:
    """1 up to the limit, beyond it the limit over the squared residual: the farther an outlier, the
    less it pulls, and no intensity has to explain it.
    """
    return np.minimum(1.0, OUTLIER / np.maximum(squared, OUTLIER))
