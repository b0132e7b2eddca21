"""The iteration that smooths one series: linearise, smooth, weigh outliers, estimate the
intensities.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import minimize
from scipy.stats import norm

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import INTENSITIES, SIZE, WRENCH, States, Step, fetched
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, COORDINATES
from vibrissa.inverse.smoothing.merging import (
    TOGETHER,
    group_starts,
    merged,
    spread_out,
    together_for,
)
from vibrissa.inverse.smoothing.phases import first_labels, runs_of
from vibrissa.inverse.smoothing.series import (
    ARC_LENGTH_SPREAD,
    AT_REST,
    FREE,
    GO_ON,
    JUMP,
    KINK,
    TANGENTIAL,
    TILT_SPREAD,
    TIP,
    Labels,
    Linear,
    NoMotionError,
    Series,
    capacity_for,
    chosen,
    exists,
    filled,
    linearised,
    steps_of,
)

OUTLIER = 28.0
"""Squared residual, six degrees of freedom, that noise exceeds once in ten thousand samples;
further ones weigh less.
"""
TARE_VARIANCE = 0.02
"""Of the zero at the start of a recording, in variances of a sample: that of a tare over 50
samples.
"""
_STRETCH = 48
_ROUGH_STEPS, MOST_STEPS = 5, 12
_FLANK_STEPS = 3
_NEAR = 1
"""Steps after which the intensities are estimated."""
_CLOSE, _ROUGHLY = 1e-5, 1e-3
_AVERAGE = 0.04
_MEDIAN = 9
_USUALLY = 1.5
_BOUNDS = [(-18.0, 16.0)] * (INTENSITIES - 1) + [(-25.0, 3.0)]


class Zero(NamedTuple):
    """The sensor's zero where a series begins, in standard deviations of a sample."""

    mean: Float[np.ndarray, "6"]
    covariance: Float[np.ndarray, "6 6"]

    @classmethod
    def tared(cls) -> "Zero":
        """That of a recording that begins at rest."""
        return cls(np.zeros(WRENCH), TARE_VARIANCE * np.eye(WRENCH))


class Fit(NamedTuple):
    """A smoothed series."""

    labels: Labels
    about: Float[np.ndarray, "n 5"]
    weight: Float[np.ndarray, "n"]
    intensities: Float[np.ndarray, "5"]
    states: States
    zero: Zero


def initial(zero: Zero | None = None) -> tuple[Float[np.ndarray, "16"], Float[np.ndarray, "16 16"]]:
    """A rod free of contact, and what is known of the sensor's zero: the error of the tare, if
    nothing else.
    """
    zero = Zero.tared() if zero is None else zero
    covariance = np.zeros((SIZE, SIZE))
    covariance[2 * COORDINATES :, 2 * COORDINATES :] = zero.covariance
    return np.concatenate([AT_REST, np.zeros(COORDINATES), zero.mean]), covariance


def initial_states(count: int) -> States:
    """States of which nothing is known yet."""
    square = np.zeros((count, SIZE, SIZE))
    nothing = np.zeros((count, SIZE))
    return States(nothing, square, nothing, square, np.zeros(count), nothing, square)


def smoothed_states(
    steps: Step,
    labels: Labels,
    intensities: Float[np.ndarray, "5"],
    zero: Zero,
    *,
    rough: bool = False,
) -> States:
    """States at these steps, from a rod at rest on. Samples without contact are taken together, and
    others too where it is rough.
    """
    starts = group_starts([labels], together=together_for(labels, rough=rough))
    grouped = filled(merged(steps, starts), capacity_for(len(starts)))
    states = fetched(
        kalman.smoothed(grouped, np.array(len(starts)), intensities, *initial(zero)), len(starts)
    )
    return spread_out(states, steps, starts)


def first_guess(
    series: Series, loaded: Bool[np.ndarray, "n"], drift: Float[np.ndarray, "n 6"]
) -> tuple[Labels, Float[np.ndarray, "n 5"]]:
    """Phases, and coordinates from moving averages of the wrench over 40 ms."""
    phase, arc_length = first_labels(series, loaded, drift)
    size = max(1, round(_AVERAGE / series.step))
    average = uniform_filter1d(
        median_filter(series.wrench, (_MEDIAN, 1), mode="nearest"), size, axis=0, mode="nearest"
    )
    about = np.column_stack(
        [average[:, 3], average[:, 4], -average[:, 2], arc_length, np.zeros(len(phase))]
    )
    link = np.where(np.diff(phase, prepend=FREE) != 0, KINK, GO_ON)
    # A series that begins in contact begins with any load.
    link[:1] = np.where(phase[:1] != FREE, JUMP, GO_ON)
    return Labels(phase, link, np.ones(len(phase)), np.ones(len(phase))), np.where(
        (phase == FREE)[:, None], AT_REST, about
    )


def rates_of(
    series: Series, labels: Labels, about: Float[np.ndarray, "n 5"]
) -> Float[np.ndarray, "5"]:
    """Standard deviations of rates of which nothing is known: thirty times the range over the
    longest contact.
    """
    touching = labels.phase != FREE
    longest = max(
        (series.time[last] - series.time[first] for first, last in runs_of(touching)), default=1.0
    )
    longest = max(float(longest), series.step)
    load = (
        max(float(np.ptp(about[touching, :ARC_LENGTH], axis=0).max(initial=0.0)), 1e-2)
        if touching.any()
        else 1.0
    )
    return np.array([load, load, load, 0.3, TILT_SPREAD / 10]) * 30 / longest


def most_probable_intensities(
    steps: Step, start: Float[np.ndarray, "5"], labels: Labels, zero: Zero, *, local: bool
) -> tuple[Float[np.ndarray, "5"], Float[np.ndarray, "n"]]:
    """Intensities, and the pace of each sample, that maximise the marginal likelihood.

    The pace is constant over stretches of 48 samples of a contact; its logarithm is a random walk
    from each to the next, with a standard deviation of 1. A short tangential phase tells little of
    how freely s₁ moves: the logarithm of that intensity has a normal prior about the one with which
    s₁ crosses its range in the time of a contact.
    """
    stretch = stretches(labels)
    starts = group_starts([labels], np.diff(stretch, prepend=-1) != 0, together_for(labels))
    grouped = filled(merged(steps, starts), capacity_for(len(starts)))
    blocks = int(stretch.max(initial=-1)) + 1 if local else 0
    expected = np.log(_usual_arc_length_intensity(steps, labels))
    linked = (
        np.diff(_contact_of(labels, stretch, blocks)) == 0 if blocks else np.zeros(0, dtype=bool)
    )
    logarithm = np.array([np.log(labels.pace[stretch == block][0]) for block in range(blocks)])
    of_group = stretch[starts]

    def paces(
        values: Float[np.ndarray, "b"],
        number: Int[np.ndarray, "k"],
        otherwise: Float[np.ndarray, "k"],
    ) -> Float[np.ndarray, "k"]:
        return (
            np.where(number >= 0, np.exp(np.clip(values, -20, 20))[number], 1.0)
            if blocks
            else otherwise
        )

    def objective(values: Float[np.ndarray, "k"]) -> tuple[float, Float[np.ndarray, "k"]]:
        pace = paces(values[INTENSITIES:], of_group, np.asarray(grouped.pace)[: len(starts)])
        now = np.exp(values[:INTENSITIES])
        grouped.pace[: len(starts)] = pace
        states = fetched(
            kalman.smoothed(grouped, np.array(len(starts)), now, *initial(zero)), len(starts)
        )
        slopes = kalman.score(Step(*(part[: len(starts)] for part in grouped)), states, now)
        local_slope = (
            np.bincount(of_group[of_group >= 0], slopes[of_group >= 0, :2].sum(axis=1), blocks)
            if blocks
            else np.zeros(0)
        )
        step = np.where(linked, np.diff(values[INTENSITIES:]), 0.0)
        pull = np.diff(step, prepend=0.0, append=0.0) if blocks else np.zeros(0)
        away = (values[ARC_LENGTH - 1] - expected) / _USUALLY
        total = slopes.sum(axis=0)
        total[ARC_LENGTH - 1] -= away / _USUALLY
        # All standard deviations are equally probable (Gelman, *Bayesian Analysis* 1, 2006): none
        # collapses to zero. Those of the loads have paces.
        total[ARC_LENGTH - 1 :] += 0.5
        known = (
            float(np.sum(states.log_likelihood)) + np.sum(values[ARC_LENGTH - 1 : INTENSITIES]) / 2
        )
        return float(step @ step + away**2) / 2 - known, -np.concatenate(
            [total, local_slope + pull]
        )

    bounds = _BOUNDS + [(-14.0, 14.0)] * blocks
    first = np.concatenate([np.clip(np.log(start), *np.array(_BOUNDS).T), logarithm])
    found = minimize(
        objective,
        first,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": 20, "ftol": 1e-5},
    )
    return np.exp(found.x[:INTENSITIES]), paces(found.x[INTENSITIES:], stretch, labels.pace)


def _usual_arc_length_intensity(steps: Step, labels: Labels) -> float:
    """That of an integrated Wiener process whose standard deviation is `ARC_LENGTH_SPREAD` at the
    end of the longest contact.
    """
    time = np.cumsum(steps.duration)
    longest = max(
        (time[last] - time[first] for first, last in runs_of(labels.phase != FREE)), default=0.0
    )
    return float(3 * ARC_LENGTH_SPREAD**2 / max(longest, 1e-3 * (time[-1] - time[0]), 1e-9) ** 3)


def stretches(labels: Labels) -> Int[np.ndarray, "n"]:
    """Number of the stretch that each sample belongs to; -1 without contact."""
    number, stretch = 0, np.full(len(labels.phase), -1)
    size = _STRETCH * together_for(labels) / TOGETHER
    for first, last in runs_of(labels.phase != FREE):
        count = max(1, round((last - first + 1) / size))
        stretch[first : last + 1] = number + np.arange(last - first + 1) * count // (
            last - first + 1
        )
        number += count
    return stretch


def _contact_of(labels: Labels, stretch: Int[np.ndarray, "n"], blocks: int) -> Int[np.ndarray, "b"]:
    contact = np.cumsum(np.diff(labels.phase != FREE, prepend=False))
    return np.array([contact[np.argmax(stretch == block)] for block in range(blocks)])


def fitted(
    series: Series,
    fit: Fit,
    rates: Float[np.ndarray, "5"],
    *,
    modulus_spread: float | None,
    local: bool = True,
    most_steps: int = _ROUGH_STEPS,
) -> Fit:
    """Gauss-Newton with robust weights, and with the intensities estimated once it is near."""
    labels, about, weight, intensities, states, zero = fit
    linear, close = linearised(about), _CLOSE if most_steps > _ROUGH_STEPS else _ROUGHLY
    rough = True
    for iteration in range(most_steps):
        steps = steps_of(
            series, labels, about, weight, rates, modulus_spread=modulus_spread, linear=linear
        )
        if iteration == _NEAR:
            intensities, pace = most_probable_intensities(
                steps, intensities, labels, zero, local=local
            )
            labels = labels._replace(pace=pace)
            steps = steps._replace(pace=pace)
        rough = rough and iteration < most_steps - 1
        states = smoothed_states(steps, labels, intensities, zero, rough=rough)
        new = _coordinates(labels, states.mean)
        change = float(np.abs(new - about).max())
        if not np.isfinite(change):
            raise NoMotionError
        about, linear = _stepped(about, linear, new)
        weight = robust_weights(series, labels, linear, states)
        if change < close and not rough:
            break
        rough = rough and (iteration <= _NEAR or change > _ROUGHLY)
    return Fit(labels, about, weight, intensities, states, zero)


def _coordinates(labels: Labels, means: Float[np.ndarray, "n 16"]) -> Float[np.ndarray, "n 5"]:
    """About which to linearise."""
    values = np.where((labels.phase == FREE)[:, None], AT_REST, means[:, :COORDINATES])
    values[:, ARC_LENGTH] = np.clip(values[:, ARC_LENGTH], 0.02, 1.2)
    return values


def _stepped(
    about: Float[np.ndarray, "n 5"], linear: Linear, new: Float[np.ndarray, "n 5"]
) -> tuple[Float[np.ndarray, "n 5"], Linear]:
    """The model about the new coordinates; about the old ones where there is no rod with the new."""
    there = linearised(new)
    sound = exists(there)
    return (
        (new, there)
        if sound.all()
        else (np.where(sound[:, None], new, about), chosen(sound, there, linear))
    )


def as_flank(
    series: Series, fit: Fit, rates: Float[np.ndarray, "5"], *, modulus_spread: float | None
) -> Fit:
    """The fit with what would be its coordinates in tangential contact where the contact is taken
    for one at the tip: rivals are compared about their own.
    """
    tip = fit.labels.phase == TIP
    if not tip.any():
        return fit
    link = np.where(
        (fit.labels.link == KINK) & (np.diff(fit.labels.phase != FREE, prepend=False) == 0),
        GO_ON,
        fit.labels.link,
    )
    labels = fit.labels._replace(phase=np.where(tip, TANGENTIAL, fit.labels.phase), link=link)
    about, linear = fit.about, linearised(fit.about)
    for _ in range(_FLANK_STEPS):
        steps = steps_of(
            series, labels, about, fit.weight, rates, modulus_spread=modulus_spread, linear=linear
        )
        about, linear = _stepped(
            about,
            linear,
            _coordinates(
                labels, smoothed_states(steps, labels, fit.intensities, fit.zero, rough=True).mean
            ),
        )
    return fit._replace(about=np.where(tip[:, None], about, fit.about))


def averaged(
    series: Series,
    fit: Fit,
    candidates: list[Labels],
    rates: Float[np.ndarray, "5"],
    *,
    modulus_spread: float | None,
) -> Fit:
    """Mean and covariance of the coordinates over equally probable labels and intensities of the
    drift: that within each, and that between them.
    """
    at_tip = fit.about.copy()
    at_tip[:, ARC_LENGTH] = 1
    linears = linearised(fit.about), linearised(at_tip)
    means, squares = [], []
    deviation = drift_deviation(
        steps_of(
            series,
            fit.labels,
            fit.about,
            fit.weight,
            rates,
            modulus_spread=modulus_spread,
            linear=linears[0],
        ),
        fit,
    )
    for labels, factor in zip(
        candidates, equally_probable(deviation, len(candidates)), strict=True
    ):
        tip = labels.phase == TIP
        about, linear = (
            np.where(tip[:, None], at_tip, fit.about),
            chosen(tip, linears[1], linears[0]),
        )
        steps = steps_of(
            series, labels, about, fit.weight, rates, modulus_spread=modulus_spread, linear=linear
        )
        states = smoothed_states(
            steps, labels, np.append(fit.intensities[:-1], factor * fit.intensities[-1]), fit.zero
        )
        means.append(_coordinates(labels, states.mean))
        squares.append(states.covariance[:, :COORDINATES, :COORDINATES])
    about = np.mean(means, axis=0)
    away = np.stack(means) - about
    covariance = fit.states.covariance.copy()
    covariance[:, :COORDINATES, :COORDINATES] = np.mean(squares, axis=0) + np.einsum(
        "kni,knj->nij", away, away
    ) / len(candidates)
    return fit._replace(about=about, states=fit.states._replace(covariance=covariance))


def drift_deviation(steps: Step, fit: Fit) -> float:
    """Standard deviation of the logarithm of the drift's intensity, by the curvature of the
    likelihood.
    """
    starts = group_starts([fit.labels], together=together_for(fit.labels))
    grouped = merged(steps, starts)
    slopes = []
    for sign in (-1, 1):
        intensities = np.append(fit.intensities[:-1], np.exp(sign / 2) * fit.intensities[-1])
        states = fetched(
            kalman.smoothed(
                filled(grouped, capacity_for(len(starts))),
                np.array(len(starts)),
                intensities,
                *initial(fit.zero),
            ),
            len(starts),
        )
        slopes.append(float(np.sum(kalman.score(grouped, states, intensities)[:, -1])))
    return float(1 / np.sqrt(max(slopes[0] - slopes[1], 1.0)))


def equally_probable(deviation: float, count: int) -> Float[np.ndarray, "k"]:
    """Factors with a log-normal distribution, in an order unrelated to that of the alternatives:
    each is followed by the one half the range off.
    """
    order = np.arange(count).reshape(2, -1).T.ravel()
    return np.asarray(np.exp(deviation * norm.ppf((order + 0.5) / count)))


def first_weights(series: Series) -> Float[np.ndarray, "n"]:
    """Weights of samples against the medians of nine, so that no outlier is followed from the
    start.
    """
    residual = series.whitened - median_filter(series.whitened, (_MEDIAN, 1), mode="nearest")
    return np.minimum(1.0, OUTLIER / np.maximum(np.sum(residual**2, axis=1), 1e-300))


def squared_residuals(
    series: Series, labels: Labels, linear: Linear, states: States
) -> Float[np.ndarray, "n"]:
    """Of the whitened wrench about the smoothed one: six degrees of freedom, a little fewer as the
    motion follows the noise.
    """
    expected = np.where((labels.phase == FREE)[:, None], 0.0, linear.values.wrench)
    residual = (
        series.whitened
        - np.einsum("nij,nj->ni", series.whitening, expected)
        - states.mean[:, 2 * COORDINATES :]
    )
    squared = np.sum(residual**2, axis=1)
    return np.where(np.isfinite(squared), squared, 0.0)


def robust_weights(
    series: Series, labels: Labels, linear: Linear, states: States
) -> Float[np.ndarray, "n"]:
    """1 up to the limit, beyond it the limit over the squared residual: the farther an outlier, the
    less it pulls, and no intensity has to explain it.
    """
    return np.minimum(
        1.0, OUTLIER / np.maximum(squared_residuals(series, labels, linear, states), 1e-300)
    )
