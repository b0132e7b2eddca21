"""Contacts of a smoothed series: points, normals, their covariances, how errors of the setup move
them, and which rows can be trusted: the model has to explain the data, and to explain away what
single samples were flagged for.

Once linearised the smoother is linear, so an error θ that adds a known column to what is observed
moves its states by the same gains with which it weighs the readings: one more pass, in which the
columns take the place of the readings (the augmented Kalman filter: de Jong, *Annals of Statistics*
19, 1991). What the drift of the zero, the tilt or the arc length take up of an error is so taken
into account, and what is known exactly, such as the arc length at the tip, stays known.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrissa.contacts import Status
from vibrissa.inverse.parameters import changes_of_rows, prepared, velocities_of
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import sensitivities
from vibrissa.inverse.smoothing.fit import OUTLIER, squared_residuals, stretches
from vibrissa.inverse.smoothing.kalman import PLACE, WRENCH
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, TILT, chosen
from vibrissa.inverse.smoothing.model import (
    FREE,
    JUMP,
    TARED,
    Codes,
    Fit,
    Flags,
    smoothed_states,
    steps_of,
)
from vibrissa.inverse.smoothing.phases import raw_arc_lengths
from vibrissa.reactions import turned_covariance

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
_FIELDS = (
    "point",
    "force_direction",
    "arc_length",
    "modulus",
    "covariance",
    "normal_covariance",
    "arc_length_deviation",
    "sensitivity",
    "kind",
    "energy",
    "status",
)
"""Of a reconstruction: those that smoothing gives anew."""


def by_itself(found: Reconstruction) -> dict[str, Any]:
    """What samples by themselves say, where smoothing says nothing: covariances without what the
    sweep shares.
    """
    itself = replace(
        found,
        covariance=found.covariance_noise,
        normal_covariance=found.normal_covariance_noise,
        sensitivity=sensitivities(found),
        status=np.where(
            found.in_contact & (found.status == Status.OK), Status.AMBIGUOUS, found.status
        ),
    )
    return {name: getattr(itself, name) for name in _FIELDS}


def contacts_of(
    found: Reconstruction, fit: Fit, smoothest: Fit, model_error: float
) -> dict[str, Any]:
    """Fields of the smoothed reconstruction: the contacts of a fit where that before averaging is
    to be trusted. Covariances are without what the sweep shares.
    """
    series, value, slope, x = fit.series, fit.linear.value, fit.linear.slope, fit.linear.x
    reactions, length = found.reactions, found.rod.length
    errors = fit.states.covariance[:, PLACE, PLACE]
    point = reactions.trail.position + length * np.einsum("nij,nj->ni", series.turn, value.reach)
    direction = np.einsum("nij,nj->ni", series.turn, value.direction)
    of_point, of_normal = length * series.turn @ slope.reach, series.turn @ slope.direction
    covariance, normal_covariance = (
        part @ errors @ np.swapaxes(part, 1, 2) for part in (of_point, of_normal)
    )
    # Errors of the robot's pose are not taken to be others in each sample: they stay in full.
    covariance = covariance + np.eye(3) * (model_error * length) ** 2
    by_pose, turned = reactions.pose_covariance(point), reactions.rotation_covariance
    if by_pose is not None:
        covariance = covariance + by_pose
    if turned is not None:
        normal_covariance = normal_covariance + turned_covariance(turned, direction)
    deviation = np.sqrt(np.maximum(errors[:, ARC_LENGTH, ARC_LENGTH], 0.0))
    touching = (fit.labels.phase != FREE) & series.sound
    sensitivity = _sensitivity(found, fit)
    finite = [np.isfinite(part).all(axis=(1, 2)) for part in (errors, sensitivity)]
    status, raw = _judged(found, smoothest, np.all([fit.linear.exists, *finite], axis=0))
    given = (
        point,
        direction,
        length * x[:, ARC_LENGTH],
        value.incidence,
        covariance,
        normal_covariance,
        length * deviation,
        sensitivity,
    )
    rows = chosen(touching, dict(zip(_FIELDS, given, strict=False)), np.nan) | {
        "kind": fit.labels.phase.astype(np.int8) * series.sound,
        "energy": np.where(touching, found.rod.moment_scale * value.energy, 0.0),
    }
    rows["status"] = status
    if raw.any():
        rows = chosen(raw, by_itself(found), rows) | {"status": status}
    # Beside the contacts: drift of the zero, weights and tilts.
    drift = np.linalg.solve(series.whitening, fit.states.zero.mean[..., None])[..., 0]
    return rows | {
        "drift": drift * np.repeat([found.rod.force_scale, found.rod.moment_scale], 3),
        "weight": np.where(series.sound, fit.weight, 1.0),
        "tilt": np.where(touching, x[:, TILT], np.nan),
    }


def _sensitivity(found: Reconstruction, fit: Fit) -> Float[np.ndarray, "n 6 parameters"]:
    """Derivatives of points and normals, world axes, by `vibrissa.tolerances.PARAMETERS` for given
    readings, lengths in units of the rod's.
    """
    series, value, slope = fit.series, fit.linear.value, fit.linear.slope
    rig = prepared(found.rod, found.reactions.setup_errors).rig
    velocity = velocities_of(found.rod, found.reactions)
    seen = changes_of_rows(rig, value.wrench, value.reach, value.direction, velocity)
    touching = fit.labels.phase != FREE
    # A larger wrench for the same contact makes of the same readings a smaller one; samples for
    # which there is no rod are not seen.
    steps, shows = steps_of(fit), touching & fit.linear.exists
    target = np.zeros((*steps.target.shape, seen.wrench.shape[-1]))
    target[:, :WRENCH] = chosen(shows, -series.whitening @ seen.wrench, 0.0)
    columns = steps._replace(begin=np.zeros_like(steps.begin), target=target)
    # As if the series began after a tare: what earlier segments tell of its zero has errors of the
    # setup, too.
    moved = smoothed_states(fit._replace(zero=TARED), columns).mean[:, PLACE]
    reach = series.turn @ (slope.reach @ moved + seen.reach)
    direction = series.turn @ (slope.direction @ moved + seen.direction)
    return chosen(touching, np.concatenate([reach, direction], axis=1), np.nan)


def _judged(found: Reconstruction, fit: Fit, known: Flags) -> tuple[Codes, Flags]:
    """Statuses of the smoothed rows, and which of them keep the contact of the sample by itself, as
    do those in contact that are not known.
    """
    phase, given = fit.labels.phase, found.status
    touching, kept = (phase != FREE) & fit.series.sound, np.isin(given, _KEPT)
    # What tells against the setup is judged anew, in terms of the smoothed errors.
    flagged = ~np.isin(given, (Status.OK, Status.SETUP_CONTRADICTED, *_KEPT))
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
    raw = touching & ((np.bincount(part)[part] < _LEAST_ROWS) | ~known)
    status = np.where(raw & ~kept, np.where(flagged, given, Status.AMBIGUOUS), status)
    return status, raw | (given == Status.TOUCHES_TWICE)


def _elsewhere(found: Reconstruction, fit: Fit, touching: Flags) -> Flags:
    """Rows of stretches over which the samples by themselves, together, put the contact elsewhere
    on the rod than smoothing does.
    """
    value, deviation = raw_arc_lengths(fit.series, fit.states.zero.mean)
    weight = np.where(touching & (fit.weight == 1), deviation**-2.0, 0.0)
    away = value - fit.linear.x[:, ARC_LENGTH]
    assert found.covariance is not None
    # What errors of the setup do to the points, they may do to the arc lengths.
    shared = np.trace(found.covariance - found.covariance_noise, axis1=1, axis2=2)
    stated = fit.states.covariance[:, ARC_LENGTH, ARC_LENGTH]
    stated = stated + np.nan_to_num(shared) / found.rod.length**2
    rows = np.zeros(len(value), dtype=bool)
    for part in _parts(stretches(fit.labels), touching):
        total, known = weight[part].sum(), max(float(np.mean(stated[part])), 0.0)
        if total > 0:
            least = max(_ELSEWHERE / np.sqrt(total), _FARTHER * np.sqrt(known), _SMALLEST)
            rows[part] = abs(weight[part] @ away[part]) / total > least
    return rows


def _parts(number: Codes, rows: Flags) -> list[Codes]:
    """Rows of each number, without those of negative ones."""
    inside = np.flatnonzero(rows & (number >= 0))
    parts = np.split(inside, np.flatnonzero(np.diff(number[inside])) + 1)
    return [part for part in parts if part.size]
