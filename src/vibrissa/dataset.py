"""Results as `xarray.Dataset`, with CF-style units and flag meanings."""

from collections.abc import Iterable
from enum import IntEnum
from operator import attrgetter
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vibrissa.contacts import ContactKind, Status
from vibrissa.rod import rod_to_json
from vibrissa.rod.rod import Quantity

if TYPE_CHECKING:
    import xarray

_LABELS = {"axis": [*"xyz"], "other_axis": [*"xyz"], "quaternion": [*"xyzw"]}


class Variable(NamedTuple):
    """How a dataset describes one field of a result."""

    name: str
    field: str
    extra: str
    """Axes other than those of the rows."""
    quantity: Quantity
    long_name: str


_COMMON = (
    Variable("clamp_position", "reactions.trail.position", "axis", "length", "clamp point"),
    Variable(
        "clamp_orientation",
        "reactions.trail.orientation",
        "quaternion",
        "number",
        "rotation from clamp to world axes",
    ),
    Variable(
        "support_force",
        "reactions.force",
        "axis",
        "force",
        "force of the clamp on the rod, world axes",
    ),
    Variable(
        "support_moment",
        "reactions.moment",
        "axis",
        "moment",
        "moment of the clamp on the rod about the clamp point, world axes",
    ),
    Variable("contact_point", "point", "axis", "length", "contact point"),
    Variable("arc_length", "arc_length", "", "length", "arc length from clamp to contact"),
    Variable("bending_energy", "energy", "", "energy", "bending energy"),
)


def dataset_of(title: str, result: Any, variables: Iterable[Variable]) -> "xarray.Dataset":
    """Return a dataset of a scan or reconstruction over positions (n,) or trails and positions
    (m, n): the common fields, those of `variables` that are known, and the flags.
    """
    import xarray  # noqa: PLC0415

    rod, rows = result.rod, ("trail", "position")[-result.kind.ndim :]
    data: dict[str, tuple[tuple[str, ...], np.ndarray, dict[str, object]]] = {
        "kind": (rows, result.kind, flags(ContactKind, "kind of contact")),
        "status": (rows, result.status, flags(Status, "whether the row can be trusted")),
    }
    for name, field, extra, quantity, long_name in (*_COMMON, *variables):
        values = attrgetter(field)(result)
        # Without tolerances there are no shared errors.
        if values is not None and values.size:
            about = {"units": rod.unit_of(quantity), "long_name": long_name}
            data[name] = (*rows, *extra.split()), values, about
    # A variable: attributes of HDF5 are limited to 64 kB, which a tabulated rod exceeds.
    data["rod"] = (), np.array(rod_to_json(rod)), {"long_name": "description of the rod, JSON"}
    used = {axis for axes, _, _ in data.values() for axis in axes}
    attributes = {
        "Conventions": "CF-1.11",
        "title": title,
        "rod_length": rod.length,
        "rod_bending_stiffness": rod.bending_stiffness,
    }
    if result.friction is not None:
        attributes["friction"] = result.friction
    coordinates = {axis: labels for axis, labels in _LABELS.items() if axis in used}
    return xarray.Dataset(data, coordinates, attributes)


def flags(enumeration: type[IntEnum], long_name: str) -> dict[str, object]:
    """Attributes of a variable whose values are members of an enumeration."""
    meanings = " ".join(member.name.lower() for member in enumeration)
    return {
        "long_name": long_name,
        "flag_values": np.array([int(member) for member in enumeration], dtype=np.int8),
        "flag_meanings": meanings,
    }
