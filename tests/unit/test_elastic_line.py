"""The rod's shape: inextensible, clamped, straight from the contact on, and the solution of the
rod's equation.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from vibrissa.mechanics.elastic_line import elastic_line, sampled_line
from vibrissa.mechanics.elastica import (
    BasePlane,
    ContactOnRod,
    Elastica,
    contact_on_rod,
    contact_tangent,
)
from vibrissa.mechanics.model import Clamp

T0, B = np.array([1.0, -2.0, 2.0]) / 3, np.array([2.0, 2.0, 1.0]) / 3
"""Clamp tangent, and the side to which the rod bends."""
CLAMP = np.array([0.3, -0.1, 0.2])


class Bent(NamedTuple):
    """A rod under a force f n̂ at an angle δ from t0, with base curvature κ₀; model units."""

    force: float
    delta: float
    curvature: float

    @property
    def n(self) -> np.ndarray:
        """n̂ (3,)."""
        return np.cos(self.delta) * T0 + np.sin(self.delta) * B

    @property
    def side(self) -> np.ndarray:
        """Unit vector from the clamp to the line of the force (3,)."""
        return np.sin(self.delta) * T0 - np.cos(self.delta) * B

    @property
    def plane(self) -> BasePlane:
        """Base angle and lever arm."""
        return BasePlane(
            jnp.asarray(np.cos(self.delta / 2)), jnp.asarray(self.curvature / self.force)
        )

    @property
    def rod(self) -> ContactOnRod:
        """Contact on the rod."""
        return contact_on_rod(self.plane, jnp.asarray(self.force))

    @property
    def reach(self) -> np.ndarray:
        """R = P1 − P0 (3,)."""
        return self.curvature / self.force * self.side - float(self.rod.advance) * self.n

    def line(self, arc_length: np.ndarray) -> np.ndarray:
        """Points seen from the clamp (k, 3)."""
        s1, k2 = float(self.rod.arc_length), float(self.rod.modulus)
        return elastic_line(self.reach, self.n, self.side, self.force, k2, s1, arc_length)

    def sampled(self, length: float, count: int) -> np.ndarray:
        """A rod of the given length, as users get it."""
        s1 = float(self.rod.arc_length)
        return sampled_line(CLAMP, T0, length, self.reach, self.n, self.force, s1, count)

    def integrated(self, arc_length: np.ndarray) -> np.ndarray:
        """Paper's eq. (10) from the clamp up to arc lengths within s₁: along t0, along b, θ, κ (k,
        4).
        """

        def slope(_s: float, y: np.ndarray) -> list[float]:
            return [np.cos(y[2]), np.sin(y[2]), y[3], self.force * np.sin(y[2] - self.delta)]

        start = [0.0, 0.0, 0.0, self.curvature]
        span = (0.0, arc_length[-1])
        return solve_ivp(
            slope, span, start, method="DOP853", t_eval=arc_length, rtol=1e-13, atol=1e-14
        ).y.T


TIP = Bent(1.3, 2.4, 0.9)
TANGENT = Bent(2.0, np.pi / 2 + 0.2, 1.5)
BEHIND = Bent(4.0, 3.4, 2.0)
SLIGHT = Bent(1e-3, 2.0, 9e-4)
STRONG = Bent(9.0, 2.2, 2.0)
ALL = pytest.mark.parametrize("bent", [TIP, TANGENT, BEHIND, SLIGHT, STRONG])


@ALL
def test_is_the_integrated_rod(bent: Bent) -> None:
    s = np.linspace(0, float(bent.rod.arc_length), 60)
    along, across, _, _ = bent.integrated(s).T
    np.testing.assert_allclose(
        bent.line(s), along[:, None] * T0 + across[:, None] * B, rtol=0, atol=1e-11
    )


@ALL
def test_starts_at_the_clamp_along_its_tangent(bent: Bent) -> None:
    s = np.array([0.0, 1e-5, 2e-5])
    points = bent.line(s)
    np.testing.assert_allclose(points[0], 0, atol=1e-13)
    tangent = (4 * points[1] - 3 * points[0] - points[2]) / 2e-5
    np.testing.assert_allclose(tangent, T0, rtol=0, atol=1e-8)


@ALL
def test_arc_length_is_preserved(bent: Bent) -> None:
    """Chords fall short of their arcs by ∫ κ² ds h²/24, and by nothing else."""
    s = np.linspace(0, 1.25 * float(bent.rod.arc_length), 1001)
    h = s[1]
    kappa = bent.integrated(s[s <= float(bent.rod.arc_length)])[:, 3]
    shortfall = s[-1] - np.linalg.norm(np.diff(bent.line(s), axis=0), axis=1).sum()
    assert shortfall == pytest.approx(np.trapezoid(kappa**2, dx=h) * h**2 / 24, rel=1e-2, abs=1e-13)


@ALL
def test_curvature_vanishes_at_the_contact_and_beyond(bent: Bent) -> None:
    s1, h = float(bent.rod.arc_length), 1e-3

    def curvature(s: float) -> float:
        before, here, after = bent.line(np.array([s - h, s, s + h]))
        return float(np.linalg.norm(before - 2 * here + after)) / h**2

    assert curvature(h) == pytest.approx(bent.curvature, rel=5e-3)
    # Towards the contact it falls in proportion to the distance left, by the shear f sin(δ − θ).
    theta1 = bent.integrated(np.array([0.0, s1]))[-1, 2]
    shear = bent.force * abs(np.sin(bent.delta - theta1))
    assert curvature(s1 - 20 * h) == pytest.approx(20 * h * shear, rel=2e-2)
    assert curvature(s1 + 2 * h) < 1e-7


@ALL
def test_is_straight_beyond_the_contact_along_the_contact_tangent(bent: Bent) -> None:
    s1 = float(bent.rod.arc_length)
    beyond = bent.line(s1 + np.array([0.0, 0.1, 0.5]))
    tangent = np.asarray(
        contact_tangent(jnp.asarray(bent.n), jnp.asarray(bent.side), bent.rod.modulus)
    )
    theta1 = bent.integrated(np.array([0.0, s1]))[-1, 2]
    np.testing.assert_allclose(
        tangent, np.cos(theta1) * T0 + np.sin(theta1) * B, rtol=0, atol=1e-11
    )
    np.testing.assert_allclose(
        beyond - beyond[0], np.outer([0.0, 0.1, 0.5], tangent), rtol=0, atol=1e-12
    )


@ALL
def test_bent_part_runs_from_contact_to_clamp_on_the_rod(bent: Bent) -> None:
    clamp = Clamp(jnp.zeros(3), jnp.asarray(T0), jnp.asarray(T0))
    force, n = jnp.asarray(bent.force), jnp.asarray(bent.n)
    model = Elastica()
    pushed = model.bent(clamp, jnp.asarray(bent.reach), force, n)
    np.testing.assert_allclose(pushed.misses, 0, atol=1e-13)
    nodes = np.asarray(model.points(pushed, np.linspace(0, 1, 25)))
    np.testing.assert_allclose(nodes[0], bent.reach, rtol=0, atol=1e-12)
    np.testing.assert_allclose(nodes[-1], 0, atol=1e-8)
    # Their arc lengths from the contact, by quadrature of ds = dc / (√f √(1 − k² cos² c)); they are
    # equally spaced in c.
    k2 = float(bent.rod.modulus)
    span = np.arctan2(bent.curvature / (2 * np.sqrt(bent.force)), np.cos(bent.delta / 2))
    ends = span * np.linspace(0, 1, len(nodes))
    left = [
        quad(lambda c: 1 / np.sqrt(bent.force * (1 - k2 * np.cos(c) ** 2)), 0, end)[0]
        for end in ends
    ]
    exact = bent.line(np.maximum(float(bent.rod.arc_length) - np.array(left), 0))
    np.testing.assert_allclose(nodes, exact, rtol=0, atol=1e-8)


@pytest.mark.parametrize("length", [1.0, 0.05])
def test_sampled_line_scales_with_the_rod(length: float) -> None:
    line = TIP.sampled(length, 21)
    np.testing.assert_allclose(
        (line - CLAMP) / length, TIP.line(np.linspace(0, 1, 21)), rtol=0, atol=1e-14
    )


def test_without_a_force_the_rod_is_straight() -> None:
    line = sampled_line(CLAMP, T0, 0.05, 0.05 * T0, T0, 0.0, 1.0, 11)
    np.testing.assert_allclose(
        line, CLAMP + np.outer(np.linspace(0, 0.05, 11), T0), rtol=0, atol=1e-16
    )


def test_a_force_that_no_bent_rod_bears_gives_no_line() -> None:
    """A wrench of the other sign pulls: the modulus is negative."""
    reach, direction = np.array([0.1, 0.0, 0.8]), np.array([0.0, 0.0, -1.0])
    line = sampled_line(CLAMP, -direction, 1.0, reach, direction, -3.0, 0.8, 5)
    assert line.shape == (5, 3)
    assert np.isnan(line).all()
