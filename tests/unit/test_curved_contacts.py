"""What errors along a curved surface do to contacts, to second order."""

import numpy as np
import pytest

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
