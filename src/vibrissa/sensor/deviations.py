"""Noise, steps and repeats as seen in the numbers themselves."""

import math

import numpy as np
from jaxtyping import Float

from vibrissa.numerics.runs import runs
from vibrissa.sensor.figures import Noise
from vibrissa.sensor.raw import Rows, Wrench, Wrenches

MEDIAN_TO_DEVIATION = 0.6745
"""Median absolute value of normal numbers of unit variance."""

# A noiseless simulation has single precision at best.
_DIGITS = 1e-6
# Differences of equal decimals in binary may differ in the last digits.
_EQUAL = 1e-12
# Replaces 0 in a denominator.
_TINY = 1e-300
# A sensor slower than the log repeats at least a third of the rows, in many short runs; a noiseless
# simulation in a few long ones.
_SLOWER, _OFTEN = 1 / 3, 0.05
# Stated noise is rounded; a tenth of it means another unit or a simulation.
_NOISIER, _QUIETER = 1.5, 0.1
# Fraction of the usual noise below which a channel counts as stuck.
_STUCK_SHARE = 0.1
# Stated figures are trusted if channels show at least this fraction of them.
_BELIEVED = 0.3
# Third differences need four rows, and a median more than one of them.
_FEWEST = 5


def deviation_by_differences(
    differences: Float[np.ndarray, "n k"], order: int
) -> Float[np.ndarray, "k"]:
    """Standard deviation (k,) of white noise on a smooth signal, from the median size of its
    differences of this order, whose variance is C(2 order, order) times the noise's; NaN if there
    are none.
    """
    if not len(differences):
        return np.full(differences.shape[1], np.nan)
    size = MEDIAN_TO_DEVIATION * math.sqrt(math.comb(2 * order, order))
    return np.asarray(np.median(np.abs(differences), axis=0) / size)


def own_noise(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k"]:
    """The same from second differences; 0 with fewer than three rows."""
    return np.nan_to_num(deviation_by_differences(np.diff(values, n=2, axis=0), 2))


def repeating_rows(wrench: Wrenches) -> Rows:
    """Rows that equal the one above in all channels."""
    return np.all(np.diff(wrench, axis=0, prepend=np.nan) == 0, axis=1)


def own_rows(wrench: Wrenches) -> Rows:
    """Rows with a new reading: all, unless more than a third repeat the one above, as when the
    sensor is slower than the log.

    A noiseless simulation repeats itself too, but in only a few runs: before and after contact.
    """
    same = repeating_rows(wrench)
    often = len(runs(same)) > _OFTEN * len(same)
    return ~(same & (often and np.count_nonzero(same) > _SLOWER * len(same)))


def smallest_steps(values: Wrenches) -> Wrench:
    """Smallest difference (6,) between readings of a channel; infinite if all are equal."""
    largest = np.nanmax(np.abs(values), axis=0, initial=0.0)
    steps = np.diff(np.sort(values, axis=0), axis=0)
    return np.min(steps, axis=0, initial=np.inf, where=steps > _EQUAL * largest)


def shown_steps(noise: Noise, values: Wrenches) -> Wrench:
    """Stated resolution (6,) of the numbers; 0 where they show finer steps."""
    stated = noise.resolution
    return np.where(smallest_steps(values) < stated / 2, 0.0, stated)


def reading_deviation(noise: Noise, values: Wrenches) -> Wrench:
    """Standard deviation (6,) of a reading: as stated; or from second differences if none is stated
    or if they show more than 1.5 times, or less than a tenth of, the stated one.
    """
    if not len(values):
        return np.ones(6)
    own = own_noise(values)
    least = np.maximum(own, _DIGITS * np.ptp(values, axis=0)) + _TINY
    if not noise.known:
        return least
    stated = np.sqrt(noise.variance)
    # Steps coarser than the stated noise would hide it.
    quieter = (least < _QUIETER * stated) & (shown_steps(noise, values) < stated)
    return np.where((own > _NOISIER * stated) | quieter, least, stated)


def believed_noise(noise: Noise, wrench: Wrenches) -> Wrench:
    """White noise (6,) from second differences; for a channel that shows almost none, that of the
    others of its kind, or the stated one if they agree with it.

    0 for a noiseless simulation, whose third differences are smaller than its second ones; for
    white noise they are larger by √(20/6).
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
