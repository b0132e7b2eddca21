"""Errors of a setup in contacts: derivatives by its numbers, and covariances that hold them."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse.kernels import Sample, Setting, sensitivities_of
from vibrissa.inverse.parameters import factor_of, prepared, velocities_of
from vibrissa.inverse.result import Reconstruction
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod


def setting_of(rod: Rod, reactions: Reactions) -> Setting:
    """What all samples share; nothing is too steep, and all are in contact."""
    rig, _, errors = prepared(rod, reactions.setup_errors)
    known = reactions.covariance is not None and reactions.setup_errors is not None
    scales = rod.length, rod.force_scale, rod.moment_scale
    return Setting(*scales, np.inf, 0.0, *((rig, errors) if known else ()))


def samples_of(rod: Rod, reactions: Reactions, *, moving: bool = False) -> Sample:
    """Rows (k, …) of reactions; with the clamp's velocity if errors of a setup are stated, or if
    `moving`.
    """
    trail, shape = reactions.trail, reactions.trail.shape
    covariance = velocity = None
    if reactions.covariance is not None:
        units = np.repeat([rod.force_scale, rod.moment_scale], 3)
        relative = reactions.covariance / np.outer(units, units)
        covariance = np.broadcast_to(relative, (*shape, 6, 6)).reshape(-1, 6, 6)
        if moving or reactions.setup_errors is not None:
            velocity = velocities_of(rod, reactions).reshape(-1, 6)
    force, moment, position, orientation = (
        part.reshape(-1, part.shape[-1])
        for part in (reactions.force, reactions.moment, trail.position, trail.orientation)
    )
    return Sample(force, moment, position, orientation, covariance, velocity)


def in_clamp_axes(
    reactions: Reactions, units: Float[np.ndarray, "6"] | float = 1.0
) -> tuple[Float[np.ndarray, "n 6"], Float[np.ndarray, "n 6 6"] | None]:
    """Wrenches of one trail in clamp axes and these units, and their covariances if known."""
    turn = rotation_matrices(reactions.trail.orientation)
    parts = (reactions.force, reactions.moment)
    turned = [np.einsum("nji,nj->ni", turn, part) for part in parts]
    wrench = np.concatenate(turned, axis=1) / units
    if reactions.covariance is None:
        return wrench, None
    both = np.zeros((len(turn), 6, 6))
    both[:, :3, :3] = both[:, 3:, 3:] = turn
    scales = units * np.ones(6)
    relative = reactions.covariance / np.outer(scales, scales)
    return wrench, np.swapaxes(both, 1, 2) @ relative @ both


def sensitivities(found: Reconstruction) -> Float[np.ndarray, "*trail n 6 setup"]:
    """Derivatives of points and normals, world axes, by `vibrissa.tolerances.PARAMETERS`, lengths
    in units of the rod's; NaN without contact.
    """
    if found.sensitivity is not None:
        return found.sensitivity
    rod, reactions = found.rod, found.reactions
    setting = setting_of(rod, reactions)._replace(rig=prepared(rod, reactions.setup_errors)[0])
    slopes = sensitivities_of(setting, samples_of(rod, reactions, moving=True))
    rows = np.concatenate([slopes.reach, slopes.direction], axis=1)
    return np.where(
        found.in_contact[..., None, None], rows.reshape(*found.kind.shape, *rows.shape[1:]), np.nan
    )


def shared_of(found: Reconstruction) -> Float[np.ndarray, "*trail n 6 p"]:
    """What the sweep shares, points in units of the rod's length; without columns where no
    tolerances are stated, or no noise.
    """
    factor = factor_of(found.rod, found.reactions)
    if found.covariance is None or not factor.shape[1]:
        return np.zeros((*found.kind.shape, 6, 0))
    return sensitivities(found) @ factor


def with_shared(found: Reconstruction) -> Reconstruction:
    """Contacts whose covariances hold what varies from sample to sample alone, with all of it."""
    noise, of_normal = found.covariance, found.normal_covariance
    whole = replace(found, covariance_noise=noise, normal_covariance_noise=of_normal)
    if noise is None or of_normal is None or not whole.shared_names:
        return whole
    shared, shared_normal = whole.shared, whole.shared_normal
    return replace(
        whole,
        covariance=noise + shared @ np.swapaxes(shared, -1, -2),
        normal_covariance=of_normal + shared_normal @ np.swapaxes(shared_normal, -1, -2),
    )
