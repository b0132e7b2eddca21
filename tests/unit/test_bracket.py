"""Bracketed roots, also of functions that mislead a secant."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import brentq

from vibrissa.numerics.bracket import roots

Function = Callable[[np.ndarray], np.ndarray]


def root(function: Function, low: float, high: float) -> float:
    ends = np.array([low]), np.array([high])
    return float(roots(lambda x, _: function(x), ends, tuple(map(function, ends)))[0])


SMOOTH = {
    "cosine": (np.cos, 0.0, 3.0, np.pi / 2),
    "falling line": (lambda x: 1 - 3 * x, 0.0, 1.0, 1 / 3),
    "first contact, f ~ √x": (
        lambda x: np.sqrt(np.maximum(x - 0.2, 0)) - np.sqrt(np.maximum(0.2 - x, 0)),
        0.0,
        1.0,
        0.2,
    ),
    "exponential": (lambda x: np.exp(8 * x) - np.exp(2.4), 0.0, 1.0, 0.3),
    "bracket given backwards": (lambda x: x**3 - 0.1, 1.0, 0.0, 0.1 ** (1 / 3)),
}


@pytest.mark.parametrize("name", SMOOTH)
def test_known_roots(name: str) -> None:
    function, low, high, exact = SMOOTH[name]
    assert root(function, low, high) == pytest.approx(exact, abs=1e-13)


@pytest.mark.parametrize("ratio", [1.5, 5.0, 100.0, 0.01])
def test_a_kink_at_the_root_costs_no_digits(ratio: float) -> None:
    """As where contact changes from tip to tangential: another branch, another slope."""
    found = root(lambda x: np.where(x < 0.7, 0.7 - x, ratio * (0.7 - x)), 0.0, 1.0)
    assert found == pytest.approx(0.7, abs=1e-11)


def test_each_row_has_its_own_root() -> None:
    levels = np.linspace(0.01, 0.99, 50)
    ends = np.zeros(50), np.ones(50)
    found = roots(lambda x, row: x * np.exp(x - 1) - levels[row, None], ends, (-levels, 1 - levels))
    exact = [brentq(lambda x, c=c: x * np.exp(x - 1) - c, 0, 1, xtol=1e-15) for c in levels]
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-13)


def test_a_jump_is_located_to_the_last_digits() -> None:
    """A figure that jumps over zero has no root, but a place where its sign changes."""
    assert root(lambda x: np.where(x < 0.123456789, -1.0, 1.0), 0.0, 1.0) == pytest.approx(
        0.123456789, abs=1e-9
    )


def test_a_root_at_an_end_is_that_end() -> None:
    assert root(lambda x: x, 0.0, 1.0) == 0.0
    assert root(lambda x: 1 - x, 0.0, 1.0) == 1.0


def test_without_a_change_of_sign_the_end_nearer_to_zero_is_returned() -> None:
    assert root(lambda x: 1 + x, 0.0, 1.0) == 0.0
    assert root(lambda x: x - 3, 0.0, 1.0) == 1.0


def test_a_function_that_is_not_finite_on_the_way_leaves_the_bracket_so_far() -> None:
    found = root(lambda x: np.where((x > 0.2) & (x < 0.8), np.nan, x - 0.6), 0.0, 1.0)
    assert found == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("function", "most"),
    [
        (lambda x: 3 * x - 1, 2),
        (lambda x: np.sin(x) - 0.4, 4),
        (lambda x: np.where(x < 0.03, np.sin(0.03 - x), 3 * np.sinh(0.03 - x)), 6),
    ],
)
def test_few_rounds_are_enough(function: Function, most: int) -> None:
    calls = []
    ends = np.zeros(1), np.ones(1)

    def counted(x: np.ndarray, _: np.ndarray) -> np.ndarray:
        calls.append(x)
        return function(x)

    roots(counted, ends, tuple(map(function, ends)))
    assert len(calls) <= most


def test_no_rows() -> None:
    nothing = np.zeros(0), np.zeros(0)
    assert roots(lambda x, _: x, nothing, nothing).shape == (0,)
