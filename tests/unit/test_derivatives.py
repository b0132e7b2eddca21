"""Derivatives by differences are those of the functions, where and for what they are asked for."""

import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array

from vibrissa.numerics.derivatives import by_differences, exact

X = jnp.array([0.3, -0.7, 1.2])


def function(x: Array) -> tuple[tuple[Array, Array], Array]:
    return (jnp.sin(x[0]) * x[1], x[1:] ** 2), jnp.sum(x)


@pytest.mark.parametrize("change", [1e-8, -1e-8])
def test_they_are_the_exact_ones_to_six_digits(change: float) -> None:
    slopes, told = by_differences(function, X, change=change)
    expected, same = exact(function, X)
    for part, other in zip(slopes, expected, strict=True):
        np.testing.assert_allclose(part, other, atol=1e-6)
    np.testing.assert_array_equal(told[0][1], same[0][1])
    assert told[1] == same[1]


def test_only_those_asked_for_are_taken() -> None:
    (slope, _), _ = by_differences(function, X, count=1)
    np.testing.assert_allclose(slope, [np.cos(0.3) * -0.7, 0, 0], atol=1e-6)


def test_they_may_be_taken_elsewhere_than_what_is_told() -> None:
    there = X + 0.5
    slopes, (value, total) = by_differences(function, X, about=there)
    np.testing.assert_allclose(slopes[0], exact(function, there)[0][0], atol=1e-6)
    np.testing.assert_array_equal(value[1], function(X)[0][1])
    assert total == function(X)[1]
