"""All wrenches of a single contact by five coordinates: against scans, the inverse map, and finite
differences.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrissa as vb
from vibrissa.inverse.smoothing.manifold import Bent, bent, linearised, poses_of, smoothed_model
from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.model import AT_ORIGIN

UNIT = vb.Rod.unit()
ROWS = 128
BENT, INVERT = jax.jit(jax.vmap(bent)), jax.jit(Elastica().contact)
SLOPE = jax.jit(jax.jacfwd(lambda x: bent(x).wrench))


def one(x: tuple[float, ...] | jax.Array) -> Bent:
    return Bent(*(part[0] for part in BENT(jnp.tile(jnp.asarray(x), (ROWS, 1)))))


COORDINATES = [
    (0.3, 0.4, -0.2, 0.9, 0.0),
    (1.2, -0.8, -1.0, 0.7, 0.0),
    (1e-3, 2e-3, -1e-4, 1.0, 0.0),
    (0.3, 0.4, -0.2, 0.9, 2e-3),
    (0.2, 0.1, 0.15, 1.0, 0.0),
]


@pytest.mark.parametrize("y0", [0.02, 0.2, 0.5])
def test_scanned_contacts_are_found_from_their_coordinates(y0: float) -> None:
    """Moment, axial force and arc length of a scan give its lateral force and its contact; at y0 =
    0.02 the force passes behind the clamp's axis.
    """
    surface = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
    scan = vb.scan(UNIT, surface, vb.Trail.line(start=(1.2, y0, 0), stop=(-1.2, y0, 0), count=121))
    rows = scan.in_contact
    f0, m0 = scan.reactions.force[rows], scan.reactions.moment[rows]
    x = np.column_stack([m0[:, :2], -f0[:, 2], scan.arc_length[rows], np.zeros(rows.sum())])
    x = np.concatenate([x, np.repeat(x[-1:], ROWS - len(x), axis=0)])
    found = Bent(*(part[: rows.sum()] for part in BENT(jnp.asarray(x))))
    np.testing.assert_allclose(found.wrench, np.concatenate([f0, m0], axis=1), rtol=0, atol=1e-11)
    np.testing.assert_allclose(
        found.reach, (scan.point - scan.trail.position)[rows], rtol=0, atol=2e-8
    )
    np.testing.assert_allclose(found.direction, scan.normal[rows], rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.energy, scan.energy[rows], rtol=0, atol=1e-8)


@pytest.mark.parametrize("x", COORDINATES)
def test_the_inverse_map_leads_back(x: tuple[float, ...]) -> None:
    value = one(x)
    force, moment = value.wrench[:3], value.wrench[3:]
    assert abs(force @ moment) < 1e-15
    back = INVERT(force, moment, AT_ORIGIN)
    # A tilt enters f only by its square, which the coordinates leave out.
    tolerance = 1e-6 if x[4] == 0 else 1e-5
    assert back.arc_length == pytest.approx(x[3], abs=tolerance)
    np.testing.assert_allclose(value.reach, back.reach, rtol=0, atol=tolerance)
    assert value.incidence == pytest.approx(float(back.incidence), abs=tolerance)


@pytest.mark.parametrize("x", COORDINATES)
def test_derivatives_are_those_of_finite_differences(x: tuple[float, ...]) -> None:
    step = 1e-6
    slopes = [
        (one(jnp.asarray(x) + step * unit).wrench - one(jnp.asarray(x) - step * unit).wrench)
        / (2 * step)
        for unit in jnp.eye(5)
    ]
    np.testing.assert_allclose(SLOPE(jnp.asarray(x)), np.stack(slopes, axis=1), rtol=0, atol=1e-6)


def test_first_contact_is_regular() -> None:
    """No load: no force, the derivatives those of a straight cantilever, F_⊥ = t0 × m0 / L."""
    x = jnp.array([0.0, 0.0, 0.0, 1.0, 0.0])
    np.testing.assert_allclose(one(x).wrench, 0, atol=1e-12)
    slope = SLOPE(x)
    expected = np.zeros((6, 5))
    expected[0, 1], expected[1, 0], expected[2, 2], expected[3, 0], expected[4, 1] = 1, -1, -1, 1, 1
    np.testing.assert_allclose(slope, expected, atol=1e-6)


LENGTH = 0.05
WHISKER = (
    vb.Rod.tapered(
        length=LENGTH, base_radius=0.1e-3, tip_radius=0.05e-3, youngs_modulus=6e9, density=5000.0
    )
    .curved(vb.RestShape.arc(0.1, roll=0.7))
    .loaded(vb.Loads(gravity=(0, 0, -9.81)))
    .on(vb.Support.pivot(stiffness=(2e-4, 3e-4, 1e-3)))
)


def test_contacts_of_any_rod_are_found_from_their_coordinates() -> None:
    """Tapered, curved, heavy, softly held and tilted: the scan's reactions in excess of the free
    rod's, and its contacts, to the smoother's resolution; derivatives by finite differences.
    """
    ball = vb.surfaces.Sphere(center=(0, 0, 0.0575), radius=0.03)
    position = np.linspace([0.04, 0.01, 0], [-0.02, 0.01, 0], 41)
    turned = np.array([0.1, -0.1, 0.05, 1.0])
    scan = vb.scan(WHISKER, ball, vb.Trail(position, np.tile(turned, (41, 1))))
    trail, rod = scan.trail[scan.in_contact], smoothed_model(WHISKER)
    pose = poses_of(rod, trail, LENGTH)
    assert pose is not None
    units = np.repeat([WHISKER.force_scale, WHISKER.moment_scale], 3)
    total = scan.reactions.wrench[scan.in_contact].reshape(-1, 2, 3) @ trail.rotation
    wrench = total.reshape(-1, 6) / units - pose.free
    s1 = scan.arc_length[scan.in_contact] / LENGTH
    assert len(s1) > 10 and s1.min() < 0.95
    x = np.column_stack([wrench[:, 3:5], -wrench[:, 2], s1, np.zeros(len(s1))])
    found = linearised(rod, pose, x).value
    reach = (scan.point[scan.in_contact] - trail.position)[:, None] @ trail.rotation / LENGTH
    np.testing.assert_allclose(found.wrench, wrench, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.reach, reach[:, 0], rtol=0, atol=1e-6)
    # At the tip derivatives by arc length are one-sided.
    x[:, 3], x[:, 4], step = np.minimum(x[:, 3], 0.99), 2e-3, 1e-5
    slope = linearised(rod, pose, x).slope
    for k, unit in enumerate(step * np.eye(5)):
        up, down = (linearised(rod, pose, x + way).value for way in (unit, -unit))
        for name in ("wrench", "reach", "direction", "incidence"):
            change = (getattr(up, name) - getattr(down, name)) / (2 * step)
            np.testing.assert_allclose(getattr(slope, name)[..., k], change, rtol=1e-5, atol=1e-5)


def test_a_rod_that_leads_back_to_its_clamp_is_refused() -> None:
    wire = vb.Rod.cylinder(length=LENGTH, radius=0.25e-3, youngs_modulus=206e9, density=7850.0)
    with pytest.raises(ValueError, match=r"tip is 0\.0.* rod lengths ahead of the clamp"):
        smoothed_model(wire.curved(vb.RestShape.arc(LENGTH / 3)))
    # One that hangs may have no shape the other way up: that is judged pose by pose.
    hair = vb.Rod.cylinder(length=0.15, radius=50e-6, youngs_modulus=3e9, density=1200.0)
    smoothed_model(hair.curved(vb.RestShape.arc(0.3)).loaded(vb.Loads(gravity=(0, 0, -9.81))))
