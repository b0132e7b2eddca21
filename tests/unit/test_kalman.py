"""The smoother's algebra against the joint Gaussian distribution of a short series, written out
densely.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from vibrissa.inverse.smoothing import kalman
from vibrissa.inverse.smoothing.kalman import (
    DRIFT,
    PLACE,
    ROWS,
    SIZE,
    WRENCH,
    Gaussian,
    Step,
)
from vibrissa.numerics.compiled import compiled

COUNT = 6
INTENSITIES = np.array([0.5, 0.8, 0.3, 0.1, 0.05])


def series(seed: int = 3) -> Step:
    """Random observations of a short series: one sample unseen, one where some states begin anew,
    one where a coordinate is known.
    """
    rng = np.random.default_rng(seed)
    keep, begin, spread, active = (
        np.ones((COUNT, SIZE)),
        np.zeros((COUNT, SIZE)),
        np.zeros((COUNT, SIZE)),
        np.ones((COUNT, 5)),
    )
    keep[3, 5:10], spread[3, 5:10] = 0, 2.0
    keep[4:, [3, 8]], begin[4:, 3], active[4:, 3] = 0, 1, 0
    slope = np.zeros((COUNT, ROWS, 5))
    slope[:, :WRENCH] = rng.normal(size=(COUNT, 6, 5))
    variance = np.full((COUNT, ROWS), np.inf)
    variance[:, :WRENCH] = rng.uniform(0.5, 2, (COUNT, 1))
    variance[2] = np.inf
    slope[1, 6, 3], variance[1, 6] = 1, 1e-3
    duration = np.array([0.0, 0.3, 0.2, 0.4, 0.3, 0.25])
    target = rng.normal(size=(COUNT, ROWS))
    pace = rng.uniform(0.5, 2, COUNT)
    return Step(keep, begin, spread, active, duration, pace, target, slope, variance)


def first() -> Gaussian:
    rng = np.random.default_rng(8)
    root = rng.normal(size=(SIZE, SIZE)) / 4
    return Gaussian(rng.normal(size=SIZE), root @ root.T)


@partial(compiled, quick=True)
def predicted(start: Gaussian, step: Step) -> Gaussian:
    return kalman.predicted(kalman.entered(start, *step[:3]), step, jnp.asarray(INTENSITIES))


def observing(steps: Step) -> np.ndarray:
    """What all observations of the series show of all its states."""
    design = np.zeros((COUNT, ROWS, COUNT, SIZE))
    for k in range(COUNT):
        design[k, :, k, PLACE] = steps.slope[k]
        design[k, :WRENCH, k, DRIFT] = np.eye(WRENCH)
    return design.reshape(COUNT * ROWS, COUNT * SIZE)


def joint(steps: Step) -> tuple[np.ndarray, np.ndarray]:
    """Mean (n·16) and covariance of all states before anything is seen."""
    state = first()
    means, rows = [], np.zeros((0, 0))
    for k in range(COUNT):
        step = jax.tree.map(lambda part, k=k: part[k], steps)
        keep, moving = step.keep, step.active * step.duration
        transition = np.diag(keep)
        transition[:5] += np.eye(16)[5:10] * (moving * keep[5:10])[:, None]
        state = predicted(state, step)
        mean, covariance = map(np.asarray, state)
        means.append(mean)
        across = transition @ rows[-SIZE:] if k else np.zeros((SIZE, 0))
        rows = np.block([[rows, across.T], [across, covariance]]) if k else covariance
    return np.concatenate(means), rows


def test_smoothed_states_are_the_conditional_distribution() -> None:
    steps = series()
    mean, covariance = joint(steps)
    seen = np.isfinite(np.asarray(steps.variance)).reshape(-1)
    design = observing(steps)
    z, target = design[seen], np.asarray(steps.target).reshape(-1)[seen]
    spread = z @ covariance @ z.T + np.diag(np.asarray(steps.variance).reshape(-1)[seen])
    gain = covariance @ z.T @ np.linalg.inv(spread)
    states = kalman.smoothed(steps, INTENSITIES, first())
    np.testing.assert_allclose(
        np.asarray(states.mean).reshape(-1), mean + gain @ (target - z @ mean), atol=1e-9
    )
    after = covariance - gain @ z @ covariance
    for k in range(COUNT):
        rows = slice(k * SIZE, (k + 1) * SIZE)
        np.testing.assert_allclose(states.covariance[k], after[rows, rows], atol=1e-9)
    expected = multivariate_normal(z @ mean, spread).logpdf(target)
    assert float(jnp.sum(states.log_likelihood)) == pytest.approx(expected, abs=1e-8)


def test_likelihoods_are_those_of_the_wrenches_given_the_constraints() -> None:
    """In whatever units the constraints are: here in small ones, so that no density is below 1."""
    steps = series()
    unit = np.where(np.arange(ROWS) < WRENCH, 1.0, 1e-3)
    steps = steps._replace(
        target=steps.target * unit,
        slope=steps.slope * unit[:, None],
        variance=steps.variance * unit**2,
    )
    mean, covariance = joint(steps)
    design = observing(steps)
    seen = np.isfinite(np.asarray(steps.variance))
    told = []
    for rows in (seen, seen & (np.arange(ROWS) >= WRENCH)):
        z, target = design[rows.ravel()], np.asarray(steps.target)[rows]
        spread = z @ covariance @ z.T + np.diag(np.asarray(steps.variance)[rows])
        told.append(multivariate_normal(z @ mean, spread).logpdf(target))
    values = kalman.log_likelihoods([steps, steps], INTENSITIES, first())
    np.testing.assert_allclose(values, told[0] - told[1], rtol=0, atol=1e-7)


def test_the_score_is_the_derivative_of_the_log_likelihood() -> None:
    steps, start = series(), first()
    states = kalman.smoothed(steps, INTENSITIES, start)
    score = states.score.sum(axis=0)
    step = 1e-5
    for k in range(5):
        up, down = (INTENSITIES * np.exp(sign * step * np.eye(5)[k]) for sign in (1, -1))
        above, below = (
            float(jnp.sum(kalman.smoothed(steps, moved, start).log_likelihood))
            for moved in (up, down)
        )
        slope = (above - below) / (2 * step)
        assert score[k] == pytest.approx(float(slope), abs=1e-6)


def test_a_shock_is_chi_square_where_there_is_none() -> None:
    """R has the covariance N: over many series, rᵀ N⁻¹ r averages to the number of entries."""
    steps, start = series(), first()
    rng = np.random.default_rng(5)
    mean, covariance = joint(steps)
    values = []
    for _ in range(100):
        states = rng.multivariate_normal(mean, covariance, method="eigh")
        noise = rng.normal(size=(COUNT, ROWS)) * np.sqrt(
            np.where(np.isfinite(steps.variance), steps.variance, 0)
        )
        target = (observing(steps) @ states).reshape(COUNT, ROWS) + noise
        found = kalman.smoothed(steps._replace(target=target), INTENSITIES, start)
        pull, information = found.pull[3, :3], found.information[3, :3, :3]
        values.append(pull @ np.linalg.solve(information, pull))
    # Mean of 100 chi-squares with three degrees of freedom: deviation √(6/100).
    assert np.mean(values) == pytest.approx(3, abs=4 * np.sqrt(6 / 100))


def test_series_that_differ_in_their_readings_alone_are_smoothed_together() -> None:
    """As columns of the same pass; they are what each of them is by itself."""
    steps, start = series(), first()
    targets = np.random.default_rng(9).normal(size=(COUNT, ROWS, 3))
    steps = steps._replace(begin=np.zeros_like(steps.begin), target=targets)
    columns = start._replace(mean=np.tile(start.mean[:, None], 3))
    together = kalman.smoothed(steps, INTENSITIES, columns)
    for k in range(3):
        alone = kalman.smoothed(steps._replace(target=targets[..., k]), INTENSITIES, start)
        np.testing.assert_allclose(together.mean[..., k], alone.mean, rtol=0, atol=1e-12)
        assert np.sum(together.log_likelihood[:, k]) == pytest.approx(np.sum(alone.log_likelihood))
