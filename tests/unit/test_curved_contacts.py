"""What errors along a curved surface do to contacts, to second order."""

import numpy as np
import pytest
from touched import joined, on_surface

import vibrissa as vb
from vibrissa.shape.noise import Noise, lifted

RADIUS, ERROR, TURN = 0.010, 8e-4, 0.02


def directions(count: int) -> np.ndarray:
    found = np.random.default_rng(5).normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1)[:, None]


@pytest.mark.parametrize("hollow", [False, True])
def test_points_lie_in_front_of_a_ball_by_what_is_said(hollow):
    """Errors of a cigar along the surface, drawn; inside a hollow ball they lie behind it."""
    rng, count, sign = np.random.default_rng(0), 200_000, -1.0 if hollow else 1.0
    normal = np.array([[0.0, 0.0, sign]])
    joint = np.zeros((1, 6, 6))
    joint[0, 0, 0], joint[0, 1, 1] = (2 * ERROR) ** 2, ERROR**2
    bent = sign / RADIUS * (np.eye(3) - np.outer(normal, normal))[None]
    off = rng.normal(size=(count, 3)) * np.sqrt(np.diag(joint[0])[:3])
    distance = sign * (np.linalg.norm(off + [0, 0, RADIUS], axis=1) - RADIUS)
    assert lifted(joint, bent)[0] == pytest.approx(distance.mean(), rel=0.03)
    told = Noise.errors(normal, joint, bent, 1e-6)[0, 0, 0]
    assert told == pytest.approx(distance.var(), rel=0.1)


def test_a_ball_is_as_large_as_it_is_however_far_contacts_are_off_along_it():
    """Each contact, of a sweep of its own, is off along the surface by a twelfth of the radius, and
    so 0.06 mm in front of it.
    """
    rng, normal = np.random.default_rng(1), directions(600)
    along = np.eye(3) - normal[:, :, None] * normal[:, None]
    drawn = rng.normal(size=(2, *normal.shape))
    felt = normal + TURN * drawn[1]
    contacts = vb.Contacts(
        RADIUS * normal + ERROR * (along @ drawn[0, :, :, None])[..., 0],
        felt / np.linalg.norm(felt, axis=1)[:, None],
        ERROR**2 * along + 1e-10 * np.eye(3),
        np.tile(TURN**2 * np.eye(3), (600, 1, 1)),
        sweep=np.arange(600),
    )
    off = vb.fit_shape(contacts).distance(RADIUS * directions(300))
    assert abs(off.mean()) < ERROR**2 / RADIUS / 4


SQUAT = vb.surfaces.Ellipsoid(center=(0, 0, 0), semi_axes=(0.022, 0.022, 0.010))


def aims(height, turn):
    """Directions (n, 3) by their heights and turns about z [rad]."""
    across = np.sqrt(1 - height**2)
    return np.column_stack([across * np.cos(turn), across * np.sin(turn), height])


def meridians(surface, highest, rng):
    """24 sweeps up an object, each off along it as a whole, by 0.8 mm, with normals that are known
    to 4 mrad.
    """
    parts = []
    for turn in np.linspace(0, 2 * np.pi, 24, endpoint=False):
        point = on_surface(surface, 0.025 * aims(np.linspace(-0.98, highest, 30), turn))
        normal = surface.normal(point)
        up = np.array([0.0, 0.0, 1.0]) - normal * normal[:, 2:]
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        felt = normal + 0.004 * rng.normal(size=3)
        parts.append(
            vb.Contacts(
                point + ERROR * rng.normal() * up + 2e-5 * rng.normal(size=point.shape),
                felt / np.linalg.norm(felt, axis=1)[:, None],
                ERROR**2 * up[:, :, None] * up[:, None] + 4e-10 * np.eye(3),
                np.tile(0.004**2 * np.eye(3), (len(point), 1, 1)),
            )
        )
    return joined(parts)


@pytest.mark.parametrize(
    ("surface", "highest", "near"),
    [
        pytest.param(
            vb.surfaces.Sphere(center=(0, 0, 0), radius=0.02), 0.98, (-1.0, 1.0), id="ball"
        ),
        pytest.param(SQUAT, 0.1, (-0.4, 0.1), id="edge of the half that was touched"),
    ],
)
def test_normals_tell_where_along_the_surface_contacts_are(surface, highest, near):
    """A normal error of 4 mrad is a tenth of a millimetre here, far less than points are off."""
    off, held = [], []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        shape = vb.fit_shape(meridians(surface, highest, rng))
        aim = aims(rng.uniform(*near, 500), rng.uniform(0, 2 * np.pi, 500))
        point = on_surface(surface, 0.025 * aim)
        distance = shape.distance(point)
        off.append(distance.mean())
        held.append(np.mean(np.abs(distance) < 1.96 * shape.deviation(point)))
    assert abs(np.mean(off)) < 0.02e-3
    assert 0.9 < np.mean(held) < 0.99
