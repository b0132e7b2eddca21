"""The sensor as a model: what it would log of given reactions."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.reactions import Reactions
from vibrissa.sensor.maps import to_readings, weight_readings
from vibrissa.sensor.raw import RawRecording

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

_ROUNDING = 1e-9


def logged(
    sensor: "Sensor",
    reactions: Reactions,
    position: Float[np.ndarray, "n 3"],
    orientation: Float[np.ndarray, "n 4"],
    tare: Float[np.ndarray, "6"],
    rng: np.random.Generator,
) -> RawRecording:
    """Readings of reactions with time, at poses of the sensor, as `Sensor.measure` describes them."""
    time = reactions.time
    assert time is not None
    shown = filtered_readings(sensor, reactions, orientation)
    position = position + rng.normal(0.0, sensor.position_noise, position.shape)
    drift = np.concatenate([sensor.force_drift, sensor.torque_drift])
    noisy = shown + tare + (time - time[0])[:, None] * drift
    if sensor.force_noise is not None:
        for part in (slice(0, 3), slice(3, 6)):
            noisy[:, part] += rng.normal(0.0, sensor.noise[part], (len(time), 3))
    for process, scale in sensor.coloured(time):
        noisy += scale * process.sampled(time, rng, 6)
    if sensor.orientation_noise:
        turn = Rotation.from_rotvec(rng.normal(0.0, sensor.orientation_noise, (len(time), 3)))
        orientation = (turn * Rotation.from_quat(orientation)).as_quat()
        if sensor.wrench_frame == "world":
            # World axes are those of the robot, which turns the wrench by the orientation that it
            # logs.
            noisy += (
                np.concatenate([turn.apply(shown[:, :3]), turn.apply(shown[:, 3:])], axis=1) - shown
            )
    read = np.stack(
        [
            _read(*channel)
            for channel in zip(noisy.T, sensor.resolution.tolist(), sensor.ranges, strict=True)
        ],
        axis=1,
    )
    return RawRecording(time, position, orientation, read[:, :3], read[:, 3:])


def filtered_readings(
    sensor: "Sensor", reactions: Reactions, orientation: Float[np.ndarray, "n 4"]
) -> Float[np.ndarray, "n 6"]:
    """Readings of reactions and of the mount's weight, with cross-talk, behind the low-pass filter,
    without noise.
    """
    axes = rotation_matrices(orientation)
    shown = np.einsum(
        "nij,nj->ni",
        to_readings(sensor, axes),
        np.concatenate([reactions.force, reactions.moment], axis=1),
    )
    if sensor.mount is not None:
        shown = shown + weight_readings(sensor, axes) @ sensor.mount.moments
    if sensor.low_pass is not None and reactions.time is not None:
        shown = sensor.low_pass.applied(reactions.time, shown)
    return np.asarray(shown)


def _read(
    values: Float[np.ndarray, "n"], resolution: float, largest: float | None
) -> Float[np.ndarray, "n"]:
    """Limited to the range and rounded, as by a converter: the last step within the range is the
    largest reading.
    """
    if largest is not None:
        limit = np.floor(largest / resolution + _ROUNDING) * resolution if resolution else largest
        values = np.clip(values, -limit, limit)
    return np.asarray(np.round(values / resolution) * resolution if resolution else values)
