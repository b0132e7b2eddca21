"""The closed form of the contact on the rod against mechanics.md's Legendre formulas in 40 digits,
and against integration.
"""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from legendre_rod import contact, slopes
from scipy.integrate import solve_ivp

from vibrissa.mechanics.elastica import (
    base_plane,
    bending_energy,
    contact_on_rod,
    legendre_over_sine,
    unit_lever,
)

lever = jax.jit(unit_lever)
lever_slopes = jax.jit(jax.jacfwd(lambda both: jnp.stack(unit_lever(both[0], both[1]))))

AHEAD = [(sin_a0, w) for sin_a0 in (0.05, 0.2, 0.45, 0.7) for w in (1e-9, 1e-4, 0.02, 0.2, 0.4)]
"""The force ahead of the clamp: a₀ > 0, up to k² = 0.89."""
BEHIND = [(sin_a0, w) for sin_a0 in (-0.02, -0.2, -0.5) for w in (1e-3, 0.05, 0.3, 0.5)]
"""It passes behind the clamp axis: a₀ < 0."""
BARELY = [(sin_a0, w) for sin_a0 in (0.1, 0.3, 0.65) for w in (-1e-3, -1e-8, 1e-14, 1e-8)]
"""Around first contact, on both sides of f = 0."""
IN_LINE = [(0.0, 0.01), (0.0, 0.3), (1e-9, 0.2), (-1e-9, 0.2)]
"""The force parallel to the clamp axis."""


@pytest.mark.parametrize(("sin_a0", "w"), AHEAD + BEHIND + BARELY + IN_LINE)
def test_arc_length_and_advance_are_mechanics_formulas(sin_a0: float, w: float) -> None:
    sigma, iota = lever(sin_a0, w)
    with mpmath.workdps(40):
        exact = contact(mpmath.mpf(sin_a0), mpmath.mpf(w))
    assert float(sigma) == pytest.approx(float(exact.sigma), rel=3e-15)
    assert float(iota) == pytest.approx(
        float(exact.iota), rel=3e-14, abs=3e-15 * float(exact.sigma)
    )


@pytest.mark.parametrize("sin_a0", [0.05, 0.4, 0.7, 0.95])
def test_a_straight_rod_at_first_contact(sin_a0: float) -> None:
    """F = 0: s₁ sin 2a₀ is the lever arm, s₁ cos 2a₀ the advance."""
    sigma, iota = lever(sin_a0, 0.0)
    a0 = np.arcsin(sin_a0)
    assert float(sigma) == pytest.approx(1 / np.sin(2 * a0), rel=1e-14)
    assert float(iota) == pytest.approx(1 / np.tan(2 * a0), rel=1e-14, abs=1e-14)


@pytest.mark.parametrize(
    ("sin_a0", "w"), AHEAD + BEHIND + BARELY + IN_LINE + [(0.3, 0.0), (0.7, 0.0)]
)
def test_derivatives_are_those_of_the_formulas(sin_a0: float, w: float) -> None:
    found = lever_slopes(jnp.array([sin_a0, w]))
    # At w = 0 the differences straddle the removable singularity.
    with mpmath.workdps(60):
        exact = np.array([[float(part) for part in row] for row in slopes(sin_a0, w)])
    np.testing.assert_allclose(found, exact, rtol=2e-12, atol=2e-13 * np.abs(exact).max())


@pytest.mark.parametrize(
    ("X", "k2"), [(0.0, 0.5), (1e-8, 0.3), (0.3, 0.2), (0.7, 0.6), (-0.2, 0.4)]
)
def test_half_argument_integrals_and_their_derivatives(X: float, k2: float) -> None:
    """F(β)/sin β and E(β)/sin β, analytic through β = 0, where they are 1."""
    found = jnp.stack(legendre_over_sine(jnp.asarray(X), jnp.asarray(k2)))
    by = jax.jacfwd(lambda both: jnp.stack(legendre_over_sine(both[0], both[1])))(
        jnp.array([X, k2])
    )

    def exact(X: mpmath.mpf, k2: mpmath.mpf) -> list[mpmath.mpf]:
        if X == 0:
            return [mpmath.mpf(1), mpmath.mpf(1)]
        sine = mpmath.sqrt(X)
        beta = mpmath.asin(sine)
        return [
            mpmath.re(mpmath.ellipf(beta, k2) / sine),
            mpmath.re(mpmath.ellipe(beta, k2) / sine),
        ]

    with mpmath.workdps(50):
        x, m, h = mpmath.mpf(X), mpmath.mpf(k2), mpmath.mpf(10) ** -15
        np.testing.assert_allclose(found, [float(part) for part in exact(x, m)], rtol=2e-15)
        for column, (ahead, behind) in enumerate(
            (((x + h, m), (x - h, m)), ((x, m + h), (x, m - h)))
        ):
            slope = [
                float((a - b) / (2 * h)) for a, b in zip(exact(*ahead), exact(*behind), strict=True)
            ]
            np.testing.assert_allclose(by[:, column], slope, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("excess", [1e-12, 1e-3, 0.1, 10.0])
def test_no_zero_of_the_curvature_gives_no_number(excess: float) -> None:
    """From k² = 1 on the rod turns over without its curvature ever vanishing."""
    assert np.all(np.isnan(lever(0.6, 1 - 0.36 + excess)))


def integrated(force: float, delta: float, curvature: float) -> tuple[float, float, float, float]:
    """Paper's eq. (10) from the clamp: s₁, both coordinates of the contact along and across t0, and
    ∫ κ²/2.
    """

    def rod(_s: float, y: np.ndarray) -> list[float]:
        return [np.cos(y[2]), np.sin(y[2]), y[3], force * np.sin(y[2] - delta), y[3] ** 2 / 2]

    def straightens(_s: float, y: np.ndarray) -> float:
        return y[3]

    straightens.terminal, straightens.direction = True, -1
    start = [0.0, 0.0, 0.0, curvature, 0.0]
    path = solve_ivp(
        rod, (0, 50), start, method="DOP853", events=straightens, rtol=1e-13, atol=1e-14
    )
    along, across, _, _, energy = path.y_events[0][0]
    return path.t_events[0][0], along, across, energy


@pytest.mark.parametrize(
    ("force", "delta", "curvature"),
    [
        (1.3, 2.4, 0.9),
        (2.0, np.pi / 2, 1.2),
        (6.0, 3.0, 2.5),
        (4.0, 3.4, 2.0),
        (0.3, 1.8, 0.15),
        (9.0, 2.2, 1.0),
    ],
)
def test_integrating_the_rod_leads_to_the_same_contact(
    force: float, delta: float, curvature: float
) -> None:
    """Bending plane x (along t0) and y (the side of the bend); F = f (cos δ, sin δ)."""
    n, t0, b = (
        np.array([np.cos(delta), np.sin(delta), 0.0]),
        np.array([1.0, 0, 0]),
        np.array([0.0, 1, 0]),
    )
    plane = base_plane(jnp.asarray(n), jnp.asarray(curvature / force * b), jnp.asarray(t0))
    found = contact_on_rod(plane, jnp.asarray(force))
    s1, x, y, energy = integrated(force, delta, curvature)
    assert float(found.arc_length) == pytest.approx(s1, abs=1e-11)
    assert float(found.advance) == pytest.approx(-(x * n[0] + y * n[1]), abs=1e-11)
    # The lever arm is the distance of the clamp from the line of the force through the contact.
    assert float(plane.lever_arm) == pytest.approx(abs(x * n[1] - y * n[0]), abs=1e-11)
    assert float(bending_energy(found, jnp.asarray(force))) == pytest.approx(energy, abs=1e-11)


@pytest.mark.parametrize(("sin_a0", "w"), AHEAD[5:] + BEHIND)
def test_energy_is_mechanics_formula(sin_a0: float, w: float) -> None:
    plane = base_plane(*plane_of(sin_a0, 1.0))
    force = jnp.asarray(4 * w)
    with mpmath.workdps(40):
        exact = float(contact(mpmath.mpf(sin_a0), mpmath.mpf(w)).energy) * 4 * w
    assert float(bending_energy(contact_on_rod(plane, force), force)) == pytest.approx(
        exact, rel=1e-12, abs=1e-14
    )


@pytest.mark.parametrize(("sin_a0", "lever_arm"), [(0.3, 0.7), (-0.2, 0.4), (0.68, 1.0)])
def test_base_plane_reads_angle_and_lever_arm(sin_a0: float, lever_arm: float) -> None:
    plane = base_plane(*plane_of(sin_a0, lever_arm))
    assert float(plane.sin_a0) == pytest.approx(sin_a0, abs=1e-15)
    assert float(plane.lever_arm) == pytest.approx(lever_arm, rel=1e-15)


def plane_of(sin_a0: float, lever_arm: float) -> tuple[jax.Array, jax.Array, jax.Array]:
    """n̂, ℓ b and t0 with δ = π − 2a₀ between n̂ and t0, in a plane that is none of the axes'."""
    t0, b = np.array([2.0, -1.0, 2.0]) / 3, np.array([1.0, 2.0, 0.0]) / np.sqrt(5)
    delta = np.pi - 2 * np.arcsin(sin_a0)
    return (
        jnp.asarray(np.cos(delta) * t0 + np.sin(delta) * b),
        jnp.asarray(lever_arm * b),
        jnp.asarray(t0),
    )
