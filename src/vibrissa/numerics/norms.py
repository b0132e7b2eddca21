"""Lengths and powers whose first and second derivatives by JAX stay finite at zero."""

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

Scalar = Float[Array, ""]

# Squares of smaller lengths, and their inverses in second derivatives, would leave the range of the numbers.
_TINY = 1e-90


def magnitude(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """|x| with the slope 1 at zero."""
    return jnp.where(x < 0, -x, x)


def positive_part(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """max(x, 0) with the slope 0 at zero."""
    return jnp.where(x > 0, x, 0.0)


def norm(vector: Float[Array, "n"]) -> Scalar:
    """Euclidean length with zero derivatives at the origin."""
    square = jnp.sum(vector * vector)
    away = square > _TINY**2
    return jnp.where(away, jnp.sqrt(jnp.where(away, square, 1.0)), 0.0)


def power(base: Float[Array, "*n"], exponent: Scalar | float) -> Float[Array, "*n"]:
    """x^p for x ≥ 0 and p ≥ 1. Where p < 2 the second derivative grows without limit towards zero; at zero it is given as 0."""
    singular = (base < _TINY) & (exponent < 2)
    return jnp.where(singular, 0.0, jnp.power(jnp.where(singular, 1.0, base), exponent))


def p_norm(values: Float[Array, "n"], p: Scalar | float) -> Scalar:
    """(Σ x^p)^(1/p) for x ≥ 0 and p ≥ 1, with zero derivatives at the origin. Scaled, so that no power over- or underflows."""
    # ‖x‖ = m ‖x/m‖ for any constant m, so m takes no part in differentiation.
    largest = lax.stop_gradient(jnp.max(values))
    away = largest > _TINY
    scale = jnp.where(away, largest, 1.0)
    total = jnp.sum(power(values / scale, p))
    return jnp.where(away, scale * jnp.power(jnp.where(away, total, 1.0), 1 / p), 0.0)
