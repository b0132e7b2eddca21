"""Voxels that a fitted object fills, and their files."""

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore
from touched import rings

import vibrissa as vb

RADIUS, STEP = 0.02, 0.0025
BALL = vb.surfaces.Sphere(center=(0, 0, 0), radius=RADIUS)


@pytest.fixture(scope="module")
def shape() -> vb.Shape:
    return vb.fit_shape(rings(BALL, np.random.default_rng(0), sweeps=9, contacts=40))


@pytest.fixture(scope="module")
def voxels(shape) -> vb.Occupancy:
    return shape.occupancy(STEP)


def test_filled_voxels_are_those_inside(voxels):
    middles = voxels.origin + STEP * np.indices(voxels.values.shape).transpose(1, 2, 3, 0)
    away = BALL.distances(middles)
    assert (voxels.values[away < -1e-3] > 0.99).all()
    # Far outside, what the surface's interval holds is unknown.
    outside = voxels.values[away > 1.2e-3]
    assert (outside[np.isfinite(outside)] < 0.025).all()
    assert np.isnan(voxels.values[np.abs(away) < 1e-3]).mean() < 0.02
    np.testing.assert_allclose(BALL.distances(voxels.points()).max(), 0, atol=0.3e-3)


def test_volume_is_that_of_the_sphere(voxels):
    assert voxels.volume == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.01)


def test_probability_is_a_half_on_the_surface_and_spreads_with_the_deviation():
    """At one deviation outside, a normal distribution leaves 16 %."""
    from vibrissa.shape.occupancy import probability_inside

    apart = np.array([0.0, 1.0, -1.0, 10.0, 1.0])
    found = probability_inside(apart, np.array([1.0, 1.0, 1.0, 1.0, 3.0]), 2.0)
    np.testing.assert_allclose(found[:4], [0.5, 0.158655, 0.841345, 0], atol=1e-6)
    assert np.isnan(found[4])


def test_what_was_not_touched_is_unknown():
    given = rings(BALL, np.random.default_rng(1), sweeps=9, contacts=30)
    voxels = vb.fit_shape(given[given.point[:, 2] < 0.0]).occupancy(0.004)
    height = voxels.origin[2] + voxels.spacing * np.arange(voxels.values.shape[2])
    unknown = np.isnan(voxels.values).mean(axis=(0, 1))
    assert unknown[height > 0.018].min() > 0.5
    assert unknown[(height > -0.02) & (height < -0.005)].max() < 0.15


def test_resolution_must_be_positive(shape):
    with pytest.raises(ValueError, match="resolution = 0"):
        shape.occupancy(0.0)
    with pytest.raises(ValueError, match="resolution = 1e-05"):
        shape.occupancy(1e-5)


def test_numpy_file(voxels, tmp_path):
    read = np.load(vb.io.write_occupancy(tmp_path / "x.npz", voxels))
    np.testing.assert_array_equal(read["values"], voxels.values)
    np.testing.assert_array_equal(read["origin"], voxels.origin)
    assert read["spacing"] == STEP


def test_ros_messages(voxels, tmp_path):
    file = vb.io.write_occupancy(tmp_path / "x.mcap", voxels, height=0.011)
    types, read = get_typestore(Stores.ROS2_HUMBLE), {}
    with file.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            read[channel.topic] = types.deserialize_cdr(message.data, schema.name)
            assert "durability: 1" in channel.metadata["offered_qos_profiles"]
    grid, cloud = read["/vibrissa/occupancy"], read["/vibrissa/voxels"]
    about, corner = grid.info, grid.info.origin.position
    cells = grid.data.reshape(about.height, about.width)
    assert cells.shape == voxels.values.shape[1::-1]
    # Middles of the filled cells are those inside the circle at this height.
    assert abs(corner.z - 0.011) <= STEP / 2
    y, x = np.nonzero(cells > 50)
    places = np.column_stack([x, y]) + 0.5
    places = places * about.resolution + [corner.x, corner.y]
    reach = np.sqrt(RADIUS**2 - corner.z**2)
    assert np.linalg.norm(places, axis=1).max() < reach + 0.3e-3
    assert len(places) * STEP**2 == pytest.approx(np.pi * reach**2, rel=0.05)
    assert set(np.unique(cells)) <= set(range(-1, 101))
    layer = np.argmin(
        np.abs(voxels.origin[2] + STEP * np.arange(voxels.values.shape[2]) - corner.z)
    )
    np.testing.assert_array_equal(cells == -1, np.isnan(voxels.values[:, :, layer].T))
    assert [field.name for field in cloud.fields] == ["x", "y", "z", "probability"]
    points = cloud.data.view("<f4").reshape(cloud.width, 4)
    np.testing.assert_allclose(points[:, :3], voxels.points(), rtol=1e-6, atol=1e-9)
    assert points[:, 3].min() >= 0.5


def test_a_layer_that_is_not_there(voxels, tmp_path):
    with pytest.raises(ValueError, match=r"height = 1.0; allowed is -0.0"):
        vb.io.write_occupancy(tmp_path / "x.mcap", voxels, height=1.0)
    with pytest.raises(vb.io.InputError, match=r"suffix '.bt'; allowed are .npz, .mcap"):
        vb.io.write_occupancy(tmp_path / "x.bt", voxels)
