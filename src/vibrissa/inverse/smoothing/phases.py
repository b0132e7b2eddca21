"""What the samples themselves show: where a recording is in contact, and a first division into tip
and tangential phases, which the likelihood then refines; and where the motion of a contact breaks:
steps of the wrench, shocks beyond the noise.
"""

from itertools import accumulate
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import (
    binary_closing,
    binary_opening,
    maximum_filter1d,
    median_filter,
    uniform_filter1d,
)
from scipy.special import chdtri

from vibrissa.inverse.inverse import single_contact
from vibrissa.inverse.smoothing.kalman import RATE, WRENCH, Gaussian, States
from vibrissa.inverse.smoothing.manifold import (
    ARC_LENGTH,
    COORDINATES,
    LOADS,
    TILT,
    finite,
    linearised,
)
from vibrissa.inverse.smoothing.model import (
    FREE,
    JUMP,
    KINK,
    TANGENTIAL,
    TILT_SPREAD,
    TINY,
    TIP,
    Codes,
    Fit,
    Flags,
    Labels,
    Samples,
    Series,
)
from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.model import AT_ORIGIN, RodModel
from vibrissa.numerics.lanes import lanes
from vibrissa.numerics.runs import runs

DETECTION_SAMPLES = 5
"""Averaged before a load is tested, so that one outlier in a thousand is not a contact."""
_LEAST_SAMPLES, _LONGEST_GAP = 8, 8
_FIT_SAMPLES, _FEW_SAMPLES = 51, 7
"""Over which s₁ changes linearly: some tenths of a second, or less where noise is low enough to see
that it does not.
"""
_MOST_COST = 6.0
"""Log-likelihood beyond which a sample's arc length is an outlier."""
_CHANGE_COST = 6.0
_FREEDOM_COST = 0.1
_MOST_DEVIATION = 0.1
"""In rod lengths: arc lengths less certain than this do not tell the phase. Half of it left a
hundred samples of 0.06 L each, 0.24 L short of the tip, untold; 0.15 and 0.25 tell no more of them.
"""
_LEAST_FORCE = 5.0
"""Force of a sample, in standard deviations, below which its arc length is not looked for."""
_NEAREST_STEPS, _NEAREST_STEP = 5, 0.3
"""Gauss-Newton steps from arc lengths up to half the rod away, and the largest of them [L]."""
_SETTLED = 0.2
"""The last of them, in standard deviations: the next is far smaller."""
_FALSE_JUMPS = 1e-3
"""Expected number of jumps found in a recording that has none."""
_APART = 12
"""Fewest samples between two breaks: closer ones count as one. Steps may be half as close, as a rod
that snaps from one face to the next may soon snap off that, too.
"""
_SIDE, _HALF = 3, 25
"""Samples on either side of a step, and of its neighbourhood."""
_STEP, _UNUSUAL = 12.0, 6.0
"""Size of a step, in standard deviations and relative to the usual difference: a contact that keeps
sliding, even through a change of phase, stays far below both.
"""


def detected(series: Series, zero: Gaussian, false_alarm: float) -> Flags:
    """Samples at which the rod is loaded: the mean of five whitened wrenches, less the drift of the
    zero, exceeds what noise and the drift's own error explain, and the rod does not swing freely.

    Without contact, its squared Mahalanobis distance under that covariance follows chi-square with
    six degrees of freedom, and exceeds the limit with probability `false_alarm`. Loads of fewer
    than eight samples are not contacts; gaps of up to eight, or bad samples between loaded ones,
    are not lift-offs.
    """
    load = (series.whitened - zero.mean) * series.sound[:, None]
    count = running_sum(series.sound.astype(float), DETECTION_SAMPLES)
    seen = np.maximum(count, 1)
    mean = running_sum(load, DETECTION_SAMPLES) / seen[:, None]
    loaded = (count > 0) & (load_chi_square(mean, seen, zero) > chdtri(WRENCH, false_alarm))
    around = np.pad(loaded, 1)
    for start, stop in runs(~series.sound):
        loaded[start:stop] = around[start] & around[stop + 1]
    size = _LONGEST_GAP + 1
    closed = binary_closing(np.pad(loaded, size, mode="edge"), np.ones(size))[size:-size]
    return binary_opening(closed, np.ones(_LEAST_SAMPLES)) & ~series.ringing


def load_chi_square(
    mean: Float[Any, "*n wrench"], count: Float[Any, "*n"], zero: Gaussian, xp: ModuleType = np
) -> Any:
    """χ² of means of `count` whitened wrenches each, less the drift of the zero, under noise and
    that drift's error alone: six degrees of freedom. `xp` is NumPy or its JAX counterpart.
    """
    covariance = xp.eye(WRENCH) / count[..., None, None] + zero.covariance
    solved = xp.linalg.solve(covariance, mean[..., None])[..., 0]
    return (mean * solved).sum(axis=-1)


def running_sum(values: np.ndarray, size: int) -> np.ndarray:
    """Sums of `size` rows around each."""
    return np.asarray(uniform_filter1d(values, size, axis=0, mode="constant") * size)


@lanes()
def _closed(
    _: None, wrench: Float[Array, "wrench"], covariance: Float[Array, "wrench wrench"]
) -> tuple[Array, Array]:
    def arc_length(wrench: Array) -> Array:
        single, _ = single_contact(wrench, covariance)
        return Elastica().contact(single[:3], single[3:], AT_ORIGIN).arc_length

    value, slope = jax.value_and_grad(arc_length)(wrench)
    return value, jnp.sqrt(slope @ covariance @ slope)


def _nearest(
    rod: RodModel, series: Series, wrench: Float[np.ndarray, "n wrench"], near: Samples
) -> tuple[Samples, Samples]:
    """The most probable coordinates of each sample that tells of a contact, by Gauss-Newton from an
    arc length: curved rods may explain the same reactions by several.
    """
    deviation = np.full(len(wrench), np.inf)
    x = np.column_stack([wrench[:, 3:5], -wrench[:, 2], near, np.zeros(len(wrench))])
    rows = np.flatnonzero(np.sum(series.whiten(wrench)[:, :3] ** 2, axis=1) > _LEAST_FORCE**2)
    prior = np.zeros(COORDINATES)
    prior[TILT] = TILT_SPREAD**-2
    for _ in range(_NEAREST_STEPS):
        if not rows.size:
            break
        pose = jax.tree.map(lambda part, rows=rows: part[rows], series.pose)
        linear = linearised(rod, pose, x[rows])
        known = finite(linear)
        rows, linear = rows[known], jax.tree.map(lambda part, known=known: part[known], linear)
        whitening = series.whitening[rows]
        away = whitening @ (wrench[rows] - linear.value.wrench)[..., None]
        slope = whitening @ linear.slope.wrench
        inverse = np.linalg.inv(np.swapaxes(slope, 1, 2) @ slope + np.diag(prior))
        pull = np.swapaxes(slope, 1, 2) @ away - (prior * x[rows])[..., None]
        change = np.clip((inverse @ pull)[..., 0], -_NEAREST_STEP, _NEAREST_STEP)
        x[rows] += change
        x[rows, ARC_LENGTH] = np.clip(x[rows, ARC_LENGTH], 0.05, 1.5)
        spread = np.sqrt(inverse[:, ARC_LENGTH, ARC_LENGTH])
        settled = np.abs(change[:, ARC_LENGTH]) < _SETTLED * spread
        deviation[rows[settled]] = spread[settled]
        rows = rows[~settled]
    return x[:, ARC_LENGTH], deviation


def raw_arc_lengths(fit: Fit) -> tuple[Samples, Samples]:
    """Arc length of each sample by itself, given the drift of the zero: also beyond the tip, and of
    several the one nearest to the fit's; and its standard deviation, infinite where it says
    nothing.
    """
    return _raw(fit.rod, fit.series, fit.states.zero.mean, fit.linear.x[:, ARC_LENGTH])


def _raw(
    rod: RodModel, series: Series, drift: Float[np.ndarray, "*n wrench"], near: Samples
) -> tuple[Samples, Samples]:
    unwhitening = np.linalg.inv(series.whitening)
    wrench = series.wrench - (unwhitening @ drift[..., None])[..., 0]
    if isinstance(rod, Elastica):
        found: Any = _closed(None, wrench, unwhitening @ np.swapaxes(unwhitening, 1, 2))
    else:
        found = _nearest(rod, series, wrench, near)
    value, deviation = found
    tells = series.sound & np.isfinite(value) & (deviation < _MOST_DEVIATION) & (deviation > 0)
    return np.where(tells, value, 1.0), np.where(tells, deviation, np.inf)


def first_labels(
    rod: RodModel, series: Series, zero: Gaussian, false_alarm: float
) -> tuple[Codes, Samples]:
    """Phase and rough arc length (model units) of each sample, given what is known of the zero."""
    phase, arc_length = np.full(len(series.time), FREE), np.ones(len(series.time))
    near = arc_length if series.near is None else series.near
    value, deviation = _raw(rod, series, zero.mean, near)
    for run in runs(detected(series, zero, false_alarm)):
        rows = slice(*run)
        phase[rows], average = _phases_of(value[rows], deviation[rows])
        arc_length[rows] = np.where(phase[rows] == TANGENTIAL, np.clip(average, 0.05, 1.0), 1.0)
    return phase, arc_length


def _phases_of(value: Samples, deviation: Samples) -> tuple[Codes, Samples]:
    """Most probable sequence of tip and tangential contact from the arc lengths of one contact, and
    the arc lengths averaged.

    Tip contact means s₁ = L, tangential contact that s₁ ≤ L varies linearly; each change costs six
    units of log-likelihood, and each tangential sample, being freer, a tenth.
    """
    weight = 1 / deviation**2
    average, closer = (
        np.minimum(_running_line(value, weight, size), 1.0) for size in (_FIT_SAMPLES, _FEW_SAMPLES)
    )
    away = np.stack([value - 1, value - average, value - closer])
    cost = np.minimum(away**2 * weight / 2, _MOST_COST)
    # Where neither is near, the noise is so low that s₁ is seen to turn.
    cost[1] = np.where(cost[:2].min(axis=0) < _MOST_COST, cost[1], cost[2])
    # With two states, Viterbi needs only the extra cost of the second so far, capped at that of a
    # change: where the cap is reached the state is known, and before it, it is that of the next
    # known one.
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


def _running_line(value: Samples, weight: Samples, size: int) -> Samples:
    """Weighted least-squares lines over so many samples, at their midpoints."""
    place, size = np.arange(len(value), dtype=float), min(size, len(value))
    products = np.stack([place**0, place, place**2, value, place * value], axis=1)
    w, wx, wxx, wy, wxy = running_sum(weight[:, None] * products, size).T
    determinant = w * wxx - wx**2
    # If only one sample has any weight, any line fits.
    sound = determinant > 1e-9 * np.maximum(w * wxx, TINY)
    slope = np.where(sound, (w * wxy - wx * wy) / np.where(sound, determinant, 1.0), 0.0)
    return np.where(w > 0, (wy - slope * wx) / np.maximum(w, TINY) + slope * place, 1.0)


def with_snaps(series: Series, labels: Labels) -> Labels:
    """Jumps where the wrench steps from one sample to the next, far beyond its noise and its course
    before and after.
    """
    sound, count = series.sound, len(labels.phase)
    if count < 2 * _HALF or not sound.any():
        return labels
    known, touching = np.flatnonzero(sound), labels.touching & sound
    parts = series.whitened[known].T
    load = np.column_stack([np.interp(np.arange(count), known, part) for part in parts])
    # Medians of a few samples on either side: a spike is not a step.
    around = np.median(sliding_window_view(load, _SIDE, axis=0), axis=-1)
    step = np.linalg.norm(around[_SIDE:] - around[:-_SIDE], axis=1)
    step = np.pad(step, (_SIDE, _SIDE - 1))
    usual = median_filter(step, 2 * _HALF + 1, mode="nearest")
    largest = step == maximum_filter1d(step, _APART + 1, mode="nearest")
    single = np.linalg.norm(np.diff(load, axis=0, prepend=load[:1]), axis=1)
    inside = touching & np.append(False, touching[:-1])
    for place in np.flatnonzero(inside & largest & (step > _STEP) & (step > _UNUSUAL * usual)):
        row = int(place - 1 + np.argmax(single[place - 1 : place + 2]))
        labels = labels.copy()
        labels.link[row] = JUMP
    return labels


def without_unloaded(series: Series, labels: Labels, zero: Gaussian, false_alarm: float) -> Labels:
    """Free where a contact is not loaded from a jump on: the rod has snapped off, and the samples
    that `detected` averages are still loaded by those before.
    """
    labels, part = labels.copy(), labels.contact + np.cumsum(labels.link == JUMP)
    load, limit = series.whitened - zero.mean, chdtri(WRENCH, false_alarm)
    covariance = np.broadcast_to(zero.covariance, (len(load), WRENCH, WRENCH))
    for first in np.flatnonzero(labels.touching & (labels.link == JUMP)):
        rows = part == part[first]
        count = np.float64(max(np.sum(rows & series.sound), 1))
        mean = load[rows & series.sound].sum(axis=0) / count
        if load_chi_square(mean, count, Gaussian(zero.mean, covariance[first])) < limit:
            labels.phase[rows] = FREE
    return labels


def changes_near_snaps(labels: Labels) -> list[tuple[int, int]]:
    """Changes of phase that a jump is near, but not at, and its place: the one may have been taken
    for the other, or a snap on the flank is soon followed by a change.
    """
    jumps = np.flatnonzero(labels.link == JUMP).tolist()
    return [
        (change, jump)
        for jump in jumps
        for change in labels.changes
        if 0 < abs(change - jump) <= _APART
    ]


def with_jumps(fit: Fit) -> Labels:
    """With JUMP or KINK where the motion of the contact breaks: at shocks to its state that noise
    does not explain (de Jong & Penzer, *JASA* 93, 1998).
    """
    labels = fit.labels.copy()
    touching = labels.touching
    rows = np.setdiff1d(np.flatnonzero(touching[1:] & touching[:-1]) + 1, labels.breaks)
    rates = RATE.start + np.arange(LOADS)
    turn = _shock(fit.states, rows, rates)
    shock = _shock(fit.states, rows, np.append(np.arange(LOADS), rates))
    level = _FALSE_JUMPS / max(len(rows), 1)
    limit, value_limit = chdtri(2 * LOADS, level), chdtri(LOADS, level)
    for k in np.argsort(-shock):
        if shock[k] < limit:
            break
        if np.abs(labels.breaks - rows[k]).min(initial=_APART) >= _APART:
            labels.link[rows[k]] = KINK if shock[k] - turn[k] < value_limit else JUMP
    return labels


def _shock(states: States, rows: Codes, entries: Int[np.ndarray, "k"]) -> Samples:
    """Chi-square of a shock to these entries of the state on the way to a sample."""
    information = states.information[np.ix_(rows, entries, entries)]
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", information), TINY))
    relative = information / scale[:, :, None] / scale[:, None, :]
    inverse = np.linalg.pinv(relative, rcond=1e-10, hermitian=True)
    pull = states.pull[np.ix_(rows, entries)] / scale
    return np.einsum("ni,nij,nj->n", pull, inverse, pull)
