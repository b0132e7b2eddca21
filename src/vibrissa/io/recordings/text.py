"""CSV and its kin by pandas, with the columns that [recording] names; what else the file holds is
not looked at.
"""

import csv
from collections.abc import Iterator, Sequence
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vibrissa.files import InputError, check_last_line, readable, text_of
from vibrissa.io.recordings.arrays import Array, Columns, matched, reading
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.io.recordings.units import is_unit

_COMMENTS = ("#", "%")
_DELIMITERS = (",", ";", "\t", "|", " ")
_MISSING = ("", "nan", "na", "n/a", "#n/a", "null", "none")
# Loggers put a few dozen lines before the names.
_LONGEST_PREAMBLE = 200


class _Header(NamedTuple):
    """Where the line of names stands, counted from 0, and what is in it."""

    line: int
    names: list[str]
    delimiter: str
    is_comment: bool


class _Row(NamedTuple):
    """A line, its number from 1, and a delimiter at the end taken off."""

    number: int
    text: str


def columns(
    file: Path,
    table: RecordingTable,
    wanted: Sequence[str],
    exactly: Sequence[str] = (),
) -> Columns:
    """Columns of a text.

    Parameters
    ----------
    file
        Text with a line of names, then one of units or none, and a line a sample. Lines before the
        names, blank lines, those that begin with # or %, and empty rows at the end are passed over.
    table
        Encoding, delimiter (where it gives none, the one that parts most of the wanted names),
        decimal sign, and how many lines to skip before the names are looked for.
    wanted
        The columns to read; those that are not there are left out.
    exactly
        The names that the file has to have, no other and in this order; then each line is a row, no
        cell is empty, and the delimiter is a comma, or that of Excel's line `sep=;`.

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
    delimiters = (table.delimiter,) if table.delimiter else _DELIMITERS[table.decimal == "," :]
    if exactly:
        first = lines[0].strip('" ').lower() if lines else ""
        delimiters = (first.removeprefix("sep="),) if first.startswith("sep=") else (",",)
    with reading(file, "text"):
        header = _header(lines, table.skip_lines, delimiters, wanted)
    if header is None:
        raise InputError(
            f"{file}: {'empty' if not lines else f'{len(lines)} lines'}; allowed is CSV with the "
            f"columns {','.join(exactly or wanted[:1])} after skip_lines = {table.skip_lines}"
        )
    if exactly:
        _check_names(file, header, exactly)
    chosen = matched(wanted, header.names)
    places = {name: header.names.index(own) for name, own in chosen.items()}
    for own in chosen.values():
        if header.names.count(own) > 1:
            raise InputError(
                f"{file}, line {header.line + 1}: column {own!r} is there "
                f"{header.names.count(own)} times; allowed is once"
            )
    with reading(file, "text"):
        units = {} if exactly else _units(lines, header, places)
        rows = list(_rows(file, lines, header, skip=bool(units), every=bool(exactly)))
    if not rows:
        raise InputError(f"{file}: no rows; allowed is at least one sample")
    if rows[-1].number == len(lines):
        check_last_line(
            file,
            text,
            lines[header.line :],
            header.names,
            delimiter=header.delimiter,
            first=header.line + 1,
        )
    at = np.array([row.number for row in rows])
    times = (
        (table.time, table.time_unit),
        (table.pose_time, table.pose_time_unit or table.time_unit),
    )
    dates = [places[name] for name, unit in times if unit == "stamp" and name in places]
    with reading(file, "text"):
        frame = _parsed(rows, header.delimiter, table.decimal, sorted({*places.values()}), dates)
        if places and len(frame) != len(at):
            raise ValueError("a quote is not closed")
        arrays = {
            name: _numbers(
                file,
                name,
                frame[place].set_axis(at),
                table.decimal,
                header.delimiter,
                missing=() if exactly else _MISSING,
                is_stamp=place in dates,
            )
            for name, place in places.items()
        }
    return Columns(file, header.names, arrays, units, at)


def _decoded(file: Path, encoding: str) -> str:
    if encoding == "utf-8":
        return text_of(file)
    try:
        return file.read_text(encoding=encoding)
    except UnicodeError as error:
        raise InputError(
            f"{file}: no text in encoding = {encoding!r} ({error}); "
            "allowed is the encoding that it has"
        ) from error


def _header(
    lines: Sequence[str], skip: int, delimiters: Sequence[str], wanted: Sequence[str]
) -> _Header | None:
    """The first line with most of the names that are asked for, by the delimiter that gives most;
    a comment, as NumPy writes it, only where it holds more of them than any other line.
    """
    found = []
    for number, line in enumerate(lines[skip : skip + _LONGEST_PREAMBLE], skip):
        plain = line.strip(" ")
        is_comment = plain.startswith(_COMMENTS)
        if is_comment:
            plain = plain.lstrip("#% \t")
        for delimiter in delimiters if plain else ():
            names = [name.strip() for name in _cells(plain, delimiter)]
            while len(names) > 1 and not names[-1]:
                names.pop()
            found.append(_Header(number, names, delimiter, is_comment))
    return max(
        found,
        key=lambda header: (len(matched(wanted, header.names)), not header.is_comment),
        default=None,
    )


def _check_names(file: Path, header: _Header, exactly: Sequence[str]) -> None:
    names = [name.lower() for name in header.names]
    if names == list(exactly):
        return
    findings = {
        "missing": [name for name in exactly if name not in names],
        "unknown": [name for name in header.names if name.lower() not in exactly],
        "twice": sorted({name for name in exactly if names.count(name) > 1}),
    }
    finding = ", ".join(f"{word} {', '.join(found)}" for word, found in findings.items() if found)
    raise InputError(
        f"{file}, line {header.line + 1}: columns: {finding[:200] or 'another order'}; allowed are "
        f"{','.join(exactly)}; another layout is told by a table [recording] in the setup"
    )


def _units(lines: Sequence[str], header: _Header, places: dict[str, int]) -> dict[str, str]:
    """Units by name, where the line below the names holds no number in any of the columns, and a
    unit in one at least.
    """
    below = "".join(lines[header.line + 1 : header.line + 2])
    cells = [cell.strip().strip("[]()") for cell in _cells(below, header.delimiter)]
    if len(cells) < len(header.names) or any(
        cells[place][:1].isdigit() for place in places.values()
    ):
        return {}
    said = {name: cells[place] for name, place in places.items() if cells[place]}
    return said if any(map(is_unit, said.values())) else {}


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [""])


def _rows(
    file: Path, lines: Sequence[str], header: _Header, *, skip: bool, every: bool
) -> Iterator[_Row]:
    """Lines with as many cells as there are names; comments and blank lines only where `every` line
    counts.
    """
    delimiter, count = header.delimiter, len(header.names)
    stop = len(lines)
    while stop > header.line and not lines[stop - 1].strip(f'{delimiter}" \t'):
        stop -= 1
    for number, line in enumerate(lines[header.line + 1 + skip : stop], header.line + 2 + skip):
        text = line.rstrip(" ")
        if not every and (not text.strip() or text.lstrip().startswith(_COMMENTS)):
            continue
        plain = '"' not in text and delimiter != " "
        cells = text.count(delimiter) + 1 if plain else len(_cells(text, delimiter))
        while cells > count and text.endswith(delimiter):
            text, cells = text.removesuffix(delimiter).rstrip(" "), cells - 1
        if cells != count:
            raise InputError(
                f"{file}, line {number}: {cells} of {count} columns, the line is truncated or "
                f"damaged; allowed are {count} numbers a line"
            )
        yield _Row(number, text)


def _parsed(
    rows: Sequence[_Row], delimiter: str, decimal: str, places: list[int], dates: list[int]
) -> Any:
    import pandas as pd  # noqa: PLC0415

    return pd.read_csv(
        StringIO("\n".join(row.text for row in rows)),
        sep=r"\s+" if delimiter == " " else delimiter,
        decimal=decimal,
        header=None,
        usecols=places,
        dtype=dict.fromkeys(dates, str),
        na_filter=False,
        skipinitialspace=True,
        skip_blank_lines=False,
        low_memory=False,
    )


def _numbers(
    file: Path,
    name: str,
    cells: Any,
    decimal: str,
    delimiter: str,
    *,
    missing: Sequence[str],
    is_stamp: bool,
) -> Array:
    """Floats of cells, which pandas leaves as texts where one of them is no number."""
    import pandas as pd  # noqa: PLC0415

    if cells.dtype.kind in "iuf":
        return cells.to_numpy(np.float64)
    texts = cells.astype(str).str.strip()
    known = texts[~texts.str.lower().isin(missing)]
    if is_stamp:
        dates = pd.to_datetime(known, format="ISO8601", utc=True, errors="coerce")
        numbers = (dates - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
    else:
        points = known if decimal == "." else known.replace({r"\.": "?", ",": "."}, regex=True)
        numbers = pd.to_numeric(points, errors="coerce").astype(float)
    bad = known[numbers.isna() & ~known.str.lower().isin(("nan", "-nan"))]
    if len(bad):
        allowed = "a date of ISO 8601" if is_stamp else "a number"
        if not is_stamp and decimal == "." != delimiter and "," in bad.iloc[0]:
            allowed += ", with decimal = ',' in [recording] where a comma is meant"
        raise InputError(
            f"{file}, line {bad.index[0]}: {name} = {bad.iloc[0][:40]!r}; allowed is {allowed}"
        )
    return numbers.reindex(cells.index).to_numpy(np.float64)
