"""Surfaces given by a function that the user writes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from vibrissa.surfaces.base import Function, Point, Scalar, Surface


class HeightField(Surface):
    """The solid above z = C(x, y) (paper, section II); the function takes x and y and must be
    traceable by JAX.
    """

    height: Callable[[Scalar, Scalar], Scalar] = eqx.field(static=True)

    def __check_init__(self) -> None:
        """Reject anything but such a function."""
        _check(self.height, "height", jnp.zeros(()), jnp.zeros(()))

    def level(self, point: Point) -> Scalar:
        """C(x, y) − z."""
        return self.height(point[0], point[1]) - point[2]


class Implicit(Surface):
    """A solid given by its level function of a point (3,): positive outside, traceable by JAX."""

    function: Function = eqx.field(static=True)

    def __check_init__(self) -> None:
        """Reject anything but such a function."""
        _check(self.function, "function", jnp.zeros(3))

    def level(self, point: Point) -> Scalar:
        """The function itself."""
        return self.function(point)


def _check(function: Callable[..., Any], name: str, *arguments: Array) -> None:
    """Raise ValueError unless JAX can trace the function to one real number."""
    try:
        shape = jax.eval_shape(function, *arguments)
    except Exception as error:
        raise ValueError(
            f"{name}: {function!r} cannot be traced by JAX ({error}); allowed is a function of "
            "jax.numpy operations"
        ) from error
    if getattr(shape, "shape", None) != () or not jnp.issubdtype(shape.dtype, jnp.floating):
        raise ValueError(f"{name}: {function!r} returns {shape}; allowed is one real number")
