"""How far surfaces depart from their osculating paraboloids, and what that makes of deviations."""

import numpy as np
import pytest
from test_fit_shape import samples
from touched import rings

import vibrissa as vb
from vibrissa.shape.departures import NONE, Departures

BLOCK = vb.surfaces.Offset(
    vb.surfaces.Box(center=(0, 0, 0), half_extents=(0.019, 0.014, 0.011)), 0.003
)
RADIUS = 0.02


def directions(count: int) -> np.ndarray:
    found = np.random.default_rng(3).normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1)[:, None]


@pytest.mark.parametrize("steep", [1.0, 2.5])
@pytest.mark.parametrize("above", [0.0, 1e-5])
def test_a_ball_departs_by_what_a_parabola_leaves_of_a_circle(steep, above):
    """Whatever the level's slope, and from points a little off its surface."""
    normal = directions(800)
    point = (RADIUS + above) * normal
    jets = steep * np.column_stack([np.full(800, above), normal])
    curvature = steep / (RADIUS + above) * (np.eye(3) - normal[:, :, None] * normal[:, None])
    found = Departures.of(point, jets, curvature, 2 * RADIUS)
    # Chords s of a circle rise by s²/2R: what its parabola is off by at s.
    rise = found.far**2 / (2 * RADIUS)
    expected = rise - (found.far**2 - rise**2) / (2 * RADIUS)
    near = found.far < RADIUS / 2
    np.testing.assert_allclose(found.size[near], expected[near], rtol=0.3)
    assert (np.diff(found.size) >= 0).all()


def test_planes_do_not_depart():
    point = np.column_stack([np.random.default_rng(1).uniform(0, 1, (300, 2)), np.zeros(300)])
    jets = np.tile([0.0, 0, 0, 1], (300, 1))
    found = Departures.of(point, jets, np.zeros((300, 3, 3)), 1.5)
    np.testing.assert_allclose(found.at(np.linspace(0, 2, 9)), 0, atol=1e-15)
    np.testing.assert_array_equal(NONE.at(np.ones((2, 3))), np.zeros((2, 3)))


@pytest.mark.parametrize(
    ("side", "held"),
    [((0.05, 0.05, 0.004), 0.95), ((0.005, 0.05, 0.01), 0.9), ((0.05, 0.05, 0.01), 0.75)],
)
def test_beyond_contacts_a_block_may_have_the_edges_that_it_has_elsewhere(side, held):
    """Of points further than 3 mm from contacts, 0.84, 0.66 and 0.19 were within intervals when
    only distances counted.
    """
    whole = rings(BLOCK, np.random.default_rng(2), sweeps=20, reach=0.022)
    known = whole[(whole.point < side).all(axis=1)]
    shape, points = vb.fit_shape(known), samples(BLOCK)
    apart = np.linalg.norm(known.point - points[:, None], axis=2).min(axis=1)
    far = points[apart > 3e-3]
    assert np.mean(np.abs(shape.distance(far)) < 1.96 * shape.deviation(far)) > held
