"""How well the numbers of a setup are known: standard deviations of what it states, and the errors
that all samples of a sweep share.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array

_AXES = ("x", "y", "z")
# Of a variance: what elimination leaves of it by rounding is nothing.
_SMALLEST_PIVOT = 1e-12
# Of unit variances: covariances that were read from a file are definite to its digits only.
_ROUNDING = 1e-6

PARAMETERS = (
    "bending_stiffness",
    "length",
    *(f"clamp_position_{axis}" for axis in _AXES),
    *(f"clamp_orientation_{axis}" for axis in _AXES),
    *(f"gain_{kind}_{axis}" for kind in ("force", "torque") for axis in _AXES),
    "pose_delay",
)
"""Numbers of a setup whose errors all samples share: EI (relative), the rod's length (its unit),
the clamp in the sensor frame (the rod's unit), its axes (rotations about them [rad]), the gains
(relative), and by how much the poses come late [s]."""


# Largest deviation, its unit, and the shape of those that may differ by axis or channel. Of what is
# known so badly nothing can be said to first order: larger numbers are millimetres, degrees or
# milliseconds.
_LIMITS: dict[str, tuple[float, str, tuple[int, ...]]] = {
    "youngs_modulus": (1.0, "", ()),
    "radius": (0.5, "", ()),
    "length": (0.1, " m", ()),
    "clamp_position": (0.1, " m", (3,)),
    "clamp_orientation": (0.5, " rad", (3,)),
    "gain": (0.5, "", (6,)),
    "pose_delay": (1.0, " s", ()),
    "object_scale": (0.5, "", ()),
    "object_position": (0.1, " m", (3,)),
}


@dataclass(frozen=True, eq=False)
class Tolerances:
    """Standard deviations of what a setup states; 0 where a number is exact.

    Attributes
    ----------
    youngs_modulus, radius
        Relative: EI has the relative deviation of the modulus and four times that of the radius,
        independent of each other.
    length
        Of the rod [m].
    clamp_position
        Of the clamp in the sensor frame, each axis [m] (3,).
    clamp_orientation
        Of the clamp's axes, small rotations about each of them [rad] (3,).
    gain
        Relative, of the six channels fx, fy, fz, tx, ty, tz in the sensor's axes (6,).
    pose_delay
        Of the time by which the poses come late [s].
    object_scale, object_position
        Of the object as stated, for `calibrate`: relative size, and place on each axis [m] (3,).

    Raises
    ------
    ValueError
        If a number is negative, not finite or larger than any bench's, or there are too many of
        them.
    """

    youngs_modulus: float = 0.0
    radius: float = 0.0
    length: float = 0.0
    clamp_position: Float[np.ndarray, "3"] = 0.0  # type: ignore[assignment]
    clamp_orientation: Float[np.ndarray, "3"] = 0.0  # type: ignore[assignment]
    gain: Float[np.ndarray, "6"] = 0.0  # type: ignore[assignment]
    pose_delay: float = 0.0
    object_scale: float = 0.0
    object_position: Float[np.ndarray, "3"] = 0.0  # type: ignore[assignment]

    def __init__(
        self,
        youngs_modulus: float = 0.0,
        radius: float = 0.0,
        length: float = 0.0,
        clamp_position: "ArrayLike" = 0.0,
        clamp_orientation: "ArrayLike" = 0.0,
        gain: "ArrayLike" = 0.0,
        pose_delay: float = 0.0,
        object_scale: float = 0.0,
        object_position: "ArrayLike" = 0.0,
    ) -> None:
        given, fields = locals(), vars(self)
        for name, (most, unit, shape) in _LIMITS.items():
            numbers = finite_array(given[name], name)
            if numbers.shape not in ((), shape) or np.any((numbers < 0) | (numbers > most)):
                many = f", or {shape[0]} of them" if shape else ""
                raise ValueError(
                    f"{name} = {numbers.tolist()}; allowed is a standard deviation from 0 to "
                    f"{most:g}{unit}{many}"
                )
            fields[name] = np.broadcast_to(numbers, shape).copy() if shape else float(numbers)

    @property
    def covariance(self) -> Float[np.ndarray, "15 15"]:
        """Of the errors of `PARAMETERS`, independent of each other."""
        stiffness = np.hypot(self.youngs_modulus, 4 * self.radius)
        mounting = self.clamp_position, self.clamp_orientation, self.gain
        return np.diag(np.hstack([stiffness, self.length, *mounting, self.pose_delay]) ** 2)


@dataclass(frozen=True, eq=False)
class SetupErrors:
    """What a setup's numbers are off by, the same for all samples of a sweep, and what is needed to
    carry it to contacts.

    Attributes
    ----------
    covariance
        (15, 15) of the errors of `PARAMETERS`.
    clamp_orientation
        Quaternion x, y, z, w (4,) that maps clamp axes onto sensor axes.
    arm
        From the torque's reference point to the clamp, sensor axes (3,).
    in_world_axes
        Whether the wrench was logged in world axes, turned by the orientation of its own instant.

    Raises
    ------
    ValueError
        If `covariance` is not symmetric and positive semidefinite.
    """

    covariance: Float[np.ndarray, "15 15"]
    clamp_orientation: Float[np.ndarray, "4"]
    arm: Float[np.ndarray, "3"]
    in_world_axes: bool = False

    def __post_init__(self) -> None:
        size = len(PARAMETERS)
        array = finite_array(self.covariance, "covariance", last=size, ndim=2)
        # By the deviations; where these are 0, so is all that goes with them.
        scale = np.sqrt(np.maximum(np.diag(array), 1e-300))
        relative = array / np.outer(scale, scale)
        if not np.allclose(relative, relative.T) or np.linalg.eigvalsh(relative)[0] < -_ROUNDING:
            raise ValueError(
                f"covariance of shape {array.shape}; allowed is a symmetric positive semidefinite "
                f"{(size, size)}"
            )
        vars(self)["covariance"] = array

    @property
    def factor(self) -> Float[np.ndarray, "15 p"]:
        """F with F Fᵀ = `covariance`: the columns of its Cholesky factor that are not zero."""
        return self._cholesky[0]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the factor's columns: each is the error of this parameter, as far as those before do
        not tell it, with what of the later ones goes with it.
        """
        return self._cholesky[1]

    @cached_property
    def _cholesky(self) -> tuple[Float[np.ndarray, "15 p"], tuple[str, ...]]:
        left, columns = self.covariance.copy(), {}
        for k, name in enumerate(PARAMETERS):
            if left[k, k] > _SMALLEST_PIVOT * self.covariance[k, k]:
                column = np.where(np.arange(len(left)) < k, 0, left[:, k]) / np.sqrt(left[k, k])
                left -= np.outer(column, column)
                columns[name] = column
        return np.array([*columns.values()]).reshape(-1, len(left)).T, tuple(columns)
