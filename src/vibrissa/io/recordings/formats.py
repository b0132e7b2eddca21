"""Detecting a recording's format, and reading binary formats of named columns or arrays: Parquet,
HDF5, NetCDF and MATLAB.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from vibrissa.files import InputError, readable, reading
from vibrissa.io.recordings.containers import is_bag, library

Array = Float[np.ndarray, "n"] | Float[np.ndarray, "n k"]
Held = dict[str, tuple[Callable[[], Any], Mapping[str, Any]]]
"""By name, a function that reads an array, and the array's attributes."""


# Format names, as used in messages.
TEXT, BAG = "CSV", "rosbag2 or MCAP"
_PARQUET, _HDF5, _CLASSIC = "Parquet", "HDF5 or NetCDF 4", "NetCDF 3"
_MATLAB, _MATLAB_HDF5 = ".mat", ".mat of MATLAB 7.3"
# Magic numbers; formats in the last rows are recognized but not supported.
_SIGNS = {
    b"PAR1": _PARQUET,
    b"\x89HDF\r\n\x1a\n": _HDF5,
    b"CDF\x01": _CLASSIC,
    b"CDF\x02": _CLASSIC,
    b"MATLAB 5.0": _MATLAB,
    b"MATLAB 7.3": _MATLAB_HDF5,
    b"\x89MCAP0\r\n": BAG,
    b"SQLite format 3\0": BAG,
    b"\x28\xb5\x2f\xfd": BAG,
    b"#ROSBAG V": "a bag of ROS 1",
    b"ARROW1": "Arrow IPC (Feather)",
    b"PK\x03\x04": "a ZIP archive, as XLSX and NPZ are",
    b"\x1f\x8b": "gzip",
    b"\x93NUMPY": "a NumPy array",
}
_SUFFIXES = {
    **dict.fromkeys((".parquet", ".pq"), _PARQUET),
    **dict.fromkeys((".h5", ".hdf5", ".hdf", ".nc"), _HDF5),
    **dict.fromkeys((".mcap", ".db3"), BAG),
    ".mat": _MATLAB,
}
_FORMATS = "CSV, Parquet, HDF5, NetCDF, MATLAB .mat, rosbag2 and MCAP"


def kind_of(path: Path) -> str:
    """Format of a recording, by its first bytes, then by its suffix.

    Raises
    ------
    InputError
        If the file cannot be read, is of a known but unsupported format, or is not what its suffix
        says.
    """
    if path.is_dir() and is_bag(path):
        return BAG
    with readable(path).open("rb") as opened:
        start = opened.read(max(map(len, _SIGNS)))
    found = next((kind for sign, kind in _SIGNS.items() if start.startswith(sign)), None)
    if found not in {None, BAG, *_READERS}:
        raise InputError(f"{path}: is {found}; allowed are {_FORMATS}")
    said = _SUFFIXES.get(path.suffix.lower(), TEXT)
    # MATLAB 4 has no signature of its own.
    if found is None and said not in {TEXT, _MATLAB}:
        raise InputError(
            f"{path}: begins with {start[:8]!r}, which is no {said}; allowed are {_FORMATS}"
        )
    return found or said


@dataclass(frozen=True)
class Columns:
    """Columns (n,) or arrays (n, k) of a file.

    Attributes
    ----------
    file
        For messages.
    names
        All names in the file.
    arrays
        The requested ones, by the names they were requested with.
    units
        Their units, as stated by the file.
    lines
        Line numbers (n,) of the rows in a text file, from 1; None for other formats.
    """

    file: Path
    names: Sequence[str]
    arrays: Mapping[str, Array]
    units: Mapping[str, str | None] = field(default_factory=dict)
    lines: Int[np.ndarray, "n"] | None = None


def matched(wanted: Iterable[str], names: Iterable[str]) -> dict[str, str]:
    """Map requested names to those of a file: the same one, or else the only one that differs just
    in case.
    """
    folded: dict[str, list[str]] = {}
    for name in dict.fromkeys(names):
        folded.setdefault(name.casefold(), []).append(name)
    alike = {name: folded.get(name.strip("/").casefold(), []) for name in wanted}
    return {
        name: name if name in same else same[0]
        for name, same in alike.items()
        if name in same or len(same) == 1
    }


def columns(file: Path, kind: str, wanted: Sequence[str]) -> Columns:
    """Read arrays of a binary file.

    Parameters
    ----------
    file
        From any software.
    kind
        Its format, other than text or a bag. Arrays are named by their paths `group/array`, and
        `group/table/column` if an HDF5 array has named columns; fields of MATLAB and Parquet
        structs by `struct.field`.
    wanted
        The arrays to read; missing ones are left out.

    Raises
    ------
    InputError
        If the file is damaged, or an array does not hold real numbers or has more than two axes.
    """
    with reading(file, kind), _READERS[kind](file) as held:
        arrays: dict[str, Array] = {}
        units: dict[str, str | None] = {}
        for name, own in matched(wanted, held).items():
            read, attributes = held[own]
            stored = np.asarray(read())
            # MATLAB stores arrays in column-major order.
            stored = stored.T if kind == _MATLAB_HDF5 else stored
            arrays[name] = _numbers(file, name, stored, attributes)
            units[name] = _unit(attributes)
        return Columns(file, list(held), arrays, units)


def _numbers(file: Path, name: str, stored: np.ndarray, attributes: Mapping[str, Any]) -> Array:
    """Stored values as floats, rows first; a matrix with one row or column becomes a vector, and
    dates seconds since 1970. xarray decodes CF packing and missing values.
    """
    if stored.dtype.kind in "mM":
        stored = (stored - np.zeros(1, stored.dtype)) / np.timedelta64(1, "s")
    if stored.dtype.kind not in "iuf" or stored.ndim > 2:
        raise InputError(
            f"{file}: {name!r} of shape {stored.shape} holds {stored.ravel()[:1].tolist()}; "
            "allowed are real numbers (n,) or (n, k)"
        )
    # A corrupt single-precision number may be a signalling NaN.
    with np.errstate(invalid="ignore"):
        floats = stored.astype(np.float64)
    keys = {"_FillValue", "missing_value", "scale_factor", "add_offset"} & attributes.keys()
    if keys:
        import xarray  # noqa: PLC0415

        axes = [f"axis {axis}" for axis in range(floats.ndim)]
        packed = xarray.Variable(axes, floats, {key: attributes[key] for key in keys})
        floats = xarray.decode_cf(xarray.Dataset({"numbers": packed}))["numbers"].to_numpy()
    return np.atleast_1d(floats.ravel() if 1 in floats.shape else floats)


def _unit(attributes: Mapping[str, Any]) -> str | None:
    """Text of the attribute `units` or `unit`."""
    values = np.ravel(attributes.get("units", attributes.get("unit", []))).tolist()
    text = values[0] if len(values) == 1 else None
    if isinstance(text, bytes):
        return text.decode(errors="replace")
    return text if isinstance(text, str) else None


@contextmanager
def _hdf5(file: Path, separator: str = "/") -> Iterator[Held]:
    """HDF5 from any software."""
    import h5py  # noqa: PLC0415

    held: Held = {}

    def note(place: str, node: Any) -> None:
        # MATLAB stores the contents of cell arrays under #refs#.
        if isinstance(node, h5py.Dataset) and not place.startswith("#"):
            for column in ("", *(node.dtype.names or ())):
                name = f"{place}/{column}" if column else place
                read = partial(node.__getitem__, column or ())
                held[name.replace("/", separator)] = read, node.attrs

    with h5py.File(file, "r") as opened:
        opened.visititems(note)
        yield held


@contextmanager
def _classic(file: Path) -> Iterator[Held]:
    """NetCDF 3, classic or with 64-bit offsets."""
    from scipy.io import netcdf_file  # noqa: PLC0415

    with netcdf_file(file, "r", mmap=False) as opened:
        yield {
            name: (partial(np.copy, variable.data), vars(variable))
            for name, variable in opened.variables.items()
        }


@contextmanager
def _matlab(file: Path) -> Iterator[Held]:
    """MATLAB's `.mat` of version 4, 6 or 7."""
    from scipy.io import loadmat  # noqa: PLC0415

    def leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
        for key, value in tree.items():
            if isinstance(value, Mapping):
                yield from leaves(value, f"{prefix}{key}.")
            elif not key.startswith("__"):
                yield f"{prefix}{key}", value

    tree = loadmat(file, appendmat=False, simplify_cells=True)
    yield {name: (partial(np.asarray, value), {}) for name, value in leaves(tree)}


@contextmanager
def _parquet(file: Path) -> Iterator[Held]:
    """Parquet: one column, or one fixed-length list, per quantity; nulls are NaN."""
    types = library("pyarrow").types

    def flattened(table: Any) -> Any:
        while any(map(types.is_struct, table.schema.types)):
            table = table.flatten()
        return table

    with library("pyarrow.parquet").ParquetFile(file) as opened:
        schema = opened.schema_arrow
        said = {
            one.name: {key.decode(): text for key, text in (one.metadata or {}).items()}
            for one in schema
        }

        def read(name: str) -> Any:
            column = flattened(opened.read(columns=[name]))[name]
            if types.is_nested(column.type):
                return np.stack(column.to_numpy())
            return (column.cast("double") if types.is_decimal(column.type) else column).to_numpy()

        yield {
            name: (partial(read, name), said.get(name, {}))
            for name in flattened(schema.empty_table()).column_names
        }


_READERS: dict[str, Callable[..., Any]] = {
    _PARQUET: _parquet,
    _HDF5: _hdf5,
    _MATLAB_HDF5: partial(_hdf5, separator="."),
    _CLASSIC: _classic,
    _MATLAB: _matlab,
}
