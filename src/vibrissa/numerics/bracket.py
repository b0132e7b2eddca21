"""Bracketed root of a scalar function, traceable and batchable."""

from collections.abc import Callable
from typing import TypeVar

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

Scalar = Float[Array, ""]
Found = TypeVar("Found")

_MOST_EVALUATIONS = 80
_WIDTH = 4e-16
_VALUE = 1e-14


def bracketed_root(
    function: Callable[[Scalar], tuple[Scalar, Found]], ends: tuple[Scalar, Scalar], values: tuple[Scalar, Scalar], nothing: Found
) -> tuple[Scalar, Found]:
    """Root of a function between two ends at which its values have opposite signs.

    Parameters
    ----------
    function
        Returns a value and whatever was found on the way to it; it appears once in the compiled loop.
    ends, values
        The bracket and the function's values there.
    nothing
        Stands for what is found, before the first evaluation.

    Returns
    -------
    tuple
        The root, and what the function found there. Without a change of sign, the end with the smaller value.

    Notes
    -----
    Illinois steps (regula falsi that halves a value kept twice), every fourth step a bisection, until the value has fallen to 1e-14 of the values given or the
    bracket to the last digits. Superlinear where the function is smooth, and never worse than a quarter of the bisections where it is not.
    """
    small = _VALUE * jnp.maximum(jnp.abs(values[0]), jnp.abs(values[1]))

    def unfinished(state: tuple[Scalar, Scalar, Scalar, Scalar, Found, Array]) -> Array:
        a, b, fa, fb, _, count = state
        wide = (jnp.abs(b - a) > _WIDTH * (1 + jnp.abs(a))) & (jnp.abs(fb) > small) & (fa * fb < 0)
        return (count == 0) | (wide & (count < _MOST_EVALUATIONS))

    def step(state: tuple[Scalar, Scalar, Scalar, Scalar, Found, Array]) -> tuple[Scalar, Scalar, Scalar, Scalar, Found, Array]:
        a, b, fa, fb, _, count = state
        secant = b - fb * (b - a) / (fb - fa)
        inside = (secant - a) * (secant - b) < 0
        c = jnp.where(inside & (count % 4 != 3), secant, (a + b) / 2)
        c = jnp.where(fa * fb < 0, c, jnp.where(jnp.abs(fa) < jnp.abs(fb), a, b))
        fc, found = function(c)
        crossed = fc * fb < 0
        # The newest point is b; a is its partner of opposite sign, with its value halved where it was kept.
        return jnp.where(crossed, b, a), c, jnp.where(crossed, fb, fa / 2), fc, found, count + 1

    start = (*ends, *values, nothing, jnp.zeros((), dtype=jnp.int64))
    _, root, _, _, found, _ = lax.while_loop(unfinished, step, start)
    return root, found
