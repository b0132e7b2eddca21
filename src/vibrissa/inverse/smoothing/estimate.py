"""Contacts of a smoothed series: points, normals, their covariances, and how errors of the setup
move them.

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

from vibrissa.inverse.parameters import changes_of_rows, prepared, velocities_of
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import sensitivities, with_shared
from vibrissa.inverse.smoothing.fit import TARED
from vibrissa.inverse.smoothing.kalman import PLACE, WRENCH
from vibrissa.inverse.smoothing.manifold import ARC_LENGTH, TILT
from vibrissa.inverse.smoothing.merging import smoothed_states
from vibrissa.inverse.smoothing.model import steps_of
from vibrissa.inverse.smoothing.result import Smoothing, Touch
from vibrissa.inverse.smoothing.series import FREE, Fit, Flags
from vibrissa.inverse.smoothing.verdict import Verdict, without
from vibrissa.reactions import turned_covariance


def contacts_of(
    found: Reconstruction,
    fit: Fit,
    verdict: Verdict,
    touches: tuple[Touch, ...],
    model_error: float,
) -> Reconstruction:
    """Rows of a reconstruction with the contacts of a fit where the verdict allows."""
    series, value, slope, x = fit.series, fit.linear.value, fit.linear.slope, fit.linear.x
    rod, reactions, length = found.rod, found.reactions, found.rod.length
    touching = (fit.labels.phase != FREE) & series.sound
    errors = fit.states.covariance[:, PLACE, PLACE]
    point = reactions.trail.position + length * np.einsum("nij,nj->ni", series.turn, value.reach)
    normal = np.einsum("nij,nj->ni", series.turn, value.direction)
    sensitivity = _sensitivity(found, fit)
    of_point, of_normal = length * series.turn @ slope.reach, series.turn @ slope.direction
    covariance = of_point @ errors @ np.swapaxes(of_point, 1, 2)
    normal_covariance = of_normal @ errors @ np.swapaxes(of_normal, 1, 2)
    finite = [np.isfinite(part).all(axis=(1, 2)) for part in (errors, sensitivity)]
    sound = np.all([fit.linear.exists, *finite], axis=0)
    verdict = without(verdict, found, touching & ~sound & ~verdict.raw)
    # Errors of the robot's pose are not taken to be others in each sample: they stay in full.
    covariance = covariance + np.eye(3) * (model_error * length) ** 2
    by_pose = reactions.pose_covariance(point)
    if by_pose is not None:
        covariance = covariance + by_pose
    if reactions.rotation_covariance is not None:
        normal_covariance = normal_covariance + turned_covariance(
            reactions.rotation_covariance, normal
        )
    drift = np.linalg.solve(series.whitening, fit.states.zero.mean[..., None])[..., 0]
    smoothing = Smoothing(
        touches,
        fit.intensities,
        drift * np.repeat([rod.force_scale, rod.moment_scale], 3),
        np.where(series.sound, fit.weight, 1.0),
        np.where(touching, x[:, TILT], np.nan),
        model_error,
        float(np.sum(fit.states.log_likelihood)),
    )

    deviation = np.sqrt(np.maximum(errors[:, ARC_LENGTH, ARC_LENGTH], 0.0))
    contacts = {
        "point": point,
        "force_direction": normal,
        "arc_length": length * x[:, ARC_LENGTH],
        "modulus": value.incidence,
        "covariance": covariance,
        "normal_covariance": normal_covariance,
        "arc_length_deviation": length * deviation,
        "sensitivity": sensitivity,
    }
    given: dict[str, Any] = {
        name: np.where(_column(touching, part), part, np.nan) for name, part in contacts.items()
    } | {
        "kind": fit.labels.phase.astype(np.int8) * series.sound,
        "energy": np.where(touching, rod.moment_scale * value.energy, 0.0),
    }
    if verdict.raw.any():
        itself = replace(
            found,
            covariance=found.covariance_noise,
            normal_covariance=found.normal_covariance_noise,
            sensitivity=sensitivities(found),
        )
        given = {
            name: np.where(_column(verdict.raw, part), getattr(itself, name), part)
            for name, part in given.items()
        }
    return with_shared(replace(found, **given, status=verdict.status, smoothing=(smoothing,)))


def _column(rows: Flags, values: np.ndarray) -> np.ndarray:
    """Flags of rows, for each number of them."""
    return rows.reshape(-1, *[1] * (values.ndim - 1))


def _sensitivity(found: Reconstruction, fit: Fit) -> Float[np.ndarray, "n 6 parameters"]:
    """Derivatives of points and normals, world axes, by `vibrissa.tolerances.PARAMETERS` for given
    readings, lengths in units of the rod's.
    """
    series, value, slope = fit.series, fit.linear.value, fit.linear.slope
    rig = prepared(found.rod, found.reactions.setup_errors).rig
    velocity = velocities_of(found.rod, found.reactions)
    seen = changes_of_rows(rig, value.wrench, value.reach, value.direction, velocity)
    touching = (fit.labels.phase != FREE)[:, None, None]
    # A larger wrench for the same contact makes of the same readings a smaller one; samples of
    # which there is no rod are not seen.
    shows = touching & fit.linear.exists[:, None, None]
    steps = steps_of(fit)
    target = np.zeros((*steps.target.shape, seen.wrench.shape[-1]))
    target[:, :WRENCH] = np.where(shows, -series.whitening @ seen.wrench, 0.0)
    entry = steps.entry._replace(begin=np.zeros_like(steps.entry.begin))
    columns = steps._replace(entry=entry, target=target)
    # As if the series began after a tare: what earlier segments tell of its zero has errors of the
    # setup, too.
    moved = smoothed_states(fit._replace(zero=TARED), columns).mean[:, PLACE]
    reach = series.turn @ (slope.reach @ moved + seen.reach)
    direction = series.turn @ (slope.direction @ moved + seen.direction)
    return np.where(touching, np.concatenate([reach, direction], axis=1), np.nan)
