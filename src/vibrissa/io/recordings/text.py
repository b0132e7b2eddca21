"""CSV and its kin, with the columns that [recording] names; what else the file holds is not looked at."""

from array import array
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from vibrissa.files import InputError, check_last_line, readable, text_of
from vibrissa.io.recordings.arrays import Columns
from vibrissa.io.recordings.table import RecordingTable

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def columns(file: Path, table: RecordingTable, wanted: Sequence[str], stamps: Sequence[str]) -> Columns:
    """Columns of a text.

    Parameters
    ----------
    file
        UTF-8 text with a line of names, and then a line a sample.
    table
        Delimiter, decimal sign, and how many lines to skip before the names.
    wanted
        The columns to read; those that are not there are left out.
    stamps
        Those of them that are dates.

    Raises
    ------
    InputError
        If the file cannot be read, is no text, has no line of names, a name twice, or no rows, a line is cut off, or a cell is no number. An empty cell is NaN.
    """
    if table.decimal == table.delimiter:
        raise InputError(f"{file}: decimal = ',' with delimiter = ','; allowed is another delimiter")
    text = text_of(readable(file))
    lines = text.splitlines()
    skip = table.skip_lines
    if len(lines) <= skip:
        raise InputError(f"{file}: {len(lines)} lines; allowed is a line of names after skip_lines = {skip}, and a line a sample")
    names = [name.strip().strip('"') for name in _cells(lines[skip], table.delimiter)]
    wanted = [name for name in dict.fromkeys(wanted) if name in names]
    twice = next((name for name in wanted if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{file}, line {skip + 1}: column {twice!r} is there {names.count(twice)} times; allowed is once")
    check_last_line(file, text, lines[skip:], names, delimiter=table.delimiter, first=skip + 1)
    place = [(name, names.index(name), name in stamps) for name in wanted]
    numbers: dict[str, array[float]] = {name: array("d") for name in wanted}
    for number, cells in _rows(file, lines, skip, len(names), table.delimiter):
        for name, index, is_stamp in place:
            numbers[name].append(_number(file, number, name, cells[index], table.decimal, is_stamp=is_stamp))
    return Columns(file, names, lambda name: np.frombuffer(numbers[name], dtype=np.float64), first_line=skip + 2)


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else line.split(delimiter)


def _rows(file: Path, lines: list[str], skip: int, count: int, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    for index in range(skip + 1, len(lines)):
        cells = _cells(lines[index], delimiter)
        if len(cells) != count:
            raise InputError(
                f"{file}, line {index + 1}: {len(cells)} of {count} columns, the line is truncated or damaged; allowed are {count} cells a line"
            )
        yield index + 1, cells


def _number(file: Path, line: int, name: str, cell: str, decimal: str, *, is_stamp: bool) -> float:
    plain = cell.strip().strip('"')
    if not plain:
        return np.nan
    try:
        if is_stamp:
            when = datetime.fromisoformat(plain)
            return ((when if when.tzinfo else when.replace(tzinfo=UTC)) - _EPOCH).total_seconds()
        return float(plain.replace("_", "?") if decimal == "." else plain.replace("_", "?").replace(".", "?").replace(",", "."))
    except (ValueError, OverflowError):
        allowed = "a date of ISO 8601" if is_stamp else "a number"
        raise InputError(f"{file}, line {line}: {name} = {plain[:40]!r}; allowed is {allowed}") from None
