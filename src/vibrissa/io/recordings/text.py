"""CSV and its kin by pandas, with the columns that [recording] names; what else the file holds is
not looked at.
"""

import csv
from collections.abc import Iterator, Sequence
from io import StringIO
from pathlib import Path
from re import search
from typing import Any, NamedTuple

import numpy as np

from vibrissa.files import InputError, check_last_line, readable, text_of
from vibrissa.io.recordings.arrays import Array, Columns, matched, reading
from vibrissa.io.recordings.table import RecordingTable
from vibrissa.io.recordings.units import is_unit

_COMMENTS = ("#", "%")
_DELIMITERS = ",;\t| "
_MISSING = ("", "nan", "na", "n/a", "#n/a", "null", "none")
# Loggers put a few dozen lines before the names.
_LONGEST_PREAMBLE = 200


class _Header(NamedTuple):
    """The line of names: its place, counted from 0, and what is in it."""

    line: int
    names: list[str]
    delimiter: str
    is_comment: bool


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
    with reading(file, "text"):
        return _columns(file, text, table, wanted, exactly)


def _columns(
    file: Path, text: str, table: RecordingTable, wanted: Sequence[str], exactly: Sequence[str]
) -> Columns:
    import pandas as pd  # noqa: PLC0415

    lines = text.splitlines()
    header = _header(file, lines, table, wanted, exactly)
    chosen = matched(wanted, header.names)
    twice = next((own for own in chosen.values() if header.names.count(own) > 1), None)
    if twice is not None:
        raise InputError(
            f"{file}, line {header.line + 1}: column {twice!r} is there "
            f"{header.names.count(twice)} times; allowed is once"
        )
    places = {name: header.names.index(own) for name, own in chosen.items()}
    units = {} if exactly else _units(lines, header, places)
    rows = dict(_rows(file, lines, header, start=header.line + 1 + bool(units), every=exactly))
    if not rows:
        raise InputError(f"{file}: no rows; allowed is at least one sample")
    if len(lines) in rows:
        own = lines[header.line :]
        first, delimiter = header.line + 1, header.delimiter
        check_last_line(file, text, own, header.names, delimiter=delimiter, first=first)
    times = {table.time: table.time_unit, table.pose_time: table.pose_time_unit or table.time_unit}
    dates = {places[name] for name in places if times.get(name) == "stamp"}
    frame = pd.read_csv(
        StringIO("\n".join(rows.values())),
        sep=r"\s+" if header.delimiter == " " else header.delimiter,
        decimal=table.decimal,
        header=None,
        usecols=sorted(set(places.values())),
        dtype=dict.fromkeys(dates, str),
        na_filter=False,
        skipinitialspace=True,
        skip_blank_lines=False,
        low_memory=False,
    )
    if places and len(frame) != len(rows):
        raise ValueError("a quote is not closed")
    frame.index = list(rows)
    missing = () if exactly else _MISSING
    arrays = {}
    for name, place in places.items():
        decimal = "" if place in dates else table.decimal
        numbers, bad = _numbers(frame[place], missing, decimal)
        if len(bad):
            allowed = "a date of ISO 8601" if place in dates else "a number"
            if decimal == "." and header.delimiter != "," and "," in bad.iloc[0]:
                allowed += ", with decimal = ',' in [recording] where a comma is meant"
            raise InputError(
                f"{file}, line {bad.index[0]}: {name} = {bad.iloc[0][:40]!r}; allowed is {allowed}"
            )
        arrays[name] = numbers
    return Columns(file, header.names, arrays, units, np.array(list(rows)))


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
    file: Path,
    lines: Sequence[str],
    table: RecordingTable,
    wanted: Sequence[str],
    exactly: Sequence[str],
) -> _Header:
    """The first line with most of the names that are asked for, by the delimiter that gives most;
    a comment, as NumPy writes it, only where it holds more of them than any other line.
    """
    delimiters = table.delimiter or _DELIMITERS.replace(table.decimal, "")
    if exactly:
        stated = search(r'^"?sep=(.)', lines[0]) if lines else None
        delimiters = stated[1] if stated else ","
    found, skip = [], table.skip_lines
    for number, line in enumerate(lines[skip : skip + _LONGEST_PREAMBLE], skip):
        is_comment = line.lstrip().startswith(_COMMENTS)
        plain = line.lstrip("#% \t") if is_comment else line.strip(" ")
        for delimiter in delimiters if plain else ():
            names = [name.strip() for name in _cells(plain, delimiter)]
            while len(names) > 1 and not names[-1]:
                names.pop()
            found.append(_Header(number, names, delimiter, is_comment))
    if not found:
        raise InputError(
            f"{file}: {'empty' if not lines else f'{len(lines)} lines'}; allowed is CSV with the "
            f"columns {','.join(exactly or wanted[:1])} after skip_lines = {skip}"
        )
    best = max(found, key=lambda one: (len(matched(wanted, one.names)), not one.is_comment))
    names = [name.lower() for name in best.names]
    if not exactly or names == list(exactly):
        return best
    findings = {
        "missing": [name for name in exactly if name not in names],
        "unknown": [name for name in best.names if name.lower() not in exactly],
        "twice": [name for name in exactly if names.count(name) > 1],
    }
    finding = ", ".join(f"{word} {', '.join(held)}" for word, held in findings.items() if held)
    raise InputError(
        f"{file}, line {best.line + 1}: columns: {finding[:200] or 'another order'}; allowed are "
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
    file: Path, lines: Sequence[str], header: _Header, *, start: int, every: Sequence[str]
) -> Iterator[tuple[int, str]]:
    """Numbers of lines, from 1, and lines with as many cells as there are names; comments and blank
    lines only where every line counts.
    """
    delimiter, count = header.delimiter, len(header.names)
    stop = len(lines)
    while stop > start and not lines[stop - 1].strip(f'{delimiter}" \t'):
        stop -= 1
    for number, line in enumerate(lines[start:stop], start + 1):
        plain = line.strip()
        if not every and (not plain or plain.startswith(_COMMENTS)):
            continue
        text = line.rstrip(" ")
        parted = '"' in text or delimiter == " "
        cells = len(_cells(text, delimiter)) if parted else text.count(delimiter) + 1
        while cells > count and text.endswith(delimiter):
            text, cells = text.removesuffix(delimiter).rstrip(" "), cells - 1
        if cells != count:
            raise InputError(
                f"{file}, line {number}: {cells} of {count} columns, the line is truncated or "
                f"damaged; allowed are {count} numbers a line"
            )
        yield number, text


def _numbers(cells: Any, missing: Sequence[str], decimal: str) -> tuple[Array, Any]:
    """Floats of cells, which pandas leaves as texts where one of them is no number; without a
    decimal sign the seconds since 1970 of dates. With them the texts that are neither.
    """
    import pandas as pd  # noqa: PLC0415

    if cells.dtype.kind in "iuf":
        return cells.to_numpy(np.float64), ()
    texts = cells.astype(str).str.strip()
    known = texts[~texts.str.lower().isin(missing)]
    if decimal:
        points = known if decimal == "." else known.replace({r"\.": "?", ",": "."}, regex=True)
        numbers = pd.to_numeric(points, errors="coerce").astype(float)
    else:
        dates = pd.to_datetime(known, format="ISO8601", utc=True, errors="coerce")
        numbers = (dates - pd.Timestamp(0, tz="UTC")) / pd.Timedelta(seconds=1)
    bad = known[numbers.isna() & ~known.str.lower().isin(("nan", "-nan"))]
    return numbers.reindex(cells.index).to_numpy(np.float64), bad
