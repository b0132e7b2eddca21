"""Noise of the robot's pose: the errors of contacts and normals are those that are stated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.reactions import turned_covariance
from vibrissa.sensor import Sensor

WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
BALL = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
SAMPLES = 900
SENSOR = Sensor(
    np.array([0.01, -0.02, 0.025]),
    Rotation.from_rotvec([0.4, 1.0, -0.3]).as_quat(),
    "on_sensor",
    force_noise=2e-4,
    torque_noise=4e-6,
    position_noise=2e-5,
    orientation_noise=2e-3,
)


@pytest.fixture(scope="module")
def scene() -> vb.Scan:
    return vb.scan(
        WIRE, BALL, vb.Trail.line(start=(0.02, 0.005, 0), stop=(-0.02, 0.005, 0), count=41)
    )


def repeated(scene: vb.Scan, row: int, sensor: Sensor) -> vb.Reconstruction:
    """One position of the scan, logged and reconstructed many times."""
    every = np.full(SAMPLES, row)
    trail = vb.Trail(scene.trail.position[every], scene.trail.orientation[every])
    reactions = vb.Reactions(
        trail,
        scene.reactions.force[every],
        scene.reactions.moment[every],
        time=np.arange(SAMPLES) * 1e-3,
    )
    return vb.reconstruct(
        WIRE, sensor.reactions(sensor.measure(reactions, np.random.default_rng(3)))
    )


@pytest.mark.parametrize("wrench_frame", ["sensor", "world"])
def test_errors_of_a_robots_orientation_are_as_stated(scene: vb.Scan, wrench_frame: str) -> None:
    """Rod and wrench turn about the sensor's origin, whichever axes the wrench is in: in units of
    the stated deviations errors scatter by one.
    """
    row = int(
        np.flatnonzero(
            (scene.kind == vb.ContactKind.TANGENTIAL) & (scene.arc_length < 0.9 * WIRE.length)
        )[2]
    )
    found = repeated(scene, row, replace(SENSOR, wrench_frame=wrench_frame))
    without = repeated(
        scene, row, replace(SENSOR, wrench_frame=wrench_frame, orientation_noise=0.0)
    )
    assert found.covariance is not None
    assert found.normal_covariance is not None
    assert without.covariance is not None
    stated = found.covariance.mean(axis=0)
    assert np.trace(stated) > 1.5 * np.trace(without.covariance.mean(axis=0))
    root = np.linalg.inv(np.linalg.cholesky(stated))
    error = (found.point - scene.point[row]) @ root.T
    np.testing.assert_allclose(
        error.T @ error / SAMPLES, np.eye(3), rtol=0, atol=5 * np.sqrt(2 / SAMPLES) + 0.02
    )
    across = np.linalg.svd(scene.normal[row][None])[2][1:]
    spread = across @ found.normal_covariance.mean(axis=0) @ across.T
    turned = (
        (found.normal - scene.normal[row]) @ across.T @ np.linalg.inv(np.linalg.cholesky(spread)).T
    )
    np.testing.assert_allclose(
        turned.T @ turned / SAMPLES, np.eye(2), rtol=0, atol=5 * np.sqrt(2 / SAMPLES) + 0.02
    )


def test_by_cause_the_pose_has_the_share_of_its_rotation(scene: vb.Scan) -> None:
    """What `contact_errors` gives to the robot is its position's noise and the rotation's about the
    sensor; the rest is as without.
    """
    row = int(np.flatnonzero(scene.kind == vb.ContactKind.TANGENTIAL)[3])
    found, without = (
        repeated(scene, row, replace(SENSOR, orientation_noise=noise)) for noise in (2e-3, 0.0)
    )
    errors = vb.contact_errors(found)
    assert found.covariance is not None
    np.testing.assert_allclose(errors.total, found.covariance, rtol=1e-9, atol=1e-18)
    arm = found.point - found.reactions.rotation_center
    expected = np.eye(3) * 2e-5**2 + turned_covariance(np.eye(3) * 2e-3**2, arm)
    np.testing.assert_allclose(errors.by_cause["pose"], expected, rtol=1e-9)
    wrench = vb.contact_errors(without).by_cause["wrench"].mean(axis=0)
    np.testing.assert_allclose(
        errors.by_cause["wrench"].mean(axis=0), wrench, rtol=0.02, atol=1e-2 * np.trace(wrench)
    )


def test_a_turned_vector(scene: vb.Scan) -> None:
    """|d|² − d dᵀ for the same error about each axis; and by the definition for any."""
    rng = np.random.default_rng(0)
    arm, root = rng.normal(size=(4, 3)), rng.normal(size=(3, 3))
    np.testing.assert_allclose(
        turned_covariance(np.eye(3), arm),
        np.sum(arm**2, axis=1)[:, None, None] * np.eye(3) - arm[:, :, None] * arm[:, None, :],
        atol=1e-14,
    )
    moved = np.stack([np.cross(root[:, place], arm) for place in range(3)], axis=-1)
    np.testing.assert_allclose(
        turned_covariance(root @ root.T, arm), moved @ np.swapaxes(moved, 1, 2), atol=1e-13
    )
