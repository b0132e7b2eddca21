"""Errors of contacts by cause: wrench noise, robot pose, the rod's stiffness and length, and the
mounting of the clamp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.brief import brief
from vibrissa.geometry.checks import finite_array, not_negative
from vibrissa.inverse.arrays import Covariances
from vibrissa.inverse.parameters import prepared
from vibrissa.inverse.result import Reconstruction
from vibrissa.inverse.shared import pose_errors, sensitivities
from vibrissa.reactions import turned_covariance


@dataclass(frozen=True, eq=False)
class ContactErrors:
    """Covariances of contact points by cause, world axes, units of the rod squared.

    Attributes
    ----------
    by_cause
        Covariance (…, 3, 3) by name of the cause; NaN without contact. The causes are independent
        of each other.
    shared
        Causes whose error is the same for all contacts of a recording: neither averaging nor
        smoothing reduces it.
    sensitivity
        Derivatives (…, 3, k) of the points with respect to the shared parameters: relative
        `bending_stiffness`, `length`, `clamp_position` and `clamp_rotation` (clamp axes). They
        correlate the errors of different contacts.
    """

    by_cause: dict[str, Covariances]
    shared: tuple[str, ...]
    sensitivity: dict[str, Float[np.ndarray, "*trail n 3 k"]]

    __repr__ = brief

    @property
    def total(self) -> Covariances:
        """(…, 3, 3), all causes together."""
        return np.asarray(sum(self.by_cause.values()))


def contact_errors(
    found: Reconstruction,
    *,
    youngs_modulus: float = 0.0,
    bending_stiffness: float = 0.0,
    length: float = 0.0,
    clamp_position: ArrayLike = 0.0,
    clamp_rotation: ArrayLike = 0.0,
    pose: ArrayLike | None = None,
    pose_rotation: float = 0.0,
) -> ContactErrors:
    """Errors of contact points, by cause, to first order.

    Parameters
    ----------
    found
        Contacts, sample by sample or smoothed.
    youngs_modulus
        Relative standard deviation of Young's modulus (0.01 for 1 %).
    bending_stiffness
        Standard deviation of EI, in units of the rod [N m²]; in addition to that of the modulus.
    length
        Standard deviation of the rod's length [m].
    clamp_position
        Of the clamp in the sensor frame, in clamp axes: one standard deviation for each axis [m],
        or a covariance (3, 3).
    clamp_rotation
        Of the clamp's orientation, as small rotations about clamp axes: a standard deviation [rad],
        or a covariance (3, 3).
    pose
        Of the robot's position in each sample: one standard deviation for each axis [m], or a
        covariance (3, 3), world axes. Default: that of the reactions.
    pose_rotation
        Standard deviation of the robot's orientation in each sample [rad], as a rotation about the
        clamp; in addition to that of the reactions.

    Raises
    ------
    ValueError
        If a standard deviation is negative or not finite, a covariance not symmetric and positive
        semidefinite, or the noise of the wrench is not known.

    Notes
    -----
    The reconstruction is the most probable single contact x given a wrench w, so an error dθ of rod
    or mounting moves it by dx = −(HᵀΣ⁻¹H)⁻¹HᵀΣ⁻¹ (∂h/∂θ) dθ, with w = h(x; θ) and H = ∂h/∂x, and
    the point p(x; θ) by dp = (∂p/∂x) dx + (∂p/∂θ) dθ (`vibrissa.inverse.parameters`). Smoothed
    contacts move by the smoother's gains over the whole sweep. At the tip, h includes s₁ = L: for
    smoothed tip contacts, and for single samples limited to the rod's length.
    """
    if found.covariance_noise is None or found.reactions.covariance is None:
        raise ValueError(
            "found.covariance = None: errors by cause need the noise of the wrench; give the "
            "sensor force_noise and torque_noise"
        )
    rod, reactions = found.rod, found.reactions
    by_stiffness, by_length, by_position, by_turn = np.split(
        sensitivities(found)[..., :3, :8], [1, 2, 5], axis=-1
    )
    turn = prepared(rod, reactions.setup_errors).rig.turn
    sensitivity = {
        "bending_stiffness": by_stiffness * rod.length,
        "length": by_length,
        "clamp_position": by_position @ turn.T,
        "clamp_rotation": by_turn * rod.length,
    }
    relative = _covariance(bending_stiffness, "bending_stiffness", 1) / rod.bending_stiffness**2
    spreads = (
        _covariance(youngs_modulus, "youngs_modulus", 1) + relative,
        _covariance(length, "length", 1),
        _covariance(clamp_position, "clamp_position"),
        _covariance(clamp_rotation, "clamp_rotation"),
    )
    floor = pose_errors(reactions, found.point, found.force_direction).point
    robot = floor if pose is None else _covariance(pose, "pose")
    turning = _covariance(pose_rotation, "pose_rotation")
    turned = turned_covariance(turning, found.point - reactions.trail.position)
    nothing = np.where(found.in_contact[..., None, None], 0.0, np.nan)
    by_cause = {"pose": nothing + robot + turned}
    wrench = found.covariance_noise - floor
    if found.smoothing is not None:
        model = np.eye(3) * (found.smoothing[0].model_error * rod.length) ** 2
        by_cause["model"] = nothing + model
        wrench = wrench - model
    by_cause["wrench"] = wrench
    for (name, part), spread in zip(sensitivity.items(), spreads, strict=True):
        by_cause[name] = nothing + part @ spread @ np.swapaxes(part, -1, -2)
    return ContactErrors(by_cause, tuple(sensitivity), sensitivity)


def _covariance(value: ArrayLike, name: str, size: int = 3) -> Float[np.ndarray, "k k"]:
    """From one standard deviation, or from a covariance."""
    array = finite_array(value, name)
    if array.ndim == 0:
        return np.eye(size) * not_negative(float(array), name) ** 2
    if (
        array.shape != (size, size)
        or not np.allclose(array, array.T)
        or np.linalg.eigvalsh(array)[0] < -1e-12 * np.abs(array).max()
    ):
        raise ValueError(
            f"{name} = {array.tolist()}; allowed is a number of at least 0, or a symmetric "
            f"positive semidefinite {(size, size)}"
        )
    return array
