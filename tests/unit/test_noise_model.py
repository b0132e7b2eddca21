"""Coloured noise has the spectrum and the covariances that are stated; a mean of rounded numbers
the error that is stated.
"""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import welch

from vibrissa.sensor.noise import Pink, RandomWalk, quantisation_of_mean

UNEVEN = np.cumsum(np.random.default_rng(3).uniform(0.002, 0.03, 60)) + 5.0


def test_pink_noise_falls_with_one_over_the_frequency() -> None:
    """Welch's estimate over octaves up to an eighth of the rate, which keeps off the band's edge.

    A segment's periodogram has a relative error of 1, a mean of k of them 1/√k; of segments that
    overlap by half, three quarters count.
    """
    rate, count, channels, segment = 200.0, 2**15, 6, 2**12
    noise = Pink.within((count - 1) / rate, 1 / rate).sampled(
        np.arange(count) / rate, np.random.default_rng(1), channels
    )
    frequency, density = welch(noise, fs=rate, nperseg=segment, axis=0, detrend="constant")
    for low in 0.25 * 2.0 ** np.arange(6):
        band = (frequency >= low) & (frequency < 2 * low)
        ratio = np.mean(density[band] * frequency[band, None])
        independent = 0.75 * (2 * count / segment - 1) * channels * np.count_nonzero(band)
        assert abs(ratio - 1) < 4 / np.sqrt(independent) + 0.04


def autocovariance(noise: Pink, lag: np.ndarray) -> np.ndarray:
    return noise.variance * np.sum(np.exp(-np.abs(lag)[..., None] * noise.rates), axis=-1)


def test_pink_noise_on_uneven_stamps_has_the_same_covariance() -> None:
    noise = Pink.within(np.ptp(UNEVEN), np.median(np.diff(UNEVEN)))
    samples = noise.sampled(UNEVEN, np.random.default_rng(2), 20000)
    expected = autocovariance(noise, UNEVEN[:, None] - UNEVEN)
    seen = samples @ samples.T / samples.shape[1]
    # Of n products of normal numbers of variances a, b and covariance c: (ab + c²)/n.
    deviation = np.sqrt(
        (np.outer(np.diag(expected), np.diag(expected)) + expected**2) / samples.shape[1]
    )
    assert np.abs((seen - expected) / deviation).max() < 5


def test_a_random_walks_steps_have_the_variance_of_their_length() -> None:
    samples = RandomWalk(5.0).sampled(UNEVEN, np.random.default_rng(2), 20000)
    steps = (
        np.diff(np.vstack([np.zeros(20000), samples]), axis=0)
        / np.sqrt(np.diff(UNEVEN, prepend=5.0))[:, None]
    )
    assert np.abs(steps @ steps.T / 20000 - np.eye(len(UNEVEN))).max() < 5 * np.sqrt(2 / 20000)
    np.testing.assert_allclose(RandomWalk(5.0).variance_at(UNEVEN), UNEVEN - 5)


INTERVALS = [(5.1, 5.5), (5.6, 6.0)]


@pytest.mark.parametrize("kind", ["pink", "walk"])
def test_means_over_rest_have_the_covariances_of_integrals(kind: str) -> None:
    noise = (
        Pink.within(np.ptp(UNEVEN), np.median(np.diff(UNEVEN)))
        if kind == "pink"
        else RandomWalk(5.0)
    )

    def covariance(first: float, second: float) -> float:
        return (
            float(autocovariance(noise, np.array(first - second)))
            if isinstance(noise, Pink)
            else min(first, second) - 5.0
        )

    def mean(first: float, start: float, stop: float) -> float:
        return quad(
            lambda second: covariance(first, second),
            start,
            stop,
            points=[first] if start < first < stop else None,
            limit=200,
        )[0] / (stop - start)

    for start, stop in INTERVALS:
        np.testing.assert_allclose(
            noise.with_mean(UNEVEN, start, stop),
            [mean(time, start, stop) for time in UNEVEN],
            rtol=1e-7,
        )
        for other in INTERVALS:
            double = quad(lambda time, start=start, stop=stop: mean(time, start, stop), *other)[
                0
            ] / (other[1] - other[0])
            assert noise.between_means((start, stop), other) == pytest.approx(double, rel=1e-5)


@pytest.mark.parametrize("ratio", [0.0, 0.1, 0.3, 1.3])
def test_a_mean_of_rounded_numbers_errs_as_stated(ratio: float) -> None:
    """Over all true values: what noise does not move over the steps stays in the mean."""
    rng, count, trials = np.random.default_rng(7), 50, 20000
    truth = rng.uniform(-0.5, 0.5, trials)
    means = np.mean(np.round(truth[:, None] + ratio * rng.normal(size=(trials, count))), axis=1)
    assert np.mean((means - truth) ** 2) == pytest.approx(
        quantisation_of_mean(ratio, 1.0, count) + ratio**2 / count, rel=0.1
    )
