"""Faults of the robot's poses: jumps, and more noise than stated; and filling of missing poses."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from vibrissa.geometry.rotation import rotation_vectors
from vibrissa.rod import Rod
from vibrissa.sensor.deviations import MEDIAN_TO_DEVIATION, deviation_by_differences
from vibrissa.sensor.raw import Fault, FaultKind, Quaternions, RawRecording, Rows, Times, Vectors
from vibrissa.sensor.sensor import Sensor

# Least size of a jump in standard deviations of the steps, over the 95 % quantile of the steps, and
# in rod lengths or radians: smaller ones do not move contacts noticeably.
_DEVIATIONS, _FASTER, _LEAST_JUMP = 12.0, 3.0, 1e-3
# Steps on either side that define the motion: among eleven, a jump does not affect the median.
_NEIGHBOURS = 5
# A median of this many sizes is known to 15 %.
_FEWEST = 60
# Stated figures are rounded, and a robot's controller makes small corrections along the path.
_LARGER = 1.5
# In rod lengths or radians: less does not move contacts noticeably.
_LEAST_NOISE = 1e-4
# Quantised poses stay constant between most steps, and all steps are equal except for rounding.
_STANDING, _EVEN = 0.5, 1.05


def pose_jumps(raw: RawRecording, rod: Rod, filled: Rows) -> Iterator[Fault]:
    """Steps of the pose that stand out from those around them, as one finding for all jumps in
    position and one for orientation.

    A jump exceeds twelve standard deviations of the steps, three times their 95 % quantile, and a
    thousandth of the rod's length or a milliradian. Steps next to filled-in poses are ignored.
    """
    if len(raw.time) < 2 * _NEIGHBOURS:
        return
    usual = 1 / raw.rate
    share = (usual / np.maximum(np.diff(raw.time), usual))[:, None]
    for name, steps, length, unit in _steps(raw.position, raw.orientation, rod):
        even = share * steps
        around = ndimage.median_filter(even, (2 * _NEIGHBOURS + 1, 1), mode="mirror")
        off = np.linalg.norm(even - around, axis=1)
        deviation = np.median(off) / MEDIAN_TO_DEVIATION
        fastest = np.quantile(np.linalg.norm(even, axis=1), 0.95)
        out = off > max(_DEVIATIONS * deviation, _FASTER * fastest, _LEAST_JUMP * length)
        rows = np.flatnonzero(out & ~filled[1:] & ~filled[:-1])
        if len(rows):
            sizes, span = np.linalg.norm(steps[rows], axis=1), raw.time[rows[0] : rows[-1] + 2]
            text = f"the {name} jumps by {sizes[0]:.3g} {unit} within {span[1] - span[0]:.3g} s"
            if len(rows) > 1:
                text += f", and {len(rows) - 1} more times, by up to {sizes.max():.3g} {unit}"
            yield Fault.over((name,), FaultKind.POSE_JUMP, span, text, len(rows))


def _steps(
    position: Vectors, orientation: Quaternions, rod: Rod
) -> list[tuple[str, Float[np.ndarray, "m 3"], float, str]]:
    """Name, steps from row to row, the length that scales them, and unit."""
    turns = rotation_vectors(orientation[:-1], orientation[1:])
    moves = np.diff(position, axis=0)
    return [("position", moves, rod.length, "m"), ("orientation", turns, 1.0, "rad")]


def filled_poses(raw: RawRecording) -> tuple[Vectors, Quaternions, Rows]:
    """Positions and unit quaternions, missing ones taken from the nearest row that has a pose, and
    which rows these are.

    Raises
    ------
    ValueError
        If no row has a pose.
    """
    norm = np.linalg.norm(raw.orientation, axis=1)
    known = np.isfinite(raw.position).all(axis=1) & (norm > 0)
    if not known.any():
        raise ValueError("no row has a pose; allowed are finite positions and unit quaternions")
    good = np.flatnonzero(known)
    halfway = (good[1:] + good[:-1]) / 2
    nearest = good[np.searchsorted(halfway, np.arange(len(norm)), side="right")]
    return raw.position[nearest], raw.orientation[nearest] / norm[nearest, None], ~known


def pose_noise(steps: Float[np.ndarray, "m 3"]) -> float:
    """Standard deviation on each axis of poses about a smooth path, from their steps (m, 3): white
    noise, or quantisation error.

    White noise is found from the median of third differences, which remove a path of constant
    acceleration, at rest or in motion. Poses that stay constant and then change by always the same
    step are rounded or held: their error is uniform over a step.
    """
    white = deviation_by_differences(np.diff(steps, n=2, axis=0), 3)
    rounded = [_rounding_step(axis) / np.sqrt(12) for axis in steps.T]
    return float(max(*white, *rounded))


def _rounding_step(steps: Times) -> float:
    """Step in which a number advances; 0 if it moves smoothly, is constant, or is noisy."""
    sizes = np.abs(steps)
    gone = np.flatnonzero(sizes > 1e-3 * sizes.max())
    if len(gone) < _FEWEST // 3:
        return 0.0
    low, middle, high = np.quantile(sizes[gone], [0.1, 0.5, 0.9])
    stays = np.mean(np.diff(gone) > 1) > _STANDING
    return float(middle) if stays and high < _EVEN * low else 0.0


def pose_noise_faults(
    sensor: Sensor, rod: Rod, time: Times, position: Vectors, orientation: Quaternions
) -> tuple[list[Fault], Sensor]:
    """Findings if the poses (n, …) are noisier than stated, and the sensor with that noise."""
    norm = np.linalg.norm(orientation, axis=1)
    whole = np.isfinite(time) & np.isfinite(position).all(axis=1) & (norm > 0)
    if np.count_nonzero(whole) <= _FEWEST:
        return [], sensor
    faults, figures = [], {}
    for name, steps, length, unit in _steps(position[whole], orientation[whole], rod):
        found, stated = pose_noise(steps), getattr(sensor, f"{name}_noise")
        enough = _LEAST_NOISE * length + stated
        if found > _LARGER * stated and np.hypot(found, stated) > enough:
            text = (
                f"the {name} scatters by {found:.3g} {unit} about a smooth path, where "
                f"{name}_noise = {stated:.3g} {unit} is stated"
            )
            text += "; the error bars use it" if sensor.noise.known else ""
            faults.append(Fault.over((name,), FaultKind.POSE_NOISE, time[whole], text))
            figures[f"{name}_noise"] = found
    return faults, sensor.updated(**figures) if figures else sensor
