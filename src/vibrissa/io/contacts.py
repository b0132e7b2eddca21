"""Write contacts to files and read them back, in the format that the suffix says."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Shaped

from vibrissa.contacts import ContactKind, Contacts, Status
from vibrissa.files import (
    InputError,
    cells_of,
    check_header,
    numbers_of,
    readable,
    reading,
    text_of,
    writable,
)
from vibrissa.forward.result import Scan
from vibrissa.inverse import Reconstruction
from vibrissa.io.clouds import (
    COVARIANCE,
    MATRIX,
    PLACE,
    read_pcd,
    read_vtp,
    write_pcd,
    write_vtp,
)
from vibrissa.libraries import writer
from vibrissa.numerics.progress import Progress

if TYPE_CHECKING:
    import pandas
    import xarray

SUFFIXES = (".ply", ".csv", ".nc", ".parquet", ".vtp", ".pcd", ".mcap", ".mat")
DEVIATIONS = tuple(f"deviation_{axis}" for axis in "xyz")
COLUMNS = ("time", *PLACE, "kind", "status", *COVARIANCE)
_NEEDED = (*PLACE, "kind", "status")
_VARIABLES = ("contact_point", "normal", "arc_length", "kind", "status")
"""Names in a dataset, in place of columns."""
VERTEX = np.dtype(
    {
        "names": (*PLACE, "standard_deviation", "kind", "status"),
        "formats": ["<f8"] * 8 + ["u1"] * 2,
    }
)
"""A point in a PLY file; `standard_deviation` is that of the whole vector."""
_BLOCK = 8192  # rows between progress reports: some tens of milliseconds


def checked_output(path: str | Path, suffixes: tuple[str, ...] = SUFFIXES) -> Path:
    """Return the path; raise InputError unless its suffix is known, what the format needs is
    installed, and its folder is writable.
    """
    suffix = _suffix(Path(path), suffixes)
    try:
        writer(suffix)
    except ImportError as error:
        raise InputError(f"{path}: {error}") from error
    return writable(Path(path))


def _suffix(file: Path, suffixes: tuple[str, ...] = SUFFIXES) -> str:
    if file.suffix.lower() not in suffixes:
        raise InputError(f"{file}: suffix {file.suffix!r}; allowed are {', '.join(suffixes)}")
    return file.suffix.lower()


def write_contacts(
    path: str | Path,
    found: Reconstruction | Scan,
    *,
    progress: Progress | None = None,
) -> Path:
    """Write the contacts of a reconstruction or scan, in the rod's units and the format that the
    suffix says.

    CSV, Parquet and MATLAB's `.mat`, a struct `contacts`: one row per sample. NetCDF: everything.
    PLY, VTK's `.vtp` (ParaView), `.pcd` (PCL) and MCAP (a ROS `PointCloud2` for each trail): the
    contacts as points with normals.

    A row whose point is not finite counts as without contact, and its status is never OK, except
    in NetCDF. `progress` is called with the rows written and their total while CSV is written, the
    slowest; the other formats are written in one piece and do not call it.

    Raises
    ------
    InputError
        If the suffix is not one of these, the file cannot be written, or a library that the format
        needs is not installed.
    ValueError
        If `found` is something else, as `Contacts` that do not know their unit.
    """
    if not isinstance(found, Reconstruction | Scan):
        raise ValueError(
            f"found is a {type(found).__name__}; allowed are a Reconstruction, smoothed or not, "
            "and a Scan, one file each: `fit_shape` and `vibrissa fit` take those of several"
        )
    file, unit = checked_output(path), "metre" if found.rod.units == "SI" else "rod length"
    writers: dict[str, Callable[[], object]] = {
        ".ply": lambda: cloud(_points(found), unit).write(str(file)),
        ".csv": lambda: _write_csv(file, _table(found), progress),
        ".parquet": lambda: _table(found).to_parquet(file, index=False),
        ".mat": lambda: _write_mat(file, _table(found)),
        ".vtp": lambda: write_vtp(file, _table(found), unit),
        ".pcd": lambda: write_pcd(file, _table(found)),
        ".mcap": lambda: _write_mcap(file, found),
        ".nc": lambda: write_dataset(file, found.to_dataset()),
    }
    return written(file, writers[_suffix(file)])


def _write_mat(file: Path, table: "pandas.DataFrame") -> None:
    from scipy.io import savemat  # noqa: PLC0415

    columns = {str(name): part.to_numpy() for name, part in table.items()}
    savemat(file, {"contacts": columns}, oned_as="column")


def _write_mcap(file: Path, found: Reconstruction | Scan) -> None:
    from vibrissa.io.rosbag.clouds import write_clouds  # noqa: PLC0415

    write_clouds(file, found)


def write_dataset(path: str | Path, dataset: "xarray.Dataset") -> Path:
    """Write a dataset as NetCDF 4.

    Raises
    ------
    InputError
        If the suffix is not .nc, or the file cannot be written.
    """
    file = checked_output(path, (".nc",))
    return written(file, lambda: dataset.to_netcdf(file, engine="h5netcdf"))


def written(file: Path, write: Callable[[], object]) -> Path:
    """Call what writes a file; raise InputError for whatever keeps it from being written."""
    try:
        write()
    except ImportError as error:
        raise InputError(f"{file}: {error}") from error
    except OSError as error:
        raise InputError(
            f"{file}: cannot be written ({error.strerror or error}); "
            "allowed is a file that can be written"
        ) from error
    return file


def _write_csv(file: Path, table: "pandas.DataFrame", progress: Progress | None) -> None:
    with file.open("w", newline="", encoding="utf-8") as stream:
        for first in range(0, max(len(table), 1), _BLOCK):
            table[first : first + _BLOCK].to_csv(
                stream, header=first == 0, index=False, lineterminator="\r\n"
            )
            if progress is not None:
                progress(min(first + _BLOCK, len(table)), len(table))


def _table(found: Reconstruction | Scan) -> "pandas.DataFrame":
    """One row per sample, trails one after another; NaN for what is not known."""
    import pandas  # noqa: PLC0415

    there, time = known(found).reshape(-1), found.reactions.time
    own = {"time": np.nan if time is None else time.reshape(-1)}
    table = pandas.DataFrame(columns(found) | own)[list(COLUMNS)]
    numbers = table[[*PLACE, *COVARIANCE]]
    table[numbers.columns] = numbers.where(there[:, None] & np.isfinite(numbers.to_numpy()))
    # A contact without a finite point is no contact, and never OK.
    lost = (table["kind"] != ContactKind.NONE) & ~there
    table.loc[lost & (table["status"] == Status.OK), "status"] = Status.NOT_CONVERGED
    table.loc[lost, "kind"] = ContactKind.NONE
    return table


def _covariance(found: Reconstruction | Scan) -> Float[np.ndarray, "*trail n 3 3"]:
    """Covariance of the points; NaN where the noise is not known, as in scans."""
    given = getattr(found, "covariance", None)
    return np.full((*found.point.shape, 3), np.nan) if given is None else given


def known(found: Reconstruction | Scan) -> Bool[np.ndarray, "*trail n"]:
    """Rows (…) with a contact at a finite point."""
    return found.in_contact & np.isfinite(found.point).all(axis=-1)


def deviations(found: Reconstruction | Scan) -> Float[np.ndarray, "*trail n 3"]:
    """Standard deviations along x, y, z; NaN where the noise is not known."""
    return np.sqrt(np.diagonal(_covariance(found), axis1=-2, axis2=-1))


def columns(found: Reconstruction | Scan) -> dict[str, Shaped[np.ndarray, "rows"]]:
    """Results of each row by column name, trails one after another."""
    spread, upper = deviations(found), _covariance(found)[..., *np.triu_indices(3)]
    whole, arc_length = np.linalg.norm(spread, axis=-1, keepdims=True), found.arc_length[..., None]
    parts = [found.point, found.normal, arc_length, spread, whole, upper]
    names = (*PLACE, *DEVIATIONS, "standard_deviation", *COVARIANCE)
    numbers = np.concatenate(parts, axis=-1).reshape(-1, len(names))
    return {
        **dict(zip(names, numbers.T, strict=True)),
        "kind": found.kind.reshape(-1),
        "status": found.status.reshape(-1),
    }


def structured(
    kind: np.dtype[np.void],
    columns: Mapping[str, Shaped[np.ndarray, "rows"]],
    rows: Bool[np.ndarray, "rows"],
) -> Shaped[np.ndarray, "chosen"]:
    """The chosen rows as an array of this structured type, padding zeroed."""
    chosen = np.zeros(np.count_nonzero(rows), dtype=kind)
    for name in kind.names or ():
        chosen[name] = columns[name][rows]
    return chosen


def _points(found: Reconstruction | Scan) -> Shaped[np.ndarray, "contacts"]:
    """Vertices of all contacts; with a standard deviation only if the noise is known."""
    from numpy.lib.recfunctions import drop_fields  # noqa: PLC0415

    points = structured(VERTEX, columns(found), known(found).reshape(-1))
    is_known = getattr(found, "covariance", None) is not None
    return points if is_known else drop_fields(points, "standard_deviation")


def cloud(points: Shaped[np.ndarray, "contacts"], unit: str, *comments: str) -> Any:
    """Vertices as `plyfile.PlyData`, with the length unit in a comment."""
    from plyfile import PlyData, PlyElement  # noqa: PLC0415

    return PlyData(
        [PlyElement.describe(points, "vertex")],
        byte_order="<",
        comments=[f"contacts of an elastic rod, unit {unit}", *comments],
    )


def read_contacts(path: str | Path) -> Contacts:
    """Read contacts written by `write_contacts`.

    Parameters
    ----------
    path
        CSV, Parquet, .mat, NetCDF, PLY, .vtp, .pcd or MCAP, by the suffix.

    Returns
    -------
    Contacts
        In the file's units, with what it holds. CSV, Parquet and .mat: one row per sample, with the
        point's covariance and the time where these were known, NaN in rows without contact. The
        others hold only rows with a contact: `.vtp` and `.pcd` (in single precision) with both,
        MCAP (in single precision, also as a stream wrote it) with the time, PLY with neither.
        NetCDF: over trails and positions as written, with the covariance of the normal and the
        direction of the force.

    Raises
    ------
    InputError
        If the suffix is not one of these, the file cannot be read, is damaged or lacks a name, or a
        library that the format needs is not installed.
    """
    file = Path(path)
    suffix = _suffix(file)
    with reading(readable(file), "contacts"):
        try:
            columns, is_dataset = _columns(file, suffix), suffix == ".nc"
        except ImportError as error:
            raise InputError(f"{file}: {error}") from error
        needed = (*_NEEDED, *(COVARIANCE if "cxx" in columns else ()))
        needed = _VARIABLES if is_dataset else needed
        missing = sorted(set(needed) - columns.keys())
        if missing:
            raise InputError(
                f"{file}: {', '.join(missing)}: missing; "
                "allowed is a file that `write_contacts` wrote"
            )
        return _of_dataset(columns) if is_dataset else _of_table(columns)


def _read_mcap(file: Path) -> Mapping[str, np.ndarray]:
    from vibrissa.io.rosbag.clouds import read_clouds  # noqa: PLC0415

    return read_clouds(file)


_CLOUDS: dict[str, Callable[[Path], Mapping[str, np.ndarray]]] = {
    ".vtp": read_vtp,
    ".pcd": read_pcd,
    ".mcap": _read_mcap,
}


def _columns(file: Path, suffix: str) -> Mapping[str, np.ndarray]:
    """Values by name, as written; for CSV, only known columns."""
    if suffix == ".nc":
        import xarray  # noqa: PLC0415

        with xarray.open_dataset(file, engine="h5netcdf", decode_times=False) as data:
            return {str(name): part.to_numpy() for name, part in data.variables.items()}
    if suffix == ".ply":
        from plyfile import PlyData  # noqa: PLC0415

        points = PlyData.read(str(file))["vertex"].data
        return {name: points[name] for name in points.dtype.names}
    if suffix in _CLOUDS:
        return _CLOUDS[suffix](file)
    if suffix == ".parquet":
        import pandas  # noqa: PLC0415

        return {name: part.to_numpy() for name, part in pandas.read_parquet(file).items()}
    if suffix == ".mat":
        from scipy.io import loadmat  # noqa: PLC0415

        columns: dict[str, np.ndarray] = loadmat(file, simplify_cells=True).get("contacts", {})
        return {name: np.atleast_1d(part) for name, part in columns.items()}
    text = text_of(file)
    names = [name.strip() for name in text.partition("\n")[0].split(",")]
    known = [name for name in names if name in COLUMNS]
    check_header(file, known, _NEEDED, ("time", *COVARIANCE), any_order=True)
    cells = cells_of(file, text, names)
    return {name: numbers_of(file, name, cells[names.index(name)], missing=("",)) for name in known}


def _of_table(columns: Mapping[str, np.ndarray]) -> Contacts:
    def vectors(*names: str) -> np.ndarray:
        return np.stack([columns[name] for name in names], axis=-1)

    given = {name: columns[name] for name in ("arc_length", "kind", "status")}
    if "cxx" in columns:
        given["covariance"] = vectors(*COVARIANCE)[:, MATRIX]
    if "time" in columns:
        given["time"] = columns["time"]
    optional = ("covariance", "time")
    given = {
        name: part
        for name, part in given.items()
        if name not in optional or not np.isnan(part).all()
    }
    return Contacts(vectors(*PLACE[:3]), vectors(*PLACE[3:6]), **given)


def _of_dataset(columns: Mapping[str, np.ndarray]) -> Contacts:
    own = {"contact_point": "point", "contact_point_covariance": "covariance"}
    named = {own.get(name, name): values for name, values in columns.items()}
    given = {field.name: named[field.name] for field in fields(Contacts) if field.name in named}
    if given["kind"].ndim > 1:
        given["sweep"] = np.indices(given["kind"].shape)[0]
    return Contacts(**given)
