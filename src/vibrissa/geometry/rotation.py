"""Unit quaternions x, y, z, w (REP-103) as arrays; they map the axes of a body frame onto world
axes.
"""

from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
import scipy
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array

Quaternions = Float[np.ndarray, "*batch 4"]


@runtime_checkable
class Turn(Protocol):
    """A rotation, or several, such as SciPy's `Rotation`."""

    def as_quat(self) -> np.ndarray:
        """Quaternions x, y, z, w (…, 4)."""


Orientation: TypeAlias = ArrayLike | Turn
"""Quaternions x, y, z, w (…, 4), or SciPy's `Rotation`."""

_AXIS_TOLERANCE = 1e-12


def unit_quaternions(value: Orientation, name: str) -> Quaternions:
    """Normalised quaternions x, y, z, w from an array (…, 4) or a SciPy `Rotation`.

    Raises
    ------
    ValueError
        If an entry is not finite or a quaternion has zero norm.
    """
    if isinstance(value, Turn):
        return np.asarray(value.as_quat(), dtype=np.float64)
    quaternion = finite_array(value, name, last=4)
    norm = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    for where in np.argwhere(norm[..., 0] < _AXIS_TOLERANCE).tolist():
        raise ValueError(
            f"{name}{where or ''} = {quaternion[tuple(where)].tolist()} has zero norm; allowed is "
            "any quaternion x, y, z, w of non-zero norm"
        )
    return quaternion / norm


def lengths(vectors: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch"]:
    """Euclidean norms along the last axis."""
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def _rotations(quaternion: Quaternions) -> "scipy.spatial.transform.Rotation":
    return scipy.spatial.transform.Rotation.from_quat(quaternion.reshape(-1, 4))


def rotation_matrices(quaternion: Quaternions) -> Float[np.ndarray, "*batch 3 3"]:
    """Rotation matrices (…, 3, 3) that take body components to world components."""
    return np.asarray(_rotations(quaternion).as_matrix().reshape(*quaternion.shape[:-1], 3, 3))


def third_axis(quaternion: Quaternions) -> Float[np.ndarray, "*batch 3"]:
    """World direction of the body's +z axis: the direction in which the rod leaves its clamp."""
    return rotation_matrices(quaternion)[..., 2]


def first_axis(quaternion: Quaternions) -> Float[np.ndarray, "*batch 3"]:
    """World direction of the body's +x axis."""
    return rotation_matrices(quaternion)[..., 0]


def rotation_vectors(first: Quaternions, last: Quaternions) -> Float[np.ndarray, "*batch 3"]:
    """Rotation vectors (…, 3) [rad], world axes, that take the orientations `first` to `last`."""
    turned = _rotations(last) * _rotations(first).inv()
    return np.asarray(turned.as_rotvec().reshape(*first.shape[:-1], 3))


def turning_axis_to(axis: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4"]:
    """Quaternion of the shortest rotation that takes +z to the unit vector `axis`."""
    x, y, z = axis
    # 1 + z without cancellation near −z, where the half turn may be about any perpendicular axis.
    w = 1 + z if z > 0 else (x * x + y * y) / (1 - z)
    if w == 0:
        return np.array([1.0, 0.0, 0.0, 0.0])
    quaternion = np.array([-y, x, 0.0, w])
    return quaternion / np.linalg.norm(quaternion)


def multiplied(first: Quaternions, second: Float[np.ndarray, "4"]) -> Quaternions:
    """Quaternions of the rotation `second` applied in the frames of `first` (…, 4)."""
    turned = _rotations(first) * _rotations(second)
    return np.asarray(turned.as_quat().reshape(first.shape))


def inverse(quaternion: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
    """Quaternion of the inverse rotation."""
    return quaternion * np.array([-1.0, -1.0, -1.0, 1.0])


def cross_matrices(vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3 3"]:
    """[v]× (…, 3, 3) with [v]× u = v × u."""
    return np.cross(np.eye(3), vectors[..., None, :])
