"""Argument validation: each error names the parameter, the value received and what is allowed."""

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike


def positive(value: float, name: str) -> float:
    """Return `value` as a float; raise ValueError unless it is finite and greater than zero."""
    return _number(value, name, "a finite number greater than 0", lambda number: number > 0)


def not_negative(value: float, name: str) -> float:
    """Return `value` as a float; raise ValueError unless it is finite and at least zero."""
    return _number(value, name, "a finite number of at least 0", lambda number: number >= 0)


def share(value: float, name: str) -> float:
    """Return `value` as a float; raise ValueError unless it lies between 0 and 1."""
    return _number(value, name, "a number between 0 and 1", lambda number: 0 < number < 1)


def finite(value: float, name: str) -> float:
    """Return `value` as a float; raise ValueError unless it is finite."""
    return _number(value, name, "a finite number")


def whole_number(value: int, name: str) -> int:
    """Return `value` as an int; raise ValueError unless it is a whole number of at least 1."""
    if not np.isfinite(value) or int(value) != value or value < 1:
        raise ValueError(f"{name} = {value!r}; allowed is a whole number of at least 1")
    return int(value)


def finite_array(
    value: ArrayLike, name: str, *, last: int | None = None, ndim: int | None = None
) -> Float[np.ndarray, "..."]:
    """Return a float64 copy of `value`.

    Raises
    ------
    ValueError
        If it does not convert, does not have `ndim` axes, does not have length `last` along the
        last axis, or has entries that are not finite.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} = {value!r}; allowed is an array of numbers") from error
    if (last is not None and array.shape[-1:] != (last,)) or ndim not in (None, array.ndim):
        end = "k" if last is None else last
        allowed = {1: f"({end},)", 2: f"(k, {end})"}.get(ndim or 0, f"(…, {end})")
        raise ValueError(f"{name} has shape {array.shape}; allowed is {allowed}")
    if not np.all(np.isfinite(array)):
        where = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ValueError(f"{name}{where} = {array[tuple(where)]}; allowed are finite numbers")
    return array


def positive_array(value: ArrayLike, name: str, *, last: int) -> Float[np.ndarray, "n"]:
    """Return a float64 copy (`last`,); raise ValueError unless all are finite and above zero."""
    array = finite_array(value, name, last=last, ndim=1)
    for index, entry in enumerate(array.tolist()):
        positive(entry, f"{name}[{index}]")
    return array


def unit_vector(value: ArrayLike, name: str) -> Float[np.ndarray, "3"]:
    """Return `value` scaled to length 1; raise ValueError unless it is a finite 3-vector of
    non-zero length.
    """
    vector = finite_array(value, name, last=3, ndim=1)
    length = float(np.linalg.norm(vector))
    if length == 0:
        raise ValueError(f"{name} = {vector.tolist()}; allowed is any 3-vector of non-zero length")
    return vector / length


def _number(
    value: float, name: str, allowed: str, holds: Callable[[float], bool] = np.isfinite
) -> float:
    try:
        number = math.nan if isinstance(value, str | bool | np.bool_) else float(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} = {value!r}; allowed is a number") from error
    if not (np.isfinite(number) and holds(number)):
        raise ValueError(f"{name} = {value!r}; allowed is {allowed}")
    return number
