"""Forward with friction, back without knowing of it: the contacts, then friction and normals from
how they move.
"""

import numpy as np
import pytest

import vibrissa as vb

PARABOLOID = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)


@pytest.fixture(scope="module", params=[0.1, 0.3, 0.5])
def there_and_back(request: pytest.FixtureRequest) -> tuple[vb.Scan, vb.Reconstruction]:
    trail = vb.Trail.line(start=(1.2, 0.2, 0), stop=(-1.2, 0.2, 0), count=1201)
    scan = vb.scan(vb.Rod.unit(), PARABOLOID, trail, friction=request.param)
    return scan, vb.reconstruct(vb.Rod.unit(), scan.reactions)


def test_points_are_exact_and_the_normal_is_the_force_s_direction(
    there_and_back: tuple[vb.Scan, vb.Reconstruction],
) -> None:
    scan, found = there_and_back
    rows = scan.in_contact & found.in_contact
    assert np.mean(rows == scan.in_contact) > 0.99
    np.testing.assert_allclose(found.point[rows], scan.point[rows], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.normal[rows], scan.force_direction[rows], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.arc_length[rows], scan.arc_length[rows], rtol=0, atol=1e-9)


def test_friction_and_normals_come_back(there_and_back: tuple[vb.Scan, vb.Reconstruction]) -> None:
    scan, found = there_and_back
    estimate = vb.estimate_friction(found)
    assert estimate.friction == pytest.approx(scan.friction, abs=1e-3)
    rows = np.isfinite(estimate.normal[:, 0])
    assert np.count_nonzero(rows) > 0.7 * np.count_nonzero(scan.motion == vb.Motion.SLIP)
    gradient = np.column_stack(
        [scan.point[rows, 0], 2 * scan.point[rows, 1], -np.ones(np.count_nonzero(rows))]
    )
    cosine = np.sum(gradient * estimate.normal[rows], axis=1) / np.linalg.norm(gradient, axis=1)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    assert np.median(angle) < 0.1
    assert np.quantile(angle, 0.98) < 0.5


def test_what_a_window_may_be(there_and_back: tuple[vb.Scan, vb.Reconstruction]) -> None:
    for window in (4, 3, 6):
        with pytest.raises(ValueError, match="allowed is an odd number of at least 5"):
            vb.estimate_friction(there_and_back[1], window=window)
    with pytest.raises(ValueError, match="no contact lasts that many samples"):
        vb.estimate_friction(there_and_back[1], window=1201)
