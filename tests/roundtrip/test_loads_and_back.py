"""Contacts of rods under loads, from their reactions: what the rod does without contact is found once
for each orientation of the clamp, or for each pose where the loads depend on the place.
"""

import math

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


@pytest.mark.parametrize(
    ("tilt", "y", "start", "stop"),
    [
        pytest.param(2.6, 0.25, 0.6, 0.0, id="at the tip"),
        pytest.param(3.0, 0.0, 0.335, 0.285, id="of four millionths of its weight"),
    ],
)
def test_contacts_of_a_hanging_rope(tilt: float, y: float, start: float, stop: float) -> None:
    """What its weight does behind the contact outweighs the contact, and has a kink at the tip."""
    rope = vb.Rod.cylinder(length=LENGTH, radius=0.02e-3, youngs_modulus=72e9, density=7850)
    rope = rope.loaded(LOADS["weight"])
    ball = vb.surfaces.Sphere(center=(0, 0, 0), radius=0.3 * LENGTH)
    x = np.linspace(start, stop, 60)
    position = np.column_stack([x, y + 0 * x, 1 + 0 * x]) * LENGTH
    trail = vb.Trail(position, Rotation.from_rotvec([tilt, 0, 0]).as_quat())
    scan = vb.scan(rope, ball, trail)
    touching = scan.in_contact
    assert touching.sum() > 10 and (scan.status == vb.Status.OK).all()
    found = vb.reconstruct(rope, scan.reactions)
    assert (found.status == vb.Status.OK).all()
    np.testing.assert_array_equal(found.kind, scan.kind)
    np.testing.assert_allclose(found.point, scan.point, rtol=0, atol=1e-8 * LENGTH)
    weight = np.linalg.norm(scan.reactions.force[0])
    share = np.linalg.norm(scan.contact_force[touching], axis=1).min() / weight
    assert share < 5e-6 or (scan.kind == vb.ContactKind.TIP).sum() > 5


def test_light_touches_of_a_rod_far_bent_by_its_weight() -> None:
    """With the loads of the free rod taken off, its contact was not found, or elsewhere."""
    wire = vb.Rod.tapered(
        length=LENGTH, base_radius=0.1e-3, tip_radius=0.04e-3, youngs_modulus=72e9, density=7850
    )
    down = np.array([-1, -0.2, 0.6]) / np.linalg.norm([-1, -0.2, 0.6])
    pull = 20 * wire.force_scale / (7850 * math.pi * 1e-8 * LENGTH)
    rod = wire.curved(vb.RestShape.arc(1.5 * LENGTH, roll=2.0)).loaded(
        vb.Loads(gravity=tuple(pull * down))
    )
    x = np.linspace(-0.6, 0.6, 101) * LENGTH
    first = np.argmax(vb.scan(rod, BALL, _along_x(x)).in_contact)
    scan = vb.scan(rod, BALL, _along_x(np.linspace(x[first - 1], x[first], 40)))
    assert (scan.status == vb.Status.OK).all()
    share = np.linalg.norm(scan.contact_force[scan.in_contact], axis=1) / wire.force_scale / 20
    assert len(share) > 10 and share.min() < 5e-5 and share.max() < 1e-3
    found = vb.reconstruct(rod, scan.reactions)
    assert (found.status == vb.Status.OK).all()
    np.testing.assert_allclose(found.point, scan.point, rtol=0, atol=1e-8 * LENGTH)


def _along_x(x: np.ndarray) -> vb.Trail:
    position = np.column_stack([x, 0 * x, 0 * x])
    return vb.Trail(position, np.broadcast_to([0.0, 0.0, 0.0, 1.0], (len(x), 4)))
