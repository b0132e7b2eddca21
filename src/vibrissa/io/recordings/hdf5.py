"""HDF5, NetCDF 4 and MATLAB 7.3, which are all HDF5, and the classic NetCDF."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vibrissa.io.recordings.arrays import Array, Columns, matched, numbers, reading

# Deeper groups are loops of links.
_DEEPEST = 8
_PACKING = ("_FillValue", "missing_value", "scale_factor", "add_offset")


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
        If the file is damaged, or an array holds no numbers.
    """
    import h5py  # noqa: PLC0415

    with reading(file, "HDF5"):
        import h5py  # noqa: PLC0415

        with h5py.File(file, "r") as opened:
            held = {
                place.replace("/", ".") if matlab else place: (node, column)
                for place, node, column in _places(opened)
            }
            found = {}
            for name, place in matched(wanted, held).items():
                node, column = held[place]
                stored = np.asarray(node[()] if column is None else node[column])
                found[name] = stored.T if matlab else stored, dict(node.attrs)
        return _columns(file, list(held), found)


def _places(group: Any, prefix: str = "", depth: int = 0) -> Iterator[tuple[str, Any, str | None]]:
    """Path, array and, of an array with named columns, the column's name."""
    for key in group if depth < _DEEPEST else ():
        node, place = group.get(key), f"{prefix}{key}"
        if hasattr(node, "dtype"):
            yield place, node, None
            yield from ((f"{place}/{column}", node, column) for column in node.dtype.names or ())
        # MATLAB keeps the contents of its cells under #refs#.
        elif hasattr(node, "keys") and not key.startswith("#"):
            yield from _places(node, f"{place}/", depth + 1)


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
        If the file is damaged, or a variable holds no numbers.
    """
    from scipy.io import netcdf_file  # noqa: PLC0415

    with reading(file, "NetCDF"), netcdf_file(file, "r", mmap=False) as opened:
        held = opened.variables
        found = {
            name: (np.array(held[own][:]), vars(held[own]))
            for name, own in matched(wanted, held).items()
        }
        return _columns(file, list(held), found)


def _columns(
    file: Path, names: list[str], found: Mapping[str, tuple[np.ndarray, Mapping[str, Any]]]
) -> Columns:
    """Columns of what is stored, and of its attributes."""
    arrays = {
        name: unpacked(numbers(file, name, stored), attributes)
        for name, (stored, attributes) in found.items()
    }
    units = {name: unit_of(attributes) for name, (_, attributes) in found.items()}
    return Columns(file, names, arrays, units)


def unpacked(floats: Array, attributes: Mapping[str, Any]) -> Array:
    """Numbers with the packing and the missing values of the CF conventions undone, by xarray."""
    packing = {key: attributes[key] for key in _PACKING if key in attributes}
    if not packing:
        return floats
    import xarray as xr  # noqa: PLC0415

    axes = [f"axis {axis}" for axis in range(floats.ndim)]
    data = xr.Dataset({"numbers": xr.Variable(axes, floats, packing)})
    return np.asarray(xr.decode_cf(data)["numbers"], dtype=np.float64)


def unit_of(attributes: Mapping[str, Any]) -> str | None:
    """Text of the attribute `units`, or `unit`."""
    value = np.ravel(attributes.get("units", attributes.get("unit", [])))
    text = value[0] if value.size == 1 else None
    if isinstance(text, bytes):
        text = text.decode(errors="replace")
    return str(text) if isinstance(text, str) else None
