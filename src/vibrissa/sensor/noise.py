"""Coloured noise of a sensor: samples of it at arbitrary stamps, and its effect on means over rest.

Pink noise, whose power spectral density falls as 1/f, is modelled as a sum of Ornstein-Uhlenbeck
processes with corner frequencies evenly spaced in log frequency (M. S. Keshner, "1/f noise", Proc.
IEEE 70 (1982) 212-218). Each of them is sampled exactly at arbitrary stamps, and so is a random
walk.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.special import exprel, hyp1f1

from vibrissa.sensor.raw import Interval, Times, Wrench

Samples = Float[np.ndarray, "n channels"]

NO_STEP = 2.0**-200
"""Replaces a step of 0: numbers keep all their digits."""

# Processes per decade, h = ln(10)/3 apart: their sum ripples about 1/f by 2/cosh(π²/h), or 1e-5.
_PER_DECADE = 3
# The slowest corner is this factor below the inverse duration, so that the sum has no edge inside
# the band; the fastest is at half the sampling rate, as anything above would alias.
_MARGIN = 10.0


@dataclass(frozen=True)
class Pink:
    """Unit pink noise: one-sided power spectral density 1/f [1/Hz] within a band, flat below it.

    Attributes
    ----------
    rates
        Decay rates (k,) [1/s] of the processes.
    variance
        Variance of each of them.
    """

    rates: Float[np.ndarray, "k"]
    variance: float

    @classmethod
    def within(cls, duration: float, interval: float) -> "Pink":
        """From a tenth of the inverse duration [s] to half the sampling rate, for this sampling
        interval [s].
        """
        lowest, highest = 1 / (_MARGIN * duration), 1 / (2 * interval)
        count = max(2, math.ceil(_PER_DECADE * math.log10(highest / lowest)) + 1)
        corners = np.geomspace(lowest, highest, count)
        # A process of variance v and rate a = 2πc has the one-sided density 4 v a / (a² + (2πf)²);
        # corners spaced by h in ln c add up to (v/h)/f.
        return cls(2 * np.pi * corners, float(np.log(corners[1] / corners[0])))

    def sampled(self, time: Times, rng: np.random.Generator, channels: int) -> Samples:
        """Stationary noise at the stamps, independent in each channel."""
        shape = len(self.rates), channels
        state = math.sqrt(self.variance) * rng.normal(size=shape)
        samples = [state.sum(axis=0)]
        for step in np.diff(time):
            fresh = np.sqrt(-np.expm1(-2 * self.rates * step) * self.variance)
            decay = np.exp(-self.rates * step)
            state = decay[:, None] * state + fresh[:, None] * rng.normal(size=shape)
            samples.append(state.sum(axis=0))
        return np.array(samples)

    def variance_at(self, time: Times) -> Times:
        """Variance of a sample at each time."""
        return np.full(len(time), self.variance * len(self.rates))

    def with_mean(self, time: Times, start: float, stop: float) -> Times:
        """Covariance of a sample at each time with the mean from `start` to `stop`."""
        # ∫ exp(−r |u|) du from 0 to either end.
        low, high = time[:, None] - start, time[:, None] - stop
        part = low * exprel(-self.rates * abs(low)) - high * exprel(-self.rates * abs(high))
        return self.variance * part.sum(axis=1) / (stop - start)

    def between_means(self, first: Interval, second: Interval) -> float:
        """Covariance of the means over two intervals, the same or disjoint."""
        early, late = sorted((first, second))
        x, y = (self.rates * (stop - start) for start, stop in (early, late))
        apart = np.exp(-self.rates * abs(late[0] - early[1])) * exprel(-x) * exprel(-y)
        # For an interval with itself: 2 (exp(−x) − 1 + x) / x², without cancellation.
        shares = hyp1f1(1, 3, -x) if first == second else apart
        return float(self.variance * np.sum(shares))


@dataclass(frozen=True)
class RandomWalk:
    """Unit random walk: 0 at the first stamp, with variance 1 a second later.

    Attributes
    ----------
    origin
        First stamp [s].
    """

    origin: float

    def sampled(self, time: Times, rng: np.random.Generator, channels: int) -> Samples:
        """Noise at the stamps, independent in each channel."""
        steps = np.sqrt(np.diff(time, prepend=self.origin))
        return np.cumsum(steps[:, None] * rng.normal(size=(len(time), channels)), axis=0)

    def variance_at(self, time: Times) -> Times:
        """Variance of a sample at each time."""
        return time - self.origin

    def with_mean(self, time: Times, start: float, stop: float) -> Times:
        """Covariance of a sample at each time with the mean from `start` to `stop`."""
        # The covariance of a walk at two times is the smaller of them; this is its mean.
        inside = np.clip(time, start, stop)
        mean = inside - (inside - start) ** 2 / (2 * (stop - start))
        return np.minimum(time, mean) - self.origin

    def between_means(self, first: Interval, second: Interval) -> float:
        """Covariance of the means over two intervals, the same or disjoint."""
        start, stop = min(first, second)
        return start + (stop - start) / (3 if first == second else 2) - self.origin


Coloured = tuple[Pink | RandomWalk, Wrench]
"""A non-white noise process, and its scale (6,) on the channels [N], [N m]."""


def quantisation_of_mean(
    noise: ArrayLike, step: ArrayLike, count: int
) -> Float[np.ndarray, "*channels"]:
    """Variance of the mean of `count` numbers rounded to `step`, beyond that of their noise,
    averaged over all true values.

    Rounding errors average out only as far as noise dithers the numbers across steps: of the
    step²/12 of one number, the fraction Σ 6/(πj)² exp(−(2πj·noise/step)²) remains (B. Widrow, I.
    Kollár, "Quantization Noise", Cambridge 2008, eq. 4.10 ff.).
    """
    noise, step = np.asarray(noise, dtype=float), np.asarray(step, dtype=float)
    # The remainder of Σ 6/(πj)² after these terms is 0.3 %.
    orders = np.pi * np.arange(1, 200)
    over = (noise / np.maximum(step, NO_STEP))[..., None]
    kept = np.sum(6 / orders**2 * np.exp(-((2 * orders * over) ** 2)), axis=-1)
    return np.asarray(step**2 / 12 * (kept + (1 - kept) / count))
