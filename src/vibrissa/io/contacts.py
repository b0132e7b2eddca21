"""Contacts to PLY, CSV or NetCDF, by the file's suffix."""

import csv
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vibrissa.io.errors import InputError, writable
from vibrissa.reconstruct import Reconstruction

if TYPE_CHECKING:
    import xarray

SUFFIXES = (".ply", ".csv", ".nc")
COLUMNS = ("time", "x", "y", "z", "nx", "ny", "nz", "arc_length", "kind", "status", "cxx", "cxy", "cxz", "cyy", "cyz", "czz")
_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def checked_output(path: str | Path, suffixes: tuple[str, ...] = SUFFIXES) -> Path:
    """Return the path; raise InputError unless its suffix is known and its folder can be written to."""
    file = Path(path)
    if file.suffix.lower() not in suffixes:
        raise InputError(f"{file}: suffix {file.suffix!r}; allowed are {', '.join(suffixes)}")
    return writable(file)


def write_contacts(path: str | Path, found: Reconstruction) -> Path:
    """Write contacts as PLY (points with normals), CSV (one row a sample) or NetCDF (everything), by the suffix; units of the rod.

    Raises
    ------
    InputError
        If the suffix is another, or the folder cannot be written to.
    """
    file = checked_output(path)
    match file.suffix.lower():
        case ".ply":
            _written(file, lambda: _write_ply(file, found))
        case ".csv":
            _written(file, lambda: _write_csv(file, found))
        case _:
            write_dataset(file, found.to_dataset())
    return file


def write_dataset(path: str | Path, dataset: "xarray.Dataset") -> Path:
    """Write a dataset as NetCDF 4.

    Raises
    ------
    InputError
        If the suffix is not .nc, or the folder cannot be written to.
    """
    file = checked_output(path, (".nc",))
    _written(file, lambda: dataset.to_netcdf(file, engine="h5netcdf"))
    return file


def _written(file: Path, write: Callable[[], object]) -> None:
    try:
        write()
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror or error}); allowed is a file that can be written") from error


def _write_csv(file: Path, found: Reconstruction) -> None:
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        for row in np.ndindex(*found.kind.shape):
            writer.writerow(_csv_row(found, row))


def _csv_row(found: Reconstruction, row: tuple[int, ...]) -> list[str]:
    time = "" if found.reactions.time is None else repr(float(found.reactions.time[row]))
    flags = [str(int(found.kind[row])), str(int(found.status[row]))]
    if not found.in_contact[row]:
        return [time, *[""] * 7, *flags, *[""] * 6]
    values = [*found.point[row], *found.normal[row], found.arc_length[row]]
    errors = [""] * 6 if found.covariance is None else [repr(float(found.covariance[row][pair])) for pair in _UPPER]
    return [time, *(repr(float(value)) for value in values), *flags, *errors]


def _write_ply(file: Path, found: Reconstruction) -> None:
    from plyfile import PlyData, PlyElement  # noqa: PLC0415

    rows = found.in_contact
    fields = ["x", "y", "z", "nx", "ny", "nz", "arc_length"]
    values = np.column_stack([found.point[rows], found.normal[rows], found.arc_length[rows]])
    if found.covariance is not None:
        fields.append("standard_deviation")
        values = np.column_stack([values, np.sqrt(np.trace(found.covariance[rows], axis1=-2, axis2=-1))])
    vertices = np.empty(len(values), dtype=[*((name, "f8") for name in fields), ("kind", "u1"), ("status", "u1")])
    for column, name in enumerate(fields):
        vertices[name] = values[:, column]
    vertices["kind"], vertices["status"] = found.kind[rows], found.status[rows]
    unit = "metre" if found.rod.units == "SI" else "rod length"
    PlyData([PlyElement.describe(vertices, "vertex")], comments=[f"contacts of an elastic rod, unit {unit}"]).write(str(file))
