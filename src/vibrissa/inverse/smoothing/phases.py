"""Where a recording is in contact, and where with the tip: a first division into phases, which the
likelihood then refines.
"""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int
from scipy.ndimage import uniform_filter1d
from scipy.stats import chi2

from vibrissa.inverse.inverse import invert, single_contact
from vibrissa.inverse.smoothing.kalman import WRENCH
from vibrissa.inverse.smoothing.series import FREE, TANGENTIAL, TIP, Series, capacity_for
from vibrissa.numerics.compiled import compiled

_DETECTION_SAMPLES = 5
_LEAST_SAMPLES = 8
_LONGEST_GAP = 8
_FIT_SAMPLES = 51
_MOST_COST = 6.0
_CHANGE_COST = 6.0
_FREEDOM_COST = 0.1
_MOST_DEVIATION = 0.05


def detected(
    series: Series,
    drift: Float[np.ndarray, "n 6"],
    spread: Float[np.ndarray, "n 6 6"],
    false_alarm: float,
) -> Bool[np.ndarray, "n"]:
    """Samples at which the rod is loaded: the mean of five whitened wrenches, less the drift of the
    zero, is more than noise and the drift's own error explain.

    Without contact its square in the metric of that covariance follows chi-square with six degrees
    of freedom, and exceeds the limit with the probability `false_alarm`. Loads of fewer than eight
    samples are no contacts, and gaps of up to eight no lift-offs, nor are samples without numbers
    between loaded ones.
    """
    weight = series.sound.astype(float)
    count = uniform_filter1d(weight, _DETECTION_SAMPLES, mode="constant") * _DETECTION_SAMPLES
    left = (series.whitened - drift) * weight[:, None]
    mean = (
        uniform_filter1d(left, _DETECTION_SAMPLES, axis=0, mode="constant")
        * _DETECTION_SAMPLES
        / np.maximum(count, 1)[:, None]
    )
    covariance = np.eye(WRENCH) / np.maximum(count, 1)[:, None, None] + spread
    distance = np.einsum("ni,ni->n", mean, np.linalg.solve(covariance, mean[..., None])[..., 0])
    loaded = (count > 0) & (distance > chi2.isf(false_alarm, WRENCH))
    for first, last in runs_of(~series.sound):
        # The mean of a sample next to the gap may hold some of it.
        around = loaded[max(0, first - 1) : first].any() and loaded[last + 1 : last + 2].any()
        loaded[first : last + 1] = around
    return _opened(_closed(loaded))


def _closed(loaded: Bool[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    filled = loaded.copy()
    for first, last in runs_of(~loaded):
        if last - first < _LONGEST_GAP and first > 0 and last < len(loaded) - 1:
            filled[first : last + 1] = True
    return filled


def _opened(loaded: Bool[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
    kept = loaded.copy()
    for first, last in runs_of(loaded):
        if last - first + 1 < _LEAST_SAMPLES:
            kept[first : last + 1] = False
    return kept


def runs_of(flags: Bool[np.ndarray, "n"]) -> Iterator[tuple[int, int]]:
    """First and last index of each run of true flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    for first, stop in zip(edges[::2], edges[1::2], strict=True):
        yield int(first), int(stop) - 1


@compiled
def _raw_blocks(
    wrench: Float[Array, "n 6"], covariance: Float[Array, "n 6 6"]
) -> Float[Array, "n 2"]:
    def one(wrench: Array, covariance: Array) -> Array:
        def arc_length(wrench: Array) -> Array:
            single, _ = single_contact(wrench, covariance)
            return invert(single[:3], single[3:], jnp.array([0.0, 0.0, 1.0])).arc_length

        slope = jax.grad(arc_length)(wrench)
        return jnp.stack([arc_length(wrench), jnp.sqrt(slope @ covariance @ slope)])

    return jax.vmap(one)(wrench, covariance)


def raw_arc_lengths(
    series: Series, drift: Float[np.ndarray, "n 6"]
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Arc length of each sample by itself, also beyond the tip, and its standard deviation;
    infinite where it says nothing.
    """
    unwhitening = np.linalg.inv(series.whitening)
    wrench = series.wrench - np.einsum("nij,nj->ni", unwhitening, drift)
    covariance = unwhitening @ np.swapaxes(unwhitening, 1, 2)
    missing = capacity_for(len(wrench)) - len(wrench)
    filled = [
        np.concatenate([part, np.repeat(part[-1:], missing, axis=0)])
        for part in (wrench, covariance)
    ]
    value, deviation = np.asarray(_raw_blocks(*map(jnp.asarray, filled)))[: len(wrench)].T
    useless = (
        ~(
            np.isfinite(value)
            & np.isfinite(deviation)
            & (deviation < _MOST_DEVIATION)
            & (deviation > 0)
        )
        | ~series.sound
    )
    return np.where(useless, 1.0, value), np.where(useless, np.inf, deviation)


def phases_of(
    value: Float[np.ndarray, "k"], deviation: Float[np.ndarray, "k"]
) -> tuple[Int[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Most probable sequence of tip and tangential contact from the arc lengths of one contact, and
    the arc lengths averaged.

    Tip contact says s₁ = L, tangential contact that s₁ ≤ L changes evenly; each change costs six
    units of log-likelihood, and each sample of the freer tangential contact a tenth.
    """
    weight = 1 / deviation**2
    average = np.minimum(_running_line(value, weight), 1.0)
    away = np.stack([value - 1, value - average]) * np.sqrt(weight)
    cost = np.minimum(away**2 / 2, _MOST_COST)
    cost[1] += _FREEDOM_COST
    return _cheapest(cost) + TIP, average


def _running_line(
    value: Float[np.ndarray, "k"], weight: Float[np.ndarray, "k"]
) -> Float[np.ndarray, "k"]:
    """Weighted least-squares lines over 51 samples, at their middles."""
    place = np.arange(len(value), dtype=float)
    size = min(_FIT_SAMPLES, len(value))

    def total(values: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        return np.asarray(uniform_filter1d(values, size, mode="constant") * size)

    w, wx, wxx, wy, wxy = (
        total(weight * part)
        for part in (np.ones_like(place), place, place**2, value, place * value)
    )
    determinant = w * wxx - wx**2
    sound = determinant > 1e-9 * np.maximum(w * wxx, 1e-300)
    safe = np.where(sound, determinant, 1.0)
    slope = np.where(sound, (w * wxy - wx * wy) / safe, 0.0)
    return np.where(w > 0, (wy - slope * wx) / np.maximum(w, 1e-300) + slope * place, 1.0)


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
    series: Series, loaded: Bool[np.ndarray, "n"], drift: Float[np.ndarray, "n 6"]
) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Phase and rough arc length (model units) of each sample."""
    phase, arc_length = np.full(len(loaded), FREE), np.ones(len(loaded))
    value, deviation = raw_arc_lengths(series, drift)
    for first, last in runs_of(loaded):
        rows = slice(first, last + 1)
        phase[rows], average = phases_of(value[rows], deviation[rows])
        arc_length[rows] = np.where(phase[rows] == TANGENTIAL, np.clip(average, 0.05, 1.0), 1.0)
    return phase, arc_length
