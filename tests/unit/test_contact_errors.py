"""Errors by cause: the derivatives against reconstructions with a wrong rod and a wrong mount, an
independent route.
"""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb

ROD = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9)
TURN = Rotation.from_rotvec([0.1, -0.2, 0.7])
AXES = TURN.as_matrix()
_LINE = vb.Trail.line(start=(0.012, 0.005, 0), stop=(-0.008, 0.005, 0), count=6)
TRAIL = vb.Trail(_LINE.position, Rotation.from_rotvec([0, 0, 0.7]))
CLAMP_AXES = Rotation.from_quat(TRAIL.orientation[0]).as_matrix()
SPREAD = np.diag([4e-6, 4e-6, 4e-6, 4e-9, 4e-9, 1e-9])


@cache
def scan() -> vb.Scan:
    return vb.scan(ROD, vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03), TRAIL)


def found_with(
    rod: vb.Rod = ROD, shift: np.ndarray | None = None, turn: np.ndarray | None = None
) -> vb.Reconstruction:
    """Reconstructed with another rod, or with the clamp taken to be elsewhere, or turned: in its
    axes.
    """
    move = np.zeros(3) if shift is None else CLAMP_AXES @ shift
    seen = Rotation.from_quat(TRAIL.orientation) * Rotation.from_rotvec(
        np.zeros(3) if turn is None else turn
    )
    moment = scan().reactions.moment - np.cross(move, scan().reactions.force)
    return vb.reconstruct(
        rod,
        vb.Reactions(
            vb.Trail(scan().trail.position + move, seen.as_quat()),
            scan().reactions.force,
            moment,
            covariance=SPREAD,
        ),
    )


@cache
def errors() -> vb.ContactErrors:
    return vb.contact_errors(
        found_with(),
        youngs_modulus=0.01,
        length=1e-4,
        clamp_position=1e-4,
        clamp_rotation=2e-3,
        pose=2e-5,
    )


def test_the_positions_are_in_tangential_contact() -> None:
    np.testing.assert_array_equal(scan().kind, vb.ContactKind.TANGENTIAL)


def test_stiffness() -> None:
    step = 1e-4
    up, down = (
        found_with(vb.Rod(ROD.length, ROD.bending_stiffness * (1 + sign * step))).point
        for sign in (1, -1)
    )
    np.testing.assert_allclose(
        errors().sensitivity["bending_stiffness"][..., 0],
        (up - down) / (2 * step),
        rtol=1e-4,
        atol=1e-8,
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_mount(axis: int) -> None:
    shift, turn = 1e-6 * np.eye(3)[axis], 1e-5 * np.eye(3)[axis]
    moved = (found_with(shift=shift).point - found_with(shift=-shift).point) / 2e-6
    np.testing.assert_allclose(
        errors().sensitivity["clamp_position"][..., axis], moved, rtol=0, atol=1e-3
    )
    turned = (found_with(turn=turn).point - found_with(turn=-turn).point) / 2e-5
    np.testing.assert_allclose(
        errors().sensitivity["clamp_rotation"][..., axis], turned, rtol=0, atol=1e-4
    )


def test_causes_add_up_and_are_what_was_given() -> None:
    parts = errors().by_cause
    np.testing.assert_allclose(errors().total, sum(parts.values()))
    np.testing.assert_allclose(parts["wrench"], found_with().covariance)
    np.testing.assert_allclose(parts["pose"], np.broadcast_to(4e-10 * np.eye(3), (6, 3, 3)))
    slope = errors().sensitivity["bending_stiffness"]
    np.testing.assert_allclose(parts["bending_stiffness"], 1e-4 * slope @ np.swapaxes(slope, 1, 2))
    # Where the rod leaves the object before its tip, its length does not matter.
    assert np.abs(parts["length"]).max() < 1e-20
    assert errors().shared == ("bending_stiffness", "length", "clamp_position", "clamp_rotation")


def test_spread_of_wrong_mounts() -> None:
    """Monte Carlo: contacts with clamps drawn from the stated covariance spread as stated."""
    rng = np.random.default_rng(2)
    points = np.array([found_with(shift=rng.normal(0, 1e-4, 3)).point for _ in range(200)])
    for row in range(3):
        seen = np.trace(np.cov(points[:, row].T))
        # Relative deviation of a variance from 200 draws: √(2/200).
        assert seen == pytest.approx(
            np.trace(errors().by_cause["clamp_position"][row]), rel=4 * np.sqrt(2 / 200)
        )


def test_what_is_given_is_checked() -> None:
    with pytest.raises(ValueError, match=r"youngs_modulus = -0.01; allowed"):
        vb.contact_errors(found_with(), youngs_modulus=-0.01)
    with pytest.raises(ValueError, match=r"clamp_position = .*allowed is a number"):
        vb.contact_errors(found_with(), clamp_position=[[1.0, 0.0], [0.0, 1.0]])
    with pytest.raises(ValueError, match="need the noise of the wrench"):
        vb.contact_errors(vb.reconstruct(ROD, scan().reactions))
