"""Ringing: the rod vibrates freely after its release, with loads that oscillate about zero, faster
than a contact can move, and are no contact.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import chdtri

from vibrissa.contacts import ContactKind, Status
from vibrissa.inverse.arrays import Flags
from vibrissa.inverse.result import Reconstruction, rows_of
from vibrissa.inverse.shared import in_clamp_axes
from vibrissa.inverse.smoothing.manifold import chosen
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod

# [s] Two or more periods of first bending modes from 20 to 200 Hz: those of wires and whiskers 30
# to 100 mm long.
_WINDOWS = (0.02, 0.06, 0.15)
_FEWEST = 6
# One and a half periods: a load that passes through zero once, as under the top of an object, is a
# contact.
_SIGN_CHANGES = 3
# Squared mean over squared oscillation: over one and a half periods or more, the mean of a sine is
# at most about a fifth of its amplitude.
_SLOW = 0.1
_FALSE_ALARM = 1e-6
# Without stated noise: fraction of the largest load.
_NOISELESS = 1e-3
_LATERAL = [0, 1, 3, 4]
"""fx, fy, mx, my."""
_UNIT = Rod.unit()
# Standard deviations: noise alone exceeds them in one of 400 samples.
_CLEAR = 3.0
# What the wrench tells even without contact.
_KEPT = ("chi_square", "single_contact_residual")


def ringing(reactions: Reactions) -> Flags:
    """Rows (n,) of one trail in which the lateral loads oscillate about zero, several times within
    a window of 0.02 to 0.15 s, by more than their noise.

    A contact pushes: within so short a time its loads keep their sign. After release the clamp
    feels the rod's inertia instead: a decaying oscillation at its first natural frequency, with
    zero mean.

    Raises
    ------
    ValueError
        If the reactions are of several trails, or have no time.
    """
    shape, time = reactions.force.shape, reactions.time
    if len(shape) != 2 or time is None:
        raise ValueError(f"reactions of shape {shape}: allowed is one trail (n, …), with stamps")
    loads = _whitened(reactions)
    found = np.zeros(len(loads), dtype=bool)
    step = np.median(np.diff(time)) if len(time) > 1 else math.inf
    for size in {max(_FEWEST, round(seconds / step)) for seconds in _WINDOWS}:
        if size <= len(loads):
            found |= _oscillating(loads, size)
    return found


def without_ringing(found: Reconstruction) -> Reconstruction:
    """The contacts of one trail without those of a ringing rod: no contact, NaN, and the status
    RINGING.
    """
    rows = found.in_contact & ringing(found.reactions)
    if not rows.any():
        return found
    floats: dict[str, Any] = {
        name: value
        for name, value in rows_of(found).items()
        if value.dtype.kind == "f" and name not in _KEPT
    }
    changed = chosen(~rows, floats, np.nan)
    for name, code in (("kind", ContactKind.NONE), ("status", Status.RINGING)):
        changed[name] = np.where(rows, np.int8(code), getattr(found, name))
    return replace(found, **changed)


def _whitened(reactions: Reactions) -> Float[np.ndarray, "n 4"]:
    """Lateral force and moment in clamp axes, in standard deviations; 0 where they are NaN."""
    wrench, covariance = in_clamp_axes(reactions, _UNIT)
    loads = np.nan_to_num(wrench[:, _LATERAL])
    if covariance is not None:
        return loads / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)[:, _LATERAL])
    scales = _NOISELESS * np.abs(loads).reshape(-1, 2, 2).max(axis=(0, 2), initial=0.0)
    return loads / np.repeat(np.where(scales > 0, scales, 1.0), 2)


def _oscillating(loads: Float[np.ndarray, "n 4"], size: int) -> Flags:
    """Rows within windows of `size` samples that hold an oscillation."""
    mean, square = _window_means(loads, size), _window_means(loads**2, size)
    spread, changes = square - mean**2, _sign_changes(loads)
    total, strongest = spread.sum(axis=1), np.argmax(spread, axis=1)
    swing = np.maximum(total - len(_LATERAL) * (1 - 1 / size), 0.0)
    loud = size * total > chdtri(len(_LATERAL) * (size - 1), _FALSE_ALARM)
    # Noise of the mean: its square is below 18 / size in all but one of a thousand windows.
    slow = (mean**2).sum(axis=1) > _SLOW * swing + 18 / size
    rows = np.zeros(len(loads), dtype=bool)
    for first in np.flatnonzero(loud & ~slow):
        turns = np.flatnonzero(changes[first : first + size, strongest[first]])
        if len(turns) >= _SIGN_CHANGES:
            # What lies more than a quarter of a period before the first sign change may still be
            # the contact.
            quarter = math.ceil((turns[-1] - turns[0]) / (len(turns) - 1) / 2)
            rows[first + max(0, turns[0] - quarter) : first + size] = True
    return rows


def _sign_changes(loads: Float[np.ndarray, "n 4"]) -> Bool[np.ndarray, "n 4"]:
    """Samples clear of the noise whose sign differs from that of the last such sample."""
    clear = np.abs(loads) > _CLEAR
    rows = np.maximum.accumulate(np.where(clear, np.arange(len(loads))[:, None], 0), axis=0)
    # Before the first such sample, zero.
    last = np.take_along_axis(np.where(clear, loads, 0.0), rows, axis=0)
    return np.pad(last[1:] * last[:-1] < 0, ((1, 0), (0, 0)))


def _window_means(values: Float[np.ndarray, "n k"], size: int) -> Float[np.ndarray, "windows k"]:
    total = np.cumsum(np.pad(values, ((1, 0), (0, 0))), axis=0)
    return (total[size:] - total[:-size]) / size
