"""A rod at another temperature."""

import numpy as np
import pytest

import vibrissa as vb

THERMAL = vb.Thermal(modulus_slope=-3e-4, expansion=1.2e-5, reference=20.0)
WIRE = vb.Rod.cylinder(
    length=0.05, radius=2e-4, youngs_modulus=2e11, density=7850.0, thermal=THERMAL
)


def test_stiffness_and_size_follow_the_temperature() -> None:
    warm = WIRE.at(temperature=70.0)
    stretch = 1 + 50 * 1.2e-5
    modulus = 2e11 * (1 - 50 * 3e-4)
    assert warm.bending_stiffness == pytest.approx(modulus * np.pi / 4 * (2e-4 * stretch) ** 4)
    assert (warm.length, warm.radius) == pytest.approx((0.05 * stretch, 2e-4 * stretch))
    mass = WIRE.linear_density * WIRE.length
    assert warm.linear_density * warm.length == pytest.approx(mass, rel=1e-14)


def test_a_warm_rod_is_a_larger_copy() -> None:
    """Angles stay: κ(s) L is the same at the same fraction of the length, for every shape."""
    x = np.linspace(0, 0.05, 40)
    shapes = (
        vb.RestShape.polynomial((2.0, 100.0)),
        vb.RestShape.parabola(9.0, roll=0.4),
        vb.RestShape.from_components((0, 0.02, 0.05), [[1, 2, 3], [3, 2, 1], [0, 0, 9]]),
        vb.RestShape.from_points(np.stack([0 * x, 9 * x**2, x], axis=1)),
    )
    for rest in shapes[:3]:
        cold = WIRE.curved(rest)
        warm = cold.at(temperature=120.0)
        for share in (0.0, 0.3, 1.0):
            np.testing.assert_allclose(
                warm.length * warm.rest.at(share * warm.length),
                cold.length * cold.rest.at(share * cold.length),
                rtol=1e-12,
            )
    larger = shapes[3].scaled(1.1)
    np.testing.assert_allclose(1.1 * larger.at(0.033), shapes[3].at(0.03), rtol=1e-12)


def test_two_steps_of_temperature_are_one() -> None:
    one, two = WIRE.at(80.0), WIRE.at(-30.0).at(80.0)
    assert two.bending_stiffness == pytest.approx(one.bending_stiffness, rel=1e-13)
    assert two.length == pytest.approx(one.length, rel=1e-14)
    assert WIRE.at(20.0) == WIRE


def test_impossible_temperatures_are_named() -> None:
    with pytest.raises(ValueError, match=r"temperature = 25: thermal = None"):
        vb.Rod(0.05, 1e-3).at(temperature=25)
    with pytest.raises(
        ValueError, match=r"temperature = 4000: Young's modulus would be .* below 3353.33 °C"
    ):
        WIRE.at(temperature=4000)
    with pytest.raises(ValueError, match=r"temperature = -1000; allowed is at least -273.15 °C"):
        WIRE.at(temperature=-1000)
    with pytest.raises(ValueError, match=r"reference = -300.0; allowed is at least -273.15 °C"):
        vb.Thermal(reference=-300.0)
    with pytest.raises(ValueError, match="temperature = nan"):
        WIRE.at(temperature=float("nan"))
    with pytest.raises(ValueError, match="modulus_slope = inf"):
        vb.Thermal(modulus_slope=float("inf"))
