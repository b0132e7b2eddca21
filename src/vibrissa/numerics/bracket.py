"""Bracketed root of a scalar function, traceable and batchable."""

from collections.abc import Callable
from typing import TypeAlias, TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

Scalar = Float[Array, ""]
Found = TypeVar("Found")
_State: TypeAlias = tuple[Scalar, tuple[Scalar, Scalar], tuple[Scalar, Scalar], Found, Found, Array]

_MOST_EVALUATIONS = 80
_WIDTH = 4e-16
_VALUE = 1e-14


def bracketed_root(
    function: Callable[[Scalar, Found], tuple[Scalar, Found]],
    ends: tuple[Scalar, Scalar],
    values: tuple[Scalar, Scalar],
    found: tuple[Found, Found],
) -> tuple[Scalar, Found]:
    """Root of a function between two ends at which its values have opposite signs.

    Parameters
    ----------
    function
        Of a point and a guess, interpolated between what was found at the ends of the bracket;
        returns a value, and what it found on the way to it. It appears once in the compiled loop.
    ends, values
        The bracket and the function's values there.
    found
        What goes with the ends; an array, or a tree of arrays.

    Returns
    -------
    tuple
        The root, and what the function found there. Without a change of sign, the end with the
        smaller value.

    Notes
    -----
    Chandrupatla's method (Adv. Eng. Softw. 28, 1997): inverse quadratic interpolation where three
    values allow it, else bisection; here begun with a secant. It ends where the value has fallen to
    1e-14 of the values given, or the bracket to its last digits.
    """
    small = _VALUE * jnp.maximum(jnp.abs(values[0]), jnp.abs(values[1]))

    def unfinished(state: _State[Found]) -> Array:
        _, (f, f_other), (x, other), _, _, count = state
        wide = (
            (jnp.abs(other - x) > _WIDTH * (1 + jnp.abs(x)))
            & (jnp.abs(f) > small)
            & (f * f_other < 0)
        )
        return (count == 0) | (wide & (count < _MOST_EVALUATIONS))

    def step(state: _State[Found]) -> _State[Found]:
        # x is the newest point, `other` the end of opposite sign: the next one lies the share t of
        # the way between them.
        t, (f1, f2), (x1, x2), at_1, at_2, count = state
        x = x1 + t * (x2 - x1)
        f, at = function(
            x, jax.tree.map(lambda first, second: first + t * (second - first), at_1, at_2)
        )
        same = f * f1 > 0
        x3, f3 = jnp.where(same, x1, x2), jnp.where(same, f1, f2)
        x2, f2 = jnp.where(same, x2, x1), jnp.where(same, f2, f1)
        at_2 = jax.tree.map(lambda kept, passed: jnp.where(same, kept, passed), at_2, at_1)
        return _share((x, x2, x3), (f, f2, f3)), (f, f2), (x, x2), at, at_2, count + 1

    secant = values[0] / (values[0] - values[1])
    nearer = jnp.where(jnp.abs(values[0]) <= jnp.abs(values[1]), 0.0, 1.0)
    start = jnp.where(values[0] * values[1] < 0, secant, nearer)
    _, _, (root, _), at_root, _, _ = lax.while_loop(
        unfinished, step, (start, values, ends, *found, jnp.zeros((), dtype=jnp.int64))
    )
    return root, at_root


def _share(x: tuple[Scalar, Scalar, Scalar], f: tuple[Scalar, Scalar, Scalar]) -> Scalar:
    """How far to go from the newest point to the other end: by inverse quadratic interpolation
    where it is safe, else half.
    """
    (x1, x2, x3), (f1, f2, f3) = x, f
    xi, phi = (x1 - x2) / (x3 - x2), (f1 - f2) / (f3 - f2)
    quadratic = f1 / (f2 - f1) * f3 / (f2 - f3) + (x3 - x1) / (x2 - x1) * f1 / (f3 - f1) * f2 / (
        f3 - f2
    )
    safe = (phi * phi < xi) & ((1 - phi) ** 2 < 1 - xi)
    least = _WIDTH / jnp.maximum(jnp.abs(x2 - x1), _WIDTH)
    return jnp.where(safe & jnp.isfinite(quadratic), jnp.clip(quadratic, least, 1 - least), 0.5)
