"""Sizes and poses of primitives from contacts, with their intervals."""

import numpy as np
import pytest
from scipy.stats import binom
from test_locate import touched
from touched import NORMAL, POINT, rings

import vibrissa as vb

SURFACES = vb.surfaces
SIZES = {
    SURFACES.Sphere: {"radius": 0.03},
    SURFACES.Cylinder: {"radius": 0.015, "length": 0.05},
    SURFACES.Cone: {"half_angle": np.arctan(0.4), "height": 0.05},
    SURFACES.Torus: {"major_radius": 0.02, "minor_radius": 0.006},
    SURFACES.Ellipsoid: {"semi_axis_1": 0.026, "semi_axis_2": 0.021, "semi_axis_3": 0.017},
    SURFACES.Box: {"half_extent_1": 0.02, "half_extent_2": 0.015, "half_extent_3": 0.01},
}
AXIS = (0, 0, 0), (0, 0, 1)
SOLIDS = {
    SURFACES.Sphere: SURFACES.Sphere((0, 0, 0), 0.03),
    SURFACES.Cylinder: SURFACES.Cylinder(*AXIS, 0.015, 0.05),
    SURFACES.Cone: SURFACES.Cone(*AXIS, 0.02, 0.05),
    SURFACES.Torus: SURFACES.Torus(*AXIS, 0.02, 0.006),
    SURFACES.Ellipsoid: SURFACES.Ellipsoid((0, 0, 0), (0.026, 0.021, 0.017)),
    SURFACES.Box: SURFACES.Box((0, 0, 0), (0.02, 0.015, 0.01)),
}


HALF = {
    SURFACES.Sphere: (0.03, 0.03, 0.03),
    SURFACES.Cylinder: (0.015, 0.015, 0.025),
    SURFACES.Cone: (0.02, 0.02, 0.025),
    SURFACES.Torus: (0.026, 0.026, 0.006),
    SURFACES.Ellipsoid: (0.026, 0.021, 0.017),
    SURFACES.Box: (0.02, 0.015, 0.01),
}


def cloud(kind: type[SURFACES.Surface], rng: np.random.Generator, count: int) -> np.ndarray:
    """Points in front of all faces of the box about a solid, some on each."""
    points = rng.uniform(-0.6, 0.6, (count, 3))
    rows = np.arange(count)
    points[rows, rows % 3] = np.where(rows % 2, 1.2, -1.2)
    return points * HALF[kind] + [0, 0, 0.025 * (kind is SURFACES.Cone)]


@pytest.mark.parametrize("kind", SIZES, ids=lambda kind: kind.__name__)
def test_intervals_hold_the_true_sizes(kind: type[SURFACES.Surface]) -> None:
    rng, inside, repeats = np.random.default_rng(1), [], 4
    for _ in range(repeats):
        contacts, _, _ = touched(SOLIDS[kind], cloud(kind, rng, 30), rng)
        found = vb.fit_primitive(kind, contacts)
        assert not found.warnings
        for name, size in SIZES[kind].items():
            value, deviation, low, high = found.parameters[name]
            assert value == pytest.approx(size, abs=5 * deviation)
            assert deviation < 0.02 * size
            inside.append(low < size < high)
        np.testing.assert_allclose(found.surface.distances(contacts.point), 0, atol=3e-4)
    assert sum(inside) > binom.ppf(1e-3, len(inside), 0.95) - 1


def test_the_side_of_a_cylinder_does_not_tell_its_length() -> None:
    rng = np.random.default_rng(2)
    angle = rng.uniform(0, 2 * np.pi, 16)
    side = np.column_stack(
        [0.016 * np.cos(angle), 0.016 * np.sin(angle), rng.uniform(-0.02, 0.02, 16)]
    )
    contacts, turn, _ = touched(SOLIDS[SURFACES.Cylinder], side, rng)
    found = vb.fit_primitive(SURFACES.Cylinder, contacts)
    assert "length" in found.undetermined
    assert np.isinf(found.parameters["length"].high)
    radius = found.parameters["radius"]
    assert radius.low < 0.015 < radius.high or abs(radius.value - 0.015) < 4 * radius.deviation
    axis = np.array([found.parameters[f"axis_{letter}"].value for letter in "xyz"])
    assert abs(axis @ turn.apply([0, 0, 1])) > np.cos(0.01)


def test_outliers_are_named_and_do_not_move_the_ball() -> None:
    rng = np.random.default_rng(3)
    contacts, _, shift = touched(SOLIDS[SURFACES.Sphere], cloud(SURFACES.Sphere, rng, 30), rng)
    contacts.point[:3] += 0.004
    found = vb.fit_primitive(SURFACES.Sphere, contacts)
    assert found.outlier[:3].all()
    assert found.outlier[3:].sum() <= 1
    radius = found.parameters["radius"]
    assert abs(radius.value - 0.03) < 4 * radius.deviation
    for letter, true in zip("xyz", shift, strict=True):
        value, deviation, *_ = found.parameters[f"center_{letter}"]
        assert abs(value - true) < 4 * deviation


def test_many_contacts_of_few_sweeps_know_a_radius_less_well() -> None:
    rng, squares = np.random.default_rng(4), []
    ball, plain = SURFACES.Sphere((0, 0, 0), 0.02), []
    for _ in range(4):
        contacts = rings(ball, rng, sweeps=4, contacts=24)
        value, deviation, *_ = vb.fit_primitive(SURFACES.Sphere, contacts).parameters["radius"]
        squares.append(((value - 0.02) / deviation) ** 2)
        plain.append(deviation)
    # As independent ones, 96 contacts of 0.04 mm would leave 0.0041 mm.
    assert min(plain) > 1.5 * 4e-5 / 96**0.5
    assert np.mean(squares) < 3


def test_a_plane() -> None:
    rng = np.random.default_rng(5)
    plane = SURFACES.Plane((0, 0, 0), (0, 0, 1))
    contacts, turn, shift = touched(plane, 0.02 * rng.normal(size=(12, 3)), rng)
    found = vb.fit_primitive(SURFACES.Plane, contacts)
    normal = turn.apply([0, 0, 1])
    value, deviation, *_ = found.parameters["offset"]
    assert abs(value - normal @ shift) < 4 * deviation
    np.testing.assert_allclose(found.surface.outward, normal, atol=0.006)
    assert not found.undetermined


def test_the_wrong_kind_is_told() -> None:
    rng = np.random.default_rng(6)
    contacts, _, _ = touched(SOLIDS[SURFACES.Box], cloud(SURFACES.Box, rng, 30), rng)
    assert vb.fit_primitive(SURFACES.Sphere, contacts).warnings


def test_what_cannot_be_fitted() -> None:
    rng = np.random.default_rng(7)
    contacts, _, _ = touched(SOLIDS[SURFACES.Box], cloud(SURFACES.Box, rng, 3), rng)
    with pytest.raises(ValueError, match="at least 4"):
        vb.fit_primitive(SURFACES.Box, contacts)
    with pytest.raises(ValueError, match="one of the classes Plane, Sphere"):
        vb.fit_primitive(SURFACES.Mesh, contacts)


def felt(point: np.ndarray, normal: np.ndarray, rng: np.random.Generator) -> vb.Contacts:
    """Contacts with errors."""
    turned = normal + NORMAL * rng.normal(size=normal.shape)
    return vb.Contacts(
        point + POINT * rng.normal(size=point.shape),
        turned / np.linalg.norm(turned, axis=1)[:, None],
        np.tile(POINT**2 * np.eye(3), (len(point), 1, 1)),
        np.tile(NORMAL**2 * np.eye(3), (len(point), 1, 1)),
    )


def test_an_end_at_an_outermost_contact_is_not_believed() -> None:
    """The error of one normal would put an end of the cylinder there, known to a tenth of a
    millimetre.
    """
    for seed in range(4):
        rng = np.random.default_rng(seed)
        angle, height = rng.uniform(-1.2, 1.2, 8), rng.uniform(-0.02, 0.02, 8)
        normal = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
        point = 0.01 * normal + np.outer(height, [0, 0, 1])
        found = vb.fit_primitive(SURFACES.Cylinder, felt(point, normal, rng))
        assert "length" in found.undetermined
        radius = found.parameters["radius"]
        assert radius.value == pytest.approx(0.01, abs=4 * radius.deviation)


def test_a_single_face_of_a_box() -> None:
    rng = np.random.default_rng(1)
    point = np.column_stack([rng.uniform(-0.01, 0.01, (20, 2)), np.full(20, 0.005)])
    normal = np.tile([0.0, 0.0, 1.0], (20, 1))
    found = vb.fit_primitive(SURFACES.Box, felt(point, normal, rng))
    assert {f"half_extent_{i}" for i in (1, 2, 3)} <= set(found.undetermined)
    np.testing.assert_allclose(found.surface.distances(point), 0, atol=3 * POINT)


def test_a_ball_through_contacts_with_one_normal() -> None:
    point = np.column_stack([np.linspace(0, 0.1, 30), np.zeros((30, 2))])
    with pytest.raises(ValueError, match="contacts: their normals are all the same"):
        vb.fit_primitive(SURFACES.Sphere, vb.Contacts(point, np.tile([0.0, 0, 1], (30, 1))))


def test_contacts_of_a_ball_are_no_torus() -> None:
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(25, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    with pytest.raises(ValueError, match=r"contacts: no Torus fits them; .*minor_radius"):
        vb.fit_primitive(SURFACES.Torus, felt(0.02 * normal, normal, rng))
