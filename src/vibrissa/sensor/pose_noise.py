"""Noise and steps of the robot's poses, held against what the setup states."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.geometry.rotation import rotation_vectors
from vibrissa.rod import Rod
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.stamps import MEDIAN_TO_DEVIATION

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor

_FEWEST = 60
# Stated figures are rounded, and a robot's control follows its path with small corrections.
_LARGER = 1.5
# Of the rod's length, or in radians: what is less moves no contact noticeably.
_LEAST = 1e-4
# Third differences take off a path of constant acceleration; their variance is 1 + 9 + 9 + 1 times
# that of white noise.
_THIRD = np.sqrt(20.0)
_STANDING = 0.5
_EVEN = 1.05


def pose_noise(steps: Float[np.ndarray, "m 3"]) -> float:
    """Standard deviation on each axis of poses about a smooth path, from their steps (m, 3): white
    noise, or that of numbers that come in steps.

    White noise by the median of third differences, clamp standing or moving. Poses that stay, then
    go on by always the same step, are rounded or held: evenly spread over the step.
    """
    if len(steps) < _FEWEST:
        return 0.0
    third = np.abs(np.diff(steps, n=2, axis=0))
    white = np.median(third, axis=0) / (MEDIAN_TO_DEVIATION * _THIRD)
    rounded = np.array([_step(axis) for axis in steps.T]) / np.sqrt(12)
    return float(np.max(np.maximum(white, rounded)))


def _step(steps: Float[np.ndarray, "m"]) -> float:
    """Size of the steps in which a number goes on; 0 where it moves evenly, stands, or is noisy."""
    gone = np.flatnonzero(np.abs(steps) > 1e-3 * np.abs(steps).max(initial=0.0))
    if len(gone) < _FEWEST // 3:
        return 0.0
    between = np.diff(gone)
    sizes = np.abs(steps[gone])
    low, high = np.quantile(sizes, [0.1, 0.9])
    stays = float(np.mean(between > 1)) > _STANDING
    return float(np.median(sizes)) if stays and high < _EVEN * low else 0.0


def pose_noise_faults(
    sensor: "Sensor",
    rod: Rod,
    time: Float[np.ndarray, "n"],
    position: Float[np.ndarray, "n 3"],
    orientation: Float[np.ndarray, "n 4"],
) -> tuple[list[Fault], "Sensor"]:
    """Findings on noise of the poses (n, …) that is larger than stated, and the sensor with that
    noise.
    """
    whole = (
        np.isfinite(time)
        & np.isfinite(position).all(axis=1)
        & (np.linalg.norm(np.nan_to_num(orientation), axis=1) > 0)
    )
    time, position, orientation = time[whole], position[whole], orientation[whole]
    if len(time) < _FEWEST:
        return [], sensor
    faults: list[Fault] = []
    figures: dict[str, Any] = {}
    turns = rotation_vectors(orientation[:-1], orientation[1:])
    for name, steps, stated, least, unit in (
        ("position", np.diff(position, axis=0), sensor.position_noise, _LEAST * rod.length, "m"),
        ("orientation", turns, sensor.orientation_noise, _LEAST, "rad"),
    ):
        found = pose_noise(steps[_known(steps)])
        if found > _LARGER * stated and np.hypot(found, stated) > least + stated:
            text = f"the {name} scatters by {found:.3g} {unit} about a smooth path, where {name}_noise = {stated:.3g} {unit} is stated"
            text += "; the error bars use it" if sensor.force_noise is not None else ""
            faults.append(
                Fault(
                    FaultKind.POSE_NOISE, (name,), float(time[0]), float(time[-1]), len(time), text
                )
            )
            figures[f"{name}_noise"] = found
    return faults, replace(sensor, **figures) if figures else sensor


def _known(steps: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, "m"]:
    return np.asarray(np.isfinite(steps).all(axis=1))
