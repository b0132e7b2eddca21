"""Results as `xarray.Dataset`, with CF-style units and flag meanings."""

from enum import IntEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Shaped

from vibrissa.contacts import ContactKind, Status

if TYPE_CHECKING:
    import xarray

AXES = ("x", "y", "z")
QUATERNION = ("x", "y", "z", "w")


class Variable(NamedTuple):
    """Values (trail…, position, extra…), the names of the extra axes, unit and long name."""

    values: Shaped[np.ndarray, "..."]
    extra: tuple[str, ...]
    unit: str
    long_name: str


def dataset_of(
    shape: tuple[int, ...],
    variables: dict[str, Variable],
    kind: Shaped[np.ndarray, "..."],
    status: Shaped[np.ndarray, "..."],
) -> "xarray.Dataset":
    """Return a dataset over positions (n,) or trails and positions (m, n), with the flags that
    every result has.
    """
    import xarray  # noqa: PLC0415

    rows = ("position",) if len(shape) == 1 else ("trail", "position")
    data: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, object]]] = {
        name: (rows + part.extra, part.values, {"units": part.unit, "long_name": part.long_name})
        for name, part in variables.items()
    }
    data["kind"] = (rows, kind, flags(ContactKind, "kind of contact"))
    data["status"] = (rows, status, flags(Status, "whether the row can be trusted"))
    labels = {"axis": list(AXES), "other_axis": list(AXES), "quaternion": list(QUATERNION)}
    used = {name for part in variables.values() for name in part.extra}
    return xarray.Dataset(
        data,
        coords={name: values for name, values in labels.items() if name in used},
        attrs={"Conventions": "CF-1.11"},
    )


def flags(enumeration: type[IntEnum], long_name: str) -> dict[str, object]:
    """Attributes of a variable that holds members of an enumeration."""
    meanings = " ".join(member.name.lower() for member in enumeration)
    return {
        "long_name": long_name,
        "flag_values": np.array([int(member) for member in enumeration], dtype=np.int8),
        "flag_meanings": meanings,
    }
