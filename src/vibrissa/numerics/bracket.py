"""Bracketed root of a scalar function, traceable and batchable."""

from collections.abc import Callable

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

Scalar = Float[Array, ""]

_MOST_EVALUATIONS = 80
_WIDTH = 4e-16
_VALUE = 1e-14


def bracketed_root(function: Callable[[Scalar], Scalar], low: Scalar, high: Scalar, value_low: Scalar, value_high: Scalar) -> Scalar:
    """Root of `function` between `low` and `high`, whose values there have opposite signs.

    Illinois steps (regula falsi that halves a value kept twice), every fourth step a bisection, until the value has fallen to 1e-14 of the values given or the
    bracket to the last digits. Superlinear where the function is smooth, and never worse than a quarter of the bisections where it is not. Without a change of
    sign the end with the smaller value is returned.
    """
    small = _VALUE * jnp.maximum(jnp.abs(value_low), jnp.abs(value_high))

    def unfinished(state: tuple[Array, ...]) -> Array:
        a, b, fa, fb, count = state
        return (jnp.abs(b - a) > _WIDTH * (1 + jnp.abs(a))) & (jnp.abs(fb) > small) & (fa * fb < 0) & (count < _MOST_EVALUATIONS)

    def step(state: tuple[Array, ...]) -> tuple[Array, ...]:
        a, b, fa, fb, count = state
        secant = b - fb * (b - a) / (fb - fa)
        inside = (secant - a) * (secant - b) < 0
        c = jnp.where(inside & (count % 4 != 3), secant, (a + b) / 2)
        fc = function(c)
        crossed = fc * fb < 0
        # The newest point is b; a is its partner of opposite sign, with its value halved where it was kept.
        return jnp.where(crossed, b, a), c, jnp.where(crossed, fb, fa / 2), fc, count + 1

    a, b, fa, fb, _ = lax.while_loop(unfinished, step, (low, high, value_low, value_high, jnp.zeros((), dtype=jnp.int64)))
    # A value of a that was halved is not its own, but then b is the better end.
    return jnp.where((jnp.abs(fb) <= small) | (jnp.abs(fb) < jnp.abs(fa)), b, a)
