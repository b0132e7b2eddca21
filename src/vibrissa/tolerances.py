"""How well the numbers of a setup are known: standard deviations of what it states, and the errors
that all samples of a sweep share.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

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


class _Limit(NamedTuple):
    """Largest deviation and its unit, and how many numbers there may be beside one."""

    most: float
    unit: str = ""
    numbers: int | None = None


_LIMITS = {
    "youngs_modulus": _Limit(1.0),
    "radius": _Limit(0.5),
    "length": _Limit(0.1, " m"),
    "clamp_position": _Limit(0.1, " m", 3),
    "clamp_orientation": _Limit(0.5, " rad", 3),
    "gain": _Limit(0.5, "", 6),
    "pose_delay": _Limit(1.0, " s"),
    "object_scale": _Limit(0.5),
    "object_position": _Limit(0.1, " m", 3),
}
"""Of what is known so badly nothing can be said to first order: larger numbers are millimetres,
degrees or milliseconds.
"""


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
        given = locals()
        for name, limit in _LIMITS.items():
            object.__setattr__(self, name, _deviations(given[name], name, limit))

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
        shape = (len(PARAMETERS),) * 2
        array = finite_array(self.covariance, "covariance", ndim=2)
        sound = array.shape == shape
        if sound:
            scale = np.sqrt(np.maximum(np.diag(array), 0.0))
            scale[scale == 0] = 1.0
            relative = array / np.outer(scale, scale)
            least = np.linalg.eigvalsh(relative)[0]
            sound = np.allclose(relative, relative.T) and least >= -_ROUNDING
        if not sound:
            raise ValueError(
                f"covariance of shape {array.shape}; allowed is a symmetric positive semidefinite "
                f"{shape}"
            )
        object.__setattr__(self, "covariance", array)

    @cached_property
    def factor(self) -> Float[np.ndarray, "15 p"]:
        """F with F Fᵀ = `covariance`: the columns of its Cholesky factor that are not zero."""
        return _cholesky(self.covariance)[0]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the factor's columns: each is the error of this parameter, as far as those before do
        not tell it, with what of the later ones goes with it.
        """
        return tuple(PARAMETERS[column] for column in _cholesky(self.covariance)[1])


def _deviations(
    value: ArrayLike, name: str, limit: _Limit
) -> "float | Float[np.ndarray, 'numbers']":
    numbers = finite_array(value, name)
    shapes = ((), (limit.numbers,))
    if numbers.shape not in shapes or np.any(numbers < 0) or np.any(numbers > limit.most):
        many = f", or {limit.numbers} of them" if limit.numbers else ""
        raise ValueError(
            f"{name} = {np.asarray(value).tolist()}; allowed is a standard deviation from 0 to "
            f"{limit.most:g}{limit.unit}{many}"
        )
    return np.broadcast_to(numbers, limit.numbers).copy() if limit.numbers else float(numbers)


def _cholesky(covariance: Float[np.ndarray, "k k"]) -> tuple[Float[np.ndarray, "k p"], list[int]]:
    """Factor of a positive semidefinite matrix, without the columns that are zero, and the numbers
    of the others.
    """
    left, columns, kept = covariance.copy(), [], []
    for k, variance in enumerate(np.diag(covariance)):
        if left[k, k] > _SMALLEST_PIVOT * variance:
            column = left[:, k] / np.sqrt(left[k, k])
            column[:k] = 0
            left = left - np.outer(column, column)
            columns.append(column)
            kept.append(k)
    return np.array(columns).reshape(-1, len(covariance)).T, kept
