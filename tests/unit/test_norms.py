"""Lengths and powers: the textbook value, and derivatives that stay finite at zero."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrissa.numerics.norms import magnitude, norm, positive_part, power


def length(vector: jax.Array) -> jax.Array:
    return norm(*vector)


@pytest.mark.parametrize("vector", [[3.0, -4.0, 0.0], [1e-80, 0.0, 0.0], [1e-5, 2e-5, -2e-5]])
def test_length_and_its_derivatives_away_from_zero(vector: list[float]) -> None:
    v = np.array(vector)
    size = np.linalg.norm(v)
    unit = v / size
    assert float(length(jnp.array(v))) == pytest.approx(size, rel=1e-15)
    np.testing.assert_allclose(jax.grad(length)(jnp.array(v)), unit, rtol=1e-15)
    hessian = (np.eye(3) - np.outer(unit, unit)) / size
    np.testing.assert_allclose(
        jax.hessian(length)(jnp.array(v)), hessian, rtol=1e-12, atol=1e-14 / size
    )


@pytest.mark.parametrize("vector", [[0.0, 0.0, 0.0], [1e-200, 0.0, 0.0], [5e-324, -5e-324, 0.0]])
def test_length_at_the_origin(vector: list[float]) -> None:
    for derivative in (jax.grad(length), jax.hessian(length), jax.jacfwd(jax.jacfwd(length))):
        np.testing.assert_array_equal(derivative(jnp.array(vector)), 0)


@pytest.mark.parametrize(
    ("x", "slopes"), [(-2.0, (-1.0, 0.0)), (0.0, (1.0, 0.0)), (3.0, (1.0, 1.0))]
)
def test_kinks_have_the_slope_of_one_side(x: float, slopes: tuple[float, float]) -> None:
    assert (float(jax.grad(magnitude)(x)), float(jax.grad(positive_part)(x))) == slopes
    assert (float(magnitude(jnp.array(x))), float(positive_part(jnp.array(x)))) == (
        abs(x),
        max(x, 0.0),
    )


@pytest.mark.parametrize("p", [1.0, 1.3, 2.0, 2.5, 40.0])
@pytest.mark.parametrize("x", [0.0, 1e-200, 1e-3, 0.7, 1.0])
def test_powers(x: float, p: float) -> None:
    value, slope, bend = (
        float(f(jnp.array(x), p)) for f in (power, jax.grad(power), jax.grad(jax.grad(power)))
    )
    if x < 1e-90 and 1 < p < 2:  # where the second derivative is infinite, or next to it
        assert (value, slope, bend) == (0, 0, 0)
    else:
        np.testing.assert_allclose([value, slope], [x**p, p * x ** (p - 1)], rtol=1e-13)
        assert bend == pytest.approx(p * (p - 1) * x ** (p - 2) if p != 1 else 0.0, rel=1e-12)
