"""What numbers show of their own noise, steps and repeats."""

import math

import numpy as np
from jaxtyping import Float

from vibrissa.numerics.runs import runs
from vibrissa.sensor.figures import Noise
from vibrissa.sensor.raw import Rows, Wrench, Wrenches

MEDIAN_TO_DEVIATION = 0.6745
"""Median size of normal numbers of unit variance."""

# A noiseless simulation is known to single precision at best.
_DIGITS = 1e-6
# Equal decimals read as binary numbers differ in the last digits.
_EQUAL = 1e-12
# In the place of 0 in a denominator.
_TINY = 1e-300
# A sensor slower than the log repeats at least a third of the rows, in many short stretches; a
# simulation without noise repeats itself in few.
_SLOWER, _OFTEN = 1 / 3, 0.05
# Stated noise is rounded, and a tenth of it is another unit or a simulation.
_NOISIER, _QUIETER = 1.5, 0.1
# Of the usual noise: a channel that shows less stands still.
_STUCK_SHARE = 0.1
# Stated figures are believed of a channel that shows at least this share of them.
_BELIEVED = 0.3
# Differences of third order need four rows, and a median more than one of them.
_FEWEST = 5


def deviation_by_differences(
    differences: Float[np.ndarray, "n k"], order: int
) -> Float[np.ndarray, "k"]:
    """Standard deviation (k,) of white noise on a smooth signal, by the median of its differences
    of this order, whose variance is C(2 order, order) times that of the noise; NaN without any.
    """
    if not len(differences):
        return np.full(differences.shape[1], np.nan)
    size = MEDIAN_TO_DEVIATION * math.sqrt(math.comb(2 * order, order))
    return np.asarray(np.median(np.abs(differences), axis=0) / size)


def own_noise(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k"]:
    """The same by second differences; 0 with fewer than three rows."""
    return np.nan_to_num(deviation_by_differences(np.diff(values, n=2, axis=0), 2))


def repeating_rows(wrench: Wrenches) -> Rows:
    """Rows that are equal to the one above in all channels."""
    return np.all(np.diff(wrench, axis=0, prepend=np.nan) == 0, axis=1)


def own_rows(wrench: Wrenches) -> Rows:
    """Rows with a reading of their own: all, unless a third of them repeat the one above, as where
    the sensor is slower than the log.

    A simulation without noise repeats itself too, but in few stretches: before and after the
    contact.
    """
    same = repeating_rows(wrench)
    often = len(runs(same)) > _OFTEN * len(same)
    return ~(same & (often and np.count_nonzero(same) > _SLOWER * len(same)))


def smallest_steps(values: Wrenches) -> Wrench:
    """Smallest difference (6,) between readings of a channel; infinite where they are equal."""
    largest = np.nanmax(np.abs(values), axis=0, initial=0.0)
    steps = np.diff(np.sort(values, axis=0), axis=0)
    return np.min(steps, axis=0, initial=np.inf, where=steps > _EQUAL * largest)


def shown_steps(noise: Noise, values: Wrenches) -> Wrench:
    """Stated steps (6,) of the numbers; 0 where the numbers show finer ones."""
    stated = noise.resolution
    return np.where(smallest_steps(values) < stated / 2, 0.0, stated)


def reading_deviation(noise: Noise, values: Wrenches) -> Wrench:
    """Standard deviation (6,) of a reading: as stated, or as second differences show where it is
    not, or where they show half as much again or a tenth.
    """
    if not len(values):
        return np.ones(6)
    own = own_noise(values)
    least = np.maximum(own, _DIGITS * np.ptp(values, axis=0)) + _TINY
    if not noise.known:
        return least
    stated = np.sqrt(noise.variance)
    # Steps coarser than the noise hide it.
    quieter = (least < _QUIETER * stated) & (shown_steps(noise, values) < stated)
    return np.where((own > _NOISIER * stated) | quieter, least, stated)


def believed_noise(noise: Noise, wrench: Wrenches) -> Wrench:
    """White noise (6,) by second differences; of a channel that shows next to none, what the others
    of its kind show, or what is stated if they agree with it.

    0 for a noiseless simulation, whose third differences are small against its second ones; those
    of white noise are larger by √(20/6).
    """
    good = wrench[np.isfinite(wrench).all(axis=1)]
    if len(good) <= _FEWEST:
        return np.zeros(6)
    second, third = (np.median(np.abs(np.diff(good, n=n, axis=0)), axis=0) for n in (2, 3))
    own = np.where(third > second, own_noise(good), 0.0).reshape(2, 3)
    usual = np.median(own, axis=1, keepdims=True)
    if noise.known:
        stated = noise.white.reshape(2, 3)
        agrees = np.median(own / stated, axis=1, keepdims=True) > _BELIEVED
        usual = np.where(agrees, stated, usual)
    return np.where(own < _STUCK_SHARE * usual, usual, own).ravel()
