"""Which smoothed rows can be trusted: the model has to explain the data, and to explain away what
single samples were flagged for.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import Status
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.smoothing.fit import OUTLIER, Fit, squared_residuals, stretches
from vibrissa.inverse.smoothing.kalman import WRENCH
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, COORDINATES
from vibrissa.inverse.smoothing.phases import raw_arc_lengths, runs_of
from vibrissa.inverse.smoothing.series import FREE, JUMP, Linear, Series, exists

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

    status: Int[np.ndarray, "n"]
    raw: Bool[np.ndarray, "n"]
    """Rows that keep the contact of the sample by itself."""


def judged(found: Reconstruction, series: Series, fit: Fit, linear: Linear) -> Verdict:
    """Statuses of the smoothed rows, and which of them stay as they were; `linear` is the model
    about the fit.
    """
    touching = (fit.labels.phase != FREE) & series.sound
    kept = np.isin(found.status, _KEPT)
    # What tells against the setup is judged anew, in terms of the smoothed errors.
    flagged = (found.status != Status.OK) & (found.status != Status.SETUP_CONTRADICTED) & ~kept
    status = np.where(kept | (touching & flagged & (fit.weight < 1)), found.status, Status.OK)
    excess = np.minimum(squared_residuals(series, fit.labels, linear, fit.states), OUTLIER) / WRENCH
    couple = np.abs(np.nan_to_num(found.single_contact_residual))
    for rows in _parts(stretches(fit.labels), touching & ~kept):
        contradicted = _contradicted(
            flagged[rows], excess[rows], float(np.mean(np.minimum(couple[rows], 2 * _COUPLE)))
        )
        if contradicted != Status.OK:
            status[rows] = np.where(flagged[rows], found.status[rows], contradicted)
    for first, last in runs_of(fit.labels.phase != FREE):
        inside = np.arange(first, last + 1)[touching[first : last + 1]]
        if inside.size and flagged[inside].mean() > _FLAGGED_CONTACT:
            status[inside] = np.where(
                flagged[inside],
                found.status[inside],
                np.maximum(status[inside], Status.SETUP_CONTRADICTED),
            )
    status[_elsewhere(found, series, fit, touching) & (status == Status.OK)] = (
        Status.SETUP_CONTRADICTED
    )
    status[_weak(series, fit, linear) & touching & (status == Status.OK)] = Status.AMBIGUOUS
    raw = touching & (
        _isolated(fit) | ~exists(linear) | ~np.isfinite(fit.states.covariance).all(axis=(1, 2))
    )
    status[raw & ~kept] = np.where(flagged, found.status, Status.AMBIGUOUS)[raw & ~kept]
    return Verdict(status.astype(np.int8), raw | (found.status == Status.TOUCHES_TWICE))


def without(verdict: Verdict, found: Reconstruction, lost: Bool[np.ndarray, "n"]) -> Verdict:
    """With rows for which smoothing gives no numbers as they were before."""
    before = np.where(found.status == Status.OK, Status.AMBIGUOUS, found.status)
    return Verdict(np.where(lost, before, verdict.status).astype(np.int8), verdict.raw | lost)


def _contradicted(
    flagged: Bool[np.ndarray, "k"], excess: Float[np.ndarray, "k"], couple: float
) -> Status:
    limit = max(_EXCESS, 1 + _LEVEL * np.sqrt(2 / (WRENCH * len(excess))))
    if flagged.mean() <= _FLAGGED_STRETCH and excess.mean() <= limit:
        return Status.OK
    return Status.NOT_SINGLE_CONTACT if couple > _COUPLE else Status.SETUP_CONTRADICTED


def _weak(series: Series, fit: Fit, linear: Linear) -> Bool[np.ndarray, "n"]:
    """Rows of contacts, or of their parts between jumps, that hardly rise out of the noise."""
    force = np.einsum("nij,nj->ni", series.whitening, np.nan_to_num(linear.values.wrench))[:, :3]
    weak = np.zeros(len(force), dtype=bool)
    for first, last in runs_of(fit.labels.phase != FREE):
        jumps = np.flatnonzero(fit.labels.link[first + 1 : last + 1] == JUMP) + first + 1
        for part in np.split(np.arange(first, last + 1), jumps - first):
            weak[part] = np.sum(force[part] ** 2) < _LITTLE
    return weak


def _elsewhere(
    found: Reconstruction, series: Series, fit: Fit, touching: Bool[np.ndarray, "n"]
) -> Bool[np.ndarray, "n"]:
    """Rows of stretches over which the samples by themselves, together, put the contact elsewhere
    on the rod than smoothing does.
    """
    value, deviation = raw_arc_lengths(series, fit.states.mean[:, 2 * COORDINATES :])
    weight = np.where(touching & (fit.weight == 1), deviation**-2.0, 0.0)
    away, stated = (
        value - fit.about[:, ARC_LENGTH],
        fit.states.covariance[:, ARC_LENGTH, ARC_LENGTH] + _shared_variance(found),
    )
    rows = np.zeros(len(value), dtype=bool)
    for part in _parts(stretches(fit.labels), touching):
        total = weight[part].sum()
        if total > 0:
            shift, known = abs(weight[part] @ away[part]) / total, float(np.mean(stated[part]))
            rows[part] = shift > max(
                _ELSEWHERE / np.sqrt(total), _FARTHER * np.sqrt(max(known, 0.0)), _SMALLEST
            )
    return rows


def _shared_variance(found: Reconstruction) -> Float[np.ndarray, "n"]:
    """Of the points, in rod lengths squared, by errors of the setup: as much may be the arc
    lengths' own.
    """
    if found.covariance is None or found.covariance_noise is None:
        return np.zeros(len(found.kind))
    return (
        np.asarray(
            np.nan_to_num(np.trace(found.covariance - found.covariance_noise, axis1=1, axis2=2))
        )
        / found.rod.length**2
    )


def _parts(number: Int[np.ndarray, "n"], rows: Bool[np.ndarray, "n"]) -> list[Int[np.ndarray, "k"]]:
    """Rows of each stretch."""
    inside = np.flatnonzero(rows & (number >= 0))
    return [
        part for part in np.split(inside, np.flatnonzero(np.diff(number[inside])) + 1) if part.size
    ]


def _isolated(fit: Fit) -> Bool[np.ndarray, "n"]:
    """Samples of contact between two breaks that are too close for smoothing."""
    phase, link = fit.labels.phase, fit.labels.link
    number = np.cumsum((np.diff(phase != FREE, prepend=False)) | (link == JUMP))
    return (phase != FREE) & (np.bincount(number)[number] < _LEAST_ROWS)
