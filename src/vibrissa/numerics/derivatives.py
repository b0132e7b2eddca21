"""Derivatives of functions of a few numbers, with whatever else these functions tell."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.numerics.linear import solve_small
from vibrissa.numerics.rows import row_of, with_row

Scalar = Float[Any, ""]
Value = TypeVar("Value")
Told = TypeVar("Told")

CHANGE = 1e-8
"""Change of an argument of order one by which a function is differentiated: the root of rounding.
"""


def exact(
    function: Callable[[Float[Array, "k"]], tuple[Value, Told]],
    x: Float[Array, "k"],
    **_: Any,
) -> tuple[Value, tuple[Value, Told]]:
    """Derivatives (…, k) of the first part (…) of what a function returns at x; and all that it
    returns there. Arguments of `by_differences` that say how are ignored.
    """

    def both(x: Float[Array, "k"]) -> tuple[Value, tuple[Value, Told]]:
        value, told = function(x)
        return value, (value, told)

    found: tuple[Value, tuple[Value, Told]] = jax.jacfwd(both, has_aux=True)(x)
    return found


def by_differences(
    function: Callable[[Float[Array, "k"]], tuple[Value, Told]],
    x: Float[Array, "k"],
    *,
    change: Scalar | float = CHANGE,
    count: Int[Any, ""] | int | None = None,
    about: Float[Array, "k"] | None = None,
) -> tuple[Value, tuple[Value, Told]]:
    """The same to some six digits: for spatial rods as fast as exact derivatives, and a third of
    the code to compile. With respect to the first `count` arguments only, the others zero; `about`
    is where derivatives are taken, if not at x itself.
    """
    last = len(x) if count is None else count
    start = x if about is None else about
    places = start + change * jnp.eye(len(x) + 1, len(x), -1)
    if about is not None:
        places, last = jnp.concatenate([x[None], places]), last + 1

    def put(index: Array, so_far: tuple[Value, Told]) -> tuple[Value, Told]:
        # Backwards, so that what is told at x itself comes last.
        row = last - index
        value, told = function(row_of(places, row))
        return with_row(so_far[0], value, row), told

    value, told = jax.tree.map(
        lambda part: jnp.zeros(part.shape, part.dtype), jax.eval_shape(function, x)
    )
    blank = jax.tree.map(lambda part: jnp.zeros((len(places), *part.shape)), value), told
    rows, told = lax.fori_loop(0, last + 1, put, blank)
    first = len(places) - len(x)
    asked = jnp.arange(first, len(places)) <= last
    slopes = jax.tree.map(
        lambda part: jnp.moveaxis(part[first:] - part[first - 1], 0, -1) * asked / change, rows
    )
    return slopes, (jax.tree.map(lambda part: part[0], rows), told)


def implicit(by_unknowns: Float[Array, "n n"], by_parameters: Any) -> Any:
    """Derivatives of a root x of R(x, θ), dx/dθ = −(∂R/∂x)⁻¹ ∂R/∂θ, from a tree of ∂R/∂θ (n, …)."""

    def column(right: Float[Array, "n"]) -> Float[Array, "n"]:
        return -solve_small(by_unknowns, right)[0]

    return jax.tree.map(jax.vmap(column, in_axes=1, out_axes=1), by_parameters)
