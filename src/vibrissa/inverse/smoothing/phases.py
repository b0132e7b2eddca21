"""Where a recording is in contact, and where with the tip: a first division into phases, which the
likelihood then refines.
"""

from itertools import accumulate

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.ndimage import binary_closing, binary_opening, uniform_filter1d
from scipy.special import chdtri

from vibrissa.inverse.inverse import invert, single_contact
from vibrissa.inverse.smoothing.kalman import WRENCH, Gaussian
from vibrissa.inverse.smoothing.model import (
    FREE,
    TANGENTIAL,
    TINY,
    TIP,
    Codes,
    Flags,
    Samples,
    Series,
    runs_of,
)
from vibrissa.numerics.lanes import lanes

_DETECTION_SAMPLES = 5
"""Averaged before a load is tested, so that one outlier in a thousand is no contact."""
_LEAST_SAMPLES, _LONGEST_GAP = 8, 8
_FIT_SAMPLES = 51
"""Over which s₁ changes evenly: some tenths of a second."""
_MOST_COST = 6.0
"""Log-likelihood beyond which a sample's arc length is an outlier."""
_CHANGE_COST = 6.0
_FREEDOM_COST = 0.1
_MOST_DEVIATION = 0.05
"""Rod lengths: of arc lengths that tell a phase."""


def detected(series: Series, zero: Gaussian, false_alarm: float) -> Flags:
    """Samples at which the rod is loaded: the mean of five whitened wrenches, less the drift of the
    zero, is more than noise and the drift's own error explain, and it does not swing freely.

    Without contact its square in the metric of that covariance follows chi-square with six degrees
    of freedom, and exceeds the limit with the probability `false_alarm`. Loads of fewer than eight
    samples are no contacts, and gaps of up to eight no lift-offs, nor are samples without numbers
    between loaded ones.
    """
    load = (series.whitened - zero.mean) * series.sound[:, None]
    count = _running_sum(series.sound.astype(float), _DETECTION_SAMPLES)
    seen = np.maximum(count, 1)[:, None]
    mean = _running_sum(load, _DETECTION_SAMPLES) / seen
    covariance = np.eye(WRENCH) / seen[..., None] + zero.covariance
    distance = np.einsum("ni,ni->n", mean, np.linalg.solve(covariance, mean[..., None])[..., 0])
    loaded = (count > 0) & (distance > chdtri(WRENCH, false_alarm))
    around = np.pad(loaded, 1)
    for first, last in runs_of(~series.sound):
        loaded[first : last + 1] = around[first] & around[last + 2]
    size = _LONGEST_GAP + 1
    closed = binary_closing(np.pad(loaded, size, mode="edge"), np.ones(size))[size:-size]
    return binary_opening(closed, np.ones(_LEAST_SAMPLES)) & ~series.ringing


def _running_sum(values: np.ndarray, size: int) -> np.ndarray:
    """Sums of `size` rows about each."""
    return np.asarray(uniform_filter1d(values, size, axis=0, mode="constant") * size)


@lanes()
def _raw(
    _: None, wrench: Float[Array, "wrench"], covariance: Float[Array, "wrench wrench"]
) -> tuple[Array, Array]:
    def arc_length(wrench: Array) -> Array:
        single, _ = single_contact(wrench, covariance)
        return invert(single[:3], single[3:], jnp.array([0.0, 0.0, 1.0])).arc_length

    value, slope = jax.value_and_grad(arc_length)(wrench)
    return value, jnp.sqrt(slope @ covariance @ slope)


def raw_arc_lengths(
    series: Series, drift: Float[np.ndarray, "*n wrench"]
) -> tuple[Samples, Samples]:
    """Arc length of each sample by itself, also beyond the tip, and its standard deviation;
    infinite where it says nothing.
    """
    unwhitening = np.linalg.inv(series.whitening)
    wrench = series.wrench - (unwhitening @ drift[..., None])[..., 0]
    value, deviation = _raw(None, wrench, unwhitening @ np.swapaxes(unwhitening, 1, 2))
    tells = series.sound & np.isfinite(value) & (deviation < _MOST_DEVIATION) & (deviation > 0)
    return np.where(tells, value, 1.0), np.where(tells, deviation, np.inf)


def first_labels(series: Series, zero: Gaussian, false_alarm: float) -> tuple[Codes, Samples]:
    """Phase and rough arc length (model units) of each sample, for what is known of the zero."""
    phase, arc_length = np.full(len(series.time), FREE), np.ones(len(series.time))
    value, deviation = raw_arc_lengths(series, zero.mean)
    for first, last in runs_of(detected(series, zero, false_alarm)):
        rows = slice(first, last + 1)
        phase[rows], average = _phases_of(value[rows], deviation[rows])
        arc_length[rows] = np.where(phase[rows] == TANGENTIAL, np.clip(average, 0.05, 1.0), 1.0)
    return phase, arc_length


def _phases_of(value: Samples, deviation: Samples) -> tuple[Codes, Samples]:
    """Most probable sequence of tip and tangential contact from the arc lengths of one contact, and
    the arc lengths averaged.

    Tip contact says s₁ = L, tangential contact that s₁ ≤ L changes evenly; each change costs six
    units of log-likelihood, and each sample of the freer tangential contact a tenth.
    """
    weight = 1 / deviation**2
    average = np.minimum(_running_line(value, weight), 1.0)
    cost = np.minimum(np.stack([value - 1, value - average]) ** 2 * weight / 2, _MOST_COST)
    # Viterbi's path through two states needs no more than by how much the second one costs more so
    # far, and never more than a change: where that is reached, the state there is known, and before
    # it goes on to the next known one.
    more = np.array(
        list(
            accumulate(
                cost[1] + _FREEDOM_COST - cost[0],
                lambda sum_, here: min(max(sum_, -_CHANGE_COST), _CHANGE_COST) + here,
            )
        )
    )
    known = np.flatnonzero(np.append(np.abs(more[:-1]) > _CHANGE_COST, True))
    following = known[np.searchsorted(known, np.arange(len(value)))]
    return np.where(more[following] < 0, TANGENTIAL, TIP), average


def _running_line(value: Samples, weight: Samples) -> Samples:
    """Weighted least-squares lines over 51 samples, at their middles."""
    place, size = np.arange(len(value), dtype=float), min(_FIT_SAMPLES, len(value))
    products = np.stack([place**0, place, place**2, value, place * value], axis=1)
    w, wx, wxx, wy, wxy = _running_sum(weight[:, None] * products, size).T
    determinant = w * wxx - wx**2
    # Where one sample alone weighs anything, any line fits.
    sound = determinant > 1e-9 * np.maximum(w * wxx, TINY)
    slope = np.where(sound, (w * wxy - wx * wy) / np.where(sound, determinant, 1.0), 0.0)
    return np.where(w > 0, (wy - slope * wx) / np.maximum(w, TINY) + slope * place, 1.0)
