"""What hangs on the sensor: its weight, by orientation."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from vibrissa.geometry.checks import finite_array, not_negative
from vibrissa.geometry.rotation import cross_matrices

STANDARD_GRAVITY = (0.0, 0.0, -9.80665)
"""Standard acceleration of free fall [m/s²], world axes with z up (ISO 80000-3)."""


@dataclass(frozen=True)
class Mount:
    """The parts that the sensor carries: clamp, adapter, rod.

    Attributes
    ----------
    mass
        [kg].
    center
        Centre of mass in the sensor frame (3,) [m].
    gravity
        Acceleration of free fall in world axes (3,) [m/s²].
    estimated
        Whether mass and centre are found from the recording's own rest intervals, in at least three
        orientations, in place of those given.

    Raises
    ------
    ValueError
        If the mass is negative, or a figure is not finite.
    """

    mass: float = 0.0
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gravity: tuple[float, float, float] = STANDARD_GRAVITY
    estimated: bool = False

    def __post_init__(self) -> None:
        not_negative(self.mass, "mount.mass")
        finite_array(self.center, "mount.center", last=3, ndim=1)
        finite_array(self.gravity, "mount.gravity", last=3, ndim=1)

    @property
    def moments(self) -> Float[np.ndarray, "4"]:
        """Mass [kg] and first moment of mass [kg m], in which the weight is linear."""
        return np.array([self.mass, *(self.mass * np.asarray(self.center))])

    def weight(
        self, axes: Float[np.ndarray, "n 3 3"], point: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "n 6 4"]:
        """Matrices that take `moments` to the weight's force and torque on the sensor about
        `point`, in sensor axes.

        Parameters
        ----------
        axes
            Rotations (n, 3, 3) from sensor to world axes.
        point
            In the sensor frame (3,) [m].
        """
        fall = np.asarray(self.gravity) @ axes
        matrix = np.zeros((len(axes), 6, 4))
        matrix[:, :3, 0], matrix[:, 3:, 0] = fall, -np.cross(point, fall)
        matrix[:, 3:, 1:] = -cross_matrices(fall)
        return matrix
