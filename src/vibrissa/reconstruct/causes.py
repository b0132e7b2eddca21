"""Errors of contacts by cause: noise of the wrench, pose of the robot, the rod's stiffness and length, the mount of the clamp."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.contacts import ContactKind
from vibrissa.geometry.checks import finite_array, not_negative
from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.numerics.blocks import AnyArray
from vibrissa.numerics.rotation import cross_matrix
from vibrissa.reconstruct.result import Reconstruction
from vibrissa.reconstruct.smoothing.manifold import ARC_LENGTH, COORDINATES, bent

_PARAMETERS = 8
_STIFFNESS, _LENGTH, _POSITION, _ROTATION = 0, 1, slice(2, 5), slice(5, 8)
_AT_TIP = 1e-6
_BLOCK = 512


@dataclass(frozen=True, eq=False)
class ContactErrors:
    """Covariances of contact points by cause, world axes, units of the rod squared.

    Attributes
    ----------
    by_cause
        Name of the cause to (…, 3, 3); NaN without contact. The causes are independent of each other.
    shared
        Causes whose error is one and the same for all contacts of a recording: neither averages nor smoothing reduce it.
    sensitivity
        Derivatives (…, 3, k) of the points by the shared parameters: `bending_stiffness` by its relative change, `length`, `clamp_position` and `clamp_rotation`
        (clamp axes) by themselves. They carry errors from one contact to another.
    """

    by_cause: dict[str, Float[np.ndarray, "*trail n 3 3"]]
    shared: tuple[str, ...]
    sensitivity: dict[str, Float[np.ndarray, "*trail n 3 k"]]

    @property
    def total(self) -> Float[np.ndarray, "*trail n 3 3"]:
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
        Standard deviation of Young's modulus as a share of it (0.01 for 1 %).
    bending_stiffness
        Standard deviation of EI, in units of the rod [N m²]; besides that of the modulus.
    length
        Standard deviation of the rod's length [m].
    clamp_position
        Of the clamp in the sensor frame, seen in clamp axes: a standard deviation for each axis [m], or a covariance (3, 3).
    clamp_rotation
        Of the clamp's axes, small rotations about clamp axes: a standard deviation [rad], or a covariance (3, 3).
    pose
        Of the robot's position in each sample: a standard deviation for each axis [m], or a covariance (3, 3), world axes. Default: that of the reactions.
    pose_rotation
        Standard deviation of the robot's orientation in each sample [rad], as a rotation about the clamp; besides that of the reactions.

    Raises
    ------
    ValueError
        If a standard deviation is negative or not finite, a covariance not symmetric and positive semidefinite, or the noise of the wrench is not known.

    Notes
    -----
    The reconstruction is the most probable single contact x of a wrench w, so an error dθ of rod or mount moves it by
    dx = −(HᵀΣ⁻¹H)⁻¹HᵀΣ⁻¹ (∂h/∂θ) dθ, with w = h(x; θ) and H = ∂h/∂x, and the point p(x; θ) by dp = (∂p/∂x) dx + (∂p/∂θ) dθ (derivatives by JAX).
    At the tip s₁ = L is part of h: in smoothed tip contacts, and in single samples that were limited to the rod's length.
    """
    if found.covariance is None or found.reactions.covariance is None:
        raise ValueError(
            "found.covariance = None: errors by cause need the noise of the wrench; give the sensor force_noise and torque_noise"
        )
    rod = found.rod
    stiffness = np.hypot(
        not_negative(youngs_modulus, "youngs_modulus"), not_negative(bending_stiffness, "bending_stiffness") / rod.bending_stiffness
    )
    own = found.reactions.pose_covariance(found.point)
    floor = np.zeros((3, 3)) if own is None else own
    robot = floor if pose is None else _covariance(pose, "pose")
    slopes = _sensitivities(found)
    turn = rotation_matrices(found.reactions.trail.orientation)
    model = np.zeros((3, 3)) if found.smoothing is None else np.eye(3) * (found.smoothing[0].model_error * rod.length) ** 2
    reach = found.point - found.reactions.trail.position
    arm = np.swapaxes(np.cross(np.eye(3), reach[..., None, :]), -1, -2)
    sensitivity = {
        "bending_stiffness": slopes[..., _STIFFNESS, None] * rod.length,
        "length": slopes[..., _LENGTH, None],
        "clamp_position": slopes[..., _POSITION],
        "clamp_rotation": slopes[..., _ROTATION] * rod.length,
    }
    sensitivity = {name: turn @ part for name, part in sensitivity.items()}
    spreads = {
        "bending_stiffness": np.eye(1) * stiffness**2,
        "length": np.eye(1) * not_negative(length, "length") ** 2,
        "clamp_position": _covariance(clamp_position, "clamp_position"),
        "clamp_rotation": _covariance(clamp_rotation, "clamp_rotation"),
    }
    nothing = np.where(found.in_contact[..., None, None], 0.0, np.nan)
    by_cause = {
        "wrench": found.covariance - floor - model,
        "pose": nothing + robot + not_negative(pose_rotation, "pose_rotation") ** 2 * arm @ np.swapaxes(arm, -1, -2),
        **{name: nothing + part @ spreads[name] @ np.swapaxes(part, -1, -2) for name, part in sensitivity.items()},
    }
    if found.smoothing is not None:
        by_cause["model"] = nothing + model
    return ContactErrors(by_cause, tuple(sensitivity), sensitivity)


def _covariance(value: ArrayLike, name: str) -> Float[np.ndarray, "3 3"]:
    """From one standard deviation, or a covariance."""
    array = finite_array(value, name)
    if array.ndim == 0:
        return np.eye(3) * not_negative(float(array), name) ** 2
    if array.shape != (3, 3) or not np.allclose(array, array.T) or np.linalg.eigvalsh(array)[0] < -1e-12 * np.abs(array).max():
        raise ValueError(f"{name} = {array.tolist()}; allowed is a number of at least 0, or a symmetric positive semidefinite (3, 3)")
    return array


class _Rows(NamedTuple):
    """Contacts in clamp axes and model units."""

    x: Float[AnyArray, "n 5"]
    at_tip: Float[AnyArray, "n"]
    precision: Float[AnyArray, "n 6 6"]


def _sensitivities(found: Reconstruction) -> Float[np.ndarray, "*trail n 3 8"]:
    """Derivatives of the contact, seen from the clamp in clamp axes and model units, by ln EI, ln L, the clamp's position and its rotation."""
    rows = _rows(found)
    count = len(rows.x)
    out = np.full((count, 3, _PARAMETERS), np.nan)
    index = np.flatnonzero(found.in_contact.reshape(-1) & np.isfinite(rows.x).all(axis=1))
    for first in range(0, len(index), _BLOCK):
        part = index[first : first + _BLOCK]
        filled = np.concatenate([part, np.repeat(part[:1], _BLOCK - len(part))])
        out[part] = np.asarray(_slopes(_Rows(*(jnp.asarray(np.asarray(field)[filled]) for field in rows))))[: len(part)]
    return out.reshape(*found.kind.shape, 3, _PARAMETERS)


def _rows(found: Reconstruction) -> _Rows:
    """Coordinates of the contacts as they were found, also where noise or smoothing moved them from the measured wrench."""
    rod, trail = found.rod, found.reactions.trail
    turn = rotation_matrices(trail.orientation).reshape(-1, 3, 3)
    reach, n = (np.einsum("nji,nj->ni", turn, part.reshape(-1, 3)) for part in ((found.point - trail.position) / rod.length, found.normal))
    lever = np.linalg.norm(np.cross(reach, n), axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        force = 4 * (found.modulus.reshape(-1) - (1 + n[:, 2]) / 2) / lever**2
        moment = -np.cross(reach, n) * force[:, None]
        tilt = moment[:, 2] / np.linalg.norm(moment[:, :2], axis=1)
    s1 = found.arc_length.reshape(-1) / rod.length
    x = np.column_stack([moment[:, :2], force * n[:, 2], s1, tilt])
    limited = s1 > 1 - _AT_TIP
    at_tip = (found.kind.reshape(-1) == ContactKind.TIP) & limited
    units = np.repeat([rod.force_scale, rod.moment_scale], 3)
    assert found.reactions.covariance is not None
    both = np.zeros((len(turn), 6, 6))
    both[:, :3, :3] = both[:, 3:, 3:] = np.swapaxes(turn, 1, 2)
    given = np.broadcast_to(found.reactions.covariance / np.outer(units, units), (*found.kind.shape, 6, 6)).reshape(-1, 6, 6)
    return _Rows(x, at_tip.astype(float), np.linalg.inv(both @ given @ np.swapaxes(both, 1, 2)))


@jax.jit
def _slopes(rows: _Rows) -> Float[Array, "n 3 8"]:
    return jax.vmap(_slope)(rows.x, rows.at_tip, rows.precision)


def _slope(x: Float[AnyArray, "5"], at_tip: Float[AnyArray, ""], precision: Float[AnyArray, "6 6"]) -> Float[Array, "3 8"]:
    def observed(both: Float[Array, "13"]) -> Float[Array, "9"]:
        return _seen(both[:COORDINATES], both[COORDINATES:])

    jacobian = jax.jacfwd(observed)(jnp.concatenate([x, jnp.zeros(_PARAMETERS)]))
    free = jnp.ones(COORDINATES).at[ARC_LENGTH].set(1 - at_tip)
    design, of_parameters = jacobian[:6, :COORDINATES] * free, jacobian[:6, COORDINATES:]
    information = design.T @ precision @ design + jnp.diag(1 - free)
    shift = -jnp.linalg.solve(information, design.T @ precision @ of_parameters)
    return jacobian[6:, :COORDINATES] @ (free[:, None] * shift) + jacobian[6:, COORDINATES:]


def _seen(x: Float[Array, "5"], parameters: Float[Array, "8"]) -> Float[Array, "9"]:
    """Wrench (6) that would be measured about the supposed clamp, in its axes and in nominal units, and the true contact seen from there (3)."""
    stiffness, length = jnp.exp(parameters[_STIFFNESS]), jnp.exp(parameters[_LENGTH])
    value = bent(x)
    shift, turn = parameters[_POSITION], jnp.eye(3) + cross_matrix(parameters[_ROTATION])
    force = turn @ value.wrench[:3] * stiffness / length**2
    moment = turn @ value.wrench[3:] * stiffness / length + jnp.cross(shift, force)
    return jnp.concatenate([force, moment, shift + turn @ value.reach * length])
