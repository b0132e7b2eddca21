"""A rod as JSON, as files hold it."""

import json
from dataclasses import fields
from typing import Any

import jax
import numpy as np

from vibrissa.rod.loads import Loads
from vibrissa.rod.rest_shape import Parabola, Polynomial, Spline, Table
from vibrissa.rod.rod import Rod
from vibrissa.rod.section import Section
from vibrissa.rod.support import Support
from vibrissa.rod.thermal import Thermal
from vibrissa.rod.tree import Described

_PARTS: dict[str, type[Described]] = {
    part.__name__: part
    for part in (Section, Polynomial, Parabola, Table, Spline, Loads, Support, Thermal, Rod)
}


def rod_to_json(rod: Rod) -> str:
    """The whole description, without what is at its default; of functions only that there is one:
    they are not read back.
    """
    return json.dumps(_written(rod))


def rod_from_json(text: str) -> Rod:
    """The rod that `rod_to_json` wrote: equal, but for functions.

    Raises
    ------
    ValueError
        If the text describes no rod.
    """
    try:
        rod = _read(json.loads(text))
    except (KeyError, TypeError) as error:
        raise ValueError(f"rod: {error} is not what a rod is written with") from error
    if not isinstance(rod, Rod):
        raise ValueError(f"rod = {text[:40]!r}…; allowed is what a scan wrote")
    return rod


def _written(value: Any) -> Any:
    if isinstance(value, Described):
        given = {
            field.name: _written(getattr(value, field.name))
            for field in fields(value)  # type: ignore[arg-type]
            if getattr(value, field.name) is not field.default
        }
        return {"is": type(value).__name__, **given}
    if isinstance(value, np.ndarray | jax.Array):
        numbers = np.asarray(value).tolist()
        return {"array": numbers} if np.ndim(value) else numbers
    if callable(value):
        return {"function": getattr(value, "__name__", type(value).__name__)}
    return value


def _read(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(value)
    if not isinstance(value, dict):
        return value
    if "function" in value:
        return None
    if "array" in value:
        return np.array(value["array"])
    given = {name: _read(part) for name, part in value.items() if name != "is"}
    return _PARTS[value["is"]](**given)
