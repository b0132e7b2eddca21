"""Short stretches of a sweep, each averaged to one wrench: less noise, fewer rows.

The motion is slow compared with the sampling, so over a hundredth of a contact the wrench follows a
straight line, and its mean is the value in the middle. The arc length, a ratio of moment to force,
is all but linear in the noise of a mean, but not of a sample.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy
from jaxtyping import Float, Int
from scipy.ndimage import binary_dilation, uniform_filter1d

from vibrissa.contacts import Status
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse.arrays import (
    Codes,
    Flags,
    Frames,
    Scalars,
    Spreads,
    Vectors,
    Wrench,
    Wrenches,
)
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import in_clamp_axes
from vibrissa.numerics.runs import runs

_MOST = 96
"""Stretches in contact: an elastica's curves through so many are straight to 3e-5 of their range,
and dense equations with three rows each take milliseconds.
"""
_MOST_AT_REST = 20
_FEWEST, _FEWEST_FOR_NOISE = 12, 30
"""Samples in contact below which a sweep is not judged, and second differences below which noise
counts as white.
"""
_OUTLYING = 4.0
"""Samples farther off the line than this many deviations, by the median, are ignored: noise alone
gets there once in ten thousand.
"""
_MARGIN = 0.1
"""Fraction of the contact's duration before and after it that does not count as rest: contact still
hidden in noise, and a wire that swings.
"""
_WINDOW = 9
"""Samples of which most are in contact when the rod touches: single false alarms and misses do not
count.
"""
_LINE = 4
"""Fewest samples for fitting a line."""
_UNSTEADY = 6.0
"""Standard deviations of the variance about the line from which samples follow no line: the rod
swings, or the contact has jumped.
"""
_UNKNOWN_ZERO = 0.02
"""Variance of the zero's error, relative to a sample's, if no rest is seen: that of a mean of 50.
"""
_WHITE = 0.2
"""Fraction of the variance by which differences of neighbours may fall short of white noise by
chance and rounding.
"""
_LEAST_WHITE = 0.05


class Stretches(NamedTuple):
    """Means over short stretches of one trail, in clamp axes and model units."""

    time: Scalars
    """[s], or the sample number."""
    wrench: Wrenches
    """Support reactions."""
    noise: Spreads
    """Covariance of the part that is independent from stretch to stretch."""
    zero: Spreads
    """Factor of what a zero error adds, the same for all samples."""
    position: Vectors
    """Of the clamp, world axes, in rod lengths."""
    turn: Frames
    """From clamp to world axes."""
    contact: Flags
    """Whether the rod touches; otherwise it is at rest."""
    first: Codes
    last: Codes
    """Samples; the last is excluded."""

    def chosen(self, rows: Any) -> "Stretches":
        """Some of them."""
        return Stretches(*(part[rows] for part in self))


def stretches_of(found: Reconstruction) -> Stretches | None:
    """Averaged rows of one trail (n, …) with known noise, in contact and at rest; None if too few
    are in contact.
    """
    reactions, trail = found.reactions, found.reactions.trail
    wrench, covariance = in_clamp_axes(reactions, found.rod)
    assert covariance is not None
    known = ~np.isin(found.status, (Status.BAD_DATA, Status.NOT_UNIQUE))
    sound = np.isfinite(wrench).all(axis=1) & known
    time = np.arange(float(len(wrench))) if reactions.time is None else reactions.time
    touching = (uniform_filter1d((found.in_contact & sound).astype(float), _WINDOW) > 0.5) & sound
    if min(np.count_nonzero(found.in_contact), np.count_nonzero(touching)) < _FEWEST:
        return None
    # Before and after all contact, with a margin.
    begin, end = time[touching][[0, -1]]
    margin = _MARGIN * (end - begin)
    resting = sound & ((time < begin - margin) | (time > end + margin))
    in_contact = _spans(touching, _MOST)
    spans = in_contact + _spans(resting, _MOST_AT_REST)
    root = np.linalg.cholesky(covariance)
    white = _white(np.linalg.solve(root, wrench[..., None])[..., 0], touching | resting)
    before = np.count_nonzero(resting[: int(np.argmax(touching))])
    lasting = np.maximum(1 - white - _WHITE, 0) + (1 / before if before else _UNKNOWN_ZERO)
    first, last = np.transpose(spans)
    means, count, scatter = _means(wrench, time, first, last)
    middle = (first + last) // 2
    noise = root[middle] * white @ np.swapaxes(root[middle], 1, 2)
    excess = np.max(scatter / np.einsum("kii->ki", noise), axis=1) - 1
    averaged = Stretches(
        time=np.array([time[a:b].mean() for a, b in spans]),
        wrench=means,
        noise=noise / count[:, None, None],
        zero=root[middle] * np.sqrt(lasting),
        position=np.array([trail.position[a:b].mean(axis=0) for a, b in spans]) / found.rod.length,
        turn=rotation_matrices(trail.orientation[middle]),
        contact=np.arange(len(spans)) < len(in_contact),
        first=first,
        last=last,
    )
    # Without unsteady ones and their neighbours: jumps, or residual swinging.
    steady = excess < _UNSTEADY * np.sqrt(2 / np.maximum(count - 2, 1))
    bad = averaged.contact & ~steady
    return averaged.chosen(~(binary_dilation(bad) & averaged.contact))


def _spans(rows: Flags, most: int) -> list[tuple[int, int]]:
    """Runs of rows [first, last), cut into roughly equal parts, about `most` in all."""
    size = max(1, -(-int(np.count_nonzero(rows)) // most))
    cuts = [
        np.linspace(start, stop, max(1, round((stop - start) / size)) + 1).astype(int)
        for start, stop in runs(rows)
    ]
    return [span for cut in cuts for span in pairwise(cut.tolist())]


def _white(whitened: Wrenches, rows: Flags) -> Wrench:
    """Sample-to-sample variance of the noise relative to the stated one, from second differences; 1
    if there are too few.
    """
    inner = rows[:-2] & rows[1:-1] & rows[2:]
    second = np.diff(whitened, 2, axis=0)[inner] / np.sqrt(6)
    if len(second) < _FEWEST_FOR_NOISE:
        return np.ones(6)
    return np.maximum(
        scipy.stats.median_abs_deviation(second, axis=0, scale="normal") ** 2, _LEAST_WHITE
    )


def _means(
    values: Wrenches, time: Scalars, first: Int[np.ndarray, "k"], last: Int[np.ndarray, "k"]
) -> tuple[Float[np.ndarray, "k 6"], Int[np.ndarray, "k"], Float[np.ndarray, "k 6"]]:
    """Midpoints of lines fitted to the rows of each span, how many rows count, and their variance
    about the line.
    """
    place = first[:, None] + np.arange((last - first).max())
    good = inside = place < last[:, None]
    place = np.minimum(place, last[:, None] - 1)
    rows, enough = values[place], (last - first >= _LINE)[:, None]
    elapsed = time[place] - np.mean(time[place], axis=1, where=inside, keepdims=True)
    for final in (False, True):
        count = np.count_nonzero(good, axis=1)
        centre = np.mean(elapsed, axis=1, where=good, keepdims=True)
        along = np.where(good & enough, elapsed - centre, 0.0)
        square = np.maximum(np.sum(along**2, axis=1, keepdims=True), np.finfo(float).tiny)
        slope = np.einsum("kl,klc->kc", along, rows) / square
        mean = np.mean(rows, axis=1, where=good[..., None])
        off = rows - mean[:, None] - (elapsed - centre)[..., None] * slope[:, None]
        if not final:
            known = np.where(inside[..., None], off, np.nan)
            apart = np.abs(known - np.nanmedian(known, axis=1, keepdims=True))
            spread = np.nanmedian(apart, axis=1, keepdims=True) / scipy.stats.norm.ppf(0.75)
            near = inside & np.all(np.abs(off) <= _OUTLYING * np.maximum(spread, 1e-300), axis=2)
            kept = enough & (np.count_nonzero(near, axis=1, keepdims=True) >= _LINE)
            good = np.where(kept, near, good)
    left = np.sum(off**2, axis=1, where=good[..., None])
    scatter = np.where(enough, left / np.maximum(count - 2, 1)[:, None], 0.0)
    return mean - centre * slope, count, scatter
