"""Fields of objects: converted and checked when an object is built."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry import checks


def _checked(check: Callable[[Any, str], Any], name: str, kind: str) -> Any:
    def convert(value: Any) -> Any:
        return check(value, name)

    # What the signature of the class shows.
    convert.__annotations__["value"] = kind
    return eqx.field(converter=convert)


def number(name: str) -> Any:
    """Finite number."""
    return _checked(checks.finite, name, "float")


def size(name: str) -> Any:
    """Finite number greater than 0."""
    return _checked(checks.positive, name, "float")


def place(name: str) -> Any:
    """Finite vector (3,)."""
    return _checked(partial(checks.finite_array, last=3, ndim=1), name, "Vector3")


def direction(name: str) -> Any:
    """Vector (3,) that is not zero, scaled to length 1."""
    return _checked(checks.unit_vector, name, "Vector3")


def sizes(name: str, count: int = 3, most: float = np.inf) -> Any:
    """Vector of finite numbers greater than 0, and at most `most`."""
    limit = "" if most == np.inf else f" and at most {most:g}"

    def check(value: ArrayLike, name: str) -> Float[np.ndarray, "n"]:
        array = checks.finite_array(value, name, last=count, ndim=1)
        for index, entry in enumerate(array.tolist()):
            if not 0 < entry <= most:
                kind = "number" if limit else "finite number"
                raise ValueError(
                    f"{name}[{index}] = {entry!r}; allowed is a {kind} greater than 0{limit}"
                )
        return array

    return _checked(check, name, f"Vector{count}")
