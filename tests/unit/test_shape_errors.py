"""Fitted surfaces against the truth and against a CAD model, on spheres whose errors are known."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from touched import rings

import vibrissa as vb

RADIUS = 0.02
COARSE = 0.003
"""Cells of meshes: vertices lie on the surface whatever their size."""


def ball(
    radius: float = RADIUS, center: tuple[float, float, float] = (0, 0, 0)
) -> vb.surfaces.Sphere:
    return vb.surfaces.Sphere(center=center, radius=radius)


def fitted(seed: int) -> vb.Shape:
    return vb.fit_shape(rings(ball(), np.random.default_rng(seed), sweeps=9, contacts=40))


@pytest.fixture(scope="module")
def shape() -> vb.Shape:
    return fitted(0)


@pytest.fixture(scope="module")
def bowl() -> vb.Shape:
    """Touched on its lower half only."""
    given = rings(ball(), np.random.default_rng(1), sweeps=9, contacts=30)
    return vb.fit_shape(given[given.point[:, 2] < 0.002])


def test_errors_against_the_truth(shape):
    errors = vb.shape_errors(shape, ball(), resolution=COARSE)
    assert errors.touched.mean < 0.03e-3
    assert errors.touched.normal_median < 0.4
    assert errors.whole.inside > 0.9
    assert errors.spurious == 0
    assert errors.touched.deviation < errors.rest.deviation
    # Of how many points each part consists.
    parts = (
        errors.share_touched * errors.touched.mean + (1 - errors.share_touched) * errors.rest.mean
    )
    assert errors.whole.mean == pytest.approx(parts)


def test_a_larger_sphere_is_off_by_the_difference(shape):
    errors = vb.shape_errors(shape, ball(RADIUS + 0.4e-3), resolution=COARSE, tolerance=0.3e-3)
    for each in (errors.touched, errors.rest, errors.whole):
        assert each.mean == pytest.approx(0.4e-3, abs=0.02e-3)
        assert each.chamfer == pytest.approx(0.4e-3, abs=0.02e-3)
    assert errors.touched.inside < 0.01
    assert errors.spurious > 0.95


def test_a_shifted_sphere(shape):
    """By δ ≪ r, distances are δ |cos θ| to first order: on average half, at 95 % of the area 0.95
    of it.
    """
    shift = 1e-3
    errors = vb.shape_errors(shape, ball(center=(0, 0, shift)), resolution=COARSE).whole
    assert errors.chamfer == pytest.approx(shift / 2, rel=0.04)
    assert errors.percentile_95 == pytest.approx(0.95 * shift, rel=0.04)
    assert errors.hausdorff == pytest.approx(shift, rel=0.06)
    # The normal at a place turns by δ sin θ / r.
    assert np.radians(errors.normal_median) == pytest.approx(
        np.sqrt(0.75) * shift / RADIUS, rel=0.06
    )


def test_hausdorff_distance_of_what_the_shape_lacks(shape):
    """A knob of the truth sticks out where nobody touched it."""
    knob = vb.surfaces.Union((ball(), ball(0.004, (0, 0, 0.026))))
    errors = vb.shape_errors(shape, knob, resolution=COARSE, samples=8000)
    assert errors.whole.hausdorff == pytest.approx(0.010, rel=0.02)
    assert errors.touched.hausdorff < 0.003
    assert errors.spurious < 0.03


def test_the_rest_is_what_no_contact_is_near(bowl):
    errors = vb.shape_errors(bowl, ball(), near=4e-3, resolution=COARSE)
    # Up to 4 mm above the ring of contacts at z = 2 mm, or less by what no ring reaches there.
    assert 0.5 < errors.share_touched < (0.020 + 0.006) / 0.040
    assert errors.rest.mean > 3 * errors.touched.mean
    assert errors.rest.deviation > 5 * errors.touched.deviation
    everywhere = vb.shape_errors(bowl, ball(), near=0.1, resolution=COARSE)
    assert everywhere.share_touched == 1
    assert everywhere.touched == everywhere.whole
    assert np.isnan(everywhere.rest).all()
    above = vb.shape_errors(
        bowl, ball(), contacts=np.array([[0, 0, RADIUS]]), near=4e-3, resolution=COARSE
    )
    # A cap of chord c has the area π c².
    assert above.share_touched == pytest.approx(0.004**2 / (4 * RADIUS**2), rel=0.25)


def test_errors_against_a_mesh(shape):
    import trimesh

    solid = trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)
    mesh = vb.surfaces.Mesh(solid.vertices, solid.faces)
    one, other = (
        vb.shape_errors(shape, truth, resolution=COARSE).whole for truth in (ball(), mesh)
    )
    assert other.chamfer == pytest.approx(one.chamfer, rel=0.1)


def test_errors_are_a_table(shape):
    lines = repr(vb.shape_errors(shape, ball(), resolution=COARSE)).splitlines()
    assert len(lines) == 2 + 8
    assert "% of the truth touched" in lines[0]
    assert lines[1].split() == ["touched", "rest", "whole"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"near": 0.0}, "near = 0.0"),
        ({"tolerance": -1.0}, "tolerance = -1.0"),
        ({"samples": 0}, "samples = 0"),
        ({"contacts": np.full((2, 3), np.nan)}, "contacts: no row is finite"),
    ],
)
def test_wrong_arguments(shape, options, said):
    with pytest.raises(ValueError, match=said):
        vb.shape_errors(shape, ball(), **options)


@pytest.mark.parametrize(
    "truth", [ball(center=(5, 0, 0)), ball(1000 * RADIUS)], ids=["elsewhere", "in millimetres"]
)
def test_a_truth_that_is_not_there(shape, truth):
    with pytest.raises(ValueError, match=r"truth: nothing of it is near.*same unit"):
        vb.shape_errors(shape, truth, resolution=COARSE)


def test_the_model_itself_does_not_differ():
    for seed in range(5):
        found = vb.compare(fitted(seed), ball(), resolution=COARSE)
        assert not found.significant.any()


def test_distance_from_a_smaller_model_is_positive_and_significant(shape):
    found = vb.compare(shape, ball(RADIUS - 0.5e-3), resolution=COARSE)
    assert found.distance.mean() == pytest.approx(0.5e-3, abs=0.02e-3)
    assert found.share > 0.9
    assert vb.compare(shape, ball(RADIUS + 0.5e-3), resolution=COARSE).distance.max() < 0
    tolerated = vb.compare(shape, ball(RADIUS - 0.5e-3), tolerance=0.6e-3, resolution=COARSE)
    assert tolerated.share == 0
    np.testing.assert_array_equal(tolerated.distance, found.distance)


def test_only_what_differs_is_found():
    """A ball flattened by 0.3 mm along z, against the round one."""
    flat = vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(RADIUS, RADIUS, RADIUS - 0.3e-3))
    part = vb.fit_shape(rings(flat, np.random.default_rng(2), sweeps=12))
    found = vb.compare(part, ball(), resolution=COARSE)
    height = np.abs(found.mesh.vertices[:, 2])
    assert found.significant[height > 0.017].mean() > 0.95
    # It lacks 0.3 mm cos² θ: a fortieth of a millimetre where z = 6 mm.
    assert height[found.significant].min() > 0.006
    assert (found.distance[found.significant] < 0).all()


def placed_at(middle: np.ndarray, covariance: np.ndarray, free: np.ndarray) -> vb.Location:
    pose = vb.Pose(Rotation.identity(), np.zeros(3), covariance, free, 0.0)
    return vb.Location(ball(), [pose], middle, 10, np.zeros(20, dtype=bool), 0.0, [])


def test_an_uncertain_pose_counts(shape):
    plain, middle = vb.compare(shape, ball(), resolution=COARSE), np.array([0.0, 0.0, 0.01])
    spread = np.diag([0, 0, 0, 0, 0, 0.1e-3]) ** 2
    moved = vb.compare(shape, placed_at(middle, spread, np.zeros((0, 6))), resolution=COARSE)
    up = plain.mesh.vertices[:, 2] / np.linalg.norm(plain.mesh.vertices, axis=1)
    np.testing.assert_allclose(
        moved.deviation**2 - plain.deviation**2, (0.1e-3 * up) ** 2, atol=1e-14
    )
    # Turned about the x axis through (0, 0, 10 mm), the middle of the ball moves along y.
    spread = np.diag([0.01, 0, 0, 0, 0, 0]) ** 2
    turned = vb.compare(shape, placed_at(middle, spread, np.zeros((0, 6))), resolution=COARSE)
    aside = plain.mesh.vertices[:, 1] / np.linalg.norm(plain.mesh.vertices, axis=1)
    np.testing.assert_allclose(
        turned.deviation**2 - plain.deviation**2, (0.01 * 0.01 * aside) ** 2, atol=1e-14
    )
    # A ball may turn about its own middle: that changes nothing, a free shift leaves all open.
    free = np.eye(6)[:3]
    same = vb.compare(shape, placed_at(np.zeros(3), np.zeros((6, 6)), free), resolution=COARSE)
    np.testing.assert_allclose(same.deviation, plain.deviation)
    free = np.array([[0, 0, 0, 0, 0, shape.extent]])
    adrift = vb.compare(shape, placed_at(middle, np.zeros((6, 6)), free), resolution=COARSE)
    assert (adrift.deviation[np.abs(up) > 0.5] > 0.4 * shape.extent).all()


def test_a_located_model():
    model = vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.026, 0.021, 0.017))
    turn = Rotation.from_rotvec([0.3, -0.2, 0.5])
    given = rings(model.placed(turn), np.random.default_rng(3), sweeps=9)
    found = vb.compare(vb.fit_shape(given), vb.locate(model, given[::12]), resolution=COARSE)
    assert not found.significant.any()
    assert (found.deviation > found.mesh.deviation).all()


def test_colours_say_what_is_significant(shape):
    found = vb.compare(shape, ball(RADIUS - 0.3e-3), resolution=COARSE)
    red, _, blue = found.colours().astype(int).T
    assert (red[found.significant] > blue[found.significant]).all()
    assert (red[~found.significant] == blue[~found.significant]).all()
    with pytest.raises(ValueError, match="limit = 0"):
        found.colours(0.0)


@pytest.mark.parametrize(
    ("options", "said"), [({"tolerance": -1.0}, "tolerance = -1.0"), ({"rate": 1.0}, "rate = 1.0")]
)
def test_wrong_arguments_of_a_comparison(shape, options, said):
    with pytest.raises(ValueError, match=said):
        vb.compare(shape, ball(), **options)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_a_model_in_another_unit_is_none(shape, scale):
    with pytest.raises(ValueError, match=r"model: its surface is at least .* unit of length"):
        vb.compare(shape, ball(scale * RADIUS), resolution=COARSE)


def test_a_model_that_was_not_placed_is_none(shape):
    aside = ball().placed(translation=(2.5 * RADIUS, 0, 0))
    with pytest.raises(ValueError, match=r"contacts' frame .* `vibrissa\.locate`"):
        vb.compare(shape, aside, resolution=COARSE)
