"""Fewer than six reactions: exact contacts of a scan found again where they are unique, and said to
be open where they are not.
"""

from functools import cache

import numpy as np
import pytest

import vibrissa as vb

UNIT, SURFACE = vb.Rod.unit(), vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
TRAIL = vb.Trail.line(start=(1.2, 0.2, 0), stop=(-1.2, 0.2, 0), count=121)
UNSEEN = 1e3


@cache
def scan() -> vb.Scan:
    return vb.scan(UNIT, SURFACE, TRAIL)


def seen_only(reactions: vb.Reactions, channels: tuple[str, ...]) -> vb.Reactions:
    """Clamp axes are world axes here: the channels that are not named are spoilt."""
    hidden = [name not in channels for name in ("fx", "fy", "fz", "mx", "my", "mz")]
    wrench = np.concatenate([reactions.force, reactions.moment], axis=1) + UNSEEN * np.array(hidden)
    return vb.Reactions(reactions.trail, wrench[:, :3], wrench[:, 3:])


@pytest.mark.parametrize("channels", [("mx", "my", "fx", "fy"), ("fx", "fy", "fz")])
def test_contacts_are_unique_from_lateral_forces_and_moments_and_from_the_force(
    channels: tuple[str, ...],
) -> None:
    found = vb.reconstruct(UNIT, seen_only(scan().reactions, channels), channels=channels)
    np.testing.assert_array_equal(found.kind[scan().in_contact], scan().kind[scan().in_contact])
    np.testing.assert_array_equal(found.status[scan().in_contact], vb.Status.OK)
    np.testing.assert_allclose(
        found.point[scan().in_contact], scan().point[scan().in_contact], rtol=0, atol=1e-8
    )


def test_bending_moments_and_axial_force_are_enough_in_tip_contact_only() -> None:
    """In tangential contact without friction k² = ½ means F_z = −m²/2: the third channel repeats
    the others (mechanics.md, "Fewer channels").
    """
    channels = ("mx", "my", "fz")
    tip, tangential = (
        scan().kind == kind for kind in (vb.ContactKind.TIP, vb.ContactKind.TANGENTIAL)
    )
    moment, force = scan().reactions.moment[tangential], scan().reactions.force[tangential]
    np.testing.assert_allclose(force[:, 2], np.sum(moment[:, :2] ** 2, axis=1) / 2, rtol=1e-9)
    found = vb.reconstruct(UNIT, seen_only(scan().reactions, channels), channels=channels)
    np.testing.assert_allclose(found.point[tip], scan().point[tip], rtol=0, atol=1e-8)
    np.testing.assert_array_equal(found.status[tangential], vb.Status.NOT_UNIQUE)
    assert np.all(np.isnan(found.point[tangential]))


@pytest.mark.parametrize("friction", [None, 0.25])
def test_the_moment_along_the_rod_says_nothing(friction: float | None) -> None:
    found = vb.reconstruct(UNIT, scan().reactions, channels=("mx", "my", "mz"), friction=friction)
    np.testing.assert_array_equal(found.status[scan().in_contact], vb.Status.NOT_UNIQUE)
    np.testing.assert_array_equal(found.kind[~scan().in_contact], vb.ContactKind.NONE)


def test_with_friction_four_channels_are_needed() -> None:
    rough = vb.scan(UNIT, SURFACE, TRAIL, friction=0.25)
    three = vb.reconstruct(UNIT, rough.reactions, channels=("fx", "fy", "fz"), friction=0.25)
    np.testing.assert_array_equal(three.status[rough.in_contact], vb.Status.NOT_UNIQUE)
    four = vb.reconstruct(UNIT, rough.reactions, channels=("fx", "fz", "mx", "my"), friction=0.25)
    np.testing.assert_allclose(
        four.point[rough.in_contact], rough.point[rough.in_contact], rtol=0, atol=1e-8
    )


@pytest.mark.parametrize(
    "channels", [("mx", "my"), ("mx", "my", "mx"), ("mx", "my", "Fz"), "fxfyfz"]
)
def test_channels_are_checked(channels: tuple[str, ...], no_shape_checks: None) -> None:
    with pytest.raises(ValueError, match=r"channels = .*allowed are at least 3"):
        vb.reconstruct(UNIT, scan().reactions, channels=channels)


def test_a_robots_orientation_adds_to_points_and_normals_what_it_turns() -> None:
    from vibrissa.reactions import turned_covariance

    center, given = scan().trail.position - [0.1, 0.2, 0.5], scan().reactions
    turning = {"rotation_covariance": np.diag([1e-6, 4e-6, 9e-6]), "rotation_center": center}
    found, without = (
        vb.reconstruct(
            UNIT,
            vb.Reactions(
                given.trail, given.force, given.moment, covariance=1e-6 * np.eye(6), **more
            ),
            channels=("mx", "my", "fx", "fy"),
        )
        for more in (turning, {})
    )
    rows = found.in_contact
    for name, arm in (("covariance", found.point - center), ("normal_covariance", found.normal)):
        added = getattr(found, name)[rows] - getattr(without, name)[rows]
        np.testing.assert_allclose(
            added,
            turned_covariance(turning["rotation_covariance"], arm[rows]),
            rtol=1e-6,
            atol=1e-12,
        )
