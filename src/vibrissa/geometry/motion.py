"""Rigid-body motions: rotation about an axis, homogeneous matrices."""

import numpy as np
import scipy
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array

_MATRIX_TOLERANCE = 1e-3
_ROUNDING = 1e-13


def equal_angles(start: float, stop: float, count: int) -> Float[np.ndarray, "count"]:
    """Equally spaced angles [rad]; raise ValueError for steps of half a turn or more, as the clamp
    takes the shorter way from one pose to the next.
    """
    if count > 1 and abs(stop - start) >= np.pi * (count - 1):
        least = int(abs(stop - start) / np.pi) + 2
        raise ValueError(
            f"count = {count}: steps of half a turn or more from {start:g} to {stop:g} rad; "
            f"allowed is at least {least}"
        )
    return np.linspace(start, stop, count)


def arm_of(
    point: Float[np.ndarray, "3"], pivot: Float[np.ndarray, "3"], axis: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Perpendicular vector to the point from the line through `pivot` along the unit vector `axis`;
    zero where it is only rounding.
    """
    arm = point - pivot
    across = arm - (arm @ axis) * axis
    rounding = _ROUNDING * max(np.linalg.norm(point), np.linalg.norm(pivot))
    return across if np.linalg.norm(across) > rounding else np.zeros(3)


def matrix_parts(
    value: ArrayLike, name: str
) -> tuple[Float[np.ndarray, "*trail n 3"], Float[np.ndarray, "*trail n 4"]]:
    """Positions and quaternions of homogeneous matrices (…, 4, 4).

    Raises
    ------
    ValueError
        If the shape is wrong, an entry is not finite, or a matrix is not a rotation and translation
        to 1e-3.
    """
    matrices = finite_array(value, name, last=4)
    if matrices.ndim not in (3, 4) or matrices.shape[-2] != 4:
        raise ValueError(
            f"{name} has shape {matrices.shape}; allowed is (n, 4, 4) for one trail or (m, n, "
            "4, 4) for several"
        )
    turn = matrices[..., :3, :3]
    uneven = np.abs(np.swapaxes(turn, -1, -2) @ turn - np.eye(3)).max(axis=(-1, -2))
    last_row = np.abs(matrices[..., 3, :] - [0, 0, 0, 1]).max(axis=-1)
    wrong = np.max([uneven, last_row, 1 - np.linalg.det(turn)], axis=0) > _MATRIX_TOLERANCE
    for where in np.argwhere(wrong).tolist():
        raise ValueError(
            f"{name}{where} = {matrices[tuple(where)].tolist()}; allowed are a rotation and a "
            f"translation above the row [0, 0, 0, 1], to {_MATRIX_TOLERANCE:g}"
        )
    flat = scipy.spatial.transform.Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_quat()
    return matrices[..., :3, 3].copy(), flat.reshape(*turn.shape[:-2], 4)
