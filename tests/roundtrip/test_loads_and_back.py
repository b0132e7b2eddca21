"""Contacts of rods under loads, from their reactions: what the rod does without contact is found once
for each orientation of the clamp, or for each pose where the loads depend on the place.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import vibrissa as vb

LENGTH = 0.1
WIRE = vb.Rod.cylinder(length=LENGTH, radius=0.1e-3, youngs_modulus=72e9, density=7850)
BALL = vb.surfaces.Sphere(center=(0, 0, 1.15 * LENGTH), radius=0.6 * LENGTH)
LOADS = {
    "weight": vb.Loads(gravity=(0, 0, -9.81)),
    "wind that grows along x": vb.Loads(
        gravity=(0, 3.0, -9.0), wind=lambda place: jnp.array([0.0, 30.0, 0.0]) * place[0]
    ),
}


def _sweep(turning: float) -> vb.Trail:
    """Under the ball along −x, while the clamp turns about three axes by angles of that size."""
    x = np.linspace(0.7, -0.5, 81) * LENGTH
    position = np.column_stack([x, 0.1 * LENGTH + 0 * x, 0 * x])
    angles = np.outer(np.linspace(-1, 1, len(x)), [0.3, 0.2, 1.0]) * turning
    return vb.Trail(position, Rotation.from_rotvec(angles).as_quat())


@pytest.mark.parametrize("turning", [0.0, 0.5])
@pytest.mark.parametrize("loads", LOADS.values(), ids=LOADS)
def test_contacts_are_where_they_were(loads: vb.Loads, turning: float) -> None:
    rod, sweep = WIRE.loaded(loads), _sweep(turning)
    scan = vb.scan(rod, BALL, sweep)
    assert 20 < scan.in_contact.sum() < len(scan.in_contact)
    found = vb.reconstruct(rod, scan.reactions)
    assert (found.status == vb.Status.OK).all()
    np.testing.assert_array_equal(found.kind, scan.kind)
    np.testing.assert_allclose(found.point, scan.point, rtol=0, atol=1e-9 * LENGTH)
    # Each row says the same alone.
    for row in np.flatnonzero(scan.in_contact)[::20]:
        force, moment = scan.reactions.force[[row]], scan.reactions.moment[[row]]
        alone = vb.reconstruct(rod, vb.Reactions(sweep[row : row + 1], force, moment))
        np.testing.assert_allclose(alone.point[0], found.point[row], rtol=0, atol=1e-11 * LENGTH)
