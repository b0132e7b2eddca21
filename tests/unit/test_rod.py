"""The rod: stiffness, scales and first natural frequency."""

import re

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import vibrissa as vb

WIRE = vb.Rod.cylinder(length=0.05, radius=0.25e-3, youngs_modulus=206e9, density=7850.0)


def test_stiffness_is_modulus_times_second_moment_of_area() -> None:
    second_moment = quad(
        lambda y: 2 * y * y * np.sqrt(0.25e-3**2 - y * y), -0.25e-3, 0.25e-3, epsabs=0
    )[0]
    assert WIRE.bending_stiffness == pytest.approx(206e9 * second_moment, rel=1e-8)


def test_scales_are_those_of_eq_1() -> None:
    assert WIRE.force_scale * WIRE.length == pytest.approx(WIRE.moment_scale, rel=1e-15)
    assert WIRE.moment_scale * WIRE.length == pytest.approx(WIRE.bending_stiffness, rel=1e-15)
    unit = vb.Rod.unit()
    assert (unit.length, unit.bending_stiffness, unit.force_scale, unit.moment_scale) == (
        1,
        1,
        1,
        1,
    )


def test_first_frequency_of_the_clamped_beam() -> None:
    """Cos β cosh β = −1, ω = β² √(EI/ρA)/L², and √(I/A) = r/2."""
    beta = brentq(lambda b: np.cos(b) * np.cosh(b) + 1, 1, 3, xtol=1e-14)
    omega = beta**2 * 0.125e-3 * np.sqrt(206e9 / 7850.0) / 0.05**2
    assert WIRE.first_natural_frequency() == pytest.approx(omega / (2 * np.pi), rel=1e-12)


def test_a_frequency_needs_a_density() -> None:
    with pytest.raises(ValueError, match=r"linear_density = None"):
        vb.Rod.unit().first_natural_frequency()


@pytest.mark.parametrize("value", [0.0, -0.05, float("nan"), float("inf")])
@pytest.mark.parametrize(
    "name", ["length", "bending_stiffness", "radius", "linear_density", "yield_strain"]
)
def test_figures_are_positive_and_finite(name: str, value: float) -> None:
    figures = {"length": 0.05, "bending_stiffness": 1e-3, "radius": 1e-3, name: value}
    with pytest.raises(
        ValueError, match=rf"^{name} = {value}; allowed is a finite number greater than 0$"
    ):
        vb.Rod(**figures)


@pytest.mark.parametrize("value", [True, "0.05"])
def test_truth_values_and_texts_are_no_numbers(value: object) -> None:
    with pytest.raises(ValueError, match=rf"^length = {value!r}; allowed is a finite number"):
        vb.Rod.cylinder(length=value, radius=1e-3, youngs_modulus=2e11)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["length", "radius", "youngs_modulus", "density", "yield_strain"])
def test_figures_of_a_wire_are_positive(name: str) -> None:
    figures = {"length": 0.05, "radius": 1e-3, "youngs_modulus": 2e11, name: -1.0}
    with pytest.raises(
        ValueError, match=rf"^{name} = -1.0; allowed is a finite number greater than 0$"
    ):
        vb.Rod.cylinder(**figures)


def test_a_yield_strain_needs_a_radius() -> None:
    with pytest.raises(ValueError, match=r"yield_strain = 0.01: needs radius"):
        vb.Rod(0.05, 1e-3, yield_strain=0.01)


@pytest.mark.parametrize(
    ("part", "value", "noun"),
    [
        ("section", 0.5, "Section"),
        ("rest", 3, "RestShape"),
        ("loads", (0, 0, -9.81), "Loads"),
        ("support", 0.1, "Support"),
        ("thermal", (1e-4, 1e-5), "Thermal"),
    ],
)
def test_a_part_of_another_type_is_named(part: str, value: object, noun: str) -> None:
    message = rf"^{part} = {re.escape(repr(value))}; allowed is a vibrissa.{noun}, or None$"
    # As without the tests' own shape checks, which refuse it first.
    rod = object.__new__(vb.Rod)
    vars(rod).update(vars(WIRE) | {part: value})
    with pytest.raises(TypeError, match=message):
        rod.__post_init__()


def test_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        WIRE.length = 1.0
