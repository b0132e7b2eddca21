"""Bracketed roots, also of functions that mislead a secant."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

from vibrissa.numerics.bracket import bracketed_root


def bracketed(
    function: Callable[[jax.Array], jax.Array], a: jax.Array, b: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Root, and its double as what was found there."""
    return bracketed_root(
        lambda x, _: (function(x), 2 * x), (a, b), (function(a), function(b)), (2 * a, 2 * b)
    )


def root(function: Callable[[jax.Array], jax.Array], low: float, high: float) -> float:
    found, double = jax.jit(lambda a, b: bracketed(function, a, b))(
        jnp.asarray(low), jnp.asarray(high)
    )
    assert float(double) == 2 * float(found)
    return float(found)


def test_the_guess_is_interpolated_between_the_ends_of_the_bracket() -> None:
    """Of a straight line, whatever the function does, the guess is the line itself."""
    worst = jnp.zeros(())

    def value(
        x: jax.Array, guess: tuple[jax.Array, jax.Array]
    ) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        line, error = guess
        return jnp.exp(x) - 2, (3 * x - 1, jnp.maximum(jnp.abs(line - (3 * x - 1)), error))

    ends = (jnp.zeros(()), jnp.ones(()))
    found, (_, error) = bracketed_root(
        value,
        ends,
        (jnp.asarray(-1.0), jnp.exp(1.0) - 2),
        ((jnp.asarray(-1.0), worst), (jnp.asarray(2.0), worst)),
    )
    assert float(found) == pytest.approx(np.log(2), abs=1e-14)
    assert float(error) < 1e-14


SMOOTH = {
    "cosine": (jnp.cos, 0.0, 3.0, np.pi / 2),
    "falling line": (lambda x: 1 - 3 * x, 0.0, 1.0, 1 / 3),
    "first contact, f ~ √x": (
        lambda x: jnp.sqrt(jnp.maximum(x - 0.2, 0)) - jnp.sqrt(jnp.maximum(0.2 - x, 0)),
        0.0,
        1.0,
        0.2,
    ),
    "exponential": (lambda x: jnp.exp(8 * x) - jnp.exp(2.4), 0.0, 1.0, 0.3),
    "bracket given backwards": (lambda x: x**3 - 0.1, 1.0, 0.0, 0.1 ** (1 / 3)),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_known_roots(name: str) -> None:
    function, low, high, exact = SMOOTH[name]
    assert root(function, low, high) == pytest.approx(exact, abs=1e-13)


@pytest.mark.parametrize("ratio", [1.5, 5.0, 100.0, 0.01])
def test_a_kink_at_the_root_costs_no_digits(ratio: float) -> None:
    """As where contact changes from tip to tangential: another branch, another slope."""
    found = root(lambda x: jnp.where(x < 0.7, 0.7 - x, ratio * (0.7 - x)), 0.0, 1.0)
    assert found == pytest.approx(0.7, abs=1e-11)


def test_agrees_with_brent_in_a_batch() -> None:
    levels = np.linspace(0.01, 0.99, 50)

    def one(c: jax.Array) -> jax.Array:
        def value(x: jax.Array) -> jax.Array:
            return x * jnp.exp(x - 1) - c

        return bracketed(value, jnp.zeros(()), jnp.ones(()))[0]

    exact = [brentq(lambda x, c=c: x * np.exp(x - 1) - c, 0, 1, xtol=1e-15) for c in levels]
    np.testing.assert_allclose(
        jax.jit(jax.vmap(one))(jnp.asarray(levels)), exact, rtol=0, atol=1e-13
    )


def test_a_jump_is_located_to_the_last_digits() -> None:
    """A figure that jumps over zero has no root, but a place where its sign changes."""
    assert root(lambda x: jnp.where(x < 0.123456789, -1.0, 1.0), 0.0, 1.0) == pytest.approx(
        0.123456789, abs=1e-9
    )


def test_a_root_at_an_end_is_that_end() -> None:
    assert root(lambda x: x, 0.0, 1.0) == 0.0
    assert root(lambda x: 1 - x, 0.0, 1.0) == 1.0


def test_without_a_change_of_sign_the_end_nearer_to_zero_is_returned() -> None:
    assert root(lambda x: 1 + x, 0.0, 1.0) == 0.0
    assert root(lambda x: x - 3, 0.0, 1.0) == 1.0
