"""How well the numbers of a setup are known: standard deviations of what it states, and the errors
that all samples of a sweep share.
"""

from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array

_CHANNELS = 6
_AXES = ("x", "y", "z")
_SMALLEST_PIVOT = 1e-12

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


_MOST = {
    "youngs_modulus": 1.0,
    "radius": 0.5,
    "length": 0.1,
    "clamp_position": 0.1,
    "clamp_orientation": 0.5,
    "gain": 0.5,
    "pose_delay": 1.0,
    "object_scale": 0.5,
    "object_position": 0.1,
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
        clamp_position: ArrayLike = 0.0,
        clamp_orientation: ArrayLike = 0.0,
        gain: ArrayLike = 0.0,
        pose_delay: float = 0.0,
        object_scale: float = 0.0,
        object_position: ArrayLike = 0.0,
    ) -> None:
        sizes = {
            "clamp_position": 3,
            "clamp_orientation": 3,
            "gain": _CHANNELS,
            "object_position": 3,
        }
        given = locals()
        for name in (field.name for field in fields(self)):
            object.__setattr__(
                self, name, _deviations(given[name], name, sizes.get(name), _MOST[name])
            )

    @property
    def covariance(self) -> Float[np.ndarray, "15 15"]:
        """Of the errors of `PARAMETERS`, independent of each other."""
        stiffness = np.hypot(self.youngs_modulus, 4 * self.radius)
        return np.diag(
            np.concatenate(
                [
                    [stiffness, self.length],
                    self.clamp_position,
                    self.clamp_orientation,
                    self.gain,
                    [self.pose_delay],
                ]
            )
            ** 2
        )


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
        scale = (
            np.sqrt(np.maximum(np.diag(array), 0.0)) if array.shape == (size, size) else np.zeros(0)
        )
        relative = (
            array / np.where(np.outer(scale, scale) > 0, np.outer(scale, scale), 1.0)
            if scale.size
            else array
        )
        if (
            array.shape != (size, size)
            or not np.allclose(relative, relative.T)
            or np.linalg.eigvalsh(relative)[0] < -1e-6
        ):
            raise ValueError(
                f"covariance of shape {array.shape}; allowed is a symmetric positive semidefinite {(size, size)}"
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
    value: ArrayLike, name: str, size: int | None, most: float
) -> "float | Float[np.ndarray, 'k']":
    numbers = finite_array(value, name)
    shapes = ((),) if size is None else ((), (size,))
    if numbers.shape not in shapes or np.any(numbers < 0) or np.any(numbers > most):
        many = "" if size is None else f", or {size} of them"
        unit = {
            "length": " m",
            "clamp_position": " m",
            "object_position": " m",
            "clamp_orientation": " rad",
            "pose_delay": " s",
        }.get(name, "")
        raise ValueError(
            f"{name} = {np.asarray(value).tolist()}; allowed is a standard deviation from 0 to {most:g}{unit}{many}"
        )
    return float(numbers) if size is None else np.broadcast_to(numbers, size).copy()


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
