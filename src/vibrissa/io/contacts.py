"""Contacts to PLY, CSV, Parquet or NetCDF and back, by the file's suffix."""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Shaped

from vibrissa.contacts import ContactKind, Contacts, Status
from vibrissa.files import InputError, cells_of, numbers_of, readable, reading, text_of
from vibrissa.forward.result import Scan
from vibrissa.inverse import Reconstruction
from vibrissa.io.errors import writable

if TYPE_CHECKING:
    import pandas
    import xarray

SUFFIXES = (".ply", ".csv", ".nc", ".parquet")
PLACE = ("x", "y", "z", "nx", "ny", "nz", "arc_length")
COVARIANCE = ("cxx", "cxy", "cxz", "cyy", "cyz", "czz")
"""Upper triangle, row by row."""
COLUMNS = ("time", *PLACE, "kind", "status", *COVARIANCE)
VERTEX = np.dtype(
    {
        "names": (*PLACE, "standard_deviation", "kind", "status"),
        "formats": ["<f8"] * 8 + ["u1"] * 2,
    }
)
"""A point of a PLY file; its standard deviation is that of the whole vector."""
_BLOCK = 8192  # rows between two words on progress: some tens of milliseconds


def checked_output(path: str | Path, suffixes: tuple[str, ...] = SUFFIXES) -> Path:
    """Return the path; raise InputError unless its suffix is known and its folder can be written
    to.
    """
    _suffix(Path(path), suffixes)
    return writable(Path(path))


def _suffix(file: Path, suffixes: tuple[str, ...] = SUFFIXES) -> str:
    if file.suffix.lower() not in suffixes:
        raise InputError(f"{file}: suffix {file.suffix!r}; allowed are {', '.join(suffixes)}")
    return file.suffix.lower()


def write_contacts(
    path: str | Path,
    found: Reconstruction | Scan,
    *,
    progress: Callable[[float], None] | None = None,
) -> Path:
    """Write the contacts of a reconstruction or a scan as PLY (points with normals), CSV or Parquet
    (one row a sample) or NetCDF (everything), by the suffix; units of the rod.

    In CSV, Parquet and PLY a row whose point is not finite is a row without contact, and its status
    is never OK. `progress` is called with the share of rows written to CSV.

    Raises
    ------
    InputError
        If the suffix is another, or the file cannot be written.
    """
    file, unit = checked_output(path), "metre" if found.rod.units == "SI" else "rod length"
    writers: dict[str, Callable[[], object]] = {
        ".ply": lambda: cloud(_points(found), unit).write(str(file)),
        ".csv": lambda: _write_csv(file, _table(found), progress),
        ".parquet": lambda: _table(found).to_parquet(file, index=False),
        ".nc": lambda: found.to_dataset().to_netcdf(file, engine="h5netcdf"),
    }
    return _written(file, writers[_suffix(file)])


def write_dataset(path: str | Path, dataset: "xarray.Dataset") -> Path:
    """Write a dataset as NetCDF 4.

    Raises
    ------
    InputError
        If the suffix is not .nc, or the file cannot be written.
    """
    file = checked_output(path, (".nc",))
    return _written(file, lambda: dataset.to_netcdf(file, engine="h5netcdf"))


def _written(file: Path, write: Callable[[], object]) -> Path:
    try:
        write()
    except OSError as error:
        raise InputError(
            f"{file}: cannot be written ({error.strerror or error}); "
            "allowed is a file that can be written"
        ) from error
    return file


def _write_csv(
    file: Path, table: "pandas.DataFrame", progress: Callable[[float], None] | None
) -> None:
    with file.open("w", newline="", encoding="utf-8") as stream:
        for first in range(0, max(len(table), 1), _BLOCK):
            table[first : first + _BLOCK].to_csv(
                stream, header=first == 0, index=False, lineterminator="\r\n"
            )
            if progress is not None:
                progress(min(1.0, (first + _BLOCK) / max(len(table), 1)))


def _table(found: Reconstruction | Scan) -> "pandas.DataFrame":
    """A row a sample, trails one after the other; NaN for what is not known."""
    import pandas  # noqa: PLC0415

    there, covariance, time = known(found), _covariance(found), found.reactions.time
    lost = found.in_contact & ~there & (found.status == Status.OK)
    upper = np.full((*there.shape, 6), np.nan)
    if covariance is not None:
        upper = covariance[..., *np.triu_indices(3)]
    numbers = [found.point, found.normal, found.arc_length[..., None], upper]
    values = np.concatenate(numbers, axis=-1)
    values = np.where(there[..., None] & np.isfinite(values), values, np.nan)
    table = pandas.DataFrame(values.reshape(there.size, -1), columns=[*PLACE, *COVARIANCE]).assign(
        time=np.nan if time is None else time.reshape(-1),
        kind=np.where(there, found.kind, ContactKind.NONE).reshape(-1),
        # A contact without a place is never OK.
        status=np.where(lost, Status.NOT_CONVERGED, found.status).reshape(-1),
    )
    return table[list(COLUMNS)]


def _covariance(found: Reconstruction | Scan) -> Float[np.ndarray, "*trail n 3 3"] | None:
    """Of the points; a scan has none."""
    return getattr(found, "covariance", None)


def known(found: Reconstruction | Scan) -> Bool[np.ndarray, "*trail n"]:
    """Rows (…) with a contact at a finite place."""
    return found.in_contact & np.isfinite(found.point).all(axis=-1)


def deviations(found: Reconstruction | Scan) -> Float[np.ndarray, "*trail n 3"]:
    """Standard deviations along x, y, z; NaN where the noise is not known."""
    covariance = _covariance(found)
    if covariance is None:
        return np.full(found.point.shape, np.nan)
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))


def structured(
    kind: np.dtype[np.void], columns: Sequence[Shaped[np.ndarray, "rows"]]
) -> Shaped[np.ndarray, "rows"]:
    """Columns as rows of this type, what lies between its fields zero."""
    rows = np.zeros(len(columns[0]), dtype=kind)
    for name, column in zip(kind.names or (), columns, strict=True):
        rows[name] = column
    return rows


def vertices(
    found: Reconstruction | Scan, rows: Bool[np.ndarray, "*trail n"]
) -> Shaped[np.ndarray, "contacts"]:
    """Contacts as PLY holds them."""
    spread = np.linalg.norm(deviations(found)[rows], axis=1)
    place = (*found.point[rows].T, *found.normal[rows].T, found.arc_length[rows])
    return structured(VERTEX, (*place, spread, found.kind[rows], found.status[rows]))


def _points(found: Reconstruction | Scan) -> Shaped[np.ndarray, "contacts"]:
    """Vertices of all contacts; with a standard deviation only where the noise is known."""
    from numpy.lib.recfunctions import drop_fields  # noqa: PLC0415

    points = vertices(found, known(found))
    return points if _covariance(found) is not None else drop_fields(points, "standard_deviation")


def cloud(points: Shaped[np.ndarray, "contacts"], unit: str, *comments: str) -> Any:
    """Vertices as `plyfile.PlyData`, with the unit of length in a comment."""
    from plyfile import PlyData, PlyElement  # noqa: PLC0415

    return PlyData(
        [PlyElement.describe(points, "vertex")],
        byte_order="<",
        comments=[f"contacts of an elastic rod, unit {unit}", *comments],
    )


def read_contacts(path: str | Path) -> Contacts:
    """Read contacts that `write_contacts` wrote.

    Parameters
    ----------
    path
        PLY, CSV, Parquet or NetCDF, by the suffix.

    Returns
    -------
    Contacts
        In the units of the file, with what it holds. CSV and Parquet: a row a sample, with the
        covariance of the point and the time where they were known, NaN in rows without contact.
        PLY: the rows with a contact only, without time and covariance. NetCDF: over trails and
        positions as written, with the covariance of the normal and, of a scan, the direction of the
        force.

    Raises
    ------
    InputError
        If the suffix is another, or the file cannot be read, is damaged or lacks one of the names.
    """
    file = Path(path)
    suffix = _suffix(file)
    with reading(readable(file), "contacts"):
        try:
            return _of_dataset(file) if suffix == ".nc" else _of_table(_columns(file, suffix))
        except KeyError as error:
            raise InputError(
                f"{file}: {error.args[0]}: missing; allowed is a file that `write_contacts` wrote"
            ) from error


def _need(names: Iterable[str], there: Container[str]) -> None:
    """Raise KeyError with all names that are missing."""
    missing = sorted(name for name in names if name not in there)
    if missing:
        raise KeyError(", ".join(missing))


def _columns(file: Path, suffix: str) -> Mapping[str, np.ndarray]:
    """Values by name, as written."""
    if suffix == ".ply":
        from plyfile import PlyData  # noqa: PLC0415

        points = PlyData.read(str(file))["vertex"].data
        return {name: points[name] for name in points.dtype.names}
    if suffix == ".parquet":
        import pandas  # noqa: PLC0415

        table = pandas.read_parquet(file)
        return {name: table[name].to_numpy() for name in COLUMNS}
    text = text_of(file)
    names = text.partition("\n")[0].strip().split(",")
    cells = cells_of(file, text, names)
    return {
        name: numbers_of(file, name, cells[place], missing=("",))
        for place, name in enumerate(names)
    }


def _of_table(columns: Mapping[str, np.ndarray]) -> Contacts:
    _need([*PLACE, "kind", "status"], columns)

    def vectors(names: Sequence[str]) -> np.ndarray:
        return np.stack([columns[name] for name in names], axis=-1)

    given = {"arc_length": columns["arc_length"]}
    given |= {name: columns[name].astype(np.int64) for name in ("kind", "status")}
    if "cxx" in columns:
        # Rows of the matrix by their places in the upper triangle.
        covariance = vectors(COVARIANCE)[:, [[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        optional = {"time": columns["time"], "covariance": covariance}
        given |= {name: part for name, part in optional.items() if not np.isnan(part).all()}
    return Contacts(vectors(PLACE[:3]), vectors(PLACE[3:6]), **given)


def _of_dataset(file: Path) -> Contacts:
    import xarray  # noqa: PLC0415

    with xarray.open_dataset(file, engine="h5netcdf", decode_times=False) as data:
        needed = ("contact_point", "normal", "arc_length", "kind", "status")
        _need(needed, [str(name) for name in data.variables])
        own = {"point": "contact_point", "covariance": "contact_point_covariance"}
        names = {field.name: own.get(field.name, field.name) for field in fields(Contacts)}
        given = {field: data[name].to_numpy() for field, name in names.items() if name in data}
        if given["kind"].ndim > 1:
            given["sweep"] = np.indices(given["kind"].shape)[0]
        return Contacts(**given)
