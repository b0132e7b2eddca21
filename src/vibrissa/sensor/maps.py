"""The linear maps between a sensor's readings and the reactions at the clamp, one matrix a row."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from vibrissa.sensor.mount import cross_matrices

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

Rotations = Float[np.ndarray, "n 3 3"]
Matrices = Float[np.ndarray, "n 6 6"]


def to_reactions(sensor: "Sensor", axes: Rotations) -> Matrices:
    """Readings to reactions: cross-talk undone, turned to world axes, carried to the clamp, with
    the support reaction's sign.

    Parameters
    ----------
    sensor
        Mount, frame, sign and cross-talk.
    axes
        Rotations (n, 3, 3) from sensor to world axes.
    """
    lever = _lever(_arm(sensor, axes))
    if sensor.wrench_frame == "world" and sensor.response is None:
        return sensor.sign * lever
    turn = _both(axes)
    if sensor.response is not None:
        turned = turn @ np.linalg.inv(sensor.response)
        turn = turned @ np.swapaxes(turn, 1, 2) if sensor.wrench_frame == "world" else turned
    return sensor.sign * lever @ turn


def to_readings(sensor: "Sensor", axes: Rotations) -> Matrices:
    """Reactions to readings: the inverse of `to_reactions`, in closed form."""
    at_sensor = sensor.sign * _lever(-_arm(sensor, axes))
    if sensor.wrench_frame == "world" and sensor.response is None:
        return at_sensor
    back = np.swapaxes(_both(axes), 1, 2)
    return crossed(sensor, axes) @ (
        at_sensor if sensor.wrench_frame == "world" else back @ at_sensor
    )


def crossed(sensor: "Sensor", axes: Rotations) -> Matrices:
    """The cross-talk in the axes of the wrench: true wrench to readings."""
    matrix = np.eye(6) if sensor.response is None else sensor.response
    if sensor.wrench_frame == "sensor" or sensor.response is None:
        return np.broadcast_to(matrix, (len(axes), 6, 6))
    turn = _both(axes)
    return turn @ matrix @ np.swapaxes(turn, 1, 2)


def weight_readings(sensor: "Sensor", axes: Rotations) -> Float[np.ndarray, "n 6 4"]:
    """Matrices that take `Mount.moments` to what the sensor shows of the mount's weight."""
    assert sensor.mount is not None
    weight = sensor.mount.weight(axes, np.asarray(sensor.wrench_point))
    if sensor.wrench_frame == "world":
        weight = _both(axes) @ weight
    # A wrench "on_sensor" is the load's, "on_rod" its reaction.
    return -sensor.sign * crossed(sensor, axes) @ weight


def _arm(sensor: "Sensor", axes: Rotations) -> Float[np.ndarray, "n 3"]:
    return np.einsum("nij,j->ni", axes, sensor.clamp_position - np.asarray(sensor.wrench_point))


def _lever(arm: Float[np.ndarray, "n 3"]) -> Matrices:
    """(f, τ) about a point to (f, τ − arm × f), about the point farther by `arm`."""
    matrices = np.tile(np.eye(6), (len(arm), 1, 1))
    matrices[:, 3:, :3] = -cross_matrices(arm)
    return matrices


def _both(axes: Rotations) -> Matrices:
    matrices = np.zeros((len(axes), 6, 6))
    matrices[:, :3, :3] = matrices[:, 3:, 3:] = axes
    return matrices
