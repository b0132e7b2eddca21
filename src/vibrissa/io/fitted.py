"""Fitted surfaces in files: beside the mesh, a PLY file holds the contacts and the points of rods
that missed, from which the surface is fitted again when it is read.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Bool

from vibrissa.contacts import Contacts
from vibrissa.files import InputError, readable, reading
from vibrissa.io.contacts import read_contacts
from vibrissa.shape import Shape, ShapeMesh, fit_shape

if TYPE_CHECKING:
    from plyfile import PlyData, PlyElement

_CONTACT, _SWEPT, _LENGTH, _OUTLIER = "contact", "swept", "length_scale", "outlier"
_WIDTHS = {
    "point": 3,
    "normal": 3,
    "covariance": 9,
    "normal_covariance": 9,
    "cross_covariance": 9,
    "sweep": 1,
    "kind": 1,
}
"""Numbers of a contact, by its fields."""
_VERTEX = ("x", "y", "z"), ("nx", "ny", "nz")


def elements_of(shape: Shape) -> "list[PlyElement]":
    """What a surface was fitted to: the contacts that count, each with the fields that all have and
    whether it is an outlier, and points of rods that missed.
    """
    from plyfile import PlyElement  # noqa: PLC0415

    contacts = Contacts.joined(shape.contacts)[shape.used]
    given = [name for name in _WIDTHS if getattr(contacts, name) is not None]
    columns = {
        f"{name}_{i}" if _WIDTHS[name] > 1 else name: column
        for name in given
        for i, column in enumerate(getattr(contacts, name).reshape(len(contacts), -1).T)
    }
    columns[_OUTLIER] = shape.outlier[shape.used]
    elements = [PlyElement.describe(_structured(columns), _CONTACT)]
    if shape.swept is not None:
        swept = _structured(dict(zip("xyz", shape.swept.T, strict=True)))
        elements.append(PlyElement.describe(swept, _SWEPT))
    return elements


def comments_of(shape: Shape) -> list[str]:
    """What else it was fitted with."""
    return [] if shape.length_scale is None else [f"{_LENGTH} {shape.length_scale!r}"]


def _structured(columns: dict[str, np.ndarray]) -> np.ndarray:
    rows = np.zeros(len(next(iter(columns.values()))), [(name, "<f8") for name in columns])
    for name, column in columns.items():
        rows[name] = column
    return rows


def read_shape(path: str | Path) -> Shape:
    """Fit the surface of a file again.

    Parameters
    ----------
    path
        PLY that `write_shape` wrote of a `Shape`, or contacts in a format of `read_contacts`.

    Raises
    ------
    InputError
        If the file cannot be read, holds no contacts, or too few to fit a surface to.
    """
    file = Path(path)
    with reading(readable(file), "contacts"):
        held = _held(file, _data(file)) if file.suffix.lower() == ".ply" else None
    try:
        if held is None:
            return fit_shape(read_contacts(file))
        return fit_shape(held[0], swept=held[1], length_scale=held[2])
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error


class StoredShape(NamedTuple):
    """A fitted surface as a file holds it: nothing is fitted again."""

    mesh: ShapeMesh
    contacts: Contacts
    outlier: Bool[np.ndarray, "n"]


def read_stored(file: Path) -> StoredShape | None:
    """Mesh and contacts of a PLY file that `write_shape` wrote with `fitted=`; nothing if it is a
    cloud.

    Raises
    ------
    InputError
        If the file cannot be read, or is a mesh without contacts.
    """
    with reading(readable(file), "contacts"):
        data = _data(file)
        held = _held(file, data)
        if held is None:
            return None
        vertex, rows = data["vertex"].data, data[_CONTACT].data
        places, normals = (np.stack([vertex[n] for n in names], axis=-1) for names in _VERTEX)
        faces = np.stack(data["face"].data["vertex_indices"]).astype(np.int64)
        seen = vertex["seen"].astype(bool)
        mesh = ShapeMesh(places, faces, normals, vertex["deviation"], seen)
    known = _OUTLIER in rows.dtype.names
    outlier = rows[_OUTLIER].astype(bool) if known else np.zeros(len(rows), dtype=bool)
    return StoredShape(mesh, held[0], outlier)


def _data(file: Path) -> "PlyData":
    from plyfile import PlyData  # noqa: PLC0415

    return PlyData.read(str(file))


def _held(file: Path, data: "PlyData") -> tuple[Contacts, np.ndarray | None, float | None] | None:
    """Contacts, rods that missed and length scale in a PLY file; nothing if it is a cloud."""
    names = [element.name for element in data.elements]
    if _CONTACT not in names:
        if "face" not in names:
            return None
        raise InputError(
            f"{file}: a mesh without the contacts it was fitted to; allowed is one that "
            "`vibrissa fit` wrote as .ply, or files of contacts"
        )
    rows = data[_CONTACT].data
    given: dict[str, Any] = {}
    for name, width in _WIDTHS.items():
        columns = [f"{name}_{i}" for i in range(width)] if width > 1 else [name]
        if columns[0] in rows.dtype.names:
            shape = (3, 3) if width == 9 else (width,) * (width > 1)
            whole = np.stack([rows[column] for column in columns], axis=-1)
            given[name] = whole.reshape(len(rows), *shape)
    swept = None
    if _SWEPT in names:
        points = data[_SWEPT].data
        swept = np.stack([points[axis] for axis in "xyz"], axis=-1)[:, None]
    lengths = [line.split()[1] for line in data.comments if line.startswith(_LENGTH)]
    return Contacts(**given), swept, float(lengths[0]) if lengths else None
