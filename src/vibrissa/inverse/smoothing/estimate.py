"""Contacts of a smoothed series: points, normals, their covariances, how setup errors move them,
and which rows can be trusted: the model must explain the data, and account for what single samples
were flagged for.

Once linearised, the smoother is linear, so an error θ that adds a known column to the observations
moves its states through the same gains as the readings: one more pass, with the columns in place of
the readings (augmented Kalman filter: de Jong, *Annals of Statistics* 19, 1991). This accounts for
what the drift of the zero, the tilt or the arc length absorb of an error, and what is known
exactly, such as the arc length at the tip, stays known.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.ndimage import maximum_filter1d
from scipy.special import chdtri

from vibrissa.contacts import Status
from vibrissa.inverse.parameters import COUNT, Changes, changes_of_rows, prepared, velocities_of
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import pose_errors, sensitivities
from vibrissa.inverse.smoothing.fit import OUTLIER, squared_residuals, stretches
from vibrissa.inverse.smoothing.kalman import PLACE, WRENCH
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, TILT, Linear, chosen, finite
from vibrissa.inverse.smoothing.model import (
    JUMP,
    TARED,
    TINY,
    Codes,
    Fit,
    Flags,
    Samples,
    smoothed_states,
    steps_of,
)
from vibrissa.inverse.smoothing.phases import raw_arc_lengths, running_sum
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.trail import Trail

_FLAGGED_STRETCH, _FLAGGED_CONTACT = 0.3, 0.15
"""Fractions of flagged samples above which noise is no explanation: it flags less than one in
fifty.
"""
_EXCESS = 1.6
"""Mean squared residual of a stretch, relative to the stated noise. A/D converters whose steps are
as large as the noise add 8 %.
"""
_LEVEL = 6.0
"""The same in standard deviations of the mean over a stretch."""
_COUPLE = 3.0
"""Mean violation of m0·f0 = 0, in standard deviations, above which it is named as the finding."""
_LEAST_ROWS = 6
"""Samples between two breaks of the motion: fewer tell little more than each one alone."""
_LITTLE = 1e4
"""Squared force in its deviations, summed over a contact or its part up to a jump, above which its
samples together tell arc lengths, moment over force, to a hundredth.
"""
_ELSEWHERE, _FARTHER = 5.0, 2.0
"""Mean distance of the samples' own arc lengths from the smoothed one, in its standard deviations,
and in stated errors of the points, above which they disagree.
"""
_SMALLEST = 2e-3
"""The same in rod lengths: the least that counts."""
_AROUND, _BY_CHANCE = 5, 0.01
"""Samples around a row that tell whether the motion was followed there, and probability that noise
alone exceeds the limit for all but the largest of their residuals; for these, it is far less.
"""
_KEPT = (Status.BAD_DATA, Status.RINGING, Status.TOUCHES_TWICE)
_FIELDS = (
    "point",
    "force_direction",
    "arc_length",
    "modulus",
    "arc_length_deviation",
    "kind",
    "energy",
)
"""Fields of a reconstruction that smoothing replaces, besides covariances and what belongs to them.
"""


def by_itself(found: Reconstruction) -> dict[str, Any]:
    """What single samples say, where smoothing says nothing: covariances without what the sweep
    shares.
    """
    fine = found.in_contact & (found.status == Status.OK)
    return {name: getattr(found, name) for name in _FIELDS} | {
        "covariance": found.covariance_noise,
        "normal_covariance": found.normal_covariance_noise,
        "cross_covariance": np.zeros_like(found.covariance_noise),
        "sensitivity": sensitivities(found),
        "status": np.where(fine, Status.AMBIGUOUS, found.status),
    }


def located(
    rod: Rod,
    trail: Trail,
    linear: Linear,
    errors: Float[np.ndarray, "n coordinates coordinates"],
    seen: Changes,
    moved: Float[np.ndarray, "n coordinates setup"],
    given: Reactions,
    model_error: float,
) -> dict[str, np.ndarray]:
    """Contacts at coordinates with these errors, world axes and units of the rod, as fields of a
    reconstruction. A setup error changes what is `seen` at given coordinates, and moves the
    coordinates. Covariances exclude what the sweep shares; they include the model error, and pose
    errors as `given`: in full, as these are not assumed to be independent from sample to sample.
    """
    value, turn = linear.value, trail.rotation
    reach, direction = ((turn @ part[..., None])[..., 0] for part in (value.reach, value.direction))
    # Hardly loaded rows have a shorter one, which is differentiable there; those at rest have none.
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    direction = direction / np.where(length > 0, length, 1.0)
    point = trail.position + rod.length * reach
    by_coordinates, by_setup = (
        np.concatenate([turn @ part.reach, turn @ part.direction], axis=1)
        for part in (linear.slope, seen)
    )
    covariance = by_coordinates @ errors @ np.swapaxes(by_coordinates, 1, 2)
    of_pose, of_model = pose_errors(given, point, direction), np.eye(3) * model_error**2
    return {
        "point": point,
        "force_direction": direction,
        "arc_length": rod.length * linear.x[:, ARC_LENGTH],
        "modulus": value.incidence,
        "covariance": rod.length**2 * (covariance[:, :3, :3] + of_model) + of_pose.point,
        "normal_covariance": covariance[:, 3:, 3:] + of_pose.direction,
        "cross_covariance": rod.length * covariance[:, :3, 3:],
        "sensitivity": by_coordinates @ moved + by_setup,
    }


def contacts_of(
    found: Reconstruction, fit: Fit, smoothest: Fit, model_error: float
) -> dict[str, Any]:
    """Fields of the smoothed reconstruction: the contacts of a fit, where the one before averaging
    can be trusted. Covariances exclude what the sweep shares.
    """
    rod, reactions, series, linear = found.rod, found.reactions, fit.series, fit.linear
    value, errors = linear.value, fit.states.covariance[:, PLACE, PLACE]
    touching = fit.labels.touching & series.sound
    rig, velocity = prepared(rod, reactions.setup_errors).rig, velocities_of(rod, reactions)
    seen = changes_of_rows(rig, value.wrench, value.reach, value.direction, velocity)
    moved = _moved(fit, seen)
    rows = located(rod, reactions.trail, linear, errors, seen, moved, reactions, model_error)
    status, raw = _judged(found, smoothest, fit, finite((linear, errors, rows["sensitivity"])))
    variance = np.maximum(errors[:, ARC_LENGTH, ARC_LENGTH], 0.0)
    rows["arc_length_deviation"] = rod.length * np.sqrt(variance)
    rows = chosen(touching, rows, np.nan) | {
        "kind": fit.labels.phase.astype(np.int8) * series.sound,
        "energy": np.where(touching, rod.moment_scale * value.energy, 0.0),
        "status": status,
    }
    if raw.any():
        rows = chosen(raw, by_itself(found), rows) | {"status": status}
    # Besides the contacts: drift of the zero, weights and tilts.
    drift = np.linalg.solve(series.whitening, fit.states.zero.mean[..., None])[..., 0]
    return rows | {
        "drift": drift * np.repeat([rod.force_scale, rod.moment_scale], 3),
        "weight": np.where(series.sound, fit.weight, 1.0),
        "tilt": np.where(touching, linear.x[:, TILT], np.nan),
    }


def _moved(fit: Fit, seen: Changes) -> Float[np.ndarray, "n coordinates setup"]:
    """Derivatives of the coordinates with respect to `vibrissa.tolerances.PARAMETERS`, for given
    readings.
    """
    # A larger wrench for the same contact acts like smaller readings; samples for which there is no
    # rod are not observed.
    steps, shows = steps_of(fit), fit.labels.touching & finite(fit.linear)
    target = np.zeros((*steps.target.shape, COUNT))
    target[:, :WRENCH] = chosen(shows, -fit.series.whitening @ seen.wrench, 0.0)
    columns = steps._replace(begin=np.zeros_like(steps.begin), target=target)
    # As if the series began after a tare: the zero from earlier segments has setup errors, too.
    return smoothed_states(fit._replace(zero=TARED), columns).mean[:, PLACE]


def _judged(found: Reconstruction, fit: Fit, averaged: Fit, known: Flags) -> tuple[Codes, Flags]:
    """Statuses of the smoothed rows, and which of them keep the contact of the single sample, as do
    contacts that are not `known`, and those that samples contradict once averaged.
    """
    labels, given = fit.labels, found.status
    touching, kept = labels.touching & fit.series.sound, np.isin(given, _KEPT)
    # Evidence against the setup is judged anew, relative to the smoothed errors.
    none = Status.OK, Status.SETUP_CONTRADICTED, Status.NOT_UNIQUE
    flagged = ~np.isin(given, (*none, *_KEPT))
    status = np.where(kept | (touching & flagged & (fit.weight < 1)), given, Status.OK)
    rows = touching & ~kept
    total = _sums(stretches(labels), rows)
    count = np.maximum(total(1), 1)
    excess = total(np.minimum(squared_residuals(fit), OUTLIER)) / (WRENCH * count)
    couple = np.minimum(np.abs(np.nan_to_num(found.single_contact_residual)), 2 * _COUPLE)
    limit = np.maximum(_EXCESS, 1 + _LEVEL * np.sqrt(2 / (WRENCH * count)))
    single = total(couple) <= _COUPLE * count
    cause = np.where(single, Status.SETUP_CONTRADICTED, Status.NOT_SINGLE_CONTACT)
    wrong = rows & ((total(flagged) > _FLAGGED_STRETCH * count) | (excess > limit))
    status = np.where(wrong, np.where(flagged, given, cause), status)
    total = _sums(labels.contact, touching)
    wrong = touching & (total(flagged) > _FLAGGED_CONTACT * total(1))
    worse = np.maximum(status, Status.SETUP_CONTRADICTED)
    status = np.where(wrong, np.where(flagged, given, worse), status)
    elsewhere = _elsewhere(found, fit, touching) & (status == Status.OK)
    status = np.where(elsewhere, Status.SETUP_CONTRADICTED, status)
    # Contacts, or their parts between jumps, any of which may be too weak or too short.
    total = _sums(np.cumsum(labels.link == JUMP) + labels.contact, labels.touching)
    force = fit.series.whiten(np.nan_to_num(fit.linear.value.wrench))[:, :3]
    weak = touching & (total(np.sum(force**2, axis=1)) < _LITTLE)
    status = np.where(weak & (status == Status.OK), Status.AMBIGUOUS, status)
    astray = _astray(averaged, rows) & (status == Status.OK)
    raw = touching & ((total(1) < _LEAST_ROWS) | ~known | astray)
    status = np.where(raw & ~kept, np.where(flagged, given, Status.AMBIGUOUS), status)
    return status, raw | (given == Status.TOUCHES_TWICE)


def _astray(fit: Fit, rows: Flags) -> Flags:
    """Rows whose neighbouring samples are further off the smoothed motion than their noise, as most
    residuals show it, explains: there the contact moved faster than it usually does. A single
    outlier among them says nothing.
    """
    if not rows.any():
        return rows
    squared = np.where(rows, np.minimum(squared_residuals(fit), OUTLIER), 0.0)
    usual = max(np.median(squared[rows]) / chdtri(WRENCH, 0.5), 1.0)
    total = running_sum(squared, _AROUND) - maximum_filter1d(squared, _AROUND)
    limit = usual * chdtri(WRENCH * (_AROUND - 1), _BY_CHANCE)
    return rows & maximum_filter1d(total > limit, _AROUND)


def _elsewhere(found: Reconstruction, fit: Fit, touching: Flags) -> Flags:
    """Rows of stretches over which the single samples, taken together, put the contact elsewhere on
    the rod than smoothing does.
    """
    value, deviation = raw_arc_lengths(fit)
    weight = np.where(fit.weight == 1, deviation**-2.0, 0.0)
    assert found.covariance is not None
    # What setup errors do to the points, they may do to the arc lengths.
    shared = np.trace(found.covariance - found.covariance_noise, axis1=1, axis2=2)
    stated = fit.states.covariance[:, ARC_LENGTH, ARC_LENGTH]
    stated = stated + np.nan_to_num(shared) / found.rod.length**2
    total = _sums(stretches(fit.labels), touching)
    known = np.maximum(total(stated), 0.0) / np.maximum(total(1), 1)
    sure = np.maximum(total(weight), TINY)
    away = total(weight * (value - fit.linear.x[:, ARC_LENGTH])) / sure
    least = np.maximum(_ELSEWHERE / np.sqrt(sure), _FARTHER * np.sqrt(known))
    return touching & (np.abs(away) > np.maximum(least, _SMALLEST))


def _sums(number: Codes, rows: Flags) -> Callable[[ArrayLike], Samples]:
    """Function that sums values over these rows: for each, over all rows with the same number."""
    _, place = np.unique(number, return_inverse=True)
    return lambda values: np.bincount(place, np.where(rows, values, 0.0))[place]
