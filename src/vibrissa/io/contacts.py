"""Contacts to PLY, CSV or NetCDF, by the file's suffix."""

import csv
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import ContactKind, Status
from vibrissa.inverse import Reconstruction
from vibrissa.io.errors import InputError, writable

if TYPE_CHECKING:
    import xarray

SUFFIXES = (".ply", ".csv", ".nc")
COLUMNS = (
    "time",
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "arc_length",
    "kind",
    "status",
    "cxx",
    "cxy",
    "cxz",
    "cyy",
    "cyz",
    "czz",
)
_UPPER = np.triu_indices(3)
# Rows written at once: large enough for NumPy, small enough for memory.
_BLOCK = 8192


def checked_output(path: str | Path, suffixes: tuple[str, ...] = SUFFIXES) -> Path:
    """Return the path; raise InputError unless its suffix is known and its folder can be written
    to.
    """
    file = Path(path)
    if file.suffix.lower() not in suffixes:
        raise InputError(f"{file}: suffix {file.suffix!r}; allowed are {', '.join(suffixes)}")
    return writable(file)


def write_contacts(
    path: str | Path, found: Reconstruction, *, progress: Callable[[float], None] | None = None
) -> Path:
    """Write contacts as PLY (points with normals), CSV (one row a sample) or NetCDF (everything),
    by the suffix; units of the rod.

    In CSV and PLY a row whose point is not finite is a row without contact, and its status is never
    OK. `progress` is told the share of the rows written to CSV.

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
            _written(file, lambda: _write_csv(file, found, progress or (lambda _: None)))
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
        raise InputError(
            f"{file}: cannot be written ({error.strerror or error}); allowed is a file that can be written"
        ) from error


def _write_csv(file: Path, found: Reconstruction, progress: Callable[[float], None]) -> None:
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(COLUMNS)
        columns = _Columns(found)
        for first in range(0, found.kind.size, _BLOCK):
            writer.writerows(columns.rows(slice(first, first + _BLOCK)))
            progress(min(1.0, (first + _BLOCK) / found.kind.size))


class _Columns:
    """Fields of a reconstruction, trails one after the other, each read once."""

    def __init__(self, found: Reconstruction) -> None:
        self._known = known(found)
        self._time = None if found.reactions.time is None else found.reactions.time.reshape(-1)
        self._flags = np.stack(
            [np.where(self._known, found.kind, ContactKind.NONE), _status(found, self._known)],
            axis=-1,
        ).reshape(-1, 2)
        self._known = self._known.reshape(-1)
        self._place = (
            found.point.reshape(-1, 3),
            found.normal.reshape(-1, 3),
            found.arc_length.reshape(-1, 1),
        )
        self._covariance = None if found.covariance is None else found.covariance.reshape(-1, 3, 3)

    def rows(self, part: slice) -> Iterable[list[object]]:
        """Cells of some rows; None, an empty field, for what is not known."""
        flags = self._flags[part].tolist()
        time = [None] * len(flags) if self._time is None else self._time[part].tolist()
        place = self._cells(part, np.concatenate([column[part] for column in self._place], axis=1))
        errors = [[None] * len(_UPPER[0])] * len(flags)
        if self._covariance is not None:
            errors = self._cells(part, self._covariance[part][:, *_UPPER])
        for moment, values, flag, error in zip(time, place, flags, errors, strict=True):
            yield [moment, *values, *flag, *error]

    def _cells(self, part: slice, values: Float[np.ndarray, "n k"]) -> list[list[Any]]:
        cells = values.astype(object)
        cells[~(self._known[part, None] & np.isfinite(values))] = None
        return list(cells.tolist())


def known(found: Reconstruction) -> Bool[np.ndarray, "*trail n"]:
    """Rows (…) with a contact at a finite place."""
    return found.in_contact & np.isfinite(found.point).all(axis=-1)


def _status(
    found: Reconstruction, known: Bool[np.ndarray, "*trail n"]
) -> Int[np.ndarray, "*trail n"]:
    """A contact without a place is never OK."""
    lost = found.in_contact & ~known & (found.status == Status.OK)
    return np.where(lost, Status.NOT_CONVERGED, found.status)


def _write_ply(file: Path, found: Reconstruction) -> None:
    from plyfile import PlyData, PlyElement  # noqa: PLC0415

    rows = known(found)
    fields = ["x", "y", "z", "nx", "ny", "nz", "arc_length"]
    values = np.column_stack([found.point[rows], found.normal[rows], found.arc_length[rows]])
    if found.covariance is not None:
        fields.append("standard_deviation")
        values = np.column_stack(
            [values, np.sqrt(np.trace(found.covariance[rows], axis1=-2, axis2=-1))]
        )
    vertices = np.empty(
        len(values), dtype=[*((name, "f8") for name in fields), ("kind", "u1"), ("status", "u1")]
    )
    for column, name in enumerate(fields):
        vertices[name] = values[:, column]
    vertices["kind"], vertices["status"] = found.kind[rows], found.status[rows]
    unit = "metre" if found.rod.units == "SI" else "rod length"
    PlyData(
        [PlyElement.describe(vertices, "vertex")],
        comments=[f"contacts of an elastic rod, unit {unit}"],
    ).write(str(file))
