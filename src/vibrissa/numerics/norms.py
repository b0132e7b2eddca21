"""Lengths and powers whose first and second derivatives by JAX stay finite at zero."""

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

Scalar = Float[Array, ""]

TINY = 1e-90
"""Squares of smaller lengths, and their inverses in second derivatives, would leave the range of
floating-point numbers.
"""


def magnitude(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """|x| with the slope 1 at zero."""
    return jnp.where(x < 0, -x, x)


def positive_part(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """max(x, 0) with the slope 0 at zero."""
    return jnp.where(x > 0, x, 0.0)


def norm(*components: Scalar) -> Scalar:
    """Euclidean length of a vector given by its components, with zero derivatives at the origin."""
    square = sum(
        (component * component for component in components[1:]), components[0] * components[0]
    )
    away = square > TINY**2
    return jnp.where(away, jnp.sqrt(jnp.where(away, square, 1.0)), 0.0)


def power(base: Float[Array, "*n"], exponent: Scalar | float) -> Float[Array, "*n"]:
    """x^p for x ≥ 0 and p > 0. For p below 2, except 1, derivatives grow without limit towards
    zero; at zero itself they are set to 0.
    """
    singular = (base < TINY) & (exponent < 2)
    bent = jnp.where(singular, 0.0, jnp.power(jnp.where(singular, 1.0, base), exponent))
    return jnp.where(exponent == 1, base, bent)
