"""Which smoothed rows can be trusted: the model has to explain the data, and to explain away what
single samples were flagged for.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from vibrissa.contacts import Status
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.smoothing.fit import OUTLIER, squared_residuals
from vibrissa.inverse.smoothing.intensities import stretches
from vibrissa.inverse.smoothing.kalman import WRENCH
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH
from vibrissa.inverse.smoothing.phases import raw_arc_lengths
from vibrissa.inverse.smoothing.series import FREE, JUMP, Codes, Fit, Flags

_FLAGGED_STRETCH, _FLAGGED_CONTACT = 0.3, 0.15
"""Shares of flagged samples from which on noise is no explanation: it flags less than one in fifty.
"""
_EXCESS = 1.6
"""Mean squared residual of a stretch, in terms of that of the stated noise. Converters whose steps
are as large as the noise add 8 %.
"""
_LEVEL = 6.0
"""The same in standard deviations of the mean over a stretch."""
_COUPLE = 3.0
"""Mean violation of m0·f0 = 0, in standard deviations, from which on it is named as the finding."""
_LEAST_ROWS = 6
"""Samples between two breaks of the motion: fewer tell little more than each by itself."""
_LITTLE = 1e4
"""Sum of the squares of the force over a contact up to a jump, in its deviations, from which its
samples together tell arc lengths, moment over force, to a hundredth.
"""
_ELSEWHERE, _FARTHER = 5.0, 2.0
"""Mean distance of the samples' own arc lengths from the smoothed one, in its standard deviations,
and in stated errors of the points, from which on they disagree.
"""
_SMALLEST = 2e-3
"""The same in rod lengths: the least that counts."""
_KEPT = (Status.BAD_DATA, Status.RINGING, Status.TOUCHES_TWICE)


class Verdict(NamedTuple):
    """What becomes of each row."""

    status: Codes
    raw: Flags
    """Rows that keep the contact of the sample by itself."""


def judged(found: Reconstruction, fit: Fit) -> Verdict:
    """Statuses of the smoothed rows, and which of them stay as they were."""
    phase, given = fit.labels.phase, found.status
    touching, kept = (phase != FREE) & fit.series.sound, np.isin(given, _KEPT)
    # What tells against the setup is judged anew, in terms of the smoothed errors.
    flagged = (given != Status.OK) & (given != Status.SETUP_CONTRADICTED) & ~kept
    status = np.where(kept | (touching & flagged & (fit.weight < 1)), given, Status.OK)
    excess = np.minimum(squared_residuals(fit), OUTLIER) / WRENCH
    couple = np.minimum(np.abs(np.nan_to_num(found.single_contact_residual)), 2 * _COUPLE)
    for rows in _parts(stretches(fit.labels), touching & ~kept):
        limit = max(_EXCESS, 1 + _LEVEL * np.sqrt(2 / (WRENCH * len(rows))))
        if flagged[rows].mean() > _FLAGGED_STRETCH or excess[rows].mean() > limit:
            single = couple[rows].mean() <= _COUPLE
            cause = Status.SETUP_CONTRADICTED if single else Status.NOT_SINGLE_CONTACT
            status[rows] = np.where(flagged[rows], given[rows], cause)
    for rows in _parts(fit.labels.contact, touching):
        if flagged[rows].mean() > _FLAGGED_CONTACT:
            contradicted = np.maximum(status[rows], Status.SETUP_CONTRADICTED)
            status[rows] = np.where(flagged[rows], given[rows], contradicted)
    status[_elsewhere(found, fit, touching) & (status == Status.OK)] = Status.SETUP_CONTRADICTED
    # Contacts and their parts between jumps, of which each may be too weak or too short.
    part = np.cumsum(np.diff(phase != FREE, prepend=False) | (fit.labels.link == JUMP))
    wrench = np.nan_to_num(fit.linear.value.wrench)
    force = np.einsum("nij,nj->ni", fit.series.whitening, wrench)[:, :3]
    weak = np.bincount(part, np.sum(force**2, axis=1))[part] < _LITTLE
    status[weak & touching & (status == Status.OK)] = Status.AMBIGUOUS
    known = np.isfinite(fit.states.covariance).all(axis=(1, 2)) & fit.linear.exists
    raw = touching & ((np.bincount(part)[part] < _LEAST_ROWS) | ~known)
    status[raw & ~kept] = np.where(flagged, given, Status.AMBIGUOUS)[raw & ~kept]
    return Verdict(status.astype(np.int8), raw | (given == Status.TOUCHES_TWICE))


def without(verdict: Verdict, found: Reconstruction, lost: Flags) -> Verdict:
    """With rows for which smoothing gives no numbers as they were before."""
    status = np.where(lost, by_itself(found), verdict.status).astype(np.int8)
    return Verdict(status, verdict.raw | lost)


def by_itself(found: Reconstruction) -> Codes:
    """Statuses of rows that keep the contact of the sample."""
    return np.where(found.status == Status.OK, Status.AMBIGUOUS, found.status)


def _elsewhere(found: Reconstruction, fit: Fit, touching: Flags) -> Flags:
    """Rows of stretches over which the samples by themselves, together, put the contact elsewhere
    on the rod than smoothing does.
    """
    value, deviation = raw_arc_lengths(fit.series, fit.states.zero.mean)
    weight = np.where(touching & (fit.weight == 1), deviation**-2.0, 0.0)
    away = value - fit.linear.x[:, ARC_LENGTH]
    stated = fit.states.covariance[:, ARC_LENGTH, ARC_LENGTH]
    if found.covariance is not None and found.covariance_noise is not None:
        # What errors of the setup do to the points, they may do to the arc lengths.
        shared = np.trace(found.covariance - found.covariance_noise, axis1=1, axis2=2)
        stated = stated + np.nan_to_num(shared) / found.rod.length**2
    rows = np.zeros(len(value), dtype=bool)
    for part in _parts(stretches(fit.labels), touching):
        total, known = weight[part].sum(), max(float(np.mean(stated[part])), 0.0)
        if total > 0:
            least = max(_ELSEWHERE / np.sqrt(total), _FARTHER * np.sqrt(known), _SMALLEST)
            rows[part] = abs(weight[part] @ away[part]) / total > least
    return rows


def _parts(number: Codes, rows: Flags) -> list[Int[np.ndarray, "k"]]:
    """Rows of each number, without those of negative ones."""
    inside = np.flatnonzero(rows & (number >= 0))
    parts = np.split(inside, np.flatnonzero(np.diff(number[inside])) + 1)
    return [part for part in parts if part.size]
