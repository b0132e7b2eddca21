"""The rod's shape without load."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import vibrissa as vb

ROD = vb.Rod.cylinder(length=0.05, radius=1e-4, youngs_modulus=3e9)


def line(rest: vb.RestShape, s: np.ndarray) -> np.ndarray:
    """Places (n, 3) by integrating r' = d₃, d_i' = (Σ u_j d_j) × d_i from the clamp's axes."""
    at = jax.jit(rest.at)

    def slope(s: float, state: np.ndarray) -> np.ndarray:
        axes = state[3:].reshape(3, 3)
        turn = np.asarray(at(s)) @ axes
        return np.concatenate([axes[2], np.cross(turn, axes).ravel()])

    start = np.concatenate([np.zeros(3), np.eye(3).ravel()])
    found = solve_ivp(slope, (0, s[-1]), start, t_eval=s, rtol=1e-10, atol=1e-13, method="DOP853")
    return found.y[:3].T


S = np.linspace(0, 0.05, 6)


@pytest.mark.parametrize("roll", [0.0, 0.7, np.pi / 2])
def test_an_arc_bends_towards_its_roll(roll: float) -> None:
    sideways = 0.03 * (1 - np.cos(S / 0.03))
    expected = np.stack(
        [sideways * np.cos(roll), sideways * np.sin(roll), 0.03 * np.sin(S / 0.03)], axis=1
    )
    np.testing.assert_allclose(line(vb.RestShape.arc(0.03, roll), S), expected, atol=1e-11)


@pytest.mark.parametrize("a", [20.0, -8.0, 0.0])
def test_a_parabola_is_one(a: float) -> None:
    place = line(vb.RestShape.parabola(a, roll=0.3), S)
    y = place[:, 0] * np.cos(0.3) + place[:, 1] * np.sin(0.3)
    np.testing.assert_allclose(y, a * place[:, 2] ** 2, atol=1e-11)


def test_a_polynomial_has_its_coefficients_and_a_slope_by_them() -> None:
    rest = vb.RestShape.polynomial((3.0, 200.0, -1e4))
    s = np.array([[0.0, 0.01], [0.02, 0.05]])
    assert rest.at(s).shape == (2, 2, 3)
    np.testing.assert_allclose(rest.at(s)[..., 1], 3 + 200 * s - 1e4 * s**2)
    np.testing.assert_allclose(rest.at(s)[..., [0, 2]], 0.0)
    slope = jax.grad(lambda c: vb.RestShape.polynomial(c).at(0.02)[1])(np.ones(3))
    np.testing.assert_allclose(slope, [1, 0.02, 4e-4])
    assert ROD.curved(vb.RestShape.straight()) == ROD


def test_points_of_a_helix_give_its_curvature_and_come_back() -> None:
    """Radius 10 mm, 8 mm a radian: κ = R/(R² + h²), places on the curve."""
    t = np.linspace(0, 2.5, 25)
    # From the point at t = 0, the tangent (0, R, h) turned to +z.
    place = np.stack([0.01 * np.cos(t) - 0.01, 0.01 * np.sin(t), 0.008 * t], axis=1)
    speed = np.hypot(0.01, 0.008)
    cos, sin = 0.008 / speed, 0.01 / speed
    points = place @ np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]).T
    rest = vb.RestShape.from_points(points)
    inner = speed * np.linspace(0.2, 2.3, 20)
    bend = np.linalg.norm(rest.at(inner), axis=1)
    np.testing.assert_allclose(bend, 0.01 / speed**2, rtol=1e-4)
    np.testing.assert_allclose(line(rest, speed * t), points, atol=2e-7)
    assert rest.breaks == ()
    rod = vb.Rod.cylinder(length=2.5 * speed, radius=1e-4, youngs_modulus=3e9).curved(rest)
    assert not rod.plain
    assert rod.uniform


def test_points_of_a_straight_rod_are_straight() -> None:
    rest = vb.RestShape.from_points([[0, 0, 0.01 * k] for k in range(5)])
    np.testing.assert_allclose(rest.at(S), 0.0, atol=1e-9)


def test_components_are_linear_between_entries_and_know_their_kinks() -> None:
    s, u = (0.0, 0.01, 0.03, 0.05), np.array([[1, 0, 5], [2, 0, 5], [4, 0, 5], [0, 8, 5.0]])
    rest = vb.RestShape.from_components(s, u)
    np.testing.assert_allclose(rest.at([0.02, 0.04]), [[3, 0, 5], [2, 4, 5]], rtol=1e-14)
    assert rest.breaks == pytest.approx([0.6])
    rod = vb.Rod.from_table(
        arc_length=(0, 0.03, 0.04, 0.05), radius=(3e-4, 2e-4, 2e-4, 1e-4), youngs_modulus=1e9
    )
    assert rod.curved(rest).breaks == pytest.approx([0.6, 0.8])
    # A calibrated length moves what is at a fraction of it, not what is at an arc length.
    longer = replace(rod.curved(rest), length=0.051)
    assert longer.breaks == pytest.approx([0.03 / 0.051, 0.6, 0.8])


def test_twist_turns_the_plane_of_bending() -> None:
    """Equal curvature and twist about a fixed axis: a helix about u."""
    u = np.array([0.0, 30.0, 30.0])
    place = line(vb.RestShape.from_components((0, 0.05), [u, u]), S)
    along = place @ u / np.linalg.norm(u)
    np.testing.assert_allclose(along, S * np.sqrt(0.5), atol=1e-11)


def test_values_are_compared_and_hashed() -> None:
    one, two = (ROD.curved(vb.RestShape.polynomial((1.0, 2.0), roll=0.1)) for _ in range(2))
    assert one == two
    assert hash(one) == hash(two)
    assert one != ROD.curved(vb.RestShape.polynomial((1.0, 2.1), roll=0.1))


@pytest.mark.parametrize(
    "radius", [0.05 / (2 * np.pi), 0.05 / (2 * np.pi) - 2e-4, 0.05 / 6.0, 0.05 / 9.5, 1e-3]
)
def test_a_rod_that_would_touch_itself_is_refused(radius: float) -> None:
    thick = vb.Rod.cylinder(length=0.05, radius=2e-3, youngs_modulus=3e9)
    with pytest.raises(ValueError, match="rest: "):
        thick.curved(vb.RestShape.arc(radius))


def test_coils_that_stay_apart_are_allowed() -> None:
    open_ring = vb.RestShape.arc(0.05 / 6.0)
    helix = vb.RestShape.from_components((0, 0.05), [[0, 500.0, 200.0]] * 2)
    for rest in (open_ring, helix):
        assert ROD.curved(rest).rest == rest


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: vb.RestShape.arc(0.0), "radius = 0.0"),
        (lambda: vb.RestShape.arc(0.1, roll=float("nan")), "roll = nan"),
        (lambda: vb.RestShape.parabola(float("inf")), "a = inf"),
        (lambda: vb.RestShape.polynomial((1, float("nan"))), r"coefficients\[1\] = nan"),
        (lambda: vb.RestShape.polynomial([]), r"coefficients = \[\]; allowed is at least one"),
        (lambda: vb.RestShape.from_components((0, 1), np.zeros((3, 3))), "curvature has shape"),
        (lambda: vb.RestShape.from_points(np.zeros((3, 3))), "points has shape"),
        (lambda: vb.RestShape.from_points(np.zeros((4, 3))), r"points\[1\] equals"),
        (
            lambda: vb.RestShape.from_points([[0.1 * k, 0, 0.1 * k] for k in range(5)]),
            "points leave the clamp along .* 45° off",
        ),
        (
            lambda: vb.RestShape.from_points([[0, 0, 0.1 * k + 0.3] for k in range(5)]),
            r"points\[0\] = ",
        ),
        (
            lambda: ROD.curved(vb.RestShape.from_components((0, 0.06), np.zeros((2, 3)))),
            "rest.arc_length: 0.06 long, the rod 0.05",
        ),
    ],
)
def test_impossible_shapes_are_named(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]
