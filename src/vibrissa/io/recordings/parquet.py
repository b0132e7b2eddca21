"""Parquet: one column, or one list of fixed length, a quantity."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vibrissa.files import InputError
from vibrissa.io.recordings.arrays import Array, Columns, matched, reading
from vibrissa.io.recordings.libraries import library
from vibrissa.io.recordings.units import factor


def columns(file: Path, wanted: Sequence[str]) -> Columns:
    """Columns of a Parquet file, parts of structs as `column.part`; nulls are NaN, dates seconds
    since 1970.

    Parameters
    ----------
    file
        As any writer of tables leaves it.
    wanted
        The columns to read; those that are not there are left out.

    Raises
    ------
    InputError
        If the file is damaged, or a column holds no numbers.
    """
    with reading(file, "Parquet"), library("pyarrow.parquet").ParquetFile(file) as opened:
        schema = opened.schema_arrow
        names = _flattened(schema.empty_table()).column_names
        chosen = matched(wanted, names)
        table = _flattened(opened.read(columns=list(chosen.values())))
        arrays = {name: _numbers(file, name, table[own]) for name, own in chosen.items()}
        units = {field.name: _unit(field.metadata or {}) for field in schema}
    return Columns(file, names, arrays, {name: units.get(own) for name, own in chosen.items()})


def _flattened(table: Any) -> Any:
    """A table with a column for each part of a struct."""
    arrow = library("pyarrow")
    while any(arrow.types.is_struct(kind) for kind in table.schema.types):
        table = table.flatten()
    return table


def _numbers(file: Path, name: str, column: Any) -> Array:
    """Floats (n,), or (n, k) of lists of one length."""
    arrow, kind = library("pyarrow"), column.type
    if hasattr(kind, "value_type"):
        compute = library("pyarrow.compute")
        lengths = set(compute.list_value_length(column).to_pylist())
        if len(lengths) > 1 or None in lengths:
            raise InputError(
                f"{file}: {name!r} holds lists of {lengths} numbers; "
                "allowed are lists of one length"
            )
        return _numbers(file, name, compute.list_flatten(column)).reshape(len(column), -1)
    scale = 1.0
    if arrow.types.is_timestamp(kind) or arrow.types.is_duration(kind):
        column, scale = column.cast(arrow.int64()), factor(kind.unit)
    elif not (
        arrow.types.is_integer(kind)
        or arrow.types.is_floating(kind)
        or arrow.types.is_decimal(kind)
    ):
        raise InputError(f"{file}: {name!r} is of type {kind}; allowed are numbers")
    floats = column.cast(arrow.float64(), safe=False).to_numpy()
    return np.asarray(floats) if scale == 1 else floats * scale


def _unit(metadata: dict[bytes, bytes]) -> str | None:
    text = metadata.get(b"units", metadata.get(b"unit"))
    return text.decode(errors="replace") if text else None
