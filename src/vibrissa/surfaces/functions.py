"""Surfaces given by a function of the user's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from vibrissa.surfaces.base import Checked, Point, Scalar, field

HeightFunction = Callable[[Scalar, Scalar], Scalar]
LevelFunction = Callable[[Point], Scalar]


def _real_function(value: Any, name: str, *shapes: tuple[int, ...]) -> Any:
    """Return the function; raise ValueError unless JAX can trace it to one real number."""
    arguments = (jnp.zeros(shape) for shape in shapes)
    try:
        result = jax.eval_shape(value, *arguments)
    except Exception as error:  # whatever the user's function raises
        raise ValueError(
            f"{name}: {value!r} cannot be traced by JAX ({error}); allowed is a function of "
            "jax.numpy operations"
        ) from error
    if getattr(result, "shape", None) != () or not np.issubdtype(result.dtype, np.floating):
        raise ValueError(f"{name}: {value!r} returns {result}; allowed is one real number")
    return value


class HeightField(Checked):
    """The solid above z = C(x, y) (paper, section II); the function takes x and y and must be
    traceable by JAX.
    """

    height: HeightFunction = field(lambda f, name: _real_function(f, name, (), ()), static=True)

    def level(self, point: Point) -> Scalar:
        """C(x, y) − z."""
        return self.height(point[0], point[1]) - point[2]


class Implicit(Checked):
    """A solid by its level function of a point (3,): positive outside, traceable by JAX."""

    function: LevelFunction = field(lambda f, name: _real_function(f, name, (3,)), static=True)

    def level(self, point: Point) -> Scalar:
        """The function itself."""
        return self.function(point)
