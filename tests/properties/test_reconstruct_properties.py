"""What must hold of the inverse for any wrench: it knows no axes, no units and no handedness."""

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scenes import UNIT, UNSHRUNK, WIRE, Scene, motions, scenes, sound
from scipy.spatial.transform import Rotation

import vibrissa as vb

FEW = settings(max_examples=10, phases=UNSHRUNK)
MIRROR = np.diag([1.0, -1.0, 1.0])
SPREAD = np.diag([4e-6, 1e-6, 2e-6, 1e-6, 3e-6, 1e-6])


def noisy(scan: vb.Scan, seed: int, covariance: np.ndarray | None) -> vb.Reactions:
    """What a noisy sensor would make of a scan."""
    noise = np.random.default_rng(seed).multivariate_normal(
        np.zeros(6), 0.01 * SPREAD, scan.kind.shape
    )
    force, moment = scan.reactions.force + noise[:, :3], scan.reactions.moment + noise[:, 3:]
    return vb.Reactions(scan.trail, force, moment, covariance=covariance)


def both_ways(covariance: np.ndarray, rotation: np.ndarray, sign: float) -> np.ndarray:
    """Covariance of (force, moment) under a rotation or reflection; a moment is an axial vector."""
    B = np.zeros((6, 6))
    B[:3, :3], B[3:, 3:] = rotation, sign * rotation
    turned = B @ covariance @ B.T
    return (turned + turned.T) / 2


seeds = st.integers(0, 2**31)
covariances = st.sampled_from([None, SPREAD])


def compare(
    moved: vb.Reconstruction, still: vb.Reconstruction, matrix: np.ndarray, shift: np.ndarray
) -> None:
    np.testing.assert_array_equal(moved.kind, still.kind)
    np.testing.assert_array_equal(moved.status, still.status)
    rows = still.in_contact & (still.status == vb.Status.OK)
    assume(rows.any())
    np.testing.assert_allclose(
        moved.point[rows], still.point[rows] @ matrix.T + shift, rtol=0, atol=1e-8
    )
    np.testing.assert_allclose(moved.normal[rows], still.normal[rows] @ matrix.T, rtol=0, atol=1e-8)
    np.testing.assert_allclose(moved.arc_length[rows], still.arc_length[rows], rtol=0, atol=1e-8)
    np.testing.assert_allclose(moved.energy[rows], still.energy[rows], rtol=1e-7, atol=1e-10)
    if still.covariance is not None and moved.covariance is not None:
        expected = matrix @ still.covariance[rows] @ matrix.T
        scale = np.abs(expected).max(axis=(1, 2), keepdims=True)
        np.testing.assert_allclose(
            moved.covariance[rows] / scale, expected / scale, rtol=0, atol=1e-5
        )


@FEW
@given(scenes(), motions, seeds, covariances)
def test_turning_and_moving_the_sensor_turns_and_moves_the_contacts(
    scene: Scene, motion: tuple[Rotation, np.ndarray], seed: int, covariance: np.ndarray | None
) -> None:
    rotation, translation = motion
    R = rotation.as_matrix()
    scan = scene.scan()
    assume(np.count_nonzero(sound(scan)) > 5)
    still = noisy(scan, seed, covariance)
    trail = vb.Trail(rotation.apply(scene.position) + translation, rotation * scene.orientation)
    turned = None if covariance is None else both_ways(covariance, R, 1.0)
    moved = vb.Reactions(trail, still.force @ R.T, still.moment @ R.T, covariance=turned)
    compare(vb.reconstruct(UNIT, moved), vb.reconstruct(UNIT, still), R, translation)


@FEW
@given(scenes(), seeds, covariances)
def test_a_mirror_shows_the_mirrored_contacts(
    scene: Scene, seed: int, covariance: np.ndarray | None
) -> None:
    scan = scene.scan()
    assume(np.count_nonzero(sound(scan)) > 5)
    still = noisy(scan, seed, covariance)
    quaternion = still.trail.orientation * [-1, 1, -1, 1]
    turned = None if covariance is None else both_ways(covariance, MIRROR, -1.0)
    image = vb.Reactions(
        vb.Trail(still.trail.position @ MIRROR, quaternion),
        still.force @ MIRROR,
        -still.moment @ MIRROR,
        covariance=turned,
    )
    compare(vb.reconstruct(UNIT, image), vb.reconstruct(UNIT, still), MIRROR, np.zeros(3))


@FEW
@given(scenes(), seeds, covariances)
def test_units_cancel(scene: Scene, seed: int, covariance: np.ndarray | None) -> None:
    scan = scene.scan()
    assume(np.count_nonzero(sound(scan)) > 5)
    model, L = noisy(scan, seed, covariance), WIRE.length
    units = np.repeat([WIRE.force_scale, WIRE.moment_scale], 3)
    si = vb.Reactions(
        vb.Trail(model.trail.position * L, model.trail.orientation),
        model.force * WIRE.force_scale,
        model.moment * WIRE.moment_scale,
        covariance=None if covariance is None else covariance * np.outer(units, units),
    )
    ours, theirs = vb.reconstruct(WIRE, si), vb.reconstruct(UNIT, model)
    rows = theirs.in_contact
    np.testing.assert_array_equal(ours.kind, theirs.kind)
    np.testing.assert_allclose(ours.point[rows] / L, theirs.point[rows], rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        ours.energy[rows] / WIRE.moment_scale, theirs.energy[rows], rtol=1e-7, atol=1e-10
    )
    if covariance is not None:
        scale = np.abs(theirs.covariance[rows]).max(axis=(1, 2), keepdims=True)
        np.testing.assert_allclose(
            ours.covariance[rows] / L**2 / scale, theirs.covariance[rows] / scale, atol=1e-5
        )


@FEW
@given(scenes(), seeds)
def test_covariances_are_those_of_something(scene: Scene, seed: int) -> None:
    """Symmetric, and not negative in any direction; the normal has none along itself."""
    scan = scene.scan()
    assume(np.count_nonzero(sound(scan)) > 5)
    found = vb.reconstruct(UNIT, noisy(scan, seed, SPREAD))
    rows = found.in_contact
    assert found.covariance is not None
    assert found.normal_covariance is not None
    for covariance in (found.covariance[rows], found.normal_covariance[rows]):
        scale = np.abs(covariance).max(axis=(1, 2))
        assert np.all(scale > 0)
        np.testing.assert_allclose(
            covariance, np.swapaxes(covariance, 1, 2), rtol=0, atol=1e-9 * scale.max()
        )
        assert np.all(np.linalg.eigvalsh(covariance)[:, 0] > -1e-9 * scale)
    n = found.normal[rows]
    along = np.einsum("ni,nij,nj->n", n, found.normal_covariance[rows], n)
    assert np.all(np.abs(along) < 1e-4 * np.trace(found.normal_covariance[rows], axis1=1, axis2=2))
