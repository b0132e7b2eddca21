"""The sensor as a model: what it would log of given reactions."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.reactions import Reactions
from vibrissa.sensor.maps import to_readings, weight_readings
from vibrissa.sensor.raw import Quaternions, RawRecording, Wrench, Wrenches

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor


def logged(
    sensor: "Sensor",
    reactions: Reactions,
    position: Float[np.ndarray, "n 3"],
    orientation: Quaternions,
    tare: Wrench,
    rng: np.random.Generator,
) -> RawRecording:
    """Readings of reactions with time, at poses of the sensor, in the order that `Sensor.measure`
    states.
    """
    time, noise = reactions.time, sensor.noise
    assert time is not None
    shown = filtered_readings(sensor, reactions, orientation)
    position = position + rng.normal(0.0, noise.position_noise, position.shape)
    noisy = shown + tare + (time - time[0])[:, None] * sensor.tare_policy.drift
    if noise.known:
        for part in (slice(0, 3), slice(3, 6)):
            noisy[:, part] += rng.normal(0.0, noise.white[part], (len(time), 3))
    for process, scale in noise.coloured(time):
        noisy += scale * process.sampled(time, rng, 6)
    if noise.orientation_noise:
        turn = Rotation.from_rotvec(rng.normal(0.0, noise.orientation_noise, (len(time), 3)))
        orientation = (turn * Rotation.from_quat(orientation)).as_quat()
        if sensor.wrench_frame == "world":
            # World axes are those of the robot, which turns the wrench by the orientation that it
            # logs.
            turned = [turn.apply(part) for part in np.split(shown, 2, axis=1)]
            noisy += np.concatenate(turned, axis=1) - shown
    limits, step = sensor.response.limits(noise.resolution), noise.resolution
    limited = np.clip(noisy, -limits, limits)
    rounded = np.round(limited / np.where(step > 0, step, 1.0)) * step
    read = np.where(step > 0, rounded, limited)
    return RawRecording(time, position, orientation, read[:, :3], read[:, 3:])


def filtered_readings(sensor: "Sensor", reactions: Reactions, orientation: Quaternions) -> Wrenches:
    """Readings of reactions and of the mount's weight, with cross-talk, behind the low-pass filter,
    without noise.
    """
    axes = rotation_matrices(orientation)
    wrench = np.concatenate([reactions.force, reactions.moment], axis=1)
    shown = np.einsum("nij,nj->ni", to_readings(sensor, axes), wrench)
    if sensor.mount is not None:
        shown = shown + weight_readings(sensor, axes) @ sensor.mount.moments
    if sensor.response.low_pass is not None and reactions.time is not None:
        shown = sensor.response.low_pass.applied(reactions.time, shown)
    return shown
