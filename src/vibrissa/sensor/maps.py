"""The linear maps between a sensor's readings and the reactions at the clamp, one matrix a row."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from vibrissa.geometry.rotation import cross_matrices
from vibrissa.sensor.raw import Covariances as Matrices

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

Rotations = Float[np.ndarray, "n 3 3"]


def to_reactions(sensor: "Sensor", axes: Rotations) -> Matrices:
    """Readings to reactions: gain and cross-talk undone, turned to world axes, carried to the
    clamp, with the support reaction's sign.

    Parameters
    ----------
    sensor
        Mount, frame, sign, gain and cross-talk.
    axes
        Rotations (n, 3, 3) from sensor to world axes.
    """
    both = _both(axes)
    turn = both @ np.linalg.inv(sensor.response.matrix)
    if sensor.wrench_frame == "world":
        turn = turn @ np.swapaxes(both, 1, 2)
    return sensor.sign * _lever(axes @ sensor.arm) @ turn


def to_readings(sensor: "Sensor", axes: Rotations) -> Matrices:
    """Reactions to readings: the inverse of `to_reactions`, in closed form."""
    at_sensor = np.swapaxes(_both(axes), 1, 2) @ _lever(-axes @ sensor.arm)
    return sensor.sign * _shown(sensor, axes) @ at_sensor


def weight_readings(sensor: "Sensor", axes: Rotations) -> Float[np.ndarray, "n 6 4"]:
    """Matrices that take `Mount.moments` to what the sensor shows of the mount's weight."""
    assert sensor.mount is not None
    weight = sensor.mount.weight(axes, np.asarray(sensor.wrench_point))
    # A wrench "on_sensor" is the load's, "on_rod" its reaction.
    return -sensor.sign * _shown(sensor, axes) @ weight


def _shown(sensor: "Sensor", axes: Rotations) -> Matrices:
    """True wrench in sensor axes to readings, in the axes of the wrench."""
    if sensor.wrench_frame == "world":
        return _both(axes) @ sensor.response.matrix
    return np.broadcast_to(sensor.response.matrix, (len(axes), 6, 6))


def _lever(arm: Float[np.ndarray, "n 3"]) -> Matrices:
    """(f, τ) about a point to (f, τ − arm × f), about the point farther by `arm`."""
    matrices = np.tile(np.eye(6), (len(arm), 1, 1))
    matrices[:, 3:, :3] = -cross_matrices(arm)
    return matrices


def _both(axes: Rotations) -> Matrices:
    return np.kron(np.eye(2), axes)
