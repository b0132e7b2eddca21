"""Classical large deflections and buckling loads of clamped rods, each against its exact solution.

All rods are in units L = EI = 1; the spatial solver is used throughout.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from cantilever import STEPS, bent_by, felt
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import jn_zeros, jv, yv

import vibrissa as vb
from vibrissa.mechanics.kirchhoff import Kirchhoff, Push
from vibrissa.mechanics.model import AT_ORIGIN, Clamp
from vibrissa.mechanics.models import spatial
from vibrissa.numerics.compiled import compiled

CLOSE = 1e-8
UNIFORM = vb.Rod.unit().curved(vb.RestShape.polynomial((0.0,)))
"""Straight, but described by a curvature, for which there is no closed form."""
ACROSS = np.array([1.0, 0.0, 0.0])

MATTIASSON = {
    0.2: (0.00265, 0.06636, 0.09964),
    0.4: (0.01035, 0.13098, 0.19715),
    0.6: (0.02249, 0.19235, 0.29074),
    0.8: (0.03817, 0.24945, 0.37906),
    1.0: (0.05643, 0.30172, 0.46135),
    2.0: (0.16064, 0.49346, 0.78175),
    3.0: (0.25442, 0.60325, 0.98602),
    4.0: (0.32894, 0.66996, 1.12124),
    5.0: (0.38763, 0.71379, 1.21537),
    6.0: (0.43459, 0.74457, 1.28370),
    7.0: (0.47293, 0.76737, 1.33496),
    8.0: (0.50483, 0.78498, 1.37443),
    9.0: (0.53182, 0.79906, 1.40547),
    10.0: (0.55500, 0.81061, 1.43029),
}
"""K. Mattiasson, International Journal for Numerical Methods in Engineering 17 (1981) 145-153, table
of the cantilever under an end force: PL²/EI to u/L, w/L and the slope at the tip.
"""


def bisshopp_drucker(load: float) -> tuple[float, float, float]:
    """Shortening, deflection and slope of the tip of a cantilever under an end force across it (K.
    E. Bisshopp, D. C. Drucker, Quarterly of Applied Mathematics 3 (1945) 272-275).
    """
    root = mpmath.sqrt(load)

    def off(p: mpmath.mpf) -> mpmath.mpf:
        begin = mpmath.asin(1 / (p * mpmath.sqrt(2)))
        return mpmath.ellipk(p * p) - mpmath.ellipf(begin, p * p) - root

    p = mpmath.findroot(off, (0.7072, 1 - 1e-9), solver="anderson", tol=1e-28)
    begin, slope = mpmath.asin(1 / (p * mpmath.sqrt(2))), mpmath.asin(2 * p * p - 1)
    down = 1 - 2 / root * (mpmath.ellipe(p * p) - mpmath.ellipe(begin, p * p))
    return float(1 - mpmath.sqrt(2 * mpmath.sin(slope)) / root), float(down), float(slope)


@pytest.fixture(scope="module")
def cantilevers() -> np.ndarray:
    """Exact shortening, deflection and slope at the loads of the table (14, 3)."""
    with mpmath.workdps(30):
        return np.array([bisshopp_drucker(load) for load in MATTIASSON])


def test_an_end_force_bends_a_cantilever_as_in_mattiassons_table(cantilevers: np.ndarray) -> None:
    np.testing.assert_array_equal(np.round(cantilevers, 5), list(MATTIASSON.values()))
    rod = spatial(vb.Rod.unit(), STEPS)
    lines = bent_by(rod, np.outer(list(MATTIASSON), ACROSS))
    for line, (short, down, slope) in zip(lines, cantilevers, strict=True):
        np.testing.assert_allclose(line.reach[-1], [down, 0, 1 - short], rtol=CLOSE, atol=1e-12)
        tangent = line.tangent[-1]
        np.testing.assert_allclose(np.arctan2(tangent[0], tangent[2]), slope, rtol=CLOSE)


def test_the_contact_is_found_from_what_the_clamp_feels_of_an_end_force(
    cantilevers: np.ndarray,
) -> None:
    short, down, slope = cantilevers.T
    tip = np.stack([down, 0 * down, 1 - short], axis=1)
    found = felt(UNIFORM, np.outer(list(MATTIASSON), ACROSS), tip)
    assert np.all(found.status == vb.Status.OK)
    np.testing.assert_allclose(found.arc_length, 1, rtol=CLOSE)
    np.testing.assert_allclose(found.point, tip, atol=CLOSE)
    np.testing.assert_allclose(2 * found.modulus - 1, np.sin(slope), atol=CLOSE)


TIMOSHENKO_GERE = {
    20: (1.015, 0.970, 0.220),
    40: (1.063, 0.881, 0.422),
    60: (1.152, 0.741, 0.593),
    80: (1.293, 0.560, 0.719),
    100: (1.518, 0.349, 0.792),
    120: (1.884, 0.123, 0.803),
    140: (2.541, -0.107, 0.750),
    160: (4.029, -0.340, 0.625),
}
"""S. P. Timoshenko, J. M. Gere, Theory of Elastic Stability (1961), table 2-4, the buckled column:
slope at the tip [°] to P/P_cr, x/L and y/L of the tip.
"""


def test_a_buckled_column_bends_as_in_the_table_of_timoshenko_and_gere() -> None:
    """P = K(p)², x = 2E(p)/K(p) − 1, y = 2p/K(p) with p = sin α/2."""
    rows = []
    for angle in TIMOSHENKO_GERE:
        p = mpmath.sin(mpmath.radians(angle) / 2)
        K, E = mpmath.ellipk(p * p), mpmath.ellipe(p * p)
        rows.append([float(each) for each in (K * K, 2 * E / K - 1, 2 * p / K)])
    load, up, off = np.array(rows).T
    printed = np.stack([load / (np.pi**2 / 4), up, off], axis=1)
    # Exact are 2.5423 and 4.0301 for the two largest loads: the table's last digit is not rounded.
    np.testing.assert_allclose(printed, list(TIMOSHENKO_GERE.values()), atol=1.5e-3)
    tip = np.stack([off, 0 * off, up], axis=1)
    found = felt(UNIFORM, np.outer(load, [0.0, 0.0, -1.0]), tip)
    assert np.all(found.status == vb.Status.OK)
    np.testing.assert_allclose(found.arc_length, 1, rtol=CLOSE)
    np.testing.assert_allclose(found.point, tip, atol=CLOSE)


def test_an_end_moment_rolls_a_rod_into_a_circle() -> None:
    """M = 2π EI/L, energy M²/2; half of it into a semicircle."""
    rod = spatial(UNIFORM, 20)
    line = compiled(lambda moment: rod.line(AT_ORIGIN, Push(jnp.zeros(3), moment)), quick=True)
    for moment in (2 * np.pi, np.pi):
        found = line(moment * np.array([0.0, 1.0, 0.0]))
        angle = moment * np.asarray(found.nodes)
        circle = np.stack([1 - np.cos(angle), 0 * angle, np.sin(angle)], axis=1) / moment
        np.testing.assert_allclose(found.reach, circle, atol=CLOSE)
        np.testing.assert_allclose(found.states.energy[-1], moment**2 / 2, rtol=CLOSE)


def test_a_moment_along_and_across_bends_a_rod_into_a_helix() -> None:
    """The tangent precesses about the moment: r = t∥ s + (sin ms, 1 − cos ms) t⊥/m."""
    moment = np.array([1.0, -2.0, 3.0])
    line = spatial(UNIFORM, 20).line(AT_ORIGIN, Push(jnp.zeros(3), moment))
    size, start = np.linalg.norm(moment), np.array([0.0, 0.0, 1.0])
    axis, s = moment / size, np.asarray(line.nodes)[:, None]
    along = axis @ start * axis
    side = start - along
    helix = s * along + np.sin(size * s) / size * side
    helix = helix + (1 - np.cos(size * s)) / size * np.cross(axis, side)
    np.testing.assert_allclose(line.reach, helix, atol=CLOSE)
    bend = np.cross(moment, start) @ np.cross(moment, start)
    np.testing.assert_allclose(
        line.states.energy[-1], (bend + (moment @ start) ** 2 * 1.3) / 2, rtol=CLOSE
    )


CURVATURE, TWIST = 2.5, 1.5


def helix(s: np.ndarray, curvature: float, torsion: float) -> np.ndarray:
    """The curve (n, 3) of constant curvature and torsion that leaves along z, bending towards x."""
    whole = np.hypot(curvature, torsion)
    axis = np.array([0.0, curvature, torsion]) / whole
    s = np.asarray(s)[..., None]
    turn, start = whole * s, np.array([0.0, 0.0, 1.0])
    along = axis @ start * axis
    side = np.cross(axis, start)
    return s * along + (np.sin(turn) * (start - along) + (1 - np.cos(turn)) * side) / whole


def helical(curvature: float, torsion: float) -> vb.Rod:
    u = [[0.0, curvature, torsion]] * 2
    return vb.Rod.unit().curved(vb.RestShape.from_components([0.0, 1.0], u))


def test_constant_curvature_and_twist_at_rest_are_a_helix() -> None:
    """Frenet and Serret: its points, and the place where a ball first touches it."""
    rod = helical(CURVATURE, TWIST)
    free = eqx.filter_jit(spatial(rod, 20).free)(AT_ORIGIN)
    np.testing.assert_allclose(
        free.line.reach, helix(free.line.nodes, CURVATURE, TWIST), atol=CLOSE
    )
    center = np.array([0.3, 0.1, 0.5])
    trail = vb.Trail.line(start=(1.0, 0.0, 0.0), stop=(0.0, 0.0, 0.0), count=25)
    scan = vb.scan(rod, vb.surfaces.Sphere(center=center, radius=0.2), trail)
    (first,) = (at for at in scan.events if at.kind == vb.EventKind.FIRST_CONTACT)

    def clearance(shift: float) -> float:
        def distance(s: np.ndarray) -> np.ndarray:
            at = helix(s, CURVATURE, TWIST) + [shift, 0.0, 0.0]
            return np.linalg.norm(at - center, axis=-1)

        s = np.linspace(0, 1, 401)
        for _ in range(8):
            place = s[np.argmin(distance(s))]
            s = np.clip(place + np.linspace(-1, 1, 401) * (s[1] - s[0]), 0, 1)
        return float(distance(s).min()) - 0.2

    exact = brentq(clearance, first.clamp[0] - 0.01, first.clamp[0] + 0.01, xtol=1e-14)
    np.testing.assert_allclose(first.clamp[0], exact, atol=CLOSE)


def test_a_wrench_along_its_axis_turns_a_helix_into_another() -> None:
    """A. E. H. Love, Mathematical Theory of Elasticity, § 270-271: with the torsion τ and curvature
    κ of the loaded helix, m = B(κ − κ₀) b + B₃(τ − τ₀) t, F = (B₃(τ − τ₀)κ − B(κ − κ₀)τ)/κ (τ t +
    κ b).
    """
    rod, torsional = spatial(helical(CURVATURE, TWIST), 20), 1 / 1.3
    for kappa, tau in ((1.5, 2.5), (3.0, 0.8)):
        bend, turn = kappa - CURVATURE, torsional * (tau - TWIST)
        darboux = np.array([0.0, kappa, tau])
        push = Push((turn * kappa - bend * tau) / kappa * darboux, np.array([0.0, bend, turn]))
        line = rod.line(AT_ORIGIN, push)
        np.testing.assert_allclose(line.reach, helix(line.nodes, kappa, tau), atol=CLOSE)


def heavy_tip(weight: float) -> tuple[np.ndarray, float, float]:
    """Tip (across, along), its slope, and the moment at the clamp of a level cantilever under its
    own weight: θ'' = −q σ cos θ with the arc length σ from the tip, as power series in σ with 40
    digits; θ(1) = 0 fixes the slope at the tip.

    F. V. Rohde, Quarterly of Applied Mathematics 11 (1953) 337-338.
    """
    terms = 120

    def series(end: mpmath.mpf) -> tuple[list, list, list]:
        theta, cosine, sine = [end, mpmath.mpf(0)], [mpmath.cos(end)], [mpmath.sin(end)]
        for n in range(terms):
            # θ'' = q σ cos θ, seen from the tip, where θ is the slope downwards less than at it.
            source = -weight * cosine[n - 1] if n else mpmath.mpf(0)
            theta.append(source / ((n + 1) * (n + 2)))
            rates = [(j + 1) * theta[j + 1] for j in range(n + 1)]
            cosine.append(-sum(rates[j] * sine[n - j] for j in range(n + 1)) / (n + 1))
            sine.append(sum(rates[j] * cosine[n - j] for j in range(n + 1)) / (n + 1))
        return theta, cosine, sine

    with mpmath.workdps(40):
        guess = weight / mpmath.mpf(6) / (1 + mpmath.mpf(weight) / 12)
        end = mpmath.findroot(lambda end: mpmath.fsum(series(end)[0]), (guess, guess * 1.05))
        theta, cosine, sine = series(end)
        assert abs(cosine[-2]) + abs(cosine[-1]) < 1e-12

        def whole(part: list) -> float:
            return float(mpmath.fsum(c / (n + 1) for n, c in enumerate(part)))

        moment = -mpmath.fsum(n * c for n, c in enumerate(theta))
        return np.array([whole(sine), whole(cosine)]), float(end), float(moment)


@pytest.mark.parametrize("weight", [0.5, 3.0, 8.0])
def test_a_heavy_rod_sags_as_the_heavy_elastica(weight: float) -> None:
    """Tip, slope there, and what the clamp feels in a scan that touches nothing."""
    down, end, base = heavy_tip(weight)
    rod = vb.Rod(length=1.0, bending_stiffness=1.0, linear_density=weight, units="model").loaded(
        vb.Loads(gravity=(0.0, 0.0, -1.0))
    )
    level = Clamp(np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0]))
    line = eqx.filter_jit(spatial(rod, STEPS).free)(level).line
    np.testing.assert_allclose(line.reach[-1], [down[1], 0, -down[0]], rtol=CLOSE, atol=1e-13)
    tangent = line.tangent[-1]
    np.testing.assert_allclose(np.arctan2(-tangent[2], tangent[0]), end, rtol=CLOSE)
    trail = vb.Trail.line(start=(0, 0, 0), stop=(0, 0.1, 0), count=2, axis=(1.0, 0.0, 0.0))
    scan = vb.scan(rod, vb.surfaces.Sphere(center=(0.0, 0.0, 5.0), radius=1.0), trail)
    np.testing.assert_allclose(scan.reactions.force, [[0, 0, weight]] * 2, rtol=CLOSE, atol=1e-12)
    np.testing.assert_allclose(scan.reactions.moment, [[0, -base, 0]] * 2, rtol=CLOSE, atol=1e-12)


def buckling_load(rod: Kirchhoff, near: float) -> float:
    """Least load along the rod under which a deflection of its tip needs no force: the lateral gap
    between a tip point and the rod that its load bends is stationary.
    """

    @partial(compiled, quick=True)
    def stiffness(load: jax.Array) -> jax.Array:
        def gap(aside: jax.Array) -> jax.Array:
            tip, push = jnp.array([1.0, 0.0, 0.0]) * aside, jnp.array([0.0, 0.0, -1.0]) * load
            tip = tip + jnp.array([0.0, 0.0, 1.0])
            return rod.line(AT_ORIGIN, Push(push, jnp.cross(tip, push))).reach[-1, 0] - aside

        return jax.jacfwd(gap)(jnp.zeros(()))

    return float(brentq(lambda load: float(stiffness(load)), 0.7 * near, 1.3 * near, xtol=1e-13))


@pytest.mark.parametrize("taper", [0.0, 0.3, 0.6, 0.9])
def test_columns_buckle_at_the_loads_of_euler_and_dinnik(taper: float) -> None:
    """I = (1 − τs)⁴, the thin end free: tan(√P/(1 − τ)) = −√P/τ (A. N. Dinnik, 1929; J. M. Gere, W.
    O. Carter, Critical buckling loads for tapered columns, ASCE 1962); π²/4 for τ = 0.
    """
    exact = np.pi**2 / 4
    if taper:
        thin = 1 - taper
        least = brentq(lambda root: root / thin - np.pi + np.arctan(root / taper), 0, 4, xtol=1e-15)
        exact = least**2
    # Young's modulus for EI = 1.
    rod = vb.Rod.tapered(
        length=1.0,
        base_radius=0.01,
        tip_radius=0.01 * (1 - taper),
        youngs_modulus=4 / np.pi * 1e8,
    )
    np.testing.assert_allclose(buckling_load(spatial(rod, STEPS), exact), exact, rtol=CLOSE)


def test_a_column_of_linear_stiffness_buckles_at_a_zero_of_bessel_functions() -> None:
    """I = 1 − τs, from a table: J₀(2β) Y₁(2β√c) = Y₀(2β) J₁(2β√c) with c = 1 − τ and β = √P/τ
    (Dinnik, as above).
    """
    taper = 0.7

    def off(load: float) -> float:
        a = 2 * np.sqrt(load) / taper
        b = a * np.sqrt(1 - taper)
        return float(jv(0, a) * yv(1, b) - yv(0, a) * jv(1, b))

    exact = brentq(off, 1.2, 2.4, xtol=1e-15)
    stiffness = np.array([1.0, 1.0 - taper])
    rod = vb.Rod.from_table(
        arc_length=[0.0, 1.0], bending_stiffness=stiffness, torsional_stiffness=stiffness
    )
    np.testing.assert_allclose(buckling_load(spatial(rod, STEPS), exact), exact, rtol=CLOSE)


def critical_weight(rod: vb.Rod, near: float) -> float:
    """Least acceleration under which a rod that stands on its clamp leans under no force: the
    resultants that leave nothing at its tip are no longer unique.
    """

    @partial(compiled, quick=True)
    def stiffness(weight: jax.Array) -> jax.Array:
        heavy = spatial(rod.loaded(vb.Loads(gravity=weight * jnp.array([0.0, 0.0, -1.0]))), STEPS)

        def tip(moment: jax.Array) -> jax.Array:
            base = jnp.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]) * total * weight
            base = base + jnp.array([0.0, 0.0, 0.0, 0.0, 1.0, 0.0]) * moment
            return heavy.line(AT_ORIGIN, Push(jnp.zeros(3), jnp.zeros(3)), base).states.load[-1, 4]

        return jax.jacfwd(tip)(jnp.zeros(()))

    x, share = np.polynomial.legendre.leggauss(8)
    total = float(share @ np.asarray(rod.linear_density_at((1 + x) / 2))) / 2
    return float(brentq(lambda load: float(stiffness(load)), 0.8 * near, 1.2 * near, xtol=1e-12))


def test_a_mast_buckles_under_the_weight_of_greenhill() -> None:
    """The weight q L³/EI = 9/4 j², j = 1.8663 the first zero of J₋₁/₃: 7.8373 (A. G. Greenhill, Proceedings of
    the Cambridge Philosophical Society 4 (1881) 65-73).
    """
    zero = brentq(lambda x: float(jv(-1 / 3, x)), 1.5, 2.2, xtol=1e-15)
    exact = 9 / 4 * zero**2
    assert round(exact, 4) == 7.8373
    rod = vb.Rod(length=1.0, bending_stiffness=1.0, linear_density=1.0, units="model")
    np.testing.assert_allclose(critical_weight(rod, exact), exact, rtol=CLOSE)


def test_a_cone_buckles_under_its_own_weight() -> None:
    """A cone of height 1 and radius c at its tip: with x from the apex in units of the whole cone's
    height, (x⁴ θ')' + q/3 (x³ − c³) θ = 0, θ' = 0 at c, θ = 0 at 1. For c → 0 Greenhill's (as above)
    3/4 j² with j the first zero of J₃.
    """
    thin = 0.01

    def slope_at_base(weight: float) -> float:
        def rates(x: float, y: np.ndarray) -> list[float]:
            return [y[1] / x**4, -weight / 3 * (x**3 - thin**3) * y[0]]

        end = solve_ivp(rates, (thin, 1), [1.0, 0.0], "DOP853", rtol=1e-13, atol=1e-16)
        return float(end.y[0, -1])

    whole = 3 / 4 * jn_zeros(3, 1)[0] ** 2
    exact = brentq(slope_at_base, 0.9 * whole, 1.1 * whole, xtol=1e-13)
    np.testing.assert_allclose(exact, whole, rtol=100 * thin**3)
    rod = vb.Rod.tapered(
        length=1.0,
        base_radius=0.01,
        tip_radius=0.01 * thin,
        youngs_modulus=4 / np.pi * 1e8,
        density=1e4 / np.pi,
    )
    # The whole cone is higher than the rod is long.
    exact *= (1 - thin) ** 3
    np.testing.assert_allclose(critical_weight(rod, exact), exact, rtol=CLOSE)
