"""Contacts to PLY, CSV or NetCDF and back, by the file's suffix."""

from collections.abc import Callable, Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Shaped

from vibrissa.contacts import ContactKind, Status
from vibrissa.files import InputError, readable, text_of
from vibrissa.inverse import Reconstruction
from vibrissa.io.errors import writable

if TYPE_CHECKING:
    import pandas
    import xarray

SUFFIXES = (".ply", ".csv", ".nc")
PLACE = ("x", "y", "z", "nx", "ny", "nz", "arc_length")
COVARIANCE = ("cxx", "cxy", "cxz", "cyy", "cyz", "czz")
"""Upper triangle, row by row."""
COLUMNS = ("time", *PLACE, "kind", "status", *COVARIANCE)
VERTEX = np.dtype(
    [
        *((name, "<f8") for name in (*PLACE, "standard_deviation")),
        ("kind", "u1"),
        ("status", "u1"),
    ]
)
"""A point of a PLY file; its standard deviation is that of the whole vector."""
_NEEDED = {
    ".ply": set(VERTEX.names or ()) - {"standard_deviation"},
    ".csv": set(COLUMNS),
    ".nc": {"contact_point", "normal", "arc_length", "kind", "status"},
}
_BLOCK = 8192  # rows between two words on progress: some tens of milliseconds


def checked_output(path: str | Path, suffixes: tuple[str, ...] = SUFFIXES) -> Path:
    """Return the path; raise InputError unless its suffix is known and its folder can be written
    to.
    """
    return writable(_check_suffix(Path(path), suffixes))


def _check_suffix(file: Path, suffixes: tuple[str, ...]) -> Path:
    if file.suffix.lower() not in suffixes:
        raise InputError(f"{file}: suffix {file.suffix!r}; allowed are {', '.join(suffixes)}")
    return file


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
            _written(file, lambda: _write_csv(file, found, progress))
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
            f"{file}: cannot be written ({error.strerror or error}); "
            "allowed is a file that can be written"
        ) from error


def _write_csv(file: Path, found: Reconstruction, progress: Callable[[float], None] | None) -> None:
    table = _table(found)
    with file.open("w", newline="", encoding="utf-8") as stream:
        for first in range(0, max(len(table), 1), _BLOCK):
            table[first : first + _BLOCK].to_csv(
                stream, header=first == 0, index=False, lineterminator="\r\n"
            )
            if progress is not None:
                progress(min(1.0, (first + _BLOCK) / max(len(table), 1)))


def _table(found: Reconstruction) -> "pandas.DataFrame":
    """A row a sample, trails one after the other; NaN for what is not known."""
    import pandas  # noqa: PLC0415

    there = known(found)
    lost = found.in_contact & ~there & (found.status == Status.OK)
    covariance = np.full((*there.shape, len(COVARIANCE)), np.nan)
    if found.covariance is not None:
        covariance = found.covariance[..., *np.triu_indices(3)]
    values = np.concatenate(
        [found.point, found.normal, found.arc_length[..., None], covariance], axis=-1
    )
    values = np.where(there[..., None] & np.isfinite(values), values, np.nan)
    table = pandas.DataFrame(
        values.reshape(-1, values.shape[-1]), columns=[*PLACE, *COVARIANCE]
    ).assign(
        time=np.nan if found.reactions.time is None else found.reactions.time.reshape(-1),
        kind=np.where(there, found.kind, ContactKind.NONE).reshape(-1),
        # A contact without a place is never OK.
        status=np.where(lost, Status.NOT_CONVERGED, found.status).reshape(-1),
    )
    return table[list(COLUMNS)]


def known(found: Reconstruction) -> Bool[np.ndarray, "*trail n"]:
    """Rows (…) with a contact at a finite place."""
    return found.in_contact & np.isfinite(found.point).all(axis=-1)


def deviations(found: Reconstruction) -> Float[np.ndarray, "*trail n 3"]:
    """Standard deviations along x, y, z; NaN where the noise is not known."""
    if found.covariance is None:
        return np.full(found.point.shape, np.nan)
    return np.sqrt(np.diagonal(found.covariance, axis1=-2, axis2=-1))


def structured(
    kind: np.dtype[np.void], columns: Sequence[Shaped[np.ndarray, "rows"]]
) -> Shaped[np.ndarray, "rows"]:
    """Columns as rows of this type, what lies between its fields zero."""
    rows = np.zeros(len(columns[0]), dtype=kind)
    for name, column in zip(kind.names or (), columns, strict=True):
        rows[name] = column
    return rows


def vertices(
    found: Reconstruction, rows: Bool[np.ndarray, "*trail n"]
) -> Shaped[np.ndarray, "contacts"]:
    """Contacts as PLY holds them."""
    return structured(
        VERTEX,
        (
            *found.point[rows].T,
            *found.normal[rows].T,
            found.arc_length[rows],
            np.linalg.norm(deviations(found)[rows], axis=1),
            found.kind[rows],
            found.status[rows],
        ),
    )


def cloud(points: Shaped[np.ndarray, "contacts"], unit: str, *comments: str) -> Any:
    """Vertices as `plyfile.PlyData`, with the unit of length in a comment."""
    from plyfile import PlyData, PlyElement  # noqa: PLC0415

    return PlyData(
        [PlyElement.describe(points, "vertex")],
        byte_order="<",
        comments=[f"contacts of an elastic rod, unit {unit}", *comments],
    )


def _write_ply(file: Path, found: Reconstruction) -> None:
    from numpy.lib.recfunctions import drop_fields  # noqa: PLC0415

    points = vertices(found, known(found))
    if found.covariance is None:
        points = drop_fields(points, "standard_deviation")
    cloud(points, "metre" if found.rod.units == "SI" else "rod length").write(str(file))


def read_contacts(path: str | Path) -> dict[str, Shaped[np.ndarray, "..."]]:
    """Read contacts that `write_contacts` wrote.

    Parameters
    ----------
    path
        PLY, CSV or NetCDF, by the suffix.

    Returns
    -------
    dict
        Arrays by the names that they have in the file, in its units. CSV: `time`, the point `x`,
        `y`, `z`, the normal `nx`, `ny`, `nz`, `arc_length`, `kind`, `status` and the upper triangle
        of the point's covariance `cxx` to `czz`, each (rows,), NaN where not known. PLY: the same
        of the rows with a contact only, without time, and `standard_deviation` in place of the
        covariance, where it was known. NetCDF: every variable of the dataset, over trails,
        positions and axes as written.

    Raises
    ------
    InputError
        If the suffix is another, or the file cannot be read, is damaged or lacks one of the names.
    """
    file = Path(path)
    _check_suffix(file, SUFFIXES)
    try:
        columns = _columns_of(readable(file))
    except InputError:
        raise
    except Exception as error:  # of three libraries, each with its own kinds
        raise InputError(
            f"{file}: damaged ({error}); allowed is a file that `write_contacts` wrote"
        ) from error
    missing = sorted(_NEEDED[file.suffix.lower()] - columns.keys())
    if missing:
        raise InputError(
            f"{file}: {', '.join(missing)}: missing; allowed is a file that `write_contacts` wrote"
        )
    return columns


def _columns_of(file: Path) -> dict[str, Shaped[np.ndarray, "..."]]:
    """Values by name, as written."""
    match file.suffix.lower():
        case ".ply":
            from plyfile import PlyData  # noqa: PLC0415

            points = PlyData.read(str(file))["vertex"].data
            return {name: np.array(points[name]) for name in points.dtype.names}
        case ".csv":
            import pandas  # noqa: PLC0415

            text = text_of(file)
            widths = {line.count(",") for line in text.splitlines()}
            if not text.endswith("\n") or len(widths) > 1:
                raise ValueError("a line is truncated")
            # As text: pandas parses floats to the last digit by an option that not all have.
            table = pandas.read_csv(StringIO(text), dtype=object, keep_default_na=False)
            cells = table.replace("", "nan")
            flags = {"kind", "status"}
            return {
                name: cells[name].to_numpy(np.int64 if name in flags else np.float64)
                for name in cells
            }
        case _:
            import xarray  # noqa: PLC0415

            with xarray.open_dataset(file, engine="h5netcdf", decode_times=False) as dataset:
                return {str(name): part.to_numpy() for name, part in dataset.variables.items()}
