"""HDF5, NetCDF 4 and MATLAB 7.3, which are all HDF5, and the classic NetCDF."""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from vibrissa.files import InputError
from vibrissa.io.recordings.arrays import MOST_ROWS, Array, Columns
from vibrissa.io.recordings.limits import Budget

_MOST_NAMES = 2000
_DAMAGED = (
    OSError,
    RuntimeError,
    KeyError,
    ValueError,
    TypeError,
    AttributeError,
    OverflowError,
    MemoryError,
    IndexError,
    SystemError,
)


def columns(file: Path, wanted: Sequence[str], *, matlab: bool = False) -> Columns:
    """Arrays of an HDF5 file by their paths, `group/array`, or `group/table/column` where an array
    has named columns.

    Parameters
    ----------
    file
        HDF5 of any writer.
    wanted
        The arrays to read; those that are not there are left out.
    matlab
        Whether arrays are stored column by column, and a struct's fields are named with a point.

    Raises
    ------
    InputError
        If the file is damaged, an array holds no numbers, lies in another file, or claims more rows
        or bytes than allowed.
    """
    import h5py  # noqa: PLC0415

    arrays: dict[str, Array] = {}
    found: dict[str, str | None] = {}
    budget = Budget(file)
    try:
        with h5py.File(file, "r") as opened:
            names = list(islice(_names(opened), _MOST_NAMES))
            if matlab:
                names = [name.replace("/", ".") for name in names]
            for name in dict.fromkeys(wanted):
                node, column = _node(
                    opened, (name.replace(".", "/") if matlab else name).strip("/")
                )
                if node is None:
                    continue
                arrays[name] = _numbers(file, name, node, column, budget, matlab=matlab)
                found[name] = _unit(node)
    except InputError:
        raise
    except _DAMAGED as error:
        raise InputError(
            f"{file}: damaged HDF5 ({str(error)[:200]}); allowed is a whole HDF5 file"
        ) from error
    return Columns(
        file,
        [*arrays, *(name for name in names if name not in arrays)],
        arrays.__getitem__,
        found.get,
    )


def _names(group: Any, prefix: str = "", depth: int = 0) -> Iterator[str]:
    """Paths of the arrays, and of the columns inside; links into other files are not followed, nor
    loops of groups.
    """
    import h5py  # noqa: PLC0415

    if depth > 8:
        return
    for key in group:
        if isinstance(group.get(key, getlink=True), h5py.ExternalLink):
            continue
        node = group.get(key)
        if isinstance(node, h5py.Group) and not key.startswith("#"):
            yield from _names(node, f"{prefix}{key}/", depth + 1)
        elif isinstance(node, h5py.Dataset):
            yield f"{prefix}{key}"
            yield from (f"{prefix}{key}/{column}" for column in node.dtype.names or ())


def _node(opened: Any, path: str) -> tuple[Any, str | None]:
    """Array at a path, and the name of the column in it where the last part is one."""
    import h5py  # noqa: PLC0415

    here = opened
    parts = path.split("/")
    for index, part in enumerate(parts):
        if isinstance(here, h5py.Dataset):
            rest = "/".join(parts[index:])
            return (here, rest) if rest in (here.dtype.names or ()) else (None, None)
        if (
            not isinstance(here, h5py.Group)
            or not part
            or part not in here
            or isinstance(here.get(part, getlink=True), h5py.ExternalLink)
        ):
            return None, None
        here = here[part]
    return (here, None) if isinstance(here, h5py.Dataset) else (None, None)


def _numbers(
    file: Path, name: str, node: Any, column: str | None, budget: Budget, *, matlab: bool
) -> Array:
    kind = node.dtype if column is None else node.dtype[column]
    if kind.kind not in "iuf":
        raise InputError(f"{file}: {name!r} is of type {str(kind)[:60]}; allowed are numbers")
    if node.external or node.is_virtual:
        raise InputError(
            f"{file}: {name!r} lies in another file; allowed are arrays in the file itself"
        )
    if node.ndim not in {0, 1, 2} or node.size > 16 * MOST_ROWS:
        raise InputError(
            f"{file}: {name!r} has shape {node.shape}; allowed are (n,) and (n, k) of at most {MOST_ROWS} rows"
        )
    chunk = int(np.prod(node.chunks, dtype=np.float64)) if node.chunks else 0
    budget.take(node.size * max(8, node.dtype.itemsize), repr(name[:60]))
    if chunk * node.dtype.itemsize > budget.allowed:
        raise InputError(
            f"{file}: {name!r} is stored in pieces of {chunk} numbers; allowed are {budget.allowed} bytes, 64 MiB or 100 times the file"
        )
    stored = node[()] if column is None else node[column]
    return _flattened(_decoded(np.asarray(stored), dict(node.attrs)), transposed=matlab)


def _decoded(stored: np.ndarray, attributes: dict[str, Any]) -> Array:
    """Floats, with the packing and the missing values of the CF conventions undone."""
    # A damaged number of single precision may be a signalling NaN.
    with np.errstate(invalid="ignore"):
        numbers = stored.astype(np.float64)
    for key in ("_FillValue", "missing_value"):
        if (
            key in attributes
            and np.size(attributes[key]) == 1
            and np.asarray(attributes[key]).dtype.kind in "iuf"
        ):
            numbers[stored == np.ravel(attributes[key])[0]] = np.nan
    factor, offset = (
        float(np.ravel(attributes.get(key, default))[0])
        for key, default in (("scale_factor", 1.0), ("add_offset", 0.0))
    )
    return numbers if (factor, offset) == (1.0, 0.0) else numbers * factor + offset


def _flattened(numbers: np.ndarray, *, transposed: bool) -> Array:
    """Rows first; a matrix of one row or column is a vector."""
    rows = numbers.T if transposed else numbers
    return np.atleast_1d(rows.ravel() if rows.ndim == 2 and 1 in rows.shape else rows)


def _unit(node: Any) -> str | None:
    value = node.attrs.get("units", node.attrs.get("unit"))
    if isinstance(value, np.ndarray):
        value = value.ravel()[0] if value.size == 1 else None
    if isinstance(value, bytes):
        value = value.decode(errors="replace")
    return value if isinstance(value, str) else None


def classic_columns(file: Path, wanted: Sequence[str]) -> Columns:
    """Variables of a NetCDF 3 file.

    Parameters
    ----------
    file
        NetCDF, classic or with 64-bit offsets.
    wanted
        The variables to read; those that are not there are left out.

    Raises
    ------
    InputError
        If the file is damaged, a variable holds no numbers, or claims more than the file holds.
    """
    from io import BytesIO  # noqa: PLC0415

    from scipy.io import netcdf_file  # noqa: PLC0415

    arrays: dict[str, Array] = {}
    found: dict[str, str | None] = {}
    try:
        # From memory: what a header claims is then read from what is there.
        with netcdf_file(BytesIO(file.read_bytes()), "r", mmap=False) as opened:
            names = list(opened.variables)
            for name in dict.fromkeys(wanted):
                variable = opened.variables.get(name)
                if variable is None:
                    continue
                stored = np.array(variable[:])
                if stored.dtype.kind not in "iuf" or stored.ndim > 2:
                    raise InputError(
                        f"{file}: {name!r} has type {stored.dtype} and shape {stored.shape}; allowed are numbers (n,) or (n, k)"
                    )
                arrays[name] = _flattened(_decoded(stored, _attributes(variable)), transposed=False)
                unit = getattr(variable, "units", None)
                found[name] = unit.decode(errors="replace") if isinstance(unit, bytes) else None
    except InputError:
        raise
    except (*_DAMAGED, AssertionError) as error:
        raise InputError(
            f"{file}: damaged NetCDF ({str(error)[:200]}); allowed is a whole NetCDF file"
        ) from error
    return Columns(file, names, arrays.__getitem__, found.get)


def _attributes(variable: Any) -> dict[str, Any]:
    keys = ("_FillValue", "missing_value", "scale_factor", "add_offset")
    return {key: getattr(variable, key) for key in keys if hasattr(variable, key)}
