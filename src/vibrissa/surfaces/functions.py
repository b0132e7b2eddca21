"""Surfaces given by a function of the user's."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from vibrissa.surfaces.base import Point, Scalar, Surface

HeightFunction = Callable[[Scalar, Scalar], Scalar]
LevelFunction = Callable[[Point], Scalar]
Function = TypeVar("Function", bound=Callable[..., Scalar])


def _scalar_function(function: Function, name: str, *arguments: Float[Array, "..."]) -> Function:
    """Return the function; raise ValueError unless JAX can trace it to one real number."""
    try:
        shape = jax.eval_shape(function, *arguments)
    except Exception as error:
        raise ValueError(
            f"{name}: {function!r} cannot be traced by JAX ({error}); allowed is a function of "
            "jax.numpy operations"
        ) from error
    if getattr(shape, "shape", None) != () or not jnp.issubdtype(shape.dtype, jnp.floating):
        raise ValueError(f"{name}: {function!r} returns {shape}; allowed is one real number")
    return function


class HeightField(Surface):
    """The solid above z = C(x, y) (paper, section II); the function takes x and y and must be
    traceable by JAX.
    """

    height: HeightFunction = eqx.field(static=True)

    def __init__(self, height: HeightFunction) -> None:
        self.height = _scalar_function(height, "height", jnp.zeros(()), jnp.zeros(()))

    def level(self, point: Point) -> Scalar:
        """C(x, y) − z."""
        return self.height(point[0], point[1]) - point[2]


class Implicit(Surface):
    """A solid by its level function of a point (3,): positive outside, traceable by JAX."""

    function: LevelFunction = eqx.field(static=True)

    def __init__(self, function: LevelFunction) -> None:
        self.function = _scalar_function(function, "function", jnp.zeros(3))

    def level(self, point: Point) -> Scalar:
        """The function itself."""
        return self.function(point)
