"""A level between the nodes of a lattice."""

import numpy as np
import pytest

import vibrissa as vb


def nodes(count: int) -> tuple[np.ndarray, float, np.ndarray]:
    step = 2.0 / (count - 1)
    places = np.stack(np.meshgrid(*[-1 + step * np.arange(count)] * 3, indexing="ij"), axis=-1)
    return np.full(3, -1.0), step, places


def test_cubics_are_exact_away_from_the_edges():
    origin, step, places = nodes(31)
    x, y, z = np.moveaxis(places, -1, 0)
    lattice = vb.surfaces.Lattice(origin, step, 0.3 * x + 0.2 * x * y - y * z + 0.1)
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (50, 3))
    x, y, z = points.T
    np.testing.assert_allclose(
        lattice.levels(points), 0.3 * x + 0.2 * x * y - y * z + 0.1, atol=1e-6
    )


def test_error_falls_with_the_fourth_power_of_the_spacing():
    points = np.random.default_rng(0).uniform(-0.4, 0.4, (200, 3))
    wanted = np.linalg.norm(points - [0.0, 0, 2], axis=1) - 1.5
    errors = []
    for count in (11, 21):
        origin, step, places = nodes(count)
        values = np.linalg.norm(places - [0.0, 0, 2], axis=-1) - 1.5
        errors.append(
            np.abs(vb.surfaces.Lattice(origin, step, values).levels(points) - wanted).max()
        )
    assert errors[1] < errors[0] / 10


def test_outside_the_lattice_the_level_grows_with_distance():
    origin, step, places = nodes(9)
    lattice = vb.surfaces.Lattice(origin, step, np.linalg.norm(places, axis=-1) - 0.5)
    at_edge, beyond = lattice.levels([[1.0, 0, 0], [3.0, 0, 0]])
    assert beyond == pytest.approx(at_edge + 2.0, abs=1e-6)
    assert np.isfinite(lattice.normal([[3.0, 0, 0]])).all()


@pytest.mark.parametrize(
    "values", [np.zeros((3, 5, 5)), np.zeros((5, 5)), np.full((5, 5, 5), np.nan)]
)
def test_wrong_values(values):
    with pytest.raises(ValueError, match="values has shape"):
        vb.surfaces.Lattice((0, 0, 0), 0.1, values)
