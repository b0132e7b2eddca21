"""A girth followed unaided, each sweep planned from the last, with a sensor's noise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from sweeps import SENSOR, WIRE

import vibrissa as vb

BLOCK = vb.surfaces.Offset(
    vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.015, 0.012, 0.010)), 0.003
)
TURN = Rotation.from_euler("z", 25, degrees=True)


def blob(p: jnp.ndarray) -> jnp.ndarray:
    """Two balls and a bump between them, run together."""
    centers = jnp.array([[0.011, 0.0, 0.0], [-0.011, 0.003, 0.002], [0.0, -0.007, 0.009]])
    apart = jnp.sqrt(jnp.sum((p - centers) ** 2, axis=1)) - jnp.array([0.012, 0.012, 0.009])
    return -0.005 * jax.nn.logsumexp(-apart / 0.005)


ELLIPSOID = vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.024, 0.019, 0.016))


@pytest.mark.parametrize(
    ("surface", "tolerance", "most", "rate"),
    [
        (ELLIPSOID, 0.6e-3, 30, 50),
        pytest.param(ELLIPSOID, 0.1e-3, 14, 100, marks=pytest.mark.slow),
        pytest.param(BLOCK, 0.1e-3, 30, 100, marks=pytest.mark.slow),
        pytest.param(vb.surfaces.Implicit(blob), 0.1e-3, 30, 100, marks=pytest.mark.slow),
    ],
    ids=["ellipsoid, roughly", "ellipsoid", "block", "blob"],
)
def test_girth_is_closed(surface, tolerance, most, rate):
    """Off the ellipsoid's middle rods slide out of the plane: with sweeps in it alone it took 17."""
    surface = surface.placed(TURN)
    arm = vb.SimulatedArm(WIRE, surface, SENSOR, rate=rate, rng=np.random.default_rng(0))
    driven = []

    def robot(trail: vb.Trail) -> vb.Reconstruction:
        driven.append(trail)
        return arm(trail)

    start = vb.Trail.line(
        start=(0.04, -0.048, 0.002), stop=(-0.045, -0.048, 0.002), count=50, axis=(0, 1, 0)
    )
    girth = vb.follow(robot, WIRE, start, tolerance=tolerance, most=most)
    assert girth.closed
    assert girth.trails == driven
    assert np.allclose(girth.point[:, 2], 0.002, atol=1e-6)
    assert np.array_equal(girth.point[0], girth.point[-1])
    away = np.abs(surface.distances(girth.point))
    assert np.quantile(away, 0.95) < tolerance
    assert np.mean(away < 1.96 * girth.deviation) > 0.9
    assert girth.deviation.max() <= tolerance
    assert np.quantile(girth.deviation, 0.95) <= tolerance / 1.96
    for trail in driven:
        assert np.all(surface.distances(trail.position) > 0)
        assert np.allclose(trail.axis[:, 2], 0, atol=1e-9)
    # All the way round: the angle about the middle turns once.
    angle = np.unwrap(np.arctan2(girth.point[:, 1], girth.point[:, 0]))
    assert abs(angle[-1] - angle[0]) == pytest.approx(2 * np.pi, abs=1e-6)


def test_a_girth_that_cannot_be_reached_is_said_to_be_open():
    arm = vb.SimulatedArm(WIRE, BLOCK, SENSOR, rate=50, rng=np.random.default_rng(1))
    start = vb.Trail.line(
        start=(0.04, -0.048, 0.0), stop=(-0.045, -0.048, 0.0), count=50, axis=(0, 1, 0)
    )
    girth = vb.follow(arm, WIRE, start, most=2)
    assert not girth.closed
    assert not girth.complete
    assert len(girth.trails) == 2
    assert girth.deviation.max() > 2e-3 * WIRE.length
    assert "not complete after 2 sweeps" in repr(girth)


def test_a_contour_is_followed_from_end_to_end():
    """Along one side of the block and round a corner, not round the back."""
    surface = BLOCK.placed(TURN)
    arm = vb.SimulatedArm(WIRE, surface, SENSOR, rate=50, rng=np.random.default_rng(2))
    start = vb.Trail.line(
        start=(0.04, -0.048, 0.002), stop=(-0.045, -0.048, 0.002), count=50, axis=(0, 1, 0)
    )
    ends = TURN.apply([[-0.010, -0.015, 0.002], [0.018, 0.004, 0.002]])
    contour = vb.follow(arm, WIRE, start, ends=ends, tolerance=0.5e-3)
    assert contour.complete
    assert not contour.closed
    away = np.abs(surface.distances(contour.point))
    assert np.quantile(away, 0.95) < 0.3e-3
    assert contour.deviation.max() <= 0.5e-3
    for end, place in zip(ends, contour.point[[0, -1]], strict=True):
        assert np.linalg.norm(end - place) < 0.5e-3
    # The way along the front: 25 mm of a face, the rounded edge, and 16 mm of another face.
    length = np.linalg.norm(np.diff(contour.point, axis=0), axis=1).sum()
    exact = 0.025 + 0.003 * np.pi / 2 + 0.016
    assert length == pytest.approx(exact, abs=0.5e-3)
    with pytest.raises(ValueError, match=r"ends has shape \(1, 3\); allowed is \(2, 3\)"):
        vb.follow(arm, WIRE, start, ends=ends[:1])


def test_a_first_trail_along_its_rod_determines_no_plane():
    start = vb.Trail.line(start=(0, 0, 0), stop=(0, 0, 0.1), count=5)
    with pytest.raises(ValueError, match=r"start moves along its rod.*; allowed is"):
        vb.follow(lambda _: None, WIRE, start)
