"""Clouds of contacts for other programs, as VTK's XML PolyData (`.vtp`), which ParaView opens, and
PCL's `.pcd`; and meshes as the former.
"""

from base64 import b64decode, b64encode
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from jaxtyping import Float, Int, Shaped

from vibrissa.files import InputError
from vibrissa.libraries import extra_library

if TYPE_CHECKING:
    import pandas

PLACE = ("x", "y", "z", "nx", "ny", "nz", "arc_length")
COVARIANCE = ("cxx", "cxy", "cxz", "cyy", "cyz", "czz")
"""Upper triangle, row by row."""
MATRIX = ([0, 1, 2], [1, 3, 4], [2, 4, 5])
"""Rows of the matrix, by index into the upper triangle."""
Columns = Mapping[str, Shaped[np.ndarray, "rows"]]

_TYPES = {"Float64": "<f8", "UInt8": "u1", "Int64": "<i8"}
_HEADER = np.dtype("<u8")
"""Of an array: its bytes."""
# What PCL calls normals. It reads places and normals in single precision only.
_PCD_NAMES = {f"n{axis}": f"normal_{axis}" for axis in "xyz"}
_PCD_DOUBLE, _PCD_BYTES = ("time",), ("kind", "status")

_pypcd4 = partial(extra_library, "pypcd4", extra="recordings", need=".pcd needs it")


def contacts_of(table: "pandas.DataFrame") -> "pandas.DataFrame":
    """Rows with a contact, with the standard deviation of the whole point; columns that are unknown
    throughout are left out.
    """
    rows = table[table["kind"] != 0]
    spread = np.sqrt(rows[["cxx", "cyy", "czz"]].sum(axis=1, skipna=False))
    rows = rows.assign(standard_deviation=spread)
    optional = ("standard_deviation", *COVARIANCE, "time")
    kept = [name for name in optional if not rows[name].isna().all()]
    return rows[[*PLACE, "kind", "status", *kept]]


def write_vtp(file: Path, table: "pandas.DataFrame", unit: str) -> None:
    """Write contacts as points with a vertex each: `normal` and `covariance` are arrays of 3 and 9
    components, the rest are scalars.
    """
    rows = contacts_of(table)
    count = len(rows)
    arrays = {
        "normal": rows[["nx", "ny", "nz"]].to_numpy(),
        **{name: rows[name].to_numpy(np.uint8) for name in ("kind", "status")},
        **{name: rows[name].to_numpy() for name in ("arc_length", "time", "standard_deviation")
           if name in rows},
    }  # fmt: skip
    if "cxx" in rows:
        arrays["covariance"] = rows[list(COVARIANCE)].to_numpy()[:, np.ravel(MATRIX)]
    write_polydata(
        file,
        rows[["x", "y", "z"]].to_numpy(),
        arrays,
        np.arange(count)[:, None],
        active={"Normals": "normal", "Scalars": "kind"},
        comment=f"contacts of an elastic rod, unit {unit}",
    )


def write_polydata(
    file: Path,
    points: Float[np.ndarray, "p 3"],
    fields: Mapping[str, Shaped[np.ndarray, "p ..."]],
    cells: Int[np.ndarray, "cells corners"],
    *,
    active: dict[str, str],
    comment: str,
) -> None:
    """Write points with fields, and cells of one corner (vertices) or more (polygons).

    `active` names the fields that a viewer takes for normals and shows first.
    """
    root = ElementTree.Element(
        "VTKFile", type="PolyData", version="1.0", byte_order="LittleEndian", header_type="UInt64"
    )
    root.append(ElementTree.Comment(f" {comment} "))
    kind = "Verts" if cells.shape[1] == 1 else "Polys"
    numbers = {f"NumberOf{part}": "0" for part in ("Verts", "Lines", "Strips", "Polys")}
    numbers |= {"NumberOfPoints": str(len(points)), f"NumberOf{kind}": str(len(cells))}
    piece = ElementTree.SubElement(ElementTree.SubElement(root, "PolyData"), "Piece", numbers)
    data = ElementTree.SubElement(piece, "PointData", active)
    for name, values in fields.items():
        _append(data, name, values)
    _append(ElementTree.SubElement(piece, "Points"), "Points", points)
    listed = ElementTree.SubElement(piece, kind)
    _append(listed, "connectivity", cells.ravel())
    _append(listed, "offsets", cells.shape[1] * np.arange(1, len(cells) + 1))
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(file, encoding="utf-8", xml_declaration=True)


def _append(parent: ElementTree.Element, name: str, values: np.ndarray) -> None:
    """Add an array, in base64 with its number of bytes in front."""
    kinds = {np.dtype(code): kind for kind, code in _TYPES.items()}
    width: dict[str, Any] = {} if values.ndim == 1 else {"NumberOfComponents": str(values.shape[1])}
    array = ElementTree.SubElement(
        parent, "DataArray", type=kinds[values.dtype], Name=name, format="binary", **width
    )
    content = np.array(values.nbytes, _HEADER).tobytes() + np.ascontiguousarray(values).tobytes()
    array.text = b64encode(content).decode()


def read_vtp(file: Path) -> Columns:
    """Columns of a file that `write_vtp` wrote.

    Raises
    ------
    InputError
        If it is a file of another program, with its arrays stored in another way.
    """
    root = ElementTree.parse(file).getroot()
    arrays = {}
    for array in root.iter("DataArray"):
        if array.get("format") != "binary" or root.get("header_type") != "UInt64":
            raise InputError(f"{file}: not as `write_contacts` writes it; allowed is such a file")
        content = b64decode(array.text or "", validate=False)
        values = np.frombuffer(content, _TYPES[array.attrib["type"]], offset=_HEADER.itemsize)
        if values.nbytes != np.frombuffer(content, _HEADER, count=1)[0]:
            raise ValueError(f"array {array.get('Name')!r} is cut off")
        arrays[array.attrib["Name"]] = values.reshape(-1, int(array.get("NumberOfComponents", "1")))
    columns: dict[str, Any] = {}
    covariance = [f"c{row}{column}" for row in "xyz" for column in "xyz"]
    for name, parts in {
        "Points": PLACE[:3], "normal": PLACE[3:6], "covariance": covariance,
        **{name: (name,) for name in ("arc_length", "time", "kind", "status")},
    }.items():  # fmt: skip
        if name in arrays:
            columns |= dict(zip(parts, arrays[name].T, strict=True))
    return columns


def write_pcd(file: Path, table: "pandas.DataFrame") -> None:
    """Write contacts as PCL reads them: binary, places and normals in single precision."""
    rows = contacts_of(table)
    types = {
        name: np.float64 if name in _PCD_DOUBLE else np.uint8 if name in _PCD_BYTES else np.float32
        for name in rows
    }
    cloud = _pypcd4().PointCloud.from_points(
        [rows[name].to_numpy(kind) for name, kind in types.items()],
        [_PCD_NAMES.get(name, name) for name in types],
        list(types.values()),
    )
    cloud.save(file, _pypcd4().Encoding.BINARY)


def read_pcd(file: Path) -> Columns:
    """Columns of a `.pcd` file, by the names that `write_pcd` was given."""
    cloud, own = _pypcd4().PointCloud.from_path(file), {new: old for old, new in _PCD_NAMES.items()}
    return {own.get(name, name): cloud.pc_data[name] for name in cloud.fields}
