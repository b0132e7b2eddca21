"""How well a setup's numbers are known: their standard deviations, and the errors that all samples
of a sweep share.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array

_AXES = ("x", "y", "z")
# Relative to the variance: a smaller pivot is what rounding leaves of zero in the elimination.
_SMALLEST_PIVOT = 1e-12
# For unit variances: a covariance read from a file is definite only to the file's digits.
_ROUNDING = 1e-6

PARAMETERS = (
    "bending_stiffness",
    "length",
    *(f"clamp_position_{axis}" for axis in _AXES),
    *(f"clamp_orientation_{axis}" for axis in _AXES),
    *(f"gain_{kind}_{axis}" for kind in ("force", "torque") for axis in _AXES),
    "pose_delay",
)
"""Setup parameters whose errors all samples share: EI (relative), the rod's length (its unit), the
clamp's position in the sensor frame (the rod's unit), its orientation (rotations about its axes
[rad]), the gains (relative), and the delay of the poses [s]."""


# Largest deviation, its unit, and the shape if it may differ by axis or channel. First-order
# propagation means nothing for errors this large: larger numbers are probably in millimetres,
# degrees or milliseconds.
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
    """Standard deviations of a setup's stated values; 0 for exact ones.

    Attributes
    ----------
    youngs_modulus, radius
        Relative, and independent: EI has the relative deviation of the modulus, and four times that
        of the radius.
    length
        Of the rod [m].
    clamp_position
        Of the clamp's position in the sensor frame, on each axis [m] (3,).
    clamp_orientation
        Of the clamp's orientation: small rotations about each of its axes [rad] (3,).
    gain
        Relative, of the six channels fx, fy, fz, tx, ty, tz in the sensor's axes (6,).
    pose_delay
        Of the delay of the poses [s].
    object_scale, object_position
        Of the stated object, for `calibrate`: relative size, and position on each axis [m] (3,).

    Raises
    ------
    ValueError
        If a number is negative, not finite or larger than on any real bench, or an array has the
        wrong shape.
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
        """Covariance of the errors of `PARAMETERS`, which are independent."""
        stiffness = np.hypot(self.youngs_modulus, 4 * self.radius)
        mounting = self.clamp_position, self.clamp_orientation, self.gain
        return np.diag(np.hstack([stiffness, self.length, *mounting, self.pose_delay]) ** 2)


@dataclass(frozen=True, eq=False)
class SetupErrors:
    """Errors of a setup's numbers, the same for all samples of a sweep, and what is needed to
    propagate them to contacts.

    Attributes
    ----------
    covariance
        Covariance (15, 15) of the errors of `PARAMETERS`.
    clamp_orientation
        Quaternion x, y, z, w (4,) that maps clamp axes onto sensor axes.
    arm
        From the torque's reference point to the clamp, sensor axes (3,).
    in_world_axes
        Whether the wrench was logged in world axes, rotated by the orientation at that instant.

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
        # Scaled by the deviations; where one is 0, so are its row and column.
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
        """F with F Fᵀ = `covariance`: the non-zero columns of its Cholesky factor."""
        return self._cholesky[0]

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter of each column of the factor: the part of its error that earlier parameters do
        not predict, with the correlated part of later ones.
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
