"""Sine and cosine as polynomials: XLA calls the C library for each number in double precision,
which keeps a loop from being vectorised.
"""

import math

from jax import Array
from jaxtyping import Float

# (π/2)^22 / 22! = 2e-17.
_TERMS = 11


def sine(angle: Float[Array, "..."]) -> Float[Array, "..."]:
    """Sine of an angle in [0, π], by Taylor series about π/2; error below 4e-16."""
    offset = angle - math.pi / 2
    return _alternating(offset * offset, [math.factorial(2 * term) for term in range(_TERMS)])


def cosine(angle: Float[Array, "..."]) -> Float[Array, "..."]:
    """Cosine of an angle in [0, π], likewise."""
    offset = angle - math.pi / 2
    return -offset * _alternating(
        offset * offset, [math.factorial(2 * term + 1) for term in range(_TERMS)]
    )


def _alternating(square: Float[Array, "..."], factorials: list[int]) -> Float[Array, "..."]:
    """1/n₀! − x²/n₁! + x⁴/n₂! − …, by Horner's rule."""
    total = square * 0.0
    for term in reversed(range(_TERMS)):
        total = total * square + (-1) ** term / factorials[term]
    return total
