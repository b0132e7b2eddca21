"""The 45° circular bend under a force out of its plane (K.-J. Bathe, S. Bolourchi, International
Journal for Numerical Methods in Engineering 14 (1979) 961-986): radius 100, square section 1 × 1, E
= 1e7, ν = 0.

The rod here neither stretches nor shears. That moves its tip by less than 0.008, or 1e-4 of its
length (measured below); what sets published positions apart is their torsion constant and their
coarse meshes. J. C. Simo and L. Vu-Quoc (Computer Methods in Applied Mechanics and Engineering 58
(1986) 79-116) use 8 straight elements and J = I₁ + I₂ = 1/6, not the 0.1406 of a square: 8 midpoint
steps along chords give their positions within 0.03 with 1/6, and miss them by 0.3 with 0.1406. Exact
for J = 1/6 is (15.685, 47.151, 53.469) under 600, where they print (15.79, 47.23, 53.37).
"""

from typing import NamedTuple

import numpy as np
import pytest
from cantilever import STEPS, bent_by, felt
from scipy.integrate import solve_ivp
from scipy.optimize import root
from scipy.spatial.transform import Rotation

import vibrissa as vb
from vibrissa.mechanics.models import spatial

CLOSE = 1e-8
RADIUS, MODULUS = 100.0, 1e7
LENGTH, BENDING = RADIUS * np.pi / 4, MODULUS / 12
SQUARE = 0.1405770139
"""Saint-Venant's torsion constant of a unit square (S. P. Timoshenko, J. N. Goodier, Theory of
Elasticity, § 109, prints 0.1406).
"""
POLAR = 1 / 6
BATHE_BOLOURCHI = {600: (15.9, 47.2, 53.4)}
SIMO_VU_QUOC = {
    300: (22.33, 58.84, 40.08),
    450: (18.62, 52.32, 48.39),
    600: (15.79, 47.23, 53.37),
}
"""Tip under a force: towards the centre of the bend, along the clamp, out of the plane."""
LOADS = tuple(SIMO_VU_QUOC)


class Tip(NamedTuple):
    """Where the tip is, and what is left of the moment there."""

    position: np.ndarray
    moment: np.ndarray


def bend(torsion_constant: float) -> vb.Rod:
    """The bend, leaving the clamp along z and bending towards x."""
    torsion = MODULUS / 2 * torsion_constant
    rod = vb.Rod.from_table(
        arc_length=[0.0, LENGTH],
        bending_stiffness=[BENDING] * 2,
        torsional_stiffness=[torsion] * 2,
    )
    return rod.curved(vb.RestShape.arc(RADIUS))


def shot(load: float, torsion: float, slack: float = 0.0) -> np.ndarray:
    """The tip by shooting for the moment at the clamp with quaternions; with `slack` 1, of a rod
    that stretches (EA) and shears (5/6 GA).
    """
    softness = slack * np.array([12 / 5, 12 / 5, 1.0]) / MODULUS
    stiffness = np.array([BENDING, BENDING, torsion * MODULUS / 2])

    def slope(_s: float, y: np.ndarray, force: float) -> np.ndarray:
        w, q = y[3], y[4:7]
        # From the axes of the section (columns) to the world's.
        cross = np.array([[0, -q[2], q[1]], [q[2], 0, -q[0]], [-q[1], q[0], 0]])
        axes = np.eye(3) + 2 * w * cross + 2 * cross @ cross
        spin = axes.T @ y[7:] / stiffness + [0, 1 / RADIUS, 0]
        rate = axes @ ([0, 0, 1] + softness * force * axes[1])
        turn = np.array([-q @ spin, *(w * spin + cross @ spin)]) / 2
        return np.concatenate([rate, turn, [rate[2] * force, 0, -rate[0] * force]])

    def tip(moment: np.ndarray, force: float) -> Tip:
        start = np.concatenate([np.zeros(3), [1, 0, 0, 0], moment])
        end = solve_ivp(
            slope, (0, LENGTH), start, "DOP853", args=(force,), rtol=1e-13, atol=1e-13
        ).y[:, -1]
        return Tip(end[:3], end[7:])

    moment = np.zeros(3)
    for force in np.linspace(0, load, 5)[1:]:
        moment = root(lambda m, f: tip(m, f).moment, moment, (force,), tol=1e-14).x
    return tip(moment, load).position


def by_elements(load: float, torsion: float, count: int) -> np.ndarray:
    """The tip by straight elements of constant strain and one integration point: each bends as the
    moment in its middle says.
    """
    turn = np.pi / 4 / count
    h, stiffness = (
        2 * RADIUS * np.sin(turn / 2),
        np.array([BENDING, BENDING, torsion * MODULUS / 2]),
    )

    def nodes(angles: np.ndarray, force: float) -> tuple[np.ndarray, list[Rotation]]:
        axes, points, middles = Rotation.identity(), [np.zeros(3)], []
        for angle in angles:
            middle = axes * Rotation.from_rotvec(angle / 2)
            own = middle.inv().apply([0, force, 0]) * [2, 2, 1] / MODULUS
            points.append(points[-1] + h * middle.apply([0, 0, 1] + own))
            middles.append(middle)
            axes = axes * Rotation.from_rotvec(angle)
        return np.array(points), middles

    def left(flat: np.ndarray, force: float) -> np.ndarray:
        angles = flat.reshape(count, 3)
        points, middles = nodes(angles, force)
        arms = points[-1] - (points[1:] + points[:-1]) / 2
        moments = np.cross(arms, [0, force, 0])
        own = np.array([m.inv().apply(one) for m, one in zip(middles, moments, strict=True)])
        return (angles - [0, turn, 0] - h * own / stiffness).ravel()

    flat = np.tile([0, turn, 0], count).astype(float)
    for force in np.linspace(0, load, 5)[1:]:
        flat = root(left, flat, (force,), tol=1e-12).x
    return nodes(flat.reshape(count, 3), load)[0][-1]


@pytest.fixture(scope="module")
def tips() -> dict[float, np.ndarray]:
    """Exact tips (3, 3) under the loads, by torsion constant."""
    return {J: np.array([shot(load, J)[[0, 2, 1]] for load in LOADS]) for J in (POLAR, SQUARE)}


@pytest.mark.parametrize("torsion_constant", [POLAR, SQUARE])
def test_the_bend_is_that_of_an_independent_integrator(
    tips: dict[float, np.ndarray], torsion_constant: float
) -> None:
    """Under each load; and the tip is where the clamp feels a contact."""
    rod = bend(torsion_constant)
    forces = np.outer(LOADS, [0.0, 1.0, 0.0])
    lines = bent_by(spatial(rod, STEPS), forces / rod.force_scale)
    found = np.array([line.reach[-1] for line in lines]) * LENGTH
    np.testing.assert_allclose(found[:, [0, 2, 1]], tips[torsion_constant], rtol=CLOSE)
    contacts = felt(rod, forces, found)
    np.testing.assert_allclose(contacts.point, found, atol=CLOSE * LENGTH)
    np.testing.assert_allclose(contacts.arc_length, LENGTH, rtol=CLOSE)


def test_published_tips_are_those_of_the_polar_moment_of_area(
    tips: dict[float, np.ndarray],
) -> None:
    """Within 0.3 % of the length; half the distance or less of the torsion constant of a square."""
    published = np.array(list(SIMO_VU_QUOC.values()))
    off, other = (np.linalg.norm(tips[J] - published, axis=1) for J in (POLAR, SQUARE))
    assert np.all(off < 0.0025 * LENGTH) and np.all(off < other / 2)
    first = np.linalg.norm(tips[POLAR][-1] - BATHE_BOLOURCHI[600])
    assert first < 0.004 * LENGTH


def test_the_digits_of_simo_and_vu_quoc_are_those_of_eight_straight_elements(
    tips: dict[float, np.ndarray],
) -> None:
    """And with more elements they converge to the rod's, with the square of their number."""
    published = np.array(list(SIMO_VU_QUOC.values()))
    coarse = np.array([by_elements(load, POLAR, 8)[[0, 2, 1]] for load in LOADS])
    assert abs(coarse - published).max() < 0.035
    square = by_elements(600, SQUARE, 8)[[0, 2, 1]]
    assert abs(square - published[-1]).max() > 0.2
    fine = by_elements(600, POLAR, 16)[[0, 2, 1]]
    extensible = shot(600, POLAR, slack=1.0)[[0, 2, 1]]
    limit = fine + (fine - coarse[-1]) / 3
    np.testing.assert_allclose(limit, extensible, atol=2e-3)
    assert abs(extensible - tips[POLAR][-1]).max() < 1e-4 * LENGTH
