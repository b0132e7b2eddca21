"""Faults of the robot's poses: jumps; and poses that are missing, filled."""

import numpy as np
from jaxtyping import Bool, Float

from vibrissa.geometry.rotation import rotation_vectors
from vibrissa.rod import Rod
from vibrissa.sensor.faults import Fault, FaultKind
from vibrissa.sensor.raw import RawRecording
from vibrissa.sensor.stamps import MEDIAN_TO_DEVIATION

_DEVIATIONS = 12.0
_FASTER = 3.0
_LEAST = 1e-3
_NEIGHBOURS = 5


def pose_jumps(raw: RawRecording, rod: Rod, filled: Bool[np.ndarray, "n"]) -> list[Fault]:
    """Steps of the pose that stand out from those around them, one finding for all of the position
    and one for all of the orientation.

    By twelve of the steps' standard deviations, by three times the step that 95 % of them stay
    below, and by a thousandth of the rod's length, or a milliradian. Next to poses that are filled
    in nothing is judged.
    """
    if len(raw.time) < 2 * _NEIGHBOURS:
        return []
    usual = 1 / raw.rate
    share = usual / np.maximum(np.diff(raw.time), usual)
    turns = rotation_vectors(raw.orientation[:-1], raw.orientation[1:])
    found = []
    for name, steps, least, unit in (
        ("position", np.diff(raw.position, axis=0), _LEAST * rod.length, "m"),
        ("orientation", turns, _LEAST, "rad"),
    ):
        rows = np.flatnonzero(
            _standing_out(share[:, None] * steps, least) & ~filled[1:] & ~filled[:-1]
        )
        if len(rows):
            sizes = np.linalg.norm(steps[rows], axis=1)
            text = f"the {name} jumps by {sizes[0]:.3g} {unit} within {raw.time[rows[0] + 1] - raw.time[rows[0]]:.3g} s"
            text += (
                f", and {len(rows) - 1} more times, by up to {sizes.max():.3g} {unit}"
                if len(rows) > 1
                else ""
            )
            found.append(
                Fault(
                    FaultKind.POSE_JUMP,
                    (name,),
                    float(raw.time[rows[0]]),
                    float(raw.time[rows[-1] + 1]),
                    len(rows),
                    text,
                )
            )
    return found


def _standing_out(steps: Float[np.ndarray, "m 3"], least: float) -> Bool[np.ndarray, "m"]:
    padded = np.pad(steps, ((_NEIGHBOURS, _NEIGHBOURS), (0, 0)), mode="reflect")
    around = np.median(
        np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1, axis=0), axis=-1
    )
    off = np.linalg.norm(steps - around, axis=1)
    deviation = float(np.median(off)) / MEDIAN_TO_DEVIATION
    usual = float(np.quantile(np.linalg.norm(steps, axis=1), 0.95))
    return off > max(_DEVIATIONS * deviation, _FASTER * usual, least)


def filled_poses(
    raw: RawRecording,
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 4"], Bool[np.ndarray, "n"]]:
    """Positions and unit quaternions with the missing ones taken from the nearest row that has one,
    and which they are.

    Raises
    ------
    ValueError
        If no row has a pose.
    """
    norm = np.linalg.norm(raw.orientation, axis=1)
    missing = ~(np.isfinite(raw.position).all(axis=1) & np.isfinite(norm) & (norm > 0))
    good = np.flatnonzero(~missing)
    if not len(good):
        raise ValueError("no row has a pose; allowed are finite positions and unit quaternions")
    rows = np.arange(len(norm))
    after = np.clip(np.searchsorted(good, rows), 0, len(good) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(
        np.abs(good[after] - rows) <= np.abs(good[before] - rows), good[after], good[before]
    )
    return raw.position[nearest], raw.orientation[nearest] / norm[nearest, None], missing
