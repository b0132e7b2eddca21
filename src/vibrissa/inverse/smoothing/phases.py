"""Where a recording is in contact, and where with the tip: a first division into phases, which the
likelihood then refines.
"""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from scipy.ndimage import binary_closing, binary_opening, uniform_filter1d
from scipy.stats import chi2

from vibrissa.inverse.inverse import invert, single_contact
from vibrissa.inverse.smoothing.kalman import WRENCH, Gaussian
from vibrissa.inverse.smoothing.series import FREE, TANGENTIAL, TIP, Codes, Flags, Samples, Series
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
_TINY = 1e-300
"""In place of a divisor of zero."""


def detected(series: Series, zero: Gaussian, false_alarm: float) -> Flags:
    """Samples at which the rod is loaded: the mean of five whitened wrenches, less the drift of the
    zero, is more than noise and the drift's own error explain.

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
    loaded = (count > 0) & (distance > chi2.isf(false_alarm, WRENCH))
    for first, last in runs_of(~series.sound):
        # The mean of a sample next to the gap may hold some of it.
        around = loaded[max(0, first - 1) : first].any() and loaded[last + 1 : last + 2].any()
        loaded[first : last + 1] = around
    size = _LONGEST_GAP + 1
    closed = binary_closing(np.pad(loaded, size, mode="edge"), np.ones(size))[size:-size]
    return np.asarray(binary_opening(closed, np.ones(_LEAST_SAMPLES)))


def _running_sum(values: np.ndarray, size: int) -> np.ndarray:
    """Sums of `size` rows about each."""
    return np.asarray(uniform_filter1d(values, size, axis=0, mode="constant") * size)


def runs_of(flags: Flags) -> Iterator[tuple[int, int]]:
    """First and last index of each run of true flags."""
    edges = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        yield int(first), int(stop) - 1


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


def _phases_of(value: Samples, deviation: Samples) -> tuple[Codes, Samples]:
    """Most probable sequence of tip and tangential contact from the arc lengths of one contact, and
    the arc lengths averaged.

    Tip contact says s₁ = L, tangential contact that s₁ ≤ L changes evenly; each change costs six
    units of log-likelihood, and each sample of the freer tangential contact a tenth.
    """
    weight = 1 / deviation**2
    average = np.minimum(_running_line(value, weight), 1.0)
    cost = np.minimum(np.stack([value - 1, value - average]) ** 2 * weight / 2, _MOST_COST)
    cost[1] += _FREEDOM_COST
    return _cheapest(cost) + TIP, average


def _running_line(value: Samples, weight: Samples) -> Samples:
    """Weighted least-squares lines over 51 samples, at their middles."""
    place, size = np.arange(len(value), dtype=float), min(_FIT_SAMPLES, len(value))
    products = np.stack([place**0, place, place**2, value, place * value], axis=1)
    w, wx, wxx, wy, wxy = _running_sum(weight[:, None] * products, size).T
    determinant = w * wxx - wx**2
    # Where one sample alone weighs anything, any line fits.
    sound = determinant > 1e-9 * np.maximum(w * wxx, _TINY)
    slope = np.where(sound, (w * wxy - wx * wy) / np.where(sound, determinant, 1.0), 0.0)
    return np.where(w > 0, (wy - slope * wx) / np.maximum(w, _TINY) + slope * place, 1.0)


def _cheapest(cost: Float[np.ndarray, "2 k"]) -> Int[np.ndarray, "k"]:
    """Viterbi's path through two states."""
    count = cost.shape[1]
    total, came = cost[:, 0].copy(), np.zeros((2, count), dtype=int)
    for k in range(1, count):
        change = total[::-1] + _CHANGE_COST
        came[:, k] = np.where(change < total, [1, 0], [0, 1])
        total = np.minimum(total, change) + cost[:, k]
    path = np.empty(count, dtype=int)
    path[-1] = int(np.argmin(total))
    for k in range(count - 1, 0, -1):
        path[k - 1] = came[path[k], k]
    return path


def first_labels(
    series: Series, loaded: Flags, drift: Float[np.ndarray, "*n wrench"]
) -> tuple[Codes, Samples]:
    """Phase and rough arc length (model units) of each sample."""
    phase, arc_length = np.full(len(loaded), FREE), np.ones(len(loaded))
    value, deviation = raw_arc_lengths(series, drift)
    for first, last in runs_of(loaded):
        rows = slice(first, last + 1)
        phase[rows], average = _phases_of(value[rows], deviation[rows])
        arc_length[rows] = np.where(phase[rows] == TANGENTIAL, np.clip(average, 0.05, 1.0), 1.0)
    return phase, arc_length
