"""Reactions row by row in units of a rod, and setup errors in contacts: derivatives with respect to
the setup's parameters, and covariances that include them.
"""

import math
from typing import Any

import numpy as np
from jaxtyping import Float

from vibrissa.inverse.arrays import Spread, Vectors, Wrenches
from vibrissa.inverse.kernels import Errors, Sample, Setting, sensitivities_of
from vibrissa.inverse.parameters import prepared, velocities_of
from vibrissa.inverse.result import Reconstruction
from vibrissa.mechanics.free import at_rest
from vibrissa.mechanics.model import RodModel, clamp_of
from vibrissa.mechanics.models import model_of
from vibrissa.reactions import Reactions, turned_covariance
from vibrissa.rod import Rod


def setting_of(rod: Rod, reactions: Reactions) -> Setting:
    """What all samples share; no contact is too steep, and every sample is in contact."""
    setting = Setting(rod.length, rod.force_scale, rod.moment_scale, np.inf, 0.0, rod=model_of(rod))
    if reactions.covariance is None or reactions.setup_errors is None:
        return setting
    known = prepared(rod, reactions.setup_errors)
    return setting._replace(rig=known.rig, errors=known.covariance)


STEEPEST = 0.8
"""Steepest incidence accepted if the friction is unknown: friction allows up to (1 + sin atan μ)/2,
and this is μ = 0.75.
"""
_UNKNOWN_FRICTION = 0.75
_MARGIN = 1e-6
"""Added to the steepest incidence under friction, for rounding."""
_LEAN_MARGIN = 0.1
"""Cosine by which noise may make a force lean out of the cone of friction."""


def under_friction(setting: Setting, friction: float | None) -> Setting:
    """The same, where friction of a coefficient, or of one that is not known, bounds how contacts
    may lean.
    """
    return setting._replace(steepest=_steepest(friction), leaning=leaning_under(friction))


def leaning_under(friction: float | None) -> float:
    """Largest cosine between force and rod before the tip, with the margin for noise."""
    known = _UNKNOWN_FRICTION if friction is None else friction
    return math.sin(math.atan(known)) + _LEAN_MARGIN


def _steepest(friction: float | None) -> float:
    """Largest incidence that friction explains: the rod's tangent is at most 90° from −n, with n
    the object's outward normal, and the force leans by up to atan μ from n.

    For small μ it is no less than for unknown friction: tangential contacts lie right on the limit,
    and noise puts them on either side of it.
    """
    return max(STEEPEST, (1 + math.sin(math.atan(friction or 0.0))) / 2 + _MARGIN)


def samples_of(
    rod: Rod, reactions: Reactions, *, moving: bool = False, model: RodModel | None = None
) -> Sample:
    """Rows (k, …) of reactions; with the clamp's velocity if setup errors are stated, or if
    `moving`. A model of the rod other than the usual one says how it rests.
    """
    trail = reactions.trail
    parts = (reactions.force, reactions.moment, trail.position, trail.orientation)
    force, moment, position, turn = (part.reshape(-1, part.shape[-1]) for part in parts)
    rows = Sample(force, moment, position, turn)
    if rod.loads is not None:
        clamps = clamp_of(position / rod.length, turn)
        rows = rows._replace(resting=at_rest(model or model_of(rod), clamps))
    if reactions.covariance is None:
        return rows
    covariance = np.broadcast_to(reactions.covariance / squares(rod), (*trail.shape, 6, 6))
    rows = rows._replace(covariance=covariance.reshape(-1, 6, 6))
    if moving or reactions.setup_errors is not None:
        rows = rows._replace(velocity=velocities_of(rod, reactions).reshape(-1, 6))
    return rows


def in_clamp_axes(
    reactions: Reactions, rod: Rod
) -> tuple[Wrenches, Float[np.ndarray, "n 6 6"] | None]:
    """Wrenches of one trail in clamp axes and model units, and their covariances if known."""
    turn = reactions.trail.rotation
    wrench = (reactions.wrench.reshape(-1, 2, 3) @ turn).reshape(-1, 6)
    scaled = wrench / np.sqrt(np.diag(squares(rod)))
    if reactions.covariance is None:
        return scaled, None
    both = np.kron(np.eye(2), turn)
    return scaled, np.swapaxes(both, 1, 2) @ (reactions.covariance / squares(rod)) @ both


def squares(rod: Rod) -> Spread:
    """Units of a wrench's covariance."""
    units = np.repeat([rod.force_scale, rod.moment_scale], 3)
    return np.outer(units, units)


def pose_errors(reactions: Reactions, point: Vectors, direction: Vectors) -> Errors:
    """What errors of the robot's pose add to the covariances of points and directions known
    relative to the clamp. An orientation error δθ moves a point at d from the centre by δθ × d.
    """
    none, fixed, turning = (
        np.zeros((3, 3)),
        reactions.position_covariance,
        reactions.rotation_covariance,
    )
    moved = none if fixed is None else fixed
    if turning is None:
        return Errors(moved, none)
    arm = point - reactions.rotation_center
    return Errors(moved + turned_covariance(turning, arm), turned_covariance(turning, direction))


def sensitivities(found: Reconstruction) -> Float[np.ndarray, "*trail n 6 setup"]:
    """Derivatives of points and normals, world axes, with respect to
    `vibrissa.tolerances.PARAMETERS`, lengths in rod lengths; NaN without contact.
    """
    if found.sensitivity is not None:
        return found.sensitivity
    rod, reactions = found.rod, found.reactions
    setting = setting_of(rod, reactions)._replace(rig=prepared(rod, reactions.setup_errors).rig)
    slopes = sensitivities_of(setting, samples_of(rod, reactions, moving=True))
    rows = np.concatenate([slopes.reach, slopes.direction], axis=1)
    return np.where(
        found.in_contact[..., None, None], rows.reshape(*found.kind.shape, *rows.shape[1:]), np.nan
    )


def with_shared(
    rows: dict[str, Any], length: float, errors: Float[np.ndarray, "setup setup"]
) -> dict[str, Any]:
    """Contact fields whose covariances hold only what varies from sample to sample, with what setup
    errors of this covariance add through their `sensitivity`.
    """
    slopes, added = rows["sensitivity"], np.zeros((6, 6))
    if errors.any():
        added = slopes @ errors @ np.swapaxes(slopes, -1, -2)
    of_point, of_normal = rows["covariance"], rows["normal_covariance"]
    return rows | {
        "covariance_noise": of_point,
        "normal_covariance_noise": of_normal,
        "covariance": of_point + length**2 * added[..., :3, :3],
        "normal_covariance": of_normal + added[..., 3:, 3:],
        "cross_covariance": rows["cross_covariance"] + length * added[..., :3, 3:],
    }
