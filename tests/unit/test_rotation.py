"""Quaternions x, y, z, w against SciPy's rotations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vibrissa.geometry.rotation import (
    multiplied,
    rotation_matrices,
    third_axis,
    turning_axis_to,
    unit_quaternions,
)

RANDOM = Rotation.random(50, rng=np.random.default_rng(3))


def test_third_axis_is_where_the_rotation_takes_z() -> None:
    np.testing.assert_allclose(
        third_axis(RANDOM.as_quat()), RANDOM.apply([0, 0, 1]), rtol=0, atol=1e-15
    )


def test_matrices_take_body_to_world() -> None:
    matrices = rotation_matrices(RANDOM.as_quat().reshape(5, 10, 4))
    v = np.array([0.3, -1.0, 2.0])
    np.testing.assert_allclose((matrices @ v).reshape(-1, 3), RANDOM.apply(v), rtol=0, atol=1e-14)
    # A quarter turn about z takes x to y: the sense of rotation, not only its axis.
    quarter = rotation_matrices(np.array([0, 0, np.sqrt(0.5), np.sqrt(0.5)]))
    np.testing.assert_allclose(quarter @ [1, 0, 0], [0, 1, 0], atol=1e-15)


def test_the_second_rotation_is_seen_in_the_frame_of_the_first() -> None:
    mount = Rotation.from_euler("xyz", [0.3, -0.2, 1.0])
    both = multiplied(RANDOM.as_quat(), mount.as_quat())
    v = np.array([0.1, 0.2, 0.3])
    np.testing.assert_allclose(
        Rotation.from_quat(both).apply(v), RANDOM.apply(mount.apply(v)), rtol=0, atol=1e-15
    )


def test_quaternions_are_normalised_and_rotations_taken_as_they_are() -> None:
    np.testing.assert_allclose(unit_quaternions([0, 0, 3, 4], "q"), [0, 0, 0.6, 0.8], atol=1e-16)
    np.testing.assert_allclose(unit_quaternions(RANDOM, "q"), RANDOM.as_quat(), atol=1e-16)


@pytest.mark.parametrize("value", [(0, 0, 0, 0), [(0, 0, 0, 1), (0, 0, 0, 0)]])
def test_zero_norm_is_refused_by_name(value: list[tuple[float, ...]]) -> None:
    with pytest.raises(ValueError, match=r"mount.*zero norm; allowed"):
        unit_quaternions(np.array(value, dtype=float), "mount")


@given(st.floats(0, np.pi), st.floats(-np.pi, np.pi))
def test_turning_takes_z_to_the_axis(angle: float, azimuth: float) -> None:
    axis = np.array(
        [np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)]
    )
    quaternion = turning_axis_to(axis / np.linalg.norm(axis))
    assert np.linalg.norm(quaternion) == pytest.approx(1, abs=1e-15)
    np.testing.assert_allclose(third_axis(quaternion), axis, rtol=0, atol=1e-12)


@pytest.mark.parametrize("tilt", [0.0, 1e-9, 3e-7, 1e-6, 1e-5, 1e-3])
def test_turning_is_exact_next_to_minus_z(tilt: float) -> None:
    axis = np.array([np.sin(tilt), 0.0, -np.cos(tilt)])
    np.testing.assert_allclose(third_axis(turning_axis_to(axis)), axis, rtol=0, atol=1e-12)
