"""Errors of a setup in contacts: derivatives by its numbers, and covariances that hold them."""

from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.inverse.kernels import sensitivity_blocks
from vibrissa.inverse.parameters import COUNT, factor_of, rig_of, velocities_of
from vibrissa.inverse.result import Reconstruction
from vibrissa.numerics.blocks import in_blocks
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod


def noisy_rows(rod: Rod, reactions: Reactions) -> tuple[np.ndarray, ...]:
    """Wrench (k, 6), clamp orientation (k, 4), a factor and the inverse of the covariance (k, 6, 6)
    of reactions of known noise, world axes and model units.
    """
    assert reactions.covariance is not None
    shape, units = reactions.trail.shape, np.repeat([rod.force_scale, rod.moment_scale], 3)
    wrench = np.concatenate([reactions.force, reactions.moment], axis=-1).reshape(-1, 6) / units
    covariance = np.broadcast_to(
        reactions.covariance / np.outer(units, units), (*shape, 6, 6)
    ).reshape(-1, 6, 6)
    orientation = reactions.trail.orientation.reshape(-1, 4)
    # In the clamp's axes, so that the points that are taken of the noise turn with it.
    turn = np.zeros((len(orientation), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = rotation_matrices(orientation)
    root = turn @ np.linalg.cholesky(np.swapaxes(turn, 1, 2) @ covariance @ turn)
    return wrench, orientation, root, np.linalg.inv(covariance)


def sensitivities(found: Reconstruction) -> Float[np.ndarray, "*trail n 6 15"]:
    """Derivatives of points and normals, world axes, by `vibrissa.tolerances.PARAMETERS`, lengths
    in units of the rod's; NaN without contact.
    """
    if found.sensitivity is not None:
        return found.sensitivity
    rod, reactions = found.rod, found.reactions
    velocity = velocities_of(rod, reactions).reshape(-1, 6)
    rows = in_blocks(
        partial(sensitivity_blocks, rig_of(rod, reactions)), *noisy_rows(rod, reactions), velocity
    )
    return np.where(
        found.in_contact[..., None, None], rows.reshape(*found.kind.shape, 6, COUNT), np.nan
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
