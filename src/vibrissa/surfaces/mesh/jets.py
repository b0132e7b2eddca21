"""Value, gradient and Hessian of functions of a point, up to the order asked for, by the rules of
calculus: half as much code as JAX's own derivatives, compiled in half the time.
"""

from typing import TypeAlias

import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from vibrissa.numerics.lanes import AnyArray
from vibrissa.numerics.norms import TINY
from vibrissa.numerics.vectors import dot

Jet: TypeAlias = tuple[Array, ...]
"""Value (), gradient (3,) and Hessian (3, 3), or the first one or two of them."""
Linear: TypeAlias = tuple[Float[AnyArray, "k"], Float[AnyArray, "k 3"]]
"""A linear function of the point, and its Jacobian."""


def added(first: Jet, second: Jet) -> Jet:
    """Sum."""
    return tuple(a + b for a, b in zip(first, second, strict=True))


def scaled(factor: Float[Array, ""] | float, jet: Jet) -> Jet:
    """A constant multiple."""
    return tuple(factor * part for part in jet)


def picked(condition: Bool[Array, ""], first: Jet, second: Jet) -> Jet:
    """The first where the condition holds, else the second."""
    return tuple(jnp.where(condition, a, b) for a, b in zip(first, second, strict=True))


def times(first: Jet, second: Jet) -> Jet:
    """Product."""
    (a, *da), (b, *db) = first, second
    jet = [a * b, *(a * v + b * u for u, v in zip(da, db, strict=True))]
    if len(jet) > 2:
        jet[2] += _symmetric(da[0], db[0])
    return tuple(jet)


def over(first: Jet, second: Jet) -> Jet:
    """Quotient."""
    (a, *da), (b, *db) = first, second
    quotient = a / b
    jet = [quotient, *((u - quotient * v) / b for u, v in zip(da, db, strict=True))]
    if len(jet) > 2:
        jet[2] -= _symmetric(jet[1], db[0]) / b
    return tuple(jet)


def root(jet: Jet) -> Jet:
    """Square root; its derivatives at zero are set to zero."""
    square, *derivatives = jet
    away = square > TINY**2
    length = jnp.sqrt(jnp.where(away, square, 1.0))
    found = [length, *(part / (2 * length) for part in derivatives)]
    if len(found) > 2:
        found[2] -= _symmetric(found[1], found[1]) / (2 * length)
    return tuple(jnp.where(away, part, 0.0) for part in found)


def product(first: Linear, second: Linear, order: int) -> Jet:
    """Scalar product, up to an order."""
    (a, da), (b, db) = first, second
    jet = [dot(a, b)]
    if order > 0:
        jet.append(mixed(b, da) + mixed(a, db))
    if order > 1:
        half = mixed(da.T, db)
        jet.append(half + half.T)
    return tuple(jet)


def mixed(weights: Float[AnyArray, "*n k"], rows: Float[AnyArray, "k 3"]) -> Float[Array, "*n 3"]:
    """Weighted sum of the rows."""
    return jnp.sum(weights[..., None] * rows, axis=-2)


def _symmetric(a: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, "3 3"]:
    half = a[:, None] * b
    return half + half.T
