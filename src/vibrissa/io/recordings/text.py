"""CSV and its kin, with the columns that [recording] names; what else the file holds is not looked
at.
"""

import csv
from array import array
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vibrissa.files import InputError, check_last_line, readable, text_of
from vibrissa.io.recordings.arrays import Columns
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.io.recordings.units import is_unit

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_COMMENTS = ("#", "%")
_DELIMITERS = (",", ";", "\t", "|", " ")
_MISSING = frozenset({"", "nan", "na", "n/a", "#n/a", "null", "none"})


def columns(
    file: Path, table: RecordingTable, wanted: Sequence[str], stamps: Sequence[str]
) -> Columns:
    """Columns of a text.

    Parameters
    ----------
    file
        Text with a line of names, then one of units or none, and a line a sample; blank lines and
        those that begin with # or % are passed over.
    table
        Encoding, delimiter (where it gives none, the one that parts most of the wanted names),
        decimal sign, and how many lines to skip before the names.
    wanted
        The columns to read; those that are not there are left out.
    stamps
        Those of them that are dates.

    Raises
    ------
    InputError
        If the file cannot be read, is no text, has no line of names, a name twice, or no rows, a
        line is cut off, or a cell is no number. Empty cells, NA and null are NaN.
    """
    if table.decimal == table.delimiter:
        raise InputError(
            f"{file}: decimal = ',' with delimiter = ','; allowed is another delimiter"
        )
    text = _decoded(readable(file), table.encoding)
    lines = text.splitlines()
    if len(lines) <= table.skip_lines:
        raise InputError(
            f"{file}: {len(lines)} lines; allowed is a line of names after skip_lines = {table.skip_lines}, and a line a sample"
        )
    header = _header(lines, table, wanted)
    delimiter = header.delimiter
    twice = next((name for name in dict.fromkeys(wanted) if header.names.count(name) > 1), None)
    if twice is not None:
        raise InputError(
            f"{file}, line {header.line + 1}: column {twice!r} is there {header.names.count(twice)} times; allowed is once"
        )
    check_last_line(
        file, text, lines[header.line :], header.names, delimiter=delimiter, first=header.line + 1
    )
    place = [
        (name, header.names.index(name), name in stamps)
        for name in dict.fromkeys(wanted)
        if name in header.names
    ]
    said = _units(lines, header, place)
    numbers: dict[str, array[float]] = {name: array("d") for name, _, _ in place}
    at = array("q")
    for number, cells in _rows(file, lines, header, skip=1 if said else 0):
        at.append(number)
        for name, index, is_stamp in place:
            numbers[name].append(
                _number(
                    file, number, name, cells[index], table.decimal, delimiter, is_stamp=is_stamp
                )
            )
    return Columns(
        file,
        header.names,
        lambda name: np.frombuffer(numbers[name], dtype=np.float64),
        said.get,
        np.frombuffer(at, dtype=np.int64),
    )


def _decoded(file: Path, encoding: str) -> str:
    if encoding == "utf-8":
        return text_of(file)
    try:
        return file.read_text(encoding=encoding)
    except UnicodeError as error:
        raise InputError(
            f"{file}: no text in encoding = {encoding!r} ({error}); allowed is the encoding that it has"
        ) from error


class _Header(NamedTuple):
    """Where the line of names stands, what is in it and what its cells are separated by."""

    line: int
    names: list[str]
    delimiter: str


def _header(lines: list[str], table: RecordingTable, wanted: Sequence[str]) -> _Header:
    """The first line that is neither blank nor a comment; or the comment above it, where it holds
    more of the names that are asked for, as NumPy writes it.
    """
    asked, above = set(wanted), None
    for line in range(table.skip_lines, len(lines)):
        plain = lines[line].lstrip()
        if not plain.startswith(_COMMENTS) and plain:
            found = [_names(line, lines[line], table, asked)]
            found += (
                [] if above is None else [_names(above, lines[above].lstrip("#% \t"), table, asked)]
            )
            return max(found, key=lambda header: len(asked.intersection(header.names)))
        above = line if plain else above
    return _Header(table.skip_lines, [], ",")


def _names(line: int, text: str, table: RecordingTable, asked: set[str]) -> _Header:
    """Names of a line, by the delimiter that is given, or the one that gives most of the names
    asked for.
    """
    delimiters = (
        (table.delimiter,)
        if table.delimiter is not None
        else _DELIMITERS
        if table.decimal == "."
        else _DELIMITERS[1:]
    )
    found = [
        _Header(line, [name.strip() for name in _cells(text, delimiter)], delimiter)
        for delimiter in delimiters
    ]
    return max(found, key=lambda header: len(asked.intersection(header.names)))


def _units(
    lines: list[str], header: _Header, place: Sequence[tuple[str, int, bool]]
) -> dict[str, str]:
    """Units by name, where the line below the names holds no number in any of the columns, and a
    unit in one at least.
    """
    below = next((line for line in lines[header.line + 1 : header.line + 2] if line.strip()), None)
    cells = (
        []
        if below is None
        else [cell.strip().strip("[]()") for cell in _cells(below, header.delimiter)]
    )
    if len(cells) != len(header.names) or any(cells[index][:1].isdigit() for _, index, _ in place):
        return {}
    said = {name: cells[index] for name, index, _ in place if cells[index]}
    return said if any(is_unit(unit) for unit in said.values()) else {}


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error:
        # Of more letters than any number or name has.
        return line.split(delimiter)


def _rows(
    file: Path, lines: list[str], header: _Header, skip: int
) -> Iterator[tuple[int, list[str]]]:
    """Numbers of the lines, from 1, and their cells; blank lines and comments are passed over."""
    count = len(header.names)
    for index in range(header.line + 1 + skip, len(lines)):
        line = lines[index]
        if not line.strip() or line.lstrip().startswith(_COMMENTS):
            continue
        cells = _cells(line, header.delimiter)
        if len(cells) == count + 1 and not cells[-1].strip():
            cells.pop()
        if len(cells) != count:
            raise InputError(
                f"{file}, line {index + 1}: {len(cells)} of {count} columns, the line is truncated or damaged; allowed are {count} cells a line"
            )
        yield index + 1, cells


def _number(
    file: Path, line: int, name: str, cell: str, decimal: str, delimiter: str, *, is_stamp: bool
) -> float:
    plain = cell.strip().strip('"')
    if plain.lower() in _MISSING:
        return np.nan
    try:
        if is_stamp:
            when = datetime.fromisoformat(plain)
            return ((when if when.tzinfo else when.replace(tzinfo=UTC)) - _EPOCH).total_seconds()
        return float(
            plain.replace("_", "?")
            if decimal == "."
            else plain.replace("_", "?").replace(".", "?").replace(",", ".")
        )
    except (ValueError, OverflowError):
        allowed = "a date of ISO 8601" if is_stamp else "a number"
        if not is_stamp and decimal == "." != delimiter and "," in plain:
            allowed += ", with decimal = ',' in [recording] where a comma is meant"
        raise InputError(
            f"{file}, line {line}: {name} = {plain[:40]!r}; allowed is {allowed}"
        ) from None
