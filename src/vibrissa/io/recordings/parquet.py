"""Parquet: one column, or one list of fixed length, a quantity."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vibrissa.files import InputError
from vibrissa.io.recordings.arrays import MOST_ROWS, Array, Columns
from vibrissa.io.recordings.libraries import library
from vibrissa.io.recordings.limits import Budget
from vibrissa.io.recordings.parquet_footer import Chunk, chunks

_STRING_LIMIT = 16 * 2**20
_CONTAINER_LIMIT = 1_000_000
_DEEPEST = 8
_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


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
        If the file is damaged, a column holds no numbers, or it claims more rows or bytes than
        allowed.
    """
    arrow, parquet = library("pyarrow"), library("pyarrow.parquet")
    try:
        claims = list(chunks(file))
        with parquet.ParquetFile(
            file,
            thrift_string_size_limit=_STRING_LIMIT,
            thrift_container_size_limit=_CONTAINER_LIMIT,
        ) as opened:
            names = list(_names(opened.schema_arrow))
            chosen = [name for name in dict.fromkeys(wanted) if name in names]
            _check_claims(file, opened.metadata.num_rows, claims, chosen)
            table = _flattened(opened.read(columns=chosen, use_threads=False))
            units = {field.name: _unit(field.metadata) for field in opened.schema_arrow}
    except InputError:
        raise
    except (
        arrow.ArrowException,
        OSError,
        ValueError,
        KeyError,
        IndexError,
        OverflowError,
        MemoryError,
    ) as error:
        raise InputError(
            f"{file}: damaged Parquet ({str(error)[:200]}); allowed is a whole Parquet file"
        ) from error
    return Columns(
        file,
        names,
        lambda name: _numbers(file, name, table.column(name).combine_chunks()),
        units.get,
    )


def _names(fields: Any, prefix: str = "", depth: int = 0) -> Iterator[str]:
    """Columns, and the parts of those that are structs as `column.part`."""
    arrow = library("pyarrow")
    for field in fields:
        yield f"{prefix}{field.name}"
        if arrow.types.is_struct(field.type) and depth < _DEEPEST:
            yield from _names(field.type, f"{prefix}{field.name}.", depth + 1)


def _flattened(table: Any) -> Any:
    arrow = library("pyarrow")
    for _ in range(_DEEPEST):
        if not any(arrow.types.is_struct(field.type) for field in table.schema):
            break
        table = table.flatten()
    return table


def _check_claims(file: Path, rows: int, claims: Sequence[Chunk], chosen: Sequence[str]) -> None:
    if not 0 <= rows <= MOST_ROWS:
        raise InputError(f"{file}: claims {rows} rows; allowed are at most {MOST_ROWS}")
    budget = Budget(file)
    for claim in claims:
        name = ".".join(claim.path)
        if any(name == column or name.startswith(f"{column}.") for column in chosen):
            budget.take(max(claim.size, 8 * claim.values), f"column {name[:60]!r}")


def _numbers(file: Path, name: str, column: Any) -> Array:
    """Floats (n,), or (n, k) of a list of equal lengths."""
    arrow = library("pyarrow")
    kind = column.type
    if (
        arrow.types.is_list(kind)
        or arrow.types.is_large_list(kind)
        or arrow.types.is_fixed_size_list(kind)
    ):
        inner = column.flatten()
        width = len(inner) // max(len(column), 1)
        lengths = {len(row) if row is not None else -1 for row in column}
        if lengths != {width}:
            raise InputError(
                f"{file}: column {name!r} holds lists of {sorted(lengths)[:5]} numbers; allowed are lists of equal length"
            )
        return _numbers(file, name, inner).reshape(len(column), width)
    try:
        if arrow.types.is_timestamp(kind) or arrow.types.is_duration(kind):
            return _floats(column.cast(arrow.int64())) * _SECONDS[kind.unit]
        if (
            arrow.types.is_integer(kind)
            or arrow.types.is_floating(kind)
            or arrow.types.is_decimal(kind)
        ):
            return _floats(column.cast(arrow.float64(), safe=False))
    except arrow.ArrowException as error:
        raise InputError(
            f"{file}: column {name!r} of type {kind} cannot be read as numbers ({str(error)[:100]}); allowed are numbers"
        ) from error
    raise InputError(f"{file}: column {name!r} is of type {str(kind)[:60]}; allowed are numbers")


def _floats(column: Any) -> Array:
    return np.asarray(column.to_numpy(zero_copy_only=False), dtype=np.float64)


def _unit(metadata: dict[bytes, bytes] | None) -> str | None:
    text = (metadata or {}).get(b"units") or (metadata or {}).get(b"unit")
    return text.decode(errors="replace") if text else None
