"""Poses of known objects from a few contacts, from a cold start: where they are determined, how well,
and what symmetry leaves open.
"""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from touched import NORMAL, POINT, on_surface

import vibrissa as vb
from vibrissa.shape import valleys
from vibrissa.shape.poses import Poses, equations
from vibrissa.shape.sites import gathered
from vibrissa.shape.starts import samples, turned

ELLIPSOID = vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.026, 0.021, 0.017))
CAN = vb.surfaces.Cylinder(center=(0, 0, 0), axis=(0, 0, 1), radius=0.015, length=0.05)
MUG = Path(__file__).parents[2] / "examples/meshes/mug.ply"


def touched(
    surface: vb.surfaces.Surface, points: np.ndarray, rng: np.random.Generator
) -> tuple[vb.Contacts, Rotation, np.ndarray]:
    """Contacts on an object in a random pose, with errors, and that pose."""
    points = on_surface(surface, points)
    turn, shift, count = Rotation.random(rng=rng), rng.normal(0, 0.05, 3), len(points)
    normal = turn.apply(surface.normal(points)) + NORMAL * rng.normal(size=(count, 3))
    contacts = vb.Contacts(
        turn.apply(points) + shift + POINT * rng.normal(size=(count, 3)),
        normal / np.linalg.norm(normal, axis=1)[:, None],
        np.tile(POINT**2 * np.eye(3), (count, 1, 1)),
        np.tile(NORMAL**2 * np.eye(3), (count, 1, 1)),
    )
    return contacts, turn, shift


def around(rng: np.random.Generator, count: int) -> np.ndarray:
    return 0.02 * rng.normal(size=(count, 3)) / 3**0.5


def motion(found: vb.Location, pose: vb.Pose, turn: Rotation, shift: np.ndarray) -> np.ndarray:
    """From a pose found to the true one, about the middle of the contacts."""
    between = turn * pose.rotation.inv()
    moved = between.apply(found.middle - pose.translation) + shift - found.middle
    return np.concatenate([between.as_rotvec(), moved])


def nearest(found: vb.Location, turn: Rotation, shift: np.ndarray) -> tuple[vb.Pose, np.ndarray]:
    away = [motion(found, pose, turn, shift) for pose in found.poses]
    best = int(np.argmin([np.linalg.norm(each[:3]) for each in away]))
    return found.poses[best], away[best]


def test_the_four_poses_of_an_ellipsoid_and_their_errors():
    rng, squares = np.random.default_rng(0), []
    for _ in range(6):
        contacts, turn, shift = touched(ELLIPSOID, around(rng, 12), rng)
        found = vb.locate(ELLIPSOID, contacts)
        assert len(found.poses) == 4
        assert np.ptp([pose.misfit for pose in found.poses]) < 1e-3
        pose, away = nearest(found, turn, shift)
        assert not len(pose.free)
        squares.append(away @ np.linalg.solve(pose.covariance, away))
        assert not found.warnings
    assert chi2.cdf(np.sum(squares), 36) < 0.999
    assert max(squares) < chi2.ppf(0.9999, 6)


def test_a_mug_has_one_pose():
    mug = vb.surfaces.Mesh.load(MUG, scale=1e-3)
    rng = np.random.default_rng(1)
    handle = np.column_stack(
        [np.full(4, 0.034), rng.uniform(-0.004, 0.004, 4), np.linspace(0.014, 0.03, 4)]
    )
    angle = np.linspace(0.7, 5.6, 8)
    wall = np.column_stack(
        [0.023 * np.cos(angle), 0.023 * np.sin(angle), np.linspace(0.004, 0.04, 8)]
    )
    wall[:2, 2], wall[:2, :2] = -0.001, 0.3 * wall[:2, :2]
    contacts, turn, shift = touched(mug, np.concatenate([handle, wall]), rng)
    found = vb.locate(mug, contacts)
    assert len(found.poses) == 1
    pose, away = found.poses[0], motion(found, found.poses[0], turn, shift)
    assert not len(pose.free)
    assert np.degrees(np.linalg.norm(away[:3])) < 0.5
    assert np.linalg.norm(away[3:]) < 0.1e-3
    assert away @ np.linalg.solve(pose.covariance, away) < chi2.ppf(0.9999, 6)
    np.testing.assert_allclose(found.placed.distances(contacts.point), 0, atol=5 * POINT)


@pytest.mark.parametrize(("wrong", "off"), [(2, 5e-3), (9, 5e-3), (9, 0.2)])
def test_one_wrong_contact_is_left_out(wrong, off):
    rng = np.random.default_rng(7)
    contacts, turn, shift = touched(ELLIPSOID, around(rng, 14), rng)
    contacts.point[wrong] += off * Rotation.random(rng=rng).apply([1, 0, 0])
    found = vb.locate(ELLIPSOID, contacts)
    assert found.outlier.tolist() == [row == wrong for row in range(14)]
    assert found.freedom == 3 * 13 - 6
    assert not found.warnings
    pose, away = nearest(found, turn, shift)
    assert away @ np.linalg.solve(pose.covariance, away) < chi2.ppf(0.9999, 6)


def test_many_wrong_contacts_are_told():
    rng = np.random.default_rng(8)
    contacts, turn, shift = touched(ELLIPSOID, around(rng, 14), rng)
    contacts.point[:3] += rng.normal(0, 5e-3, (3, 3))
    found = vb.locate(ELLIPSOID, contacts)
    assert found.outlier.sum() == 3
    assert "3 of 14 contacts contradict" in found.warnings[0]
    pose, away = nearest(found, turn, shift)
    assert away @ np.linalg.solve(pose.covariance, away) < chi2.ppf(0.9999, 6)


def test_half_turns_about_principal_axes_leave_an_ellipsoid_where_it_is():
    rng = np.random.default_rng(10)
    moved = ELLIPSOID.placed(Rotation.identity(), np.array([0.01, 0.0, 0.02]))
    contacts, turn, shift = touched(ELLIPSOID, around(rng, 12), rng)
    given, pose = gathered(contacts), Poses(turn.as_matrix()[None], shift[None])
    # The same place of an object whose own axes begin elsewhere.
    here = pose._replace(shift=pose.shift - pose.turn[0] @ [0.01, 0.0, 0.02])
    others = turned(here, samples(moved, given.extent, np.random.default_rng(0)))
    assert len(others.turn) == 9
    off = np.abs(moved.distances(others.own(given.point))).max(axis=1)
    half = np.trace(here.turn[0].T @ others.turn, axis1=1, axis2=2) < -0.99
    assert half.sum() == 3
    # The principal axes of some hundred points are some hundredths of a radian off.
    assert off[half].max() < 1e-3
    assert off[~half].min() > 2e-3


def test_a_ball_may_turn_freely():
    ball = vb.surfaces.Sphere(center=(0.01, 0, 0), radius=0.02)
    rng = np.random.default_rng(2)
    contacts, turn, shift = touched(ball, around(rng, 12) + [0.01, 0, 0], rng)
    found = vb.locate(ball, contacts)
    assert len(found.poses) == 1
    assert len(found.poses[0].free) == 3
    center = found.rotation.apply([0.01, 0, 0]) + found.translation
    np.testing.assert_allclose(center, turn.apply([0.01, 0, 0]) + shift, atol=3 * POINT)


def test_a_rod_may_turn_about_its_axis_and_end_for_end():
    rod = vb.surfaces.Capsule(center=(0, 0, 0), axis=(0, 0, 1), radius=0.01, length=0.04)
    rng = np.random.default_rng(3)
    points = np.concatenate([around(rng, 8), [[0.003, 0.001, 0.03], [0.002, -0.004, -0.03]]])
    contacts, turn, shift = touched(rod, points, rng)
    found = vb.locate(rod, contacts)
    assert len(found.poses) == 2
    assert [len(pose.free) for pose in found.poses] == [1, 1]
    axis, true = found.rotation.apply([0, 0, 1]), turn.apply([0, 0, 1])
    assert abs(axis @ true) > np.cos(0.01)
    np.testing.assert_allclose(found.translation, shift, atol=4 * POINT)
    # The free motion is a turn about the axis.
    np.testing.assert_allclose(np.abs(found.poses[0].free[0, :3] @ axis), 1, atol=0.02)


def test_contacts_at_a_rim_say_nothing_about_a_turn_along_it():
    # So far out that differences of normals are exact.
    angle, point = np.linspace(0, 5, 9), 10 * POINT
    across = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(9)])
    normal = (across + [0, 0, 1]) / 2**0.5
    contacts = vb.Contacts(
        CAN.radius * across + [0, 0, 0.5 * CAN.length] + point * normal,
        normal,
        np.tile(point**2 * np.eye(3), (9, 1, 1)),
        np.tile(NORMAL**2 * np.eye(3), (9, 1, 1)),
    )
    given = gathered(contacts)
    found = equations(CAN, given, Poses(np.eye(3)[None], np.zeros((1, 3))))
    axis = np.array([0.0, 0.0, 1.0])
    turn = [*axis, *np.cross(axis, given.point.mean(axis=0)) / given.extent]
    # One radian, in errors of the normal.
    np.testing.assert_allclose(found.slope[0] @ turn, 0, atol=0.01 / NORMAL)


@pytest.mark.slow
def test_how_far_a_can_may_slide_if_neither_end_was_touched():
    rng, top = np.random.default_rng(8), 0.5 * CAN.length - 1e-4
    for _ in range(16):
        angle, height = rng.uniform(0, 2 * np.pi, 14), rng.uniform(3e-3 - top, top, 14)
        height[0] = top
        side = np.column_stack([np.cos(angle), np.sin(angle), height])
        contacts, turn, shift = touched(CAN, side * [CAN.radius, CAN.radius, 1], rng)
        found, axis = vb.locate(CAN, contacts), turn.apply([0, 0, 1])
        covered = []
        for pose in found.poses:
            slide = axis @ (pose.translation - shift)
            known = np.sqrt(max(axis @ pose.covariance[3:, 3:] @ axis, 0.0))
            free = np.linalg.norm(pose.free[:, 3:] @ axis) > top
            covered.append(free or abs(slide) < 3 * known)
        assert any(covered)


def test_walks_end_where_places_are_drawn_back(monkeypatch):
    rng = np.random.default_rng(9)
    contacts, turn, shift = touched(ELLIPSOID, around(rng, 12), rng)
    given, pose = gathered(contacts), Poses(turn.as_matrix()[None], shift[None])

    def halfway(surface, given, start, **_):
        begin = pose.times(len(start.turn))
        motion = 0.5 * start.screws(begin, given.middle)
        return begin.screwed(motion, given.middle), SimpleNamespace(misfit=np.zeros(len(motion)))

    monkeypatch.setattr(valleys, "fitted", halfway)
    found = valleys._walked(ELLIPSOID, given, pose, 0.0, 1e-3 * np.eye(6), 1.0)
    # Each step is 1.6 times as long as the one before, up to 2.8.
    assert np.bincount(found.begun).tolist() == [17] * 6


def test_another_object_is_told():
    rng = np.random.default_rng(4)
    contacts, _, _ = touched(ELLIPSOID, around(rng, 20), rng)
    other = vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.026, 0.021, 0.020))
    found = vb.locate(other, contacts)
    assert any("another object" in line for line in found.warnings)


def test_too_few_contacts():
    rng = np.random.default_rng(5)
    contacts, _, _ = touched(ELLIPSOID, around(rng, 2), rng)
    with pytest.raises(ValueError, match="at least 3"):
        vb.locate(ELLIPSOID, contacts)


def test_errors_that_are_assumed_are_said():
    rng = np.random.default_rng(5)
    contacts, _, _ = touched(ELLIPSOID, around(rng, 12), rng)
    plain = vb.Contacts(contacts.point, contacts.normal, contacts.covariance)
    for given, count in ((contacts, 0), (plain, 1)):
        said = [
            vb.locate(ELLIPSOID, given).warnings,
            vb.identify([ELLIPSOID], given).warnings,
            vb.fit_primitive(vb.surfaces.Ellipsoid, given).warnings,
        ]
        assert [
            sum("normal_covariance is not given" in line for line in each) for each in said
        ] == [count] * 3


def test_something_else_than_a_surface(no_shape_checks):
    rng = np.random.default_rng(5)
    contacts, _, _ = touched(ELLIPSOID, around(rng, 8), rng)
    with pytest.raises(ValueError, match="surface is a ndarray; allowed is a surface"):
        vb.locate(np.eye(3), contacts)


def test_an_object_too_thin_to_be_found_is_said_to_be_so():
    rng = np.random.default_rng(5)
    contacts, _, _ = touched(ELLIPSOID, around(rng, 8), rng)
    wire = vb.surfaces.Torus((0, 0, 0), (0, 0, 1), 0.05, 0.5e-3)
    with pytest.raises(ValueError, match="near its origin, or it is too thin"):
        vb.locate(wire, contacts)


def test_an_object_far_from_its_origin():
    rng = np.random.default_rng(6)
    contacts, _, _ = touched(ELLIPSOID, around(rng, 8), rng)
    with pytest.raises(ValueError, match="nothing of it is near its origin"):
        vb.locate(vb.surfaces.Sphere(center=(1e6, 0, 0), radius=0.02), contacts)
